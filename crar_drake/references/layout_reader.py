"""From what a file holds to the motions that it may mean, by the table of layouts."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError, NoMotionError
from crar_drake.motion.rates import SLOWEST, rate_doubt, rate_meant
from crar_drake.references import locomujoco_npz
from crar_drake.references.held_values import (
    FRAME,
    MANIFEST,
    joined,
    numbers,
    read_held,
    stated_rate,
    texts,
)
from crar_drake.references.layouts import (
    EULER,
    FILE_NAME,
    LAYOUTS,
    LINK_STATES,
    TURN,
    WXYZ,
    XYZW,
    Layout,
    Part,
)
from crar_drake.references.robot_motion import LENGTH_TOLERANCE, RobotMotion

# Columns of x y z w and w x y z from w x y z.
FROM_WXYZ = {XYZW: [1, 2, 3, 0], WXYZ: [0, 1, 2, 3]}
_TO_WXYZ = {XYZW: [3, 0, 1, 2], WXYZ: [0, 1, 2, 3]}

_IN_NAME = re.compile(r"_(\d{2,3})_jpos$")

# Links whose distance to the one before changes less than this hang on it [m]; what
# float32 rounds a few metres to is a tenth of it.
_RIGID = 1e-5

# Depth first, most links hang on the one before; breadth first, few do.
_DEPTH_FIRST_SHARE, _BREADTH_FIRST_SHARE = 0.6, 0.4

# How the guess begins that is none, of the order of joints.
ORDER_UNKNOWN = "whether joints are "

# Key of our own extras: poses of objects that follow the joints in `qpos`.
OBJECTS = "objects"


@dataclass(frozen=True)
class Reading:
    """What a file may mean."""

    motion: RobotMotion
    order: str  # of the numbers of the root's rotation, as it was read
    usual: bool  # whether files of that kind are meant so
    said: bool  # whether the user, or a certificate, says so

    @property
    def layout(self) -> Layout:
        """Its layout."""
        return LAYOUTS[self.motion.layout]

    def guessing(self, guess: str) -> Reading:
        """The same with a guess more, before the others."""
        guesses = (guess, *self.motion.guesses)
        return replace(self, motion=replace(self.motion, guesses=guesses))


def readings(
    path: Path,
    suffix: str,
    layout: str | None,
    rate: float | None,
    joint_names: Sequence[str] | None,
) -> list[list[Reading]]:
    """Of each motion in a file all that it may mean, at least one.

    Args:
        path: of the file.
        suffix: of its kind.
        layout, rate, joint_names: as of `motion_files.read_motion`.

    Raises:
        MotionError: the file is damaged, or of no layout.
    """
    held = read_held(path, suffix)
    found = []
    for clip, values in _clips(path, held, suffix, layout).items():
        where = f"{path}, clip {clip!r}" if clip else str(path)
        possible = _possible(where, values, suffix, layout)
        read = [_Values(where, values, candidate) for candidate in possible]
        turning = [values for values in read if not values.no_rotation()]
        if not turning:
            raise MotionError(f"{where}{read[0].no_rotation()}")
        made = []
        for values in turning:
            source = dict(source=str(path), clip=clip)
            made += values.readings(rate, joint_names, source, layout is not None)
        if layout is None and {x.layout.breadth_first for x in made} == {True, False}:
            made = _by_links(where, turning[0].held, made)
        found.append(made)
    return found


def _clips(
    path: Path, held: object, suffix: str, said: str | None
) -> dict[str, Mapping[str, object]]:
    """What a file holds of each of its motions, by its name; "" of a single one."""
    if not isinstance(held, Mapping):
        raise MotionError(f"{path}: it holds no dict, and so no motion")
    if said == locomujoco_npz.NAME or locomujoco_npz.MARKS & held.keys():
        _need(path, held, LAYOUTS[locomujoco_npz.NAME])
        return locomujoco_npz.trajectories(path, held)
    clips = suffix == ".pkl" and all(isinstance(v, dict) for v in held.values())
    if clips and all(_all_in(clip, suffix) for clip in held.values()):
        return {str(name): clip for name, clip in held.items()}
    return {"": held}


def _all_in(held: Mapping, suffix: str) -> list[Layout]:
    """The layouts all of whose keys are there, the usual ones first."""
    of_suffix = [layout for layout in LAYOUTS.values() if layout.suffix == suffix]
    found = [layout for layout in of_suffix if set(layout.keys) <= held.keys()]
    trajectories = [layout for layout in found if layout.name == locomujoco_npz.NAME]
    return trajectories or found


def _possible(where: str, held: Mapping, suffix: str, said: str | None) -> list[Layout]:
    """The layouts that a motion can have, the usual one first.

    Raises:
        MotionError: there is none, or not the one that is said.
    """
    found = _all_in(held, suffix)
    if any(layout.parts[2].keys == ("joint_pos",) for layout in found):
        with_root = _has_root(where, held, said)
        found = [layout for layout in found if bool(layout.root_columns) == with_root]
    if said is None and found:
        return found
    if said in [layout.name for layout in found]:
        return [LAYOUTS[said]]
    if said is None or (not found and LAYOUTS[said].parts[2].keys[0] in held):
        raise _unknown(where, held, suffix)
    if suffix == LAYOUTS[said].suffix == ".csv":
        has = "no heading" if "" in held else "a heading"
        raise MotionError(f"{where}: it has {has}, which is not as {said} has it")
    names = joined([layout.name for layout in found])
    raise MotionError(f"{where}: its keys are those of {names}, not those of {said}")


def _has_root(where: str, held: Mapping, said: str | None) -> bool:
    """Whether the root stands in `joint_pos`, before the joints."""
    columns = numbers(where, held, "joint_pos", None, None).shape[1]
    names = texts(held.get("joint_names"))
    with_root = said == "holosoma-npz"
    if names:
        if columns not in (len(names), len(names) + 7):
            raise MotionError(
                f"{where}: joint_pos has {columns} columns, but there are {len(names)} "
                f"joint names; {len(names)} columns are expected, or {len(names) + 7} "
                "with the root"
            )
        with_root = columns == len(names) + 7
    elif said is None and "joint_vel" in held:
        # A quaternion has one number more than an angular velocity.
        with_root = np.shape(held["joint_vel"])[1:] == (columns - 1,)
    return with_root


def _need(where: object, held: Mapping, layout: Layout) -> None:
    """Raises MotionError if keys of a layout are missing."""
    if missing := [key for key in layout.keys if key not in held]:
        raise MotionError(
            f"{where}: it has no {', '.join(missing)}, as {layout.name} has"
        )


def _unknown(where: object, held: Mapping, suffix: str) -> MotionError:
    """What to say of a file that is of no layout; what the nearest one has, if any."""
    layouts = [x for x in LAYOUTS.values() if x.suffix == suffix and "" not in x.keys]

    begun = [x for x in layouts if {*x.keys, *x.names} & held.keys()]
    for layout in sorted(begun, key=lambda x: len(set(x.keys) - held.keys())):
        _need(where, held, layout)
    known = "; ".join(
        f"{layout.used_by.split(',')[0]}'s has {', '.join(layout.keys)}"
        for layout in layouts
    )
    log = " (it looks like the log of a run)" if "signed_distances" in held else ""
    has = f"; this has {joined(held)}"
    return NoMotionError(f"{where}: it is no motion{log}: {known}{has}")


class _Values:
    """What a file holds of one motion, as a layout has it."""

    def __init__(self, where: str, held: Mapping, layout: Layout) -> None:
        """
        Raises:
            MotionError: arrays are of another shape, or have different frames.
        """
        self.where, self.held, self.layout = where, held, layout
        self.names = next(filter(None, (texts(held.get(k)) for k in layout.names)), ())
        position, rotation, joints = layout.parts
        if layout.has_columns:
            joints = self._named_columns(joints.keys[0].removeprefix("*"))
        self.position = self._of(position, 3)
        self.rotation = self._of(rotation, 3 if layout.order in (EULER, TURN) else 4)
        self.joints = self._of(joints, None)
        shapes = [
            values.shape for values in (self.position, self.rotation, self.joints)
        ]
        if len({shape[0] for shape in shapes}) > 1 or 0 in shapes[2]:
            raise MotionError(
                f"{where}: numbers of frames differ, or there are none: of root and "
                f"joints {shapes}"
            )
        self.objects = None
        if joints.keys == ("qpos",) and layout.name != locomujoco_npz.NAME:
            self._part_objects()

    def _named_columns(self, end: str) -> Part:
        """Columns of the joints, whose names are what stands before an end."""
        used = {*self.layout.keys, FRAME, self.layout.rate}
        keys = [key for key in self.held if key.endswith(end) and key not in used]
        if not keys:
            raise MotionError(f"{self.where}: its heading has no JOINT{end}")
        self.names = tuple(key.removesuffix(end) for key in keys)
        return Part(tuple(keys))

    def _of(self, part: Part, count: int | None) -> np.ndarray:
        """(T, count) of a part; of links the root's."""
        where, held, before = self.where, self.held, self.layout.root_columns
        if self.layout.has_columns:
            return np.column_stack([numbers(where, held, k, None) for k in part.keys])
        (key,) = part.keys
        if part.of_links:
            values = numbers(where, held, key, None, None, count)
            if not values.size:
                raise MotionError(f"{where}: {key} {values.shape} is of no link")
            return values[:, 0]
        values = numbers(where, held, key, None, None if before else count)
        if before and values.shape[1] <= before:
            raise MotionError(
                f"{where}: {key or 'it'} has {values.shape[1]} columns; a robot's "
                "motion has x, y, z, its root's orientation, and at least one joint"
            )
        return values[:, part.first :][:, :count]

    def _part_objects(self) -> None:
        """Takes poses of objects from behind the joints of `qpos`: what has quaternions
        there, and no names."""
        keep, first = self.joints.shape[1], self.layout.parts[1].first
        while keep > max(7, len(self.names)) and _are_rotations(
            self.joints[:, keep - 7 : keep][:, first : first + 4]
        ):
            keep -= 7
        if keep < self.joints.shape[1]:
            self.joints, self.objects = self.joints[:, :keep], self.joints[:, keep:]

    def no_rotation(self) -> str:
        """What is wrong with the root's quaternions, or ""."""
        if self.layout.order not in FROM_WXYZ:
            return ""
        first, what = self.layout.parts[1].first, self.layout.parts[1].keys[0]
        if self.layout.root_columns:
            what = f"the root's quaternion (columns {first + 1} to {first + 4})"
        length = np.linalg.norm(self.rotation, axis=1)
        if len(zero := np.flatnonzero(length < 1e-6)):
            return f", frame {zero[0] + 1}: {what} has length zero"
        if _are_rotations(self.rotation) or not np.isfinite(length).all():
            return ""  # what is no finite number is told of any column
        frame = int(np.abs(length - 1.0).argmax())
        return (
            f": {what} in frame {frame + 1} has length {length[frame]:.3g}, and is no "
            "rotation; a root that stands elsewhere is to be put there"
        )

    def readings(
        self,
        rate: float | None,
        joint_names: Sequence[str] | None,
        source: Mapping[str, str],
        said: bool,
    ) -> Iterator[Reading]:
        """Yields the motion, and that with the quaternion's other order, if there is
        no layout of its own for it."""
        layout = self.layout
        motion = self._motion(rate, joint_names, source)
        yield Reading(motion, layout.order, layout.usual, said)
        other = {WXYZ: XYZW, XYZW: WXYZ}.get(layout.order)
        alike = {x.order for x in LAYOUTS.values() if x.parts == layout.parts}
        if said or other is None or other in alike:
            return
        quaternions = _quaternions(self.rotation.astype(float), other)
        # What follows from the root is in another order, too.
        kept = {k: v for k, v in motion.computed.items() if k == "body_pos_w"}
        turned = replace(motion, root_quaternions=quaternions, computed=kept)
        yield Reading(turned.as_read(), other, False, said)

    def _motion(self, rate, joint_names, source) -> RobotMotion:
        layout, guesses = self.layout, []
        rate = self._rate(guesses) if rate is None else float(rate)
        position = layout.metre * self.position.astype(float)
        if 7 + self.joints.shape[1] == layout.raised_columns:
            position = position + [0.0, 0.0, layout.raised]
            guesses.append(
                f"with {layout.raised_columns} columns it is a G1: its heights are "
                f"those above its first pose, {layout.raised:g} m"
            )
        if self.objects is not None:
            columns = self.objects.shape[1]
            guesses.append(f"the last {columns} of its columns are poses of objects")
        if MANIFEST in self.held:
            guesses.append(f"its joints and rate are those of {MANIFEST}")
        return RobotMotion(
            joint_names=self.names or tuple(joint_names or ()),
            root_positions=position,
            root_quaternions=_quaternions(self.rotation.astype(float), layout.order),
            joint_positions=layout.radian * self.joints.astype(float),
            rate=rate,
            layout=layout.name,
            precision="" if layout.suffix == ".csv" else self.joints.dtype.name,
            guesses=tuple(guesses),
            extras=self._extras(),
            computed=self._computed(),
            **source,
        ).as_read()

    def _rate(self, guesses: list[str]) -> float:
        layout, key = self.layout, self.layout.rate
        usual = f"{layout.usual_rate:g} Hz, the usual rate of such files"
        if key == FILE_NAME:
            if named := _IN_NAME.search(Path(self.where).stem):
                return float(named[1])
            guesses.append(f"{usual}: its name has none")
        elif key and key in self.held:
            rate = stated_rate(self.where, self.held[key], key)
            doubt = rate_doubt(rate)
            if 0.0 < rate < SLOWEST:
                meant = {"the time between frames in seconds": 1.0 / rate}
                stated = f"a rate of {rate:g} Hz"
                rate, doubt = rate_meant(self.where, stated, meant)
            guesses += [doubt] * bool(doubt)
            return rate
        else:
            lacks = f": it has no {key}" if key else ", which do not say it"
            guesses.append(usual + lacks)
        return layout.usual_rate

    def _computed(self) -> dict[str, object]:
        """What follows from motion and robot; of links by names of `LINK_STATES`."""
        layout, held = self.layout, self.held
        keys = {"joint_vel": layout.velocities} | {k: k for k in layout.computed}
        keys |= dict(zip(LINK_STATES, layout.links[1:], strict=False))
        found = {ours: held[key] for ours, key in keys.items() if key in held}
        if layout.order not in FROM_WXYZ or layout.raised or layout.radian != 1.0:
            # These are not the same to the last bit after two conversions.
            found["rows"] = np.hstack([self.position, self.rotation, self.joints])
        return found

    def _extras(self) -> dict[str, object]:
        layout, found = self.layout, {}
        if not layout.has_columns:
            used = {*layout.keys, layout.rate, layout.velocities, MANIFEST}
            used |= {*layout.links[1:], *layout.computed, *layout.names[:1]}
            found = {str(k): v for k, v in self.held.items() if k not in used}
        return found if self.objects is None else found | {OBJECTS: self.objects}


def _by_links(where: str, held: Mapping, made: list[Reading]) -> list[Reading]:
    """Of readings that differ by the order of joints those that links tell, by which of
    them hang on the one before; all, if they do not tell."""
    p = numbers(where, held, "body_pos_w", None, None, 3).astype(float)
    apart = np.linalg.norm(np.diff(p[:, 1:], axis=1), axis=2)
    share = float((np.ptp(apart, axis=0) < _RIGID).mean()) if apart.size else 1.0
    guess = f"{ORDER_UNKNOWN}depth first or breadth first cannot be guessed"
    kept = made
    if share > _DEPTH_FIRST_SHARE:
        guess = "joints are depth first, as MuJoCo's"
        kept = [reading for reading in made if not reading.layout.breadth_first]
    elif share < _BREADTH_FIRST_SHARE:
        guess = "joints are breadth first, as Isaac's"
        kept = [reading for reading in made if reading.layout.breadth_first]
    guess = f"{guess} ({100 * share:.0f} % of the links hang on the one before)"
    return [reading.guessing(guess) for reading in kept]


def _quaternions(values: np.ndarray, order: str) -> np.ndarray:
    """(T, 4) w x y z."""
    if order in _TO_WXYZ:
        return values[:, _TO_WXYZ[order]]
    if order == EULER:
        turns = Rotation.from_euler(EULER, values, degrees=True)
    else:
        turns = Rotation.from_rotvec(values)
    return turns.as_quat()[:, _TO_WXYZ[XYZW]]


def _are_rotations(quaternions: np.ndarray) -> bool:
    off = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0)
    return bool((off < LENGTH_TOLERANCE).all())
