"""Acclaim skeletons (ASF) and motions (AMC): reading and kinematics.

The conventions are those of the CMU Graphics Lab database: lengths in inches
divided by the skeleton's own `length` value, rotations Rz Ry Rx of fixed axes,
y up. Angles are never clamped to the skeleton's limits: real files exceed them,
and exceed a full turn as well.
"""

import math
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.segment_tree import SegmentTree, tree_of_turns
from crar_drake.motion.text_files import NumberedLines, shown

INCH = 0.0254  # [m]
CMU_LENGTH = 0.45  # the `length` of every CMU skeleton [file units per inch]
CMU_FRAME_RATE = 120.0  # [Hz]
CMU_SLOW_SUBJECTS = {60: 60.0, 61: 60.0}  # subject: rate [Hz]

ROOT_ORDER = ("TX", "TY", "TZ", "RX", "RY", "RZ")
_DOF_NAMES = ("rx", "ry", "rz")
_RADIANS_PER_UNIT = {"degrees": math.pi / 180.0, "radians": 1.0}


@dataclass(frozen=True)
class Bone:
    """One bone of a skeleton, in the file's y-up world at rest."""

    name: str  # the bone's name, e.g. "lhumerus"
    parent: str  # the parent bone's name; "root" for the bones at the root
    direction: np.ndarray  # (3,) unit vector from the bone's start to its end
    length: float  # distance from start to end [m]
    axis: np.ndarray  # (3,) the local axes' rotation about x, y, z [rad]: C = Rz Ry Rx
    dof: tuple[str, ...] = ()  # its degrees of freedom in file order, of rx ry rz
    # one (lower, upper) per dof [rad]; informative only
    limits: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Skeleton:
    """An ASF skeleton: `bones` maps name to Bone, each parent before its children."""

    name: str  # what the file or the author calls it
    bones: dict[str, Bone]  # name to Bone
    # the file's `length` value; one file unit is 0.0254 m divided by it. Lengths in
    # `bones` are metres already; motions need it.
    length_unit: float = CMU_LENGTH
    # "degrees" or "radians", what the file says that its angles are; "" for a skeleton
    # of no file
    angle_unit: str = ""

    @property
    def metres_per_unit(self) -> float:
        """Metres in one length unit of this skeleton's files [m]."""
        return INCH / self.length_unit


@dataclass(frozen=True)
class Clip:
    """One AMC motion on its skeleton."""

    name: str  # what the user called it, for messages
    skeleton: Skeleton  # the skeleton that it moves
    frame_rate: float  # samples per second [Hz]
    root_position: np.ndarray  # (T, 3) x y z of the root, y up [m]
    root_rotation: np.ndarray  # (T, 3) rotations about x y z as in the file [rad]
    joints: dict[str, np.ndarray]  # bone to (T, k) values of its dof [rad]
    # where the frame rate comes from, one of `performer.SOURCES`
    rate_source: str = "given"
    # "degrees" or "radians", what the file says that its angles are; "" for a clip of
    # no file
    angle_unit: str = ""

    @property
    def num_frames(self) -> int:
        """Number of samples T."""
        return len(self.root_position)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return (self.num_frames - 1) / self.frame_rate


# --- reading ----------------------------------------------------------------------


def read_asf(path: str | os.PathLike[str]) -> Skeleton:
    """Reads an Acclaim skeleton.

    Lengths become metres by the file's own `length` value (CMU: 0.45), angles
    become radians. Bone directions are normalised, since files print six digits.

    Raises:
        MotionError: the file is missing, is not an ASF, or its bones do not hang
            together; the message names file and line.
    """
    return _AsfParser(NumberedLines(path, comment="#")).parse()


class _AsfParser:
    """One pass over an ASF: section keyword lines switch the meaning of the rest."""

    def __init__(self, lines: NumberedLines) -> None:
        self.lines, self.fail = lines, lines.fail
        self.length_unit: float | None = None
        self.angle_unit = "degrees"
        # Of the bone that is open: key to the number of its line, and its words.
        self.block: dict[str, tuple[int, list[str]]] = {}
        self.bones: dict[str, Bone] = {}  # without parents, in the file's units
        self.begun: dict[str, int] = {}  # numbers of the lines where they begin
        self.parents: dict[str, str] = {}

    def parse(self) -> Skeleton:
        name, section, seen = self.lines.path.stem, "", set()
        handlers = {
            "units": self.on_units,
            "root": self.on_root,
            "bonedata": self.on_bonedata,
            "hierarchy": self.on_hierarchy,
        }
        for words in self.lines:
            if words[0].startswith(":"):
                self.check_closed("has no end")
                section = words[0][1:].lower()
                seen.add(section)
                if section == "name" and len(words) > 1:
                    name = " ".join(words[1:])
            elif not section:
                self.fail(
                    f"not an ASF skeleton: expected a keyword such as :version, "
                    f"found {shown(words[0])}"
                )
            elif section in handlers:
                handlers[section](words)
        if self.block:
            self.fail(
                f"the file ends inside the bone begun on line {self.block['begin'][0]};"
                " it seems cut off"
            )
        for needed in ("root", "bonedata", "hierarchy"):
            if needed not in seen:
                self.fail(f"the skeleton has no :{needed} section")
        if self.length_unit is None:
            self.fail(
                "the :units section has no length, so the scale is unknown; "
                f"CMU skeletons have 'length {CMU_LENGTH}'"
            )
        return Skeleton(name, self.ordered_bones(), self.length_unit, self.angle_unit)

    def check_closed(self, what: str) -> None:
        """Fails if a bone is open; `what` is said of it."""
        if self.block:
            self.fail(f"the bone begun on line {self.block['begin'][0]} {what}")

    def values(
        self, words: list[str], count: int, number: int | None = None
    ) -> list[float]:
        """So many numbers after the first word, of the last line or another."""
        if len(words) - 1 != count:
            found = len(words) - 1
            self.fail(f"{words[0]} needs {count} values, found {found}", number)
        return self.lines.numbers(words[1:], number)

    def on_units(self, words: list[str]) -> None:
        key = words[0].lower()
        if key == "length":
            (value,) = self.values(words, 1)
            if value <= 0.0:
                self.fail(f"length must be positive, found {value:g}")
            self.length_unit = value
        elif key == "angle":
            unit = words[1].lower() if len(words) > 1 else ""
            known = {"deg": "degrees", "rad": "radians"}
            if unit[:3] not in known:
                self.fail(f"angle must be deg or rad, found {shown(unit)}")
            self.angle_unit = known[unit[:3]]

    def on_root(self, words: list[str]) -> None:
        key = words[0].lower()
        if key == "order":
            if tuple(word.upper() for word in words[1:]) != ROOT_ORDER:
                self.fail(
                    f"root order {' '.join(words[1:])} is not supported, only "
                    f"{' '.join(ROOT_ORDER)}"
                )
        elif key == "axis":
            self.check_axis_order(words[1:2])
        elif key in ("position", "orientation") and any(self.values(words, 3)):
            self.fail(f"a root {key} other than 0 0 0 is not supported")

    def check_axis_order(self, words: list[str], number: int | None = None) -> None:
        if [word.upper() for word in words] != ["XYZ"]:
            order = shown(" ".join(words))
            self.fail(f"axis order {order} is not supported, only XYZ", number)

    def on_bonedata(self, words: list[str]) -> None:
        key = words[0].lower()
        if key == "begin":
            self.check_closed("has no end")
        elif not self.block:
            self.fail(f"expected begin, found {shown(words[0])}")
        if key == "end":
            self.end_bone()
        elif not key.startswith("("):
            self.block[key] = (self.lines.number, words)
        elif next(reversed(self.block)) == "limits":
            self.block["limits"][1].extend(words)
        else:
            self.fail("a pair of limits without the word limits before it")

    def end_bone(self) -> None:
        """Checks what the lines of a bone say, and keeps it."""
        for needed in ("name", "direction", "length", "axis"):
            if needed not in self.block:
                self.check_closed(f"has no {needed}")

        def values(key: str, count: int) -> list[float]:
            number, words = self.block[key]
            return self.values(words[: count + 1], count, number)

        number, (_, *names) = self.block["name"]
        if len(names) != 1:
            self.fail("a bone needs one name without spaces", number)
        (name,) = names
        direction, (length,) = np.array(values("direction", 3)), values("length", 1)
        axis = np.array(values("axis", 3))
        number, words = self.block["axis"]
        self.check_axis_order(words[4:], number)
        number, words = self.block.get("dof", (0, ["dof"]))
        dof = tuple(word.lower() for word in words[1:])
        for word in words[1:]:
            if word.lower() not in _DOF_NAMES:
                self.fail(f"dof {shown(word)} is not supported, only rx ry rz", number)
        if len(set(dof)) < len(dof):
            self.fail("a dof is listed twice", number)
        if name in self.bones or name == "root":
            self.fail(f"bone {shown(name)} is defined twice")
        if length < 0.0 or (length > 0.0 and not direction.any()):
            self.fail(
                f"bone {name} needs a length >= 0 and a direction other than 0 0 0"
            )
        norm = np.linalg.norm(direction)
        direction = direction / norm if norm > 0.0 else direction
        limits = _limits(self.block.get("limits", (0, [""]))[1][1:], len(dof))
        self.bones[name] = Bone(name, "", direction, length, axis, dof, limits)
        self.begun[name] = self.block["begin"][0]
        self.block = {}

    def on_hierarchy(self, words: list[str]) -> None:
        if words[0].lower() in ("begin", "end"):
            return
        parent, *children = words
        for name in words:
            if name != "root" and name not in self.bones:
                what = "parent" if name == parent else "bone"
                self.fail(
                    f"the hierarchy names the {what} {shown(name)}, which "
                    f":bonedata does not define"
                )
        for child in children:
            if child == "root" or child in self.parents:
                self.fail(f"bone {child} has two parents in the hierarchy")
            self.parents[child] = parent

    def ordered_bones(self) -> dict[str, Bone]:
        """Returns the bones from the root outwards, in metres and radians."""
        bones: dict[str, Bone] = {}
        radians = _RADIANS_PER_UNIT[self.angle_unit]
        waiting = ["root"]
        while waiting:
            name = waiting.pop()
            if name != "root":
                bone = self.bones[name]
                bones[name] = replace(
                    bone,
                    parent=self.parents[name],
                    length=bone.length * INCH / self.length_unit,
                    axis=bone.axis * radians,
                    limits=tuple((a * radians, b * radians) for a, b in bone.limits),
                )
            inwards = reversed(self.parents.items())
            waiting += [child for child, parent in inwards if parent == name]
        for name, number in self.begun.items():
            if name not in bones:
                self.fail(
                    f"bone {name} has no way to the root in :hierarchy; give it a "
                    "parent there or remove the bone",
                    number,
                )
        if not bones:
            self.fail("the skeleton has no bones")
        return bones


def _limits(words: list[str], count: int) -> tuple[tuple[float, float], ...]:
    """Pairs of limits, or none where they make no sense."""
    text = re.sub(r"[(),]", " ", " ".join(words)).split()
    try:
        values = [float(word) for word in text]
    except ValueError:
        return ()
    if len(values) != 2 * count:
        return ()
    return tuple(zip(values[0::2], values[1::2], strict=True))


def default_frame_rate(path: str | os.PathLike[str]) -> float:
    """Returns the CMU database's rate for a file name such as 60_01.amc [Hz].

    The files do not say it: it is 120 Hz, but 60 Hz for subjects 60 and 61.
    """
    match = re.match(r"(\d+)_\d+$", Path(path).stem)
    subject = int(match.group(1)) if match else -1
    return CMU_SLOW_SUBJECTS.get(subject, CMU_FRAME_RATE)


def read_amc(
    path: str | os.PathLike[str],
    skeleton: Skeleton,
    *,
    frame_rate: float | None = None,
    name: str | None = None,
) -> Clip:
    """Reads an Acclaim motion, line by line.

    Args:
        path: the AMC file. The skeleton's path in its first comment is stale in
            every CMU file and is not looked at.
        skeleton: the skeleton that the motion was recorded on.
        frame_rate: samples per second [Hz]; overrides the file's own
            `:SAMPLES-PER-SECOND` line and the default_frame_rate.
        name: what messages call the motion; by default the file's stem.

    Raises:
        MotionError: the file is missing, damaged, has fewer than two frames, or
            does not fit the skeleton; the message names file and line.
    """
    counts = {bone.name: len(bone.dof) for bone in skeleton.bones.values()}
    counts["root"] = 6
    # The numbers are read at last, all at once.
    columns: dict[str, list] = {bone: [] for bone, count in counts.items() if count}
    frames, angle_unit = 0, "degrees"
    stated_rate: float | None = None
    lines = NumberedLines(path, comment="#")

    def check_complete() -> None:
        missing = [
            b for b, column in columns.items() if len(column) < frames * counts[b]
        ]
        if missing:
            more = f" and {len(missing) - 4} more" if len(missing) > 4 else ""
            lines.fail(
                f"frame {frames} ends without {', '.join(missing[:4])}{more}; "
                f"the file is cut off or belongs to another skeleton than "
                f"{shown(skeleton.name)}"
            )

    for words in lines:
        bone = words[0]
        if bone in columns and frames > 0:
            column, count = columns[bone], counts[bone]
            if len(words) - 1 != count:
                lines.fail(
                    f"{bone} needs {count} values on skeleton "
                    f"{shown(skeleton.name)}, found {len(words) - 1}"
                )
            if len(column) == frames * count:
                lines.fail(f"{bone} appears twice in frame {frames}")
            column += words[1:]
        elif len(words) == 1 and bone.isascii() and bone.isdigit():
            check_complete()
            if int(bone) != frames + 1:
                lines.fail(
                    f"frame {bone} where frame {frames + 1} was expected; "
                    f"frames are numbered from 1 without gaps"
                )
            frames += 1
        elif bone.startswith(":") and frames == 0:
            keyword = bone.upper()
            if keyword in (":DEGREES", ":RADIANS"):
                angle_unit = keyword[1:].lower()
            elif keyword == ":SAMPLES-PER-SECOND":
                stated_rate = lines.numbers(words[1:])[0] if len(words) == 2 else 0.0
                if not stated_rate > 0.0:
                    lines.fail(":SAMPLES-PER-SECOND needs one positive number")
        elif frames == 0:
            lines.fail(
                f"not an AMC motion: expected frame number 1, found {shown(bone)}"
            )
        elif bone in counts:
            lines.fail(
                f"{bone} has no degrees of freedom on skeleton {shown(skeleton.name)}"
            )
        else:
            lines.fail(
                f"bone {shown(bone)} is not in skeleton {shown(skeleton.name)}; "
                f"give the motion's own skeleton"
            )
    if frames < 2:
        have = "no frames" if frames == 0 else "a single frame"
        lines.fail(f"the motion has {have}; at least 2 are needed")
    check_complete()

    values = _numbers(lines.path, columns, frames)
    root = values.pop("root")
    rate, rate_source = frame_rate, "given"
    if rate is None:
        rate, rate_source = stated_rate, "file"
    if rate is None:
        rate, rate_source = default_frame_rate(lines.path), "assumed"
    radians_per_unit = _RADIANS_PER_UNIT[angle_unit]
    if not (math.isfinite(rate) and rate > 0.0):
        raise MotionError(f"{lines.path}: the frame rate must be positive, not {rate}")
    return Clip(
        name=lines.path.stem if name is None else name,
        skeleton=skeleton,
        frame_rate=float(rate),
        root_position=root[:, :3] * skeleton.metres_per_unit,
        root_rotation=root[:, 3:] * radians_per_unit,
        joints={bone: rows * radians_per_unit for bone, rows in values.items()},
        rate_source=rate_source,
        angle_unit=angle_unit,
    )


def _numbers(
    path: Path, columns: Mapping[str, list[str]], frames: int
) -> dict[str, np.ndarray]:
    """Bone to (frames, k) numbers of its words, of all frames one after the other."""
    with suppress(ValueError):
        values = {
            bone: np.array(list(map(float, column))).reshape(frames, -1)
            for bone, column in columns.items()
        }
        if all(np.isfinite(numbers).all() for numbers in values.values()):
            return values
    lines = NumberedLines(path, comment="#")  # once more, to say where
    for words in lines:
        if words[0] in columns:
            lines.numbers(words[1:])
    raise AssertionError


# --- kinematics -------------------------------------------------------------------


def rotation_xyz(angles: np.ndarray) -> np.ndarray:
    """Returns Rz Ry Rx of (..., 3) angles about x, y, z [rad] as (..., 3, 3)."""
    sx, sy, sz = np.moveaxis(np.sin(angles), -1, 0)
    cx, cy, cz = np.moveaxis(np.cos(angles), -1, 0)
    rows = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def clip_tree(clip: Clip) -> SegmentTree:
    """Where every bone of the clip begins at every frame, in the file's y-up world.

    Segment 0 is "root", the others are the bones. R_WB = R_WP C (Rz Ry Rx)(dof values)
    Cᵀ with C = (Rz Ry Rx)(axis), the identity at rest.
    """
    bones = list(clip.skeleton.bones.values())
    index = {"root": 0} | {bone.name: i for i, bone in enumerate(bones, start=1)}
    ends = [np.zeros(3), *(bone.direction * bone.length for bone in bones)]
    offsets = [np.asarray(clip.root_position, dtype=float)]
    turns = [rotation_xyz(np.asarray(clip.root_rotation, dtype=float))]
    for bone in bones:
        offsets.append(ends[index[bone.parent]])
        R = np.broadcast_to(np.eye(3), turns[0].shape)
        if bone.dof:
            angles = np.zeros((clip.num_frames, 3))
            angles[:, [_DOF_NAMES.index(of) for of in bone.dof]] = clip.joints[
                bone.name
            ]
            C = rotation_xyz(bone.axis)
            R = C @ rotation_xyz(angles) @ C.T
        turns.append(R)
    parents = [-1, *(index[bone.parent] for bone in bones)]
    return tree_of_turns(list(index), parents, offsets, turns)


def bone_end(skeleton: Skeleton, tree: SegmentTree, name: str) -> np.ndarray:
    """(T, 3) p_WE of a bone's end [m]."""
    i, bone = tree.names.index(name), skeleton.bones[name]
    return tree.positions[i] + tree.rotations[i] @ (bone.direction * bone.length)


def rest_tree(skeleton: Skeleton) -> SegmentTree:
    """The skeleton at rest, root at the origin, as one frame (T = 1)."""
    return clip_tree(
        Clip(
            name=skeleton.name,
            skeleton=skeleton,
            frame_rate=1.0,
            root_position=np.zeros((1, 3)),
            root_rotation=np.zeros((1, 3)),
            joints={
                bone.name: np.zeros((1, len(bone.dof)))
                for bone in skeleton.bones.values()
                if bone.dof
            },
        )
    )
