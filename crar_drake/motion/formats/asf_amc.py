"""Acclaim skeletons (ASF) and motions (AMC): reading and kinematics.

The conventions are those of the CMU Graphics Lab database: lengths in inches
divided by the skeleton's own `length` value, rotations Rz Ry Rx of fixed axes,
y up. Angles are never clamped to the skeleton's limits: real files exceed them,
and exceed a full turn as well.
"""

import io
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.text_files import read_motion_text, shown

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


@dataclass(frozen=True)
class BonePoses:
    """Where every bone is, in the file's y-up world W.

    Each dict has an entry per bone of the skeleton, and "root", whose start and
    end are both the root's position.
    """

    start: dict[str, np.ndarray]  # bone name to (T, 3) p_WS of its start [m]
    end: dict[str, np.ndarray]  # bone name to (T, 3) p_WE of its end [m]
    rotation: dict[str, np.ndarray]  # bone name to (T, 3, 3) R_WB, the identity at rest


# --- reading ----------------------------------------------------------------------


class _Lines:
    """The lines of a text file without comments and blanks, with their numbers."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.number = 0

    def __iter__(self) -> Iterator[list[str]]:
        """Yields each line's words."""
        # Unlike `splitlines`, as editors count them.
        for line in io.StringIO(read_motion_text(self.path)):
            self.number += 1
            words = line.partition("#")[0].split()
            if words:
                yield words

    def fail(self, message: str) -> NoReturn:
        line = f":{self.number}" if self.number else ""  # an empty file has none
        raise MotionError(f"{self.path}{line}: {message}")

    def numbers(self, words: list[str]) -> list[float]:
        """Returns the words as finite numbers."""
        try:
            values = [float(word := each) for each in words]
        except ValueError:
            self.fail(f"expected a number, found {shown(word)}")
        if not all(map(math.isfinite, values)):
            word = next(x for x in words if not math.isfinite(float(x)))
            self.fail(f"{word} is not a finite number; repair the file")
        return values

    def every(self, first: str, words: list[str]) -> np.ndarray:
        """Returns the words of all lines that begin with `first`, as `numbers`."""
        try:
            values = np.array(list(map(float, words)))
        except ValueError:
            values = np.array([np.nan])
        if not np.isfinite(values).all():
            # They are read once more, to say where.
            self.number = 0
            for line in self:
                if line[0] == first:
                    self.numbers(line[1:])
        return values


def read_asf(path: str | os.PathLike[str]) -> Skeleton:
    """Reads an Acclaim skeleton.

    Lengths become metres by the file's own `length` value (CMU: 0.45), angles
    become radians. Bone directions are normalised, since files print six digits.

    Raises:
        MotionError: the file is missing, is not an ASF, or its bones do not hang
            together; the message names file and line.
    """
    return _AsfParser(_Lines(Path(path))).parse()


class _AsfParser:
    """One pass over an ASF: section keyword lines switch the meaning of the rest."""

    def __init__(self, lines: _Lines) -> None:
        self.lines = lines
        self.name = lines.path.stem
        self.length_unit: float | None = None
        self.angle_unit = "degrees"
        # Of the bones, by name: what their lines say, and the number of the first.
        self.blocks: dict[str, dict[str, Any]] = {}
        self.block: dict[str, Any] | None = None  # that is open
        self.last_key = ""
        self.parents: dict[str, str] = {}

    def parse(self) -> Skeleton:
        section, seen = "", set()
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
                    self.name = " ".join(words[1:])
            elif not section:
                self.lines.fail(
                    f"not an ASF skeleton: expected a keyword such as :version, "
                    f"found {shown(words[0])}"
                )
            elif section in handlers:
                handlers[section](words)
        if self.block is not None:
            self.lines.fail(
                f"the file ends inside the bone begun on line {self.block['begin']}; "
                f"it seems cut off"
            )
        for needed in ("root", "bonedata", "hierarchy"):
            if needed not in seen:
                self.lines.fail(f"the skeleton has no :{needed} section")
        if self.length_unit is None:
            self.lines.fail(
                "the :units section has no length, so the scale is unknown; "
                f"CMU skeletons have 'length {CMU_LENGTH}'"
            )
        return Skeleton(
            self.name, self.ordered_bones(), self.length_unit, self.angle_unit
        )

    def check_closed(self, what: str) -> None:
        """Fails if a bone is open; `what` is said of it."""
        if self.block is not None:
            self.lines.fail(f"the bone begun on line {self.block['begin']} {what}")

    @property
    def radians_per_unit(self) -> float:
        return _RADIANS_PER_UNIT[self.angle_unit]

    def on_units(self, words: list[str]) -> None:
        key = words[0].lower()
        if key == "length":
            (value,) = self.values(words, 1)
            if value <= 0.0:
                self.lines.fail(f"length must be positive, found {value:g}")
            self.length_unit = value
        elif key == "angle":
            self.angle_unit = self.stated_angle_unit(words)

    def stated_angle_unit(self, words: list[str]) -> str:
        unit = words[1].lower() if len(words) > 1 else ""
        if unit.startswith("deg"):
            return "degrees"
        if unit.startswith("rad"):
            return "radians"
        self.lines.fail(f"angle must be deg or rad, found {shown(unit)}")

    def on_root(self, words: list[str]) -> None:
        key = words[0].lower()
        if key == "order":
            if tuple(word.upper() for word in words[1:]) != ROOT_ORDER:
                self.lines.fail(
                    f"root order {' '.join(words[1:])} is not supported, only "
                    f"{' '.join(ROOT_ORDER)}"
                )
        elif key == "axis":
            self.check_axis_order(words[1:2])
        elif key in ("position", "orientation") and any(self.values(words, 3)):
            self.lines.fail(f"a root {key} other than 0 0 0 is not supported")

    def check_axis_order(self, words: list[str]) -> None:
        if [word.upper() for word in words] != ["XYZ"]:
            self.lines.fail(
                f"axis order {shown(' '.join(words))} is not supported, only XYZ"
            )

    def on_bonedata(self, words: list[str]) -> None:
        key = words[0].lower()
        if key == "begin":
            self.check_closed("has no end")
            self.block, self.last_key = {"begin": self.lines.number}, ""
        elif self.block is None:
            self.lines.fail(f"expected begin, found {shown(words[0])}")
        elif key == "end":
            self.end_bone()
        elif key.startswith("("):
            if self.last_key != "limits":
                self.lines.fail("a pair of limits without the word limits before it")
            self.block["limits"] += words
        else:
            self.block[key], self.last_key = self.bone_entry(key, words), key

    def bone_entry(self, key: str, words: list[str]) -> Any:
        """What a line of a bone says, checked while its number is at hand."""
        if key == "direction":
            return self.values(words, 3)
        if key == "length":
            return self.values(words, 1)[0]
        if key == "axis":
            values = self.values(words[:4], 3)
            self.check_axis_order(words[4:])
            return values
        if key == "dof":
            names = tuple(word.lower() for word in words[1:])
            for name in words[1:]:
                if name.lower() not in _DOF_NAMES:
                    self.lines.fail(
                        f"dof {shown(name)} is not supported, only rx ry rz"
                    )
            if len(set(names)) < len(names):
                self.lines.fail("a dof is listed twice")
            return names
        if key == "name":
            if len(words) != 2:
                self.lines.fail("a bone needs one name without spaces")
            return words[1]
        return words[1:]

    def end_bone(self) -> None:
        for needed in ("name", "direction", "length", "axis"):
            if needed not in self.block:
                self.check_closed(f"has no {needed}")
        name, length = self.block["name"], self.block["length"]
        if name in self.blocks or name == "root":
            self.lines.fail(f"bone {shown(name)} is defined twice")
        if length < 0.0 or (length > 0.0 and not any(self.block["direction"])):
            self.lines.fail(
                f"bone {name} needs a length >= 0 and a direction other than 0 0 0"
            )
        self.blocks[name], self.block = self.block, None

    def on_hierarchy(self, words: list[str]) -> None:
        if words[0].lower() in ("begin", "end"):
            return
        parent, *children = words
        for name in words:
            if name != "root" and name not in self.blocks:
                what = "parent" if name == parent else "bone"
                self.lines.fail(
                    f"the hierarchy names the {what} {shown(name)}, which "
                    f":bonedata does not define"
                )
        for child in children:
            if child == "root" or child in self.parents:
                self.lines.fail(f"bone {child} has two parents in the hierarchy")
            self.parents[child] = parent

    def ordered_bones(self) -> dict[str, Bone]:
        """Returns the bones from the root outwards."""
        bones: dict[str, Bone] = {}
        waiting = ["root"]
        while waiting:
            name = waiting.pop()
            if name != "root":
                bones[name] = self.make_bone(name)
            inwards = reversed(self.parents.items())
            waiting += [child for child, parent in inwards if parent == name]
        for name, block in self.blocks.items():
            if name not in bones:
                self.lines.number = block["begin"]
                self.lines.fail(
                    f"bone {name} has no way to the root in :hierarchy; give it a "
                    f"parent there or remove the bone"
                )
        if not bones:
            self.lines.fail("the skeleton has no bones")
        return bones

    def make_bone(self, name: str) -> Bone:
        block = self.blocks[name]
        direction = np.array(block["direction"])
        norm = np.linalg.norm(direction)
        dof = block.get("dof", ())
        return Bone(
            name=name,
            parent=self.parents[name],
            direction=direction / norm if norm > 0.0 else direction,
            length=block["length"] * INCH / self.length_unit,
            axis=np.array(block["axis"]) * self.radians_per_unit,
            dof=dof,
            limits=self.limits(block.get("limits", []), len(dof)),
        )

    def limits(self, words: list[str], count: int) -> tuple[tuple[float, float], ...]:
        """Returns the limits [rad], or none where they make no sense."""
        text = re.sub(r"[(),]", " ", " ".join(words)).split()
        try:
            values = [float(word) * self.radians_per_unit for word in text]
        except ValueError:
            return ()
        if len(values) != 2 * count:
            return ()
        return tuple(zip(values[0::2], values[1::2], strict=True))

    def values(self, words: list[str], count: int) -> list[float]:
        if len(words) - 1 != count:
            self.lines.fail(f"{words[0]} needs {count} values, found {len(words) - 1}")
        return self.lines.numbers(words[1:])


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
    path = Path(path)
    counts = {bone.name: len(bone.dof) for bone in skeleton.bones.values()}
    counts["root"] = 6
    needed = [bone for bone, count in counts.items() if count > 0]
    # The numbers are read at last, all at once.
    columns: dict[str, list[str]] = {bone: [] for bone in needed}
    frames = read = 0  # and so many of the bones in the last of them
    angle_unit = "degrees"
    stated_rate: float | None = None

    lines = _Lines(path)

    def check_complete() -> None:
        if frames and read < len(needed):
            missing = [
                bone for bone in needed if len(columns[bone]) < frames * counts[bone]
            ]
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
            read += 1
        elif len(words) == 1 and bone.isascii() and bone.isdigit():
            check_complete()
            if int(bone) != frames + 1:
                lines.fail(
                    f"frame {bone} where frame {frames + 1} was expected; "
                    f"frames are numbered from 1 without gaps"
                )
            frames, read = frames + 1, 0
        elif bone.startswith(":") and frames == 0:
            keyword = bone.upper()
            if keyword in (":DEGREES", ":RADIANS"):
                angle_unit = keyword[1:].lower()
            elif keyword == ":SAMPLES-PER-SECOND":
                stated_rate = _stated_rate(lines, words)
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

    values = {
        bone: lines.every(bone, column).reshape(frames, -1)
        for bone, column in columns.items()
    }
    root = values.pop("root")
    rate, rate_source = frame_rate, "given"
    if rate is None:
        rate, rate_source = stated_rate, "file"
    if rate is None:
        rate, rate_source = default_frame_rate(path), "assumed"
    radians_per_unit = _RADIANS_PER_UNIT[angle_unit]
    if not (math.isfinite(rate) and rate > 0.0):
        raise MotionError(f"{path}: the frame rate must be positive, not {rate}")
    return Clip(
        name=path.stem if name is None else name,
        skeleton=skeleton,
        frame_rate=float(rate),
        root_position=root[:, :3] * skeleton.metres_per_unit,
        root_rotation=root[:, 3:] * radians_per_unit,
        joints={bone: rows * radians_per_unit for bone, rows in values.items()},
        rate_source=rate_source,
        angle_unit=angle_unit,
    )


def _stated_rate(lines: _Lines, words: list[str]) -> float:
    if len(words) == 2:
        (rate,) = lines.numbers(words[1:])
        if rate > 0.0:
            return rate
    lines.fail(":SAMPLES-PER-SECOND needs one positive number")


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


def forward_kinematics(clip: Clip) -> BonePoses:
    """Returns where every bone of the clip is at every frame.

    R_WB = R_WP C (Rz Ry Rx)(dof values) Cᵀ with C = (Rz Ry Rx)(axis), and
    p_WE = p_WS + R_WB direction length, from the root outwards.
    """
    root = np.asarray(clip.root_position, dtype=float)
    start, end = {"root": root}, {"root": root}
    rotation = {"root": rotation_xyz(np.asarray(clip.root_rotation, dtype=float))}
    for bone in clip.skeleton.bones.values():
        R_WB = rotation[bone.parent]
        if bone.dof:
            angles = np.zeros((len(root), 3))
            angles[:, [_DOF_NAMES.index(dof) for dof in bone.dof]] = clip.joints[
                bone.name
            ]
            C = rotation_xyz(bone.axis)
            R_WB = R_WB @ (C @ rotation_xyz(angles) @ C.T)
        start[bone.name] = end[bone.parent]
        end[bone.name] = start[bone.name] + R_WB @ (bone.direction * bone.length)
        rotation[bone.name] = R_WB
    return BonePoses(start, end, rotation)


def rest_pose(skeleton: Skeleton) -> BonePoses:
    """Returns the skeleton at rest, root at the origin, as one frame (T = 1)."""
    return forward_kinematics(
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
