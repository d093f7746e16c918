"""Pickles of motions: GMR's, with one motion, and motion_lib's, with several clips.

`gmr-pkl`, of GMR (general motion retargeting), is a dict:

===============  =========  ========================================================
key              shape      what
===============  =========  ========================================================
fps              number     frames per second [Hz]
root_pos         (T, 3)     x y z of the root in the world [m]
root_rot         (T, 4)     its orientation, x y z w (w x y z is told by its tilt)
dof_pos          (T, n)     joints [rad], in the order of the robot's model
local_body_pos   (T, B, 3)  origins of links in the root's frame [m], or None
link_body_list   B texts    their names, or None
===============  =========  ========================================================

`motion-lib-pkl`, of PHC, ASAP and others (usually by joblib), has such a dict per clip:

=================  ==============  ===================================================
key                shape           what
=================  ==============  ===================================================
fps                number          frames per second [Hz]
root_trans_offset  (T, 3)          x y z of the root in the world [m]
root_rot           (T, 4)          its orientation, x y z w
dof                (T, n)          joints [rad], in the order of the robot's model
pose_aa            (T, 1 + n, 3)   turns as axis times angle [rad]: of the root in the
                                   world, of each joint in its link; rows of zeros
                                   for links that were added may follow
=================  ==============  ===================================================

`joint_names` (or `dof_names`), a list of n texts, is understood where a file has it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.plain_pickle import read_plain_pickle, write_plain_pickle
from crar_drake.references.held_values import (
    check_frames,
    check_quaternions,
    numbers,
    stated_rate,
)
from crar_drake.references.quaternion_order import guess_quaternion_order
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody

USUAL_RATE = 30.0  # [Hz]

_GMR = {"position": "root_pos", "rotation": "root_rot", "joints": "dof_pos"}
_LIB = {"position": "root_trans_offset", "rotation": "root_rot", "joints": "dof"}
_PHUMA = {"position": "root_trans", "rotation": "root_ori", "joints": "dof_pos"}
_KEYS = {"gmr-pkl": _GMR, "motion-lib-pkl": _LIB, "phuma-npy": _PHUMA}
_COMPUTED = {
    "gmr-pkl": ("local_body_pos", "link_body_list"),
    "motion-lib-pkl": ("pose_aa",),
    "phuma-npy": (),
}
_PRECISION = {"gmr-pkl": "float64", "motion-lib-pkl": "float32", "phuma-npy": "float64"}
_JOINT_NAMES = ("joint_names", "dof_names")


def read_pickle(
    path: Path,
    layout: str | None,
    rate: float | None,
    joint_names: Sequence[str] | None,
) -> tuple[RobotMotion, ...]:
    """Reads all motions of a pickle; its keys tell the layout.

    Raises:
        MotionError: it holds more than data, is damaged, or of another layout.
    """
    held = read_plain_pickle(path)
    if not isinstance(held, dict) or not held:
        raise MotionError(f"{path}: it holds no dict, and so no motion")
    found = _layout(held)
    clips: dict[str, dict] = {"": held}
    if found is None:
        clips = {str(name): clip for name, clip in held.items()}
        kinds = {
            _layout(clip) if isinstance(clip, dict) else None for clip in clips.values()
        }
        found = kinds.pop() if len(kinds) == 1 else None
        if found is None:
            keys = ", ".join(str(key)[:30] for key in list(held)[:6])
            raise MotionError(
                f"{path}: it is no motion: GMR's has {', '.join(_GMR.values())}, "
                f"motion_lib's has clips with {', '.join(_LIB.values())}; this has "
                f"{keys}"
            )
    if layout is not None and layout != found:
        raise MotionError(f"{path}: its keys are those of {found}, not of {layout}")
    return tuple(
        _motion(path, name, clip, found, rate, joint_names, layout is not None)
        for name, clip in clips.items()
    )


def motion_of_clip(
    path: Path,
    held: object,
    layout: str,
    rate: float | None,
    joint_names: Sequence[str] | None,
) -> RobotMotion:
    """The motion in a dict with the keys of a layout that has one.

    Raises:
        MotionError: it is no dict, lacks a key, or an array is of another shape.
    """
    if not isinstance(held, dict) or not set(_KEYS[layout].values()) <= held.keys():
        has = ", ".join(str(key)[:30] for key in list(held)[:6]) if held else "nothing"
        keys = ", ".join(_KEYS[layout].values())
        raise MotionError(f"{path}: {layout} is a dict with {keys}; this has {has}")
    return _motion(path, "", held, layout, rate, joint_names, said=True)


def write_pickle(
    path: str | os.PathLike[str],
    motions: Sequence[RobotMotion],
    layout: str,
    robot: WholeBody | None,
) -> None:
    """Writes motions as a pickle that Python with any NumPy reads.

    Args:
        path: of the file.
        motions: one for GMR's layout.
        layout: its name.
        robot: that moves; its joints' axes are needed for `pose_aa`, and its links for
            `local_body_pos`, which is None without.

    Raises:
        MotionError: there is no robot where one is needed, or two clips have one name.
    """
    if layout == "gmr-pkl":
        write_plain_pickle(path, clip_of_motion(path, motions[0], layout, robot))
        return
    clips = {}
    for motion in motions:
        name = motion.clip or Path(motion.source).stem or "motion"
        if name in clips:
            raise MotionError(f"{path}: two clips are called {name!r}")
        clips[name] = clip_of_motion(path, motion, layout, robot)
    # A file that was one clip without a name stays so.
    if len(motions) == 1 and not motions[0].clip and motions[0].layout == layout:
        (clips,) = clips.values()
    write_plain_pickle(path, clips)


def _layout(held: Mapping) -> str | None:
    for layout, keys in _KEYS.items():
        if layout.endswith("-pkl") and set(keys.values()) <= held.keys():
            return layout
    return None


def _motion(
    path: Path,
    clip: str,
    held: dict,
    layout: str,
    rate: float | None,
    joint_names: Sequence[str] | None,
    said: bool,
) -> RobotMotion:
    where = f"{path}, clip {clip!r}" if clip else str(path)
    keys, guesses = _KEYS[layout], []
    if rate is None:
        rate = stated_rate(where, held, usual=USUAL_RATE, guesses=guesses)
    columns = {"position": 3, "rotation": 4, "joints": None}
    arrays = {
        what: numbers(where, held, key, None, columns[what])
        for what, key in keys.items()
    }
    check_frames(where, {key: arrays[what] for what, key in keys.items()})
    check_quaternions(where, keys["rotation"], arrays["rotation"])
    quaternions = arrays["rotation"].astype(float)
    order, evidence = guess_quaternion_order(quaternions)
    if order == "wxyz" and evidence.startswith("sure") and not said:
        guesses.append(
            f"{keys['rotation']} is wxyz, not xyzw as {layout} has it: {evidence} "
            f"(--layout {layout} takes it as xyzw)"
        )
    else:
        quaternions = quaternions[:, [3, 0, 1, 2]]
    names = ()
    for key in _JOINT_NAMES:
        if isinstance(held.get(key), list | tuple | np.ndarray):
            names = tuple(str(name) for name in held[key])
            break
    used = {*keys.values(), "fps", *_COMPUTED[layout]}
    return RobotMotion(
        joint_names=names or tuple(joint_names or ()),
        root_positions=arrays["position"].astype(float),
        root_quaternions=quaternions,
        joint_positions=arrays["joints"].astype(float),
        rate=rate,
        layout=layout,
        source=str(path),
        clip=clip,
        precision=arrays["joints"].dtype.name,
        guesses=tuple(guesses),
        extras={str(k): value for k, value in held.items() if k not in used},
        computed={key: held[key] for key in _COMPUTED[layout] if key in held},
    ).as_read()


def clip_of_motion(
    path: str | os.PathLike[str],
    motion: RobotMotion,
    layout: str,
    robot: WholeBody | None,
) -> dict:
    """The dict of a motion, with the keys of a layout; see `write_pickle`."""
    same = motion.layout == layout
    precision = motion.precision if same and motion.precision else _PRECISION[layout]
    computed = dict(motion.computed) if same and motion.is_as_read else {}
    if not set(_COMPUTED[layout]) <= computed.keys():
        computed = _computed(path, motion, layout, robot, precision)
    keys, rate = _KEYS[layout], motion.rate
    extras = dict(motion.extras) if same else {}
    if motion.joint_names and not set(_JOINT_NAMES) & extras.keys():
        extras["joint_names"] = list(motion.joint_names)
    for key in _JOINT_NAMES:
        if key in extras:
            extras[key] = list(motion.joint_names)
    return {
        "fps": int(rate) if rate == int(rate) else rate,
        keys["position"]: motion.root_positions.astype(precision),
        keys["rotation"]: motion.root_quaternions[:, [1, 2, 3, 0]].astype(precision),
        keys["joints"]: motion.joint_positions.astype(precision),
        **computed,
        **extras,
    }


def _computed(path, motion: RobotMotion, layout: str, robot, precision: str) -> dict:
    if layout == "phuma-npy":
        return {}
    if layout == "gmr-pkl":
        if robot is None:
            return {"local_body_pos": None, "link_body_list": None}
        links = robot.links_of(motion.joint_names)
        columns = robot.columns_in(motion.joint_names)
        p_RB, _ = robot.poses_in_root(motion.joint_positions[:, columns], links)
        return {"local_body_pos": p_RB.astype("float32"), "link_body_list": list(links)}
    if robot is None:
        raise MotionError(
            f"{path}: {layout} has the joints' turns about their axes (pose_aa), which "
            "follow from the robot's model: say which robot (--robot)"
        )
    order = [robot.joint_names.index(name) for name in motion.joint_names]
    turns = robot.joint_axes[order] * motion.joint_positions[:, :, None]
    root = motion.root_rotations.as_rotvec()[:, None]
    return {"pose_aa": np.concatenate([root, turns], axis=1).astype(precision)}
