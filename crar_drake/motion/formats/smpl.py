"""Motions of the body models SMPL, SMPL-H and SMPL-X, of AMASS and WHAM.

A joint's turn against its parent is an axis times an angle; the pelvis's is in the
file's axes. The first 22 joints are the same in all three models; hands and face are
not read.

=====================================  =============  ================================
keys                                   shape          of
=====================================  =============  ================================
poses, trans                           (T, 3 J), (T,  AMASS: J is 52 (SMPL-H) or 55
                                       3)             (SMPL-X)
root_orient, pose_body, trans          (T, 3), (T,    AMASS of SMPL-X, beside `poses`
                                       63), (T, 3)
global_orient, body_pose, transl       (T, 3), (T,    the package smplx
                                       63), (T, 3)
pose_world, trans_world, frame_ids     (T, 72), (T,   WHAM, in a pickle, one such dict
                                       3), (T,)       for each person (SMPL)
mocap_framerate, mocap_frame_rate,     ()             [Hz]
fps, frame_rate
betas                                  (10) or more   the body's shape
=====================================  =============  ================================

Lengths are in metres; in AMASS's files, which have mocap_framerate or
mocap_frame_rate, z points up. WHAM's files say no rate. Sources: amass.is.tue.mpg.de;
`smplx/body_models.py` of github.com/vchoutas/smplx; `demo.py` of
github.com/yohanshin/WHAM.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.array_files import load_arrays, npz_names
from crar_drake.motion.formats.point_arrays import RATES, one_rate
from crar_drake.motion.joint_names import joints_by_name
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import Fact, Performer, repeated
from crar_drake.motion.performers.assemble import Recording, assemble
from crar_drake.motion.plain_pickle import read_plain_pickle
from crar_drake.motion.plausible import refuse_far
from crar_drake.motion.segment_tree import tree_of_turns
from crar_drake.motion.smpl_skeleton import (
    BODY_AXES,
    MEAN_OFFSETS,
    NAMES,
    PARENTS,
    offsets_of,
)

# Turns, side by side, and the translation.
_KEYS = (
    (("poses",), "trans"),
    (("root_orient", "pose_body"), "trans"),
    (("global_orient", "body_pose"), "transl"),
    (("pose_world",), "trans_world"),
)
_WHAM, _FRAMES = "pose_world", "frame_ids"

_SHAPE, _MODEL = "betas", "surface_model_type"
# Of AMASS's files alone, whose z points up.
_AMASS = {"mocap_framerate", "mocap_frame_rate"}
_USED = {*(k for keys, trans in _KEYS for k in (*keys, trans)), *RATES, _SHAPE, _MODEL}
_TURNS = 3 * len(NAMES)
_SMPLX_TURNS = 3 * 55
_SMPL_BODY = 3 * 23  # of `body_pose`; SMPL-X has 21 joints there


@dataclass(frozen=True)
class SmplMotion:
    """A motion of a body model."""

    turns: np.ndarray  # (T, 22, 3) of `smpl_skeleton.NAMES`, axis times angle [rad]
    translations: np.ndarray  # (T, 3) of the model [m]
    frame_rate: float  # samples per second [Hz]; 0 if the file does not say
    model: str  # "SMPL", whose skeleton SMPL-H has as well, or "SMPL-X"
    betas: np.ndarray  # (K,) the body's shape; none if the file does not say
    up: str = ""  # axis that points up by convention, or "" if there is none
    notes: tuple[str, ...] = ()  # what of the file is left out


def holds_smpl(path: Path) -> bool:
    """Whether an NPZ has turns of a body model's joints; a damaged one has not."""
    return _found(npz_names(path)) is not None


def smpl_performer(path: Path, name: str, options: MotionOptions) -> Performer:
    """The performer of an NPZ with the keys of AMASS or of the package smplx.

    Without the model's own file (`options.skeleton`) its lengths are the mean ones,
    whatever the person's. Turns are the person's; the floor is then where that body
    comes lowest.

    Raises:
        MotionError: the file is missing or damaged, an array is of another shape, the
            file says no rate, or an option is given that it does not need.
    """
    return _performer(_smpl_of(str(path), load_arrays(path, _USED)), name, options)


def wham_performer(path: Path, name: str, options: MotionOptions) -> Performer:
    """The performer of a pickle of WHAM: who is seen longest, the longest time.

    Raises:
        MotionError: as of `smpl_performer`, or it holds more than arrays and plain
            data.
    """
    return _performer(_read_wham(path), name, options)


def _read_wham(path: Path) -> SmplMotion:
    held = read_plain_pickle(path)
    people = {
        name: person
        for name, person in (held.items() if isinstance(held, dict) else ())
        if isinstance(person, dict) and isinstance(person.get(_WHAM), np.ndarray)
    }
    if not people:
        return _smpl_of(str(path), held if isinstance(held, dict) else {})
    chosen = max(people, key=lambda name: len(people[name][_WHAM]))
    where, person = f"{path}, person {chosen}", people[chosen]
    motion, notes = _smpl_of(where, person), []
    if len(people) > 1:
        others = ", ".join(str(name) for name in people if name != chosen)
        notes.append(f"person {chosen}, who is seen longest; others: {others}")
    frames = np.ravel(person.get(_FRAMES, ()))
    if len(frames) == len(motion.turns) and frames.dtype.kind in "iu":
        breaks = np.flatnonzero(np.diff(frames) != 1) + 1
        runs = np.split(np.arange(len(frames)), breaks)
        run = max(runs, key=len)
        if len(runs) > 1:
            notes.append(
                f"only frames {frames[run[0]]} to {frames[run[-1]]} of the video, "
                f"the longest of {len(runs)} times for which the person is seen"
            )
        motion = replace(
            motion, turns=motion.turns[run], translations=motion.translations[run]
        )
    return replace(motion, notes=tuple(notes))


def _smpl_of(where: str, arrays: Mapping[str, object]) -> SmplMotion:
    """The motion in named arrays; `where` is for errors."""
    found = _found(arrays)
    if found is None:
        raise MotionError(
            f"{where}: no turns of a body model's joints: "
            + ", or ".join(", ".join([*keys, trans]) for keys, trans in _KEYS)
        )
    keys, trans = found
    parts = [_rows(where, key, np.asarray(arrays[key])) for key in keys]
    translations = _rows(where, trans, np.asarray(arrays[trans]))
    lengths = {len(array) for array in (*parts, translations)}
    if len(lengths) > 1 or not len(translations):
        raise MotionError(
            f"{where}: numbers of frames differ or are zero: "
            + ", ".join(f"{key} {len(arrays[key])}" for key in (*keys, trans))
        )
    turns = np.hstack(parts)
    columns = turns.shape[1]
    if columns < _TURNS or columns % 3 or translations.shape[1] != 3:
        raise MotionError(
            f"{where}: {' and '.join(keys)} have {columns} columns and {trans} "
            f"{translations.shape[1]}; three for each of {len(NAMES)} joints or more, "
            "and three, are expected"
        )
    refuse_far(f"{where}: {trans}", translations)
    rate = next((arrays[key] for key in RATES if key in arrays), None)
    smplx = (
        columns == _SMPLX_TURNS
        or str(arrays.get(_MODEL, "")).lower() == "smplx"
        or (len(keys) > 1 and parts[1].shape[1] != _SMPL_BODY)
    )
    betas = np.asarray(arrays.get(_SHAPE, ()))
    betas = betas.astype(float) if betas.dtype.kind in "fiu" else np.zeros(0)
    return SmplMotion(
        turns=turns[:, :_TURNS].reshape(-1, len(NAMES), 3),
        translations=translations,
        frame_rate=one_rate(where, rate),
        model="SMPL-X" if smplx else "SMPL",
        # Some have a row a frame, all of one body.
        betas=betas.reshape(-1, betas.shape[-1])[0] if betas.size else np.zeros(0),
        up="+z" if trans == "trans" and _AMASS & arrays.keys() else "",
    )


def _performer(motion: SmplMotion, name: str, options: MotionOptions) -> Performer:
    options.refuse(("unit", "joints"), f"motion {name} is of {motion.model}")
    rate, rate_source = options.rate_of(name, motion.frame_rate)
    if options.skeleton:
        offsets = _own_offsets(options.skeleton, motion.betas)
        lengths = Fact("lengths", "of the body's shape", "given", options.skeleton)
    else:
        offsets = MEAN_OFFSETS[motion.model]
        ignored = "betas are ignored" if motion.betas.size else "no betas"
        lengths = Fact("lengths", f"the mean {motion.model} body's", "assumed", ignored)
    turns = Rotation.from_rotvec(motion.turns.reshape(-1, 3)).as_matrix()
    turns = turns.reshape(*motion.turns.shape[:2], 3, 3).swapaxes(0, 1)
    # The pelvis turns about itself: its offset does not turn.
    root = motion.translations + offsets[0]
    tree = tree_of_turns(NAMES, PARENTS, [root, *offsets[1:]], turns)
    index = joints_by_name(NAMES)
    return assemble(
        Recording(
            name=name,
            format=motion.model,
            frame_rate=rate,
            rate_source=rate_source,
            positions={joint: tree.positions[i] for joint, i in index.items()},
            joints={joint: NAMES[i] for joint, i in index.items()},
            rotations={joint: tree.rotations[i] for joint, i in index.items()},
            body_axes=BODY_AXES,
            floor_unknown=not options.skeleton,
            unit_fact=Fact("unit", "m", "assumed", "as the model has it"),
            bones=len(NAMES),
            bones_called="joints",
            same=repeated(
                np.hstack(
                    [motion.translations, motion.turns.reshape(len(motion.turns), -1)]
                )
            ),
            notes=motion.notes,
            up=motion.up,
            facts=(lengths,),
            **tree.described(index),
        ),
        options,
    )


def _own_offsets(path: str | os.PathLike[str], betas: np.ndarray) -> np.ndarray:
    """(22, 3) offsets of the joints [m] of a body model's own file, for a shape.

    Args:
        path: an NPZ of SMPL-H or SMPL-X as it is given out (`model.npz`,
            `SMPLX_NEUTRAL.npz`): J_regressor (J, V), v_template (V, 3), shapedirs
            (V, 3, K).
        betas: (k,) of the body.

    Raises:
        MotionError: it is missing, damaged or none.
    """
    path = Path(path)
    keys = ("J_regressor", "v_template", "shapedirs")
    arrays = load_arrays(path, keys)
    if not set(keys) <= arrays.keys():
        raise MotionError(
            f"{path}: it is no NPZ of SMPL-H or SMPL-X: they have {', '.join(keys)}"
        )
    regressor, template, shapes = (arrays[key].astype(float) for key in keys)
    count = min(len(betas), shapes.shape[-1])
    try:
        vertices = template + shapes[..., :count] @ betas[:count]
        joints = regressor @ vertices
        if joints.ndim != 2 or len(joints) < len(NAMES) or joints.shape[1] != 3:
            raise ValueError
    except ValueError:
        shapes_found = ", ".join(f"{key} {arrays[key].shape}" for key in keys)
        raise MotionError(
            f"{path}: shapes of a body model are (J, V), (V, 3), (V, 3, K), not "
            f"{shapes_found}"
        ) from None
    return offsets_of(joints)


def _found(names: Iterable[object]) -> tuple[tuple[str, ...], str] | None:
    return next((f for f in _KEYS if set(f[0]) | {f[1]} <= set(names)), None)


def _rows(where: str, key: str, array: np.ndarray) -> np.ndarray:
    """(T, k) finite numbers; further axes, as of (T, J, 3), are laid side by side."""
    if array.dtype.kind not in "fiu" or array.ndim < 2:
        raise MotionError(
            f"{where}: {key} is an array {array.shape} of {array.dtype}; a row of "
            "numbers a frame is expected"
        )
    rows = array.reshape(len(array), -1).astype(float)
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        raise MotionError(
            f"{where}: {key}, frame {bad[0][0] + 1}, has a {rows[tuple(bad[0])]}, no "
            "finite number"
        )
    return rows
