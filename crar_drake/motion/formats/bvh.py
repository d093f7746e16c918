"""Biovision hierarchies (BVH): reading and kinematics.

The format: a tree of joints, each with an OFFSET from its parent and a list of
CHANNELS, whose order says in which order they are applied; then one line of numbers
per frame. It states neither unit, up axis nor facing, and no two programs name joints
alike, see `performers.bvh`.

Own code, because maintained readers on PyPI (pybvh 0.9, bvhio 1.5) take NaN for a
number, cannot tell the line of most mistakes, and refuse keywords in lower case.
"""

import os
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.motion.segment_tree import SegmentTree, tree_of_turns
from crar_drake.motion.text_files import NumberedLines, shown

_POSITIONS = {"xposition": 0, "yposition": 1, "zposition": 2}
_ROTATIONS = ("xrotation", "yrotation", "zrotation")
_SHORTEST_FRAME = 1e-4  # [s]: no camera takes 10,000 pictures a second

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

    def columns(self, index: int) -> dict[str, int]:
        """Channel of a joint to its column of the values."""
        first = sum(len(joint.channels) for joint in self.joints[:index])
        return {c: first + k for k, c in enumerate(self.joints[index].channels)}


def read_bvh(path: str | os.PathLike[str]) -> Bvh:
    """Reads a BVH file.

    Keywords may be in any case, blanks and line ends of any kind; a byte order mark,
    names with blanks, joints without an end site, and more than one root are read.

    Raises:
        MotionError: the file is missing, cut off, or has a frame time of 0, no frames,
            or a wrong number of values in a line; the message names file and line.
    """
    lines = NumberedLines(path)
    joints = _HierarchyParser(lines).parse()
    frames, frame_time = _header(lines)
    width = sum(len(joint.channels) for joint in joints)
    return Bvh(tuple(joints), _frames(lines, frames, width), frame_time)


class _HierarchyParser:
    """One pass over the tree's lines; braces and keywords may share a line."""

    def __init__(self, lines: NumberedLines) -> None:
        self.lines, self.fail = lines, lines.fail
        self.joints: list[BvhJoint] = []
        self.stack: list[int] = []  # joints whose block is open
        self.waiting: tuple[str, int] | None = None  # whose block is to be opened
        self.offsets: set[int] = set()  # joints that have one

    def parse(self) -> list[BvhJoint]:
        """Reads the tree, up to the line MOTION."""
        begun = False
        for line in self.lines:
            words = " ".join(line).replace("{", " { ").replace("}", " } ").split()
            if not begun:
                if words[0].lower() != "hierarchy":
                    self.fail(
                        f"not a BVH motion: expected HIERARCHY, found {shown(words[0])}"
                    )
                begun, words = True, words[1:]
            while words:
                if words[0].lower() == "motion" and self.waiting is None:
                    self.check_closed()
                    return self.joints
                words = self.take(*words)
        if not begun:
            self.fail("the file is empty: expected HIERARCHY")
        self.fail("the file ends before MOTION; it seems cut off")

    def check_closed(self) -> None:
        """Fails at MOTION if a block is open, or if there was none."""
        if self.stack:
            called = self.called(self.stack[-1])
            self.fail(f"MOTION inside {called}: a }} is missing")
        if not self.joints:
            self.fail("the hierarchy has no joints")

    def take(self, word: str, *rest: str) -> list[str]:
        """Takes a keyword and what belongs to it; returns the words after that."""
        words, keyword = list(rest), word.lower()
        if word == "{":
            if self.waiting is None:
                self.fail("a { without a ROOT, JOINT or End Site before it")
            self.stack.append(len(self.joints))
            self.joints.append(BvhJoint(*self.waiting, np.zeros(3)))
            self.waiting = None
        elif self.waiting is not None:
            self.fail(f"expected {{ after a joint's name, found {shown(word)}")
        elif word == "}":
            if not self.stack:
                self.fail("a } too many")
            closed = self.stack.pop()
            if closed not in self.offsets:
                self.fail(f"{self.called(closed)} has no OFFSET")
        elif keyword in ("root", "joint", "end"):
            if (keyword == "root") == bool(self.stack):
                what = "inside another joint" if self.stack else "outside of a ROOT"
                self.fail(f"{word} {what}")
            # A name may have blanks.
            end = words.index("{") if "{" in words else len(words)
            if keyword != "end" and end == 0:
                self.fail(f"{keyword.upper()} without a name")
            name = "" if keyword == "end" else " ".join(words[:end])
            self.waiting = (name, self.stack[-1] if self.stack else -1)
            return words[end:]
        elif keyword in ("offset", "channels"):
            if not self.stack:
                what = "an OFFSET" if keyword == "offset" else "CHANNELS"
                self.fail(f"{what} outside of a joint")
            return self.offset(words) if keyword == "offset" else self.channels(words)
        else:
            self.fail(
                "expected OFFSET, CHANNELS, JOINT, End Site, } or MOTION, "
                f"found {shown(word)}"
            )
        return words

    def called(self, index: int) -> str:
        name = self.joints[index].name
        return f"joint {shown(name)}" if name else "an end site"

    def set(self, **values) -> None:
        index = self.stack[-1]
        self.joints[index] = replace(self.joints[index], **values)

    def offset(self, words: list[str]) -> list[str]:
        self.set(offset=np.array(_numbers(self.lines, words[:3], 3)))
        self.offsets.add(self.stack[-1])
        return words[3:]

    def channels(self, words: list[str]) -> list[str]:
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
        self.set(channels=names)
        return words[count + 1 :]


def _numbers(lines: NumberedLines, words: list[str], count: int) -> list[float]:
    if len(words) != count:
        lines.fail(f"expected {count} numbers, found {len(words)}")
    return lines.numbers(words)


def _header(lines: NumberedLines) -> tuple[int, float]:
    """Number of frames and frame time [s]."""
    found: dict[str, float] = {}
    for line in lines:
        words = " ".join(line).replace(":", " ").split()
        lowered = [word.lower() for word in words]
        if lowered[:1] == ["frames"]:
            found["frames"] = _numbers(lines, words[1:], 1)[0]
        elif lowered[:2] == ["frame", "time"]:
            found["time"] = _numbers(lines, words[2:], 1)[0]
            if found["time"] < _SHORTEST_FRAME:
                lines.fail(
                    f"a frame time of {found['time']:g} s; write the seconds from "
                    "frame to frame, such as 0.008333"
                )
        else:
            lines.fail(f"expected Frames: or Frame Time:, found {shown(line[0])}")
        if len(found) == 2:
            break
    else:
        lines.fail("the file ends before Frames: and Frame Time:")
    frames = found["frames"]
    if frames != int(frames) or frames < 1:
        lines.fail(f"the motion has no frames: Frames: {frames:g}")
    return int(frames), found["time"]


def _frames(lines: NumberedLines, frames: int, width: int) -> np.ndarray:
    """The (frames, width) values, a line each."""
    if width == 0:
        lines.fail("no joint has CHANNELS, so nothing can move")
    rows = []
    for words in lines:
        if len(rows) == frames:
            lines.fail(f"a line too many: Frames: says {frames}")
        if len(words) != width:
            lines.fail(
                f"{len(words)} values in frame {len(rows) + 1}, but the channels are "
                f"{width}"
            )
        rows.append(lines.numbers(words))
    if len(rows) < frames:
        lines.fail(f"{len(rows)} of {frames} frames are there; the file seems cut off")
    return np.array(rows)


# --- kinematics -------------------------------------------------------------------


def bvh_tree(bvh: Bvh) -> SegmentTree:
    """Where every joint is at every frame, in the file's own axes and unit.

    R_FJ = R_FP R_1 R_2 ... in the order of the rotation channels, and
    p_FJ = p_FP + R_FP t, with t the OFFSET or, where a joint has position channels,
    their values: programs that write them write the whole translation. Joints of
    `added_positions` have both.
    """
    added = added_positions(bvh)
    offsets, turns = [], []
    for j, joint in enumerate(bvh.joints):
        t = np.tile(joint.offset, (bvh.num_frames, 1))
        R = np.tile(np.eye(3), (bvh.num_frames, 1, 1))
        for channel, column in bvh.columns(j).items():
            value = bvh.values[:, column]
            if channel in _POSITIONS:
                axis = _POSITIONS[channel]
                t[:, axis] = value + (t[:, axis] if j in added else 0.0)
            else:
                about = Rotation.from_euler(channel[0], value[:, None], degrees=True)
                R = R @ about.as_matrix()
        offsets.append(t)
        turns.append(R)
    names, parents = zip(*((j.name, j.parent) for j in bvh.joints), strict=True)
    return tree_of_turns(names, parents, offsets, turns)


def added_positions(bvh: Bvh) -> tuple[int, ...]:
    """Indices of the joints whose positions are 0, or little, beside their OFFSET.

    With these alone the bone would have no length: some programs write what is to be
    added to the OFFSET.
    """
    joints = []
    for j, joint in enumerate(bvh.joints):
        places = {
            _POSITIONS[channel]: column
            for channel, column in bvh.columns(j).items()
            if channel in _POSITIONS
        }
        offset = joint.offset[list(places)]
        if joint.parent < 0 or np.linalg.norm(offset) <= _NO_BONE * np.linalg.norm(
            joint.offset
        ):
            continue
        written = np.linalg.norm(bvh.values[:, list(places.values())], axis=1)
        if np.median(written) < _NO_BONE * np.linalg.norm(offset):
            joints.append(j)
    return tuple(joints)


def rest_positions(bvh: Bvh, tree: SegmentTree) -> np.ndarray:
    """(J, 3) where the joints are with all rotations zero, the root at 0.

    A joint without OFFSET, but with position channels, is as in the first frame.
    """
    p = np.zeros((len(bvh.joints), 3))
    for j, joint in enumerate(bvh.joints):
        if joint.parent < 0:
            continue
        t = joint.offset
        if joint.channels and joint.channels[0] in _POSITIONS and not t.any():
            step = tree.positions[j][0] - tree.positions[joint.parent][0]
            t = tree.rotations[joint.parent][0].T @ step
        p[j] = p[joint.parent] + t
    return p
