"""What clients and the filter for teleoperation say to each other: JSON, a line each.

A client sends targets, any of the tasks in one line:

    {"time": 12.345, "targets": {
        "left_wrist": {"position": [0.3, 0.2, 0.9]},
        "right_hand": {"position": [0.3, -0.2, 0.9], "orientation": [1, 0, 0, 0]},
        "left_elbow_bend": {"position": 0.5}}}

`time` is the client's own clock [s], which only has to run forward; it may be left out.
Positions are in the world frame W [m], orientations unit quaternions (w, x, y, z); of a
task that is a joint the position is a number [rad or m]. `{"describe": true}` asks for
the names and the order of what comes back, `{"drive": true}` to be the one whose
targets are followed. The robot says where its joints are [rad or m]:

    {"measured": {"left_elbow": -0.52, "left_shoulder_x": 0.1}}

Obstacles that move by themselves may be told: spheres in W, with a bound of their
speed, by any names; null takes one away.

    {"obstacles": {"person": {"position": [1, 0, 1], "radius": 0.3, "speed": 1.6},
                   "trolley": null}}

`{"obstacles": null}` takes all away. Numbers are all that is taken from a message:
nothing in it is run, and no name in it is looked up but among those of the tasks,
joints and obstacles that were told before.
"""

import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from crar_drake.law.tasks import TaskLayout
from crar_drake.strict_json import MessageError, finite, number, numbers, read_object

# A longer datagram is dropped unread [bytes]. It takes 0.6 ms to see that the worst of
# this length is no message; sixty poses fit in.
LONGEST = 8192
# A target farther from the world's origin is no target [m, rad].
_FARTHEST = 1e3
_LATEST = 1e300  # of a sender's clock [s], which may be any

# What an obstacle has, and how long its name may be.
_OBSTACLE = {"position", "radius", "speed"}
_LONGEST_NAME = 40

# What the targets of each kind of task consist of: key, and how many numbers.
PARTS: Mapping[str, tuple[tuple[str, int], ...]] = {
    "position": (("position", 3),),
    "orientation": (("orientation", 4),),
    "pose": (("orientation", 4), ("position", 3)),  # in the order of TaskLayout
    "joint": (("position", 1),),
}


@dataclass(frozen=True)
class TargetMessage:
    """New targets of some tasks."""

    time: float | None  # on the sender's clock [s]; None where it sent none
    # task number to its entries of x_d, see `TaskLayout`; quaternions are of unit
    # length
    targets: Mapping[int, np.ndarray]


@dataclass(frozen=True)
class Describe:
    """A client asks for names and order."""


@dataclass(frozen=True)
class Drive:
    """A client wants to be the one whose targets are followed, from now on."""


@dataclass(frozen=True)
class Measured:
    """Where the robot's joints are."""

    positions: Mapping[str, float]  # joint to position [rad or m]


@dataclass(frozen=True)
class Heard:
    """A sphere that moves, as it is told of."""

    position: tuple[float, float, float]  # (3,) of its centre, in W [m]
    radius: float  # [m]
    speed: float  # that no point of it exceeds [m/s]


@dataclass(frozen=True)
class ObstacleMessage:
    """Where obstacles are now."""

    # by name; None: taken away. None of all of them
    obstacles: Mapping[str, Heard | None] | None


Message = TargetMessage | Measured | ObstacleMessage | Describe | Drive


def parse(line: bytes, layout: TaskLayout, joints: Collection[str] = ()) -> Message:
    """Reads one line.

    Raises:
        MessageError: it is too long, no JSON object, has a key that is not known, a
            task or joint that is not there, a wrong number of numbers, or one that is
            not finite, too large, or no orientation.
    """
    said = read_object(line, LONGEST)
    if said == {"describe": True}:
        return Describe()
    if said == {"drive": True}:
        return Drive()
    if set(said) == {"measured"}:
        positions = joint_positions(said["measured"])
        for name in positions:
            if name not in joints:
                raise MessageError(f"no joint {name[:40]!r}")
        return Measured(positions)
    if set(said) == {"obstacles"}:
        return ObstacleMessage(_obstacles(said["obstacles"]))
    targets = said.get("targets")
    if not set(said) <= {"time", "targets"} or not isinstance(targets, dict):
        raise MessageError('give "targets", and "time" if you like')
    if not targets:
        raise MessageError("no target")
    time = said.get("time")
    found: dict[int, np.ndarray] = {}
    for name, target in targets.items():
        if name not in layout.names:
            raise MessageError(f"no task {name[:40]!r}")
        task = layout.names.index(name)
        found[task] = _entries(target, layout.kinds[task])
    if time is not None:
        time = number(time, -_LATEST, _LATEST)
    return TargetMessage(time, found)


def joint_positions(said: object) -> dict[str, float]:
    """Positions of joints by name [rad or m].

    Raises:
        MessageError: they are none.
    """
    if not isinstance(said, dict) or not said:
        raise MessageError('give {"joint": position, ...}')
    return {name: number(x, -_FARTHEST, _FARTHEST) for name, x in said.items()}


def _obstacles(said: object) -> dict[str, Heard | None] | None:
    """By name; None of all."""
    if said is None:
        return None
    if not isinstance(said, dict) or not said:
        raise MessageError("obstacles has where they are by name")
    found: dict[str, Heard | None] = {}
    for name, told in said.items():
        if not 0 < len(name) <= _LONGEST_NAME:
            raise MessageError(
                f"an obstacle's name has 1 to {_LONGEST_NAME} characters"
            )
        found[name] = None if told is None else _sphere(told)
    return found


def _sphere(told: object) -> Heard:
    if not isinstance(told, dict) or set(told) != _OBSTACLE:
        raise MessageError("an obstacle has position, radius and speed, or is null")
    x, y, z = numbers("position", told["position"], 3, _FARTHEST)
    radius, speed = (number(told[key], 0.0, _FARTHEST) for key in ("radius", "speed"))
    return Heard((x, y, z), radius, speed)


def as_targets(x: np.ndarray, layout: TaskLayout) -> dict[str, dict]:
    """Places as targets that could be sent, the inverse of `parse`.

    Args:
        x: (size_x,) of the tasks, or longer.
    """
    entries = iter(x.round(9).tolist())
    return {
        name: {
            key: [next(entries) for _ in range(count)] if count > 1 else next(entries)
            for key, count in PARTS[kind]
        }
        for name, kind in zip(layout.names, layout.kinds, strict=True)
    }


def _entries(target: object, kind: str) -> np.ndarray:
    parts = PARTS[kind]
    if not isinstance(target, dict) or set(target) != {key for key, _ in parts}:
        raise MessageError(f"a {kind} has {' and '.join(key for key, _ in parts)}")
    entries: list[float] = []
    for key, count in parts:
        values = target[key] if count > 1 else [target[key]]
        values = numbers(key, values, count, _FARTHEST)
        if key == "orientation":
            length = math.hypot(*values)
            if not 0.5 < length < 2.0:
                raise MessageError(f"a quaternion of length {length:.3g}")
            values = [value / length for value in values]
        entries += values
    return np.array(entries)


@dataclass(frozen=True)
class Command:
    """What goes back each period."""

    time: float  # of the server's clock, since it started [s]
    # `time` of the newest message that the command knows, on the sender's clock [s];
    # None before the first, or where it had none
    of: float | None
    # "tracking", "blending" (onto the targets, after a start or a gap) or "braking"
    # (there are no targets)
    status: str
    positions: np.ndarray  # (nq,) where to be one period on [rad, m]
    velocities: np.ndarray  # (nv,) and how fast [rad/s, m/s]
    torques: np.ndarray  # (nu,) at the state that the period begins in [Nm or N]
    distance: float  # of the nearest watched pair [m]; infinite if none is watched
    admitted: str  # "nominal", "corrected", or "scaled", see docs/theory/theorem.md
    driver: str | None = None  # who is followed, "host:port"; None: nobody
    # how far the robot was from what it was told when it was heard last [rad or m]; NaN
    # if it never was
    tracking_error: float = math.nan
    tracking_joint: str | None = None  # of which joint; None of none
    # what held the command back, in words; None where nothing did, or nobody says
    why: str | None = None

    def to_line(self, rejected: str | None = None) -> bytes:
        """As JSON: numbers have as many digits as make sense for a robot.

        Args:
            rejected: why messages of the client were not taken; None: all were.
        """
        said = vars(self) | {"rejected": rejected}
        for name, value in said.items():
            if isinstance(value, np.ndarray):
                said[name] = value.round(9).tolist()
            elif isinstance(value, float) and name != "of":  # which is as it came
                said[name] = finite(value, 6)
        return json.dumps(said, separators=(",", ":")).encode() + b"\n"
