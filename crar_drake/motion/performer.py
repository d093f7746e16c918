"""The one performer that every format of motion files is read into."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import low_pass

T = TypeVar("T")
Points = Mapping[str, np.ndarray]  # joint to (T, 3) positions, or (3,) of a rest pose

# Joint centre: the one that it hangs on. "head" is where the head turns on the neck,
# "toe" where the toes begin.
PARENTS: Mapping[str, str] = MappingProxyType(
    {
        "pelvis": "",
        "neck": "pelvis",
        "head": "neck",
        "left_shoulder": "neck",
        "left_elbow": "left_shoulder",
        "left_wrist": "left_elbow",
        "right_shoulder": "neck",
        "right_elbow": "right_shoulder",
        "right_wrist": "right_elbow",
        "left_hip": "pelvis",
        "left_knee": "left_hip",
        "left_ankle": "left_knee",
        "left_toe": "left_ankle",
        "right_hip": "pelvis",
        "right_knee": "right_hip",
        "right_ankle": "right_knee",
        "right_toe": "right_ankle",
    }
)
JOINTS = tuple(PARENTS)
_SHORTEST = 1e-3  # from joint to joint, of which a direction is worth keeping [m]
SIDES = ("left", "right")
ARM = ("shoulder", "elbow", "wrist")
LEG = ("hip", "knee", "ankle")

# What robots call the points that they follow: all but one as the joints.
JOINT_CENTRES = (
    "waist",
    "neck",
    *(f"{side}_{joint}" for side in SIDES for joint in ARM),
)


def file_joint(name: str) -> str:
    """The performer's joint that a name of JOINT_CENTRES stands for."""
    return "pelvis" if name == "waist" else name


# Where a fact comes from: what the user gave, what the file states, what was inferred
# from its numbers, or what is assumed for want of anything better.
SOURCES = ("given", "file", "database", "inferred", "assumed")


@dataclass(frozen=True)
class Fact:
    """Something about a recording that a format may leave open."""

    what: str  # of it, e.g. "unit"
    value: str  # in words
    source: str  # one of SOURCES
    why: str = ""  # what it was inferred from, or which option gave it; may be ""

    def __str__(self) -> str:
        source = {"file": "of the file", "database": "of the database"}
        said = source.get(self.source, self.source)
        subject = f"{self.what} {self.value}".strip()
        return f"{subject} ({said}{': ' if self.why else ''}{self.why})"


class Sampled:
    """What has samples of a heading, evenly spaced in time.

    Attributes:
        frame_rate: samples per second [Hz].
        heading: (T,) [rad].
    """

    frame_rate: float  # [Hz]
    heading: np.ndarray  # [rad]

    @property
    def num_frames(self) -> int:
        """Number of samples T."""
        return len(self.heading)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return (self.num_frames - 1) / self.frame_rate

    @property
    def time(self) -> np.ndarray:
        """(T,) sample times, from 0 [s]."""
        return np.arange(self.num_frames) / self.frame_rate


@dataclass(frozen=True, kw_only=True)
class Described:
    """What is known of a recording, whatever its axes and unit.

    A joint that the recording does not have is in none of the mappings.
    """

    name: str  # what the user calls the motion
    format: str  # of the file, e.g. "BVH"
    frame_rate: float  # samples per second [Hz]
    rate_source: str  # where that comes from, one of SOURCES
    # name of JOINTS to what it is taken from in the file
    joints: Mapping[str, str] = field(default_factory=dict)
    # names of JOINTS whose position the file does not have as such (a mean of others,
    # or by a regression)
    guessed: frozenset[str] = frozenset()
    bones: int = 0  # number of the file's bones, markers or points
    bones_called: str = "bones"  # which of these they are
    # bone to the (T - 1,) angles by which it turns against its parent from one frame to
    # the next [rad]
    turns: Mapping[str, np.ndarray] = field(default_factory=dict)
    # name of JOINTS to the bones whose rotations move it
    carriers: Mapping[str, frozenset[str]] = field(default_factory=dict)
    # (T - 1,) whether a frame's numbers are all the same as the one's before
    same: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    notes: tuple[str, ...] = ()  # what was mended, e.g. gaps that were filled.
    hands_obstacle: str = ""  # why nothing tells how the hands are turned, or ""


@dataclass(frozen=True, kw_only=True)
class Performer(Described, Sampled):
    """A person in motion, in the robot's world W: z up, x forward, y left."""

    positions: Points  # name of JOINTS to (T, 3) p_WJ [m]
    heading: np.ndarray  # (T,) yaw of the pelvis about z, unwrapped [rad]; 0 faces x
    hip_height: float  # the pelvis's height above the soles, standing [m]
    height: float  # of the standing performer [m]
    # name of JOINTS to (T, 3, 3) R_WJ, of the part of the body that begins there. It is
    # the identity as the skeleton stands at rest, where the file's rest pose is a
    # standing person, else see `facts`. Empty where the format has none.
    orientations: Mapping[str, np.ndarray] = field(default_factory=dict)
    # "left_hand", "right_hand" to (T, 3, 3) R_WH, see `orientations`
    hands: Mapping[str, np.ndarray] = field(default_factory=dict)
    up: str = ""  # the file's axis that points up, e.g. "+y"; "" if it is W's
    facing: str = ""  # the file's axis that becomes W's x
    facts: tuple[Fact, ...] = ()  # what the file says, and what was inferred or assumed
    doubts: tuple[str, ...] = ()  # what is implausible, and what would explain it
    obstacle: str = ""  # why it cannot drive a robot, or ""

    def centres(self) -> dict[str, np.ndarray]:
        """Name of JOINT_CENTRES to (T, 3) p_WC [m].

        Raises:
            MotionError: the performer lacks joint centres of the upper body, or has no
                legs to take the hip height from.
        """
        if self.obstacle:
            raise MotionError(self.obstacle)
        return {name: self.positions[file_joint(name)] for name in JOINT_CENTRES}

    def smooth(
        self, samples: Mapping[str, np.ndarray], cutoff: float
    ) -> dict[str, np.ndarray]:
        """Samples (T, ...) of the motion by name, after `conditioning.low_pass`.

        Raises:
            MotionError: the motion is too short, or the cutoff [Hz] too high.
        """
        try:
            return {
                name: low_pass(each, self.frame_rate, cutoff)
                for name, each in samples.items()
            }
        except MotionError as error:
            raise MotionError(f"motion {self.name}: {error}") from error

    def directions(self, a: str, b: str, ways: np.ndarray) -> np.ndarray:
        """(T, 3) unit vectors along ways (T, 3) from joint a to joint b.

        Raises:
            MotionError: they coincide in a frame.
        """
        lengths = np.linalg.norm(ways, axis=1, keepdims=True)
        frame = int(np.argmin(lengths))
        # Written so that a NaN fails, too.
        if not lengths[frame] >= _SHORTEST:
            raise MotionError(
                f"motion {self.name}: {a} and {b} coincide in frame {frame + 1}, so "
                "that nothing tells a direction; check the skeleton's lengths"
            )
        return ways / lengths

    def matches(self) -> Iterator[str]:
        """Yields "joint: what of the file", a line for each joint of JOINTS."""
        for joint in JOINTS:
            if joint in self.positions:
                guessed = " (a guess)" if joint in self.guessed else ""
                yield f"{joint}: {self.joints.get(joint, '?')}{guessed}"
            else:
                yield f"{joint}: not in the file"


# No camera sees a person's pelvis so still while a foot goes so far [m].
_STILL, _STEP = 1e-3, 0.1


def pinned_pelvis(performer: Performer) -> str:
    """What to say of points that are relative to the pelvis; "" if they are not.

    Pose estimators give such: the pelvis never moves, and feet slide to and fro.
    """
    p = performer.positions
    feet = [p[f"{side}_ankle"] for side in SIDES if f"{side}_ankle" in p]
    farthest = max((np.ptp(foot, axis=0).max() for foot in feet), default=0.0)
    if np.ptp(p["pelvis"], axis=0).max() > _STILL or farthest < _STEP:
        return ""
    return (
        f"the pelvis never moves, although a foot does by {farthest:.2f} m: the points "
        "are relative to it, as pose estimators give them"
    )


def heading_of(R_WP: np.ndarray) -> np.ndarray:
    """(T,) the twist about z, unwrapped [rad], of (T, 3, 3) rotations.

    It is 2 atan2(q_z, q_w): unlike the direction of the belly it is defined for a
    performer who bends over by 90 degrees.
    """
    sine = R_WP[:, 1, 0] - R_WP[:, 0, 1]
    cosine = R_WP[:, 0, 0] + R_WP[:, 1, 1]
    return np.unwrap(np.arctan2(sine, cosine))


def repeated(values: np.ndarray) -> np.ndarray:
    """(T - 1,) whether a row of (T, k) values equals the one before."""
    return np.all(values[1:] == values[:-1], axis=1)


def sides_swapped(mapping: Mapping[str, T]) -> dict[str, T]:
    """A mapping by joints with left and right exchanged."""
    other = {"left": "right", "right": "left"}
    return {
        f"{other[side]}_{part}" if (side := key.partition("_")[0]) in other else key: v
        for key, v in mapping.items()
        for part in [key.partition("_")[2]]
    }
