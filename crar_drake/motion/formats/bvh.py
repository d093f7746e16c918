"""Biovision hierarchies (BVH): reading and kinematics.

The format: a tree of joints, each with an OFFSET from its parent and a list of
CHANNELS, whose order says in which order they are applied; then one line of numbers
per frame. It states neither unit, up axis nor facing, and no two programs name joints
alike, see `performers.bvh`.

Own code, because maintained readers on PyPI (pybvh 0.9, bvhio 1.5) take NaN for a
number, cannot tell the line of most mistakes, and refuse keywords in lower case.
"""

import math
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.text_files import read_motion_text, shown

_POSITIONS = {"xposition": 0, "yposition": 1, "zposition": 2}
_ROTATIONS = ("xrotation", "yrotation", "zrotation")
_SHORTEST_FRAME = 1e-4  # [s]: no camera takes 10,000 pictures a second
_LARGEST = 1e9  # in any unit and in degrees: more was never measured

_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+")

# Positions of a joint that are shorter than this share of its OFFSET are no bone.
_NO_BONE = 0.2


@dataclass(frozen=True)
class BvhJoint:
    """One joint of a hierarchy."""

    name: str  # as in the file, without surrounding blanks; "" for an end site
    parent: int  # index of its parent; -1 for a root
    offset: np.ndarray  # (3,) from its parent at zero rotation [file units]
    # in the file's order, in lower case: "xposition", "zrotation", ...
    channels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Bvh:
    """A hierarchy and its motion."""

    joints: tuple[BvhJoint, ...]  # parents before children; end sites, too
    values: np.ndarray  # (T, number of channels) as in the file: file units and degrees
    frame_time: float  # from frame to frame [s]

    @property
    def num_frames(self) -> int:
        """Number of samples T."""
        return len(self.values)

    def path(self, index: int) -> list[int]:
        """Indices from the root to that joint, both included."""
        path = []
        while index >= 0:
            path.append(index)
            index = self.joints[index].parent
        return path[::-1]


def read_bvh(path: str | os.PathLike[str]) -> Bvh:
    """Reads a BVH file.

    Keywords may be in any case, blanks and line ends of any kind; a byte order mark,
    names with blanks, joints without an end site, and more than one root are read.

    Raises:
        MotionError: the file is missing, cut off, or has a frame time of 0, no frames,
            or a wrong number of values in a line; the message names file and line.
    """
    return _Parser(Path(path), read_motion_text(path)).parse()


class _Parser:
    """One pass over the lines; braces and keywords may share a line."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self.lines = text.split("\n")
        self.number = 0  # of the line that is looked at
        self.joints: list[BvhJoint] = []

    def fail(self, message: str) -> NoReturn:
        raise MotionError(f"{self.path}:{self.number}: {message}")

    def parse(self) -> Bvh:
        motion = self.hierarchy()
        frames, frame_time, first = self.header(motion)
        return Bvh(tuple(self.joints), self.frames(first, frames), frame_time)

    # The tree ---------------------------------------------------------------------

    def hierarchy(self) -> int:
        """Reads the tree, and returns the index of the line after MOTION."""
        begun = False
        stack: list[int] = []  # joints whose block is open
        waiting: tuple[str, int] | None = None  # joint whose block is to be opened
        offsets: set[int] = set()
        for index, line in enumerate(self.lines):
            self.number = index + 1
            words = line.replace("{", " { ").replace("}", " } ").split()
            while words:
                word = words.pop(0)
                keyword = word.lower()
                if not begun:
                    if keyword != "hierarchy":
                        self.fail(
                            f"not a BVH motion: expected HIERARCHY, found {shown(word)}"
                        )
                    begun = True
                elif word == "{":
                    if waiting is None:
                        self.fail("a { without a ROOT, JOINT or End Site before it")
                    stack.append(len(self.joints))
                    self.joints.append(BvhJoint(*waiting, np.zeros(3)))
                    waiting = None
                elif waiting is not None:
                    self.fail(f"expected {{ after a joint's name, found {shown(word)}")
                elif word == "}":
                    if not stack:
                        self.fail("a } too many")
                    if stack[-1] not in offsets:
                        self.fail(f"{self.called(stack[-1])} has no OFFSET")
                    stack.pop()
                elif keyword in ("root", "joint", "end"):
                    if (keyword == "root") == bool(stack):
                        what = "inside another joint" if stack else "outside of a ROOT"
                        self.fail(f"{word} {what}")
                    name, words = self.name(keyword, words)
                    waiting = (name, stack[-1] if stack else -1)
                elif keyword == "offset":
                    if not stack:
                        self.fail("an OFFSET outside of a joint")
                    self.set(stack[-1], offset=np.array(self.numbers(words[:3], 3)))
                    words, _ = words[3:], offsets.add(stack[-1])
                elif keyword == "channels":
                    if not stack:
                        self.fail("CHANNELS outside of a joint")
                    names, words = self.channels(words)
                    self.set(stack[-1], channels=names)
                elif keyword == "motion":
                    if stack:
                        self.fail(
                            f"MOTION inside {self.called(stack[-1])}: a }} is missing"
                        )
                    if not self.joints:
                        self.fail("the hierarchy has no joints")
                    return index + 1
                else:
                    self.fail(
                        "expected OFFSET, CHANNELS, JOINT, End Site, } or MOTION, "
                        f"found {shown(word)}"
                    )
        if not begun:
            self.fail("the file is empty: expected HIERARCHY")
        self.fail("the file ends before MOTION; it seems cut off")

    def called(self, index: int) -> str:
        name = self.joints[index].name
        return f"joint {shown(name)}" if name else "an end site"

    def set(self, index: int, **values) -> None:
        self.joints[index] = replace(self.joints[index], **values)

    def name(self, keyword: str, words: list[str]) -> tuple[str, list[str]]:
        """The name, which may have blanks, and the words after it."""
        end = words.index("{") if "{" in words else len(words)
        if keyword == "end":
            return "", words[end:]
        if end == 0:
            self.fail(f"{keyword.upper()} without a name")
        return " ".join(words[:end]), words[end:]

    def channels(self, words: list[str]) -> tuple[tuple[str, ...], list[str]]:
        if not words or not words[0].isdecimal():
            self.fail("CHANNELS needs the number of channels")
        count = int(words[0])
        names = tuple(word.lower() for word in words[1 : count + 1])
        for word in names:
            if word not in _POSITIONS and word not in _ROTATIONS:
                self.fail(f"channel {shown(word)} is not known, only Xposition, ...")
        if len(names) < count:
            self.fail(f"CHANNELS says {count}, found {len(names)}")
        if len(set(names)) < count:
            self.fail("a channel is listed twice")
        return names, words[count + 1 :]

    def numbers(self, words: list[str], count: int) -> list[float]:
        if len(words) != count:
            self.fail(f"expected {count} numbers, found {len(words)}")
        values = []
        for word in words:
            try:
                values.append(float(word))
            except ValueError:
                comma = _DECIMAL_COMMA.fullmatch(word)
                self.fail(
                    f"expected a number, found {shown(word)}"
                    + ("; write a point for the decimal comma" if comma else "")
                )
            if not math.isfinite(values[-1]):
                self.fail(f"{word} is not a finite number; repair the file")
            if abs(values[-1]) > _LARGEST:
                self.fail(f"{shown(word)} is no measurement; repair the file")
        return values

    # The motion -------------------------------------------------------------------

    def header(self, index: int) -> tuple[int, float, int]:
        """Returns number of frames, frame time [s], and the first frame's index."""
        found: dict[str, float] = {}
        for i in range(index, len(self.lines)):
            self.number = i + 1
            words = self.lines[i].replace(":", " ").split()
            if not words:
                continue
            lowered = [word.lower() for word in words]
            if lowered[0] == "frames":
                found["frames"] = self.numbers(words[1:], 1)[0]
            elif lowered[:2] == ["frame", "time"]:
                found["time"] = self.numbers(words[2:], 1)[0]
                if found["time"] < _SHORTEST_FRAME:
                    self.fail(
                        f"a frame time of {found['time']:g} s; write the seconds from "
                        "frame to frame, such as 0.008333"
                    )
            else:
                self.fail(f"expected Frames: or Frame Time:, found {shown(words[0])}")
            if len(found) == 2:
                break
        else:
            self.fail("the file ends before Frames: and Frame Time:")
        frames = found["frames"]
        if frames != int(frames) or frames < 1:
            self.fail(f"the motion has no frames: Frames: {frames:g}")
        return int(frames), found["time"], i + 1

    def frames(self, first: int, frames: int) -> np.ndarray:
        """The (frames, channels) values, a line each."""
        width = sum(len(joint.channels) for joint in self.joints)
        if width == 0:
            self.fail("no joint has CHANNELS, so nothing can move")
        rows = []
        for i in range(first, len(self.lines)):
            words = self.lines[i].split()
            if not words:
                continue
            self.number = i + 1
            if len(rows) == frames:
                self.fail(f"a line too many: Frames: says {frames}")
            if len(words) != width:
                self.fail(
                    f"{len(words)} values in frame {len(rows) + 1}, but the channels "
                    f"are {width}"
                )
            try:
                row = np.array(words, dtype=float)
            except ValueError:
                row = np.array(self.numbers(words, width))
            if not np.abs(row).max() <= _LARGEST:
                self.numbers(words, width)
            rows.append(row)
        if len(rows) < frames:
            self.number = len(self.lines)
            self.fail(
                f"{len(rows)} of {frames:g} frames are there; the file seems cut off"
            )
        return np.array(rows)


# --- kinematics -------------------------------------------------------------------


@dataclass(frozen=True)
class BvhPoses:
    """Where each joint is, in the file's own axes and unit."""

    positions: np.ndarray  # (J, T, 3) p_FJ [file units]
    rotations: np.ndarray  # (J, T, 3, 3) R_FJ, the identity where all channels are zero
    local: np.ndarray  # (J, T, 3, 3) against the parent


def bvh_kinematics(bvh: Bvh) -> BvhPoses:
    """Returns where every joint is at every frame.

    R_FJ = R_FP R_1 R_2 ... in the order of the rotation channels, and
    p_FJ = p_FP + R_FP t, with t the OFFSET or, where a joint has position channels,
    their values: programs that write them write the whole translation. Joints of
    `added_positions` have both.
    """
    added = added_positions(bvh)
    T, J = bvh.num_frames, len(bvh.joints)
    positions = np.zeros((J, T, 3))
    rotations = np.zeros((J, T, 3, 3))
    local = np.zeros((J, T, 3, 3))
    column = 0
    for j, joint in enumerate(bvh.joints):
        t = np.tile(joint.offset, (T, 1))
        R = np.tile(np.eye(3), (T, 1, 1))
        for channel in joint.channels:
            value = bvh.values[:, column]
            column += 1
            if channel in _POSITIONS and j in added:
                t[:, _POSITIONS[channel]] += value
            elif channel in _POSITIONS:
                t[:, _POSITIONS[channel]] = value
            else:
                about = Rotation.from_euler(channel[0], value[:, None], degrees=True)
                R = R @ about.as_matrix()
        local[j] = R
        if joint.parent < 0:
            positions[j], rotations[j] = t, R
        else:
            R_FP = rotations[joint.parent]
            positions[j] = positions[joint.parent] + np.einsum("tij,tj->ti", R_FP, t)
            rotations[j] = R_FP @ R
    return BvhPoses(positions, rotations, local)


def added_positions(bvh: Bvh) -> tuple[int, ...]:
    """Indices of the joints whose positions are 0, or little, beside their OFFSET.

    With these alone the bone would have no length: some programs write what is to be
    added to the OFFSET.
    """
    joints, column = [], 0
    for j, joint in enumerate(bvh.joints):
        places = {
            _POSITIONS[channel]: column + k
            for k, channel in enumerate(joint.channels)
            if channel in _POSITIONS
        }
        column += len(joint.channels)
        offset = joint.offset[list(places)]
        if joint.parent < 0 or np.linalg.norm(offset) <= _NO_BONE * np.linalg.norm(
            joint.offset
        ):
            continue
        written = np.linalg.norm(bvh.values[:, list(places.values())], axis=1)
        if np.median(written) < _NO_BONE * np.linalg.norm(offset):
            joints.append(j)
    return tuple(joints)


def rest_positions(bvh: Bvh, poses: BvhPoses) -> np.ndarray:
    """(J, 3) where the joints are with all rotations zero, the root at 0.

    A joint without OFFSET, but with position channels, is as in the first frame.
    """
    p = np.zeros((len(bvh.joints), 3))
    for j, joint in enumerate(bvh.joints):
        if joint.parent < 0:
            continue
        t = joint.offset
        if joint.channels and joint.channels[0] in _POSITIONS and not t.any():
            step = poses.positions[j, 0] - poses.positions[joint.parent, 0]
            t = poses.rotations[joint.parent, 0].T @ step
        p[j] = p[joint.parent] + t
    return p
