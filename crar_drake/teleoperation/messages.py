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

Numbers are all that is taken from a message: nothing in it is run, and no name in it is
looked up but among those of the tasks, joints and obstacles that were told before.
"""

import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from crar_drake.law.tasks import TaskLayout

# A longer datagram is dropped unread [bytes]. It takes 2 ms to see that the worst of
# this length is no message; sixty poses fit in.
LONGEST = 8192
# A target farther from the world's origin is no target [m, rad].
_FARTHEST = 1e3

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


class MessageError(ValueError):
    """A message that is not one of those above; it says why."""


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

    obstacles: Mapping[str, Heard | None]  # by name; None: taken away


def parse(
    line: bytes, layout: TaskLayout, joints: Collection[str] = ()
) -> TargetMessage | Measured | ObstacleMessage | Describe | Drive:
    """Reads one line.

    Raises:
        MessageError: it is too long, no JSON object, has a key that is not known, a
            task or joint that is not there, a wrong number of numbers, or one that is
            not finite, too large, or no orientation.
    """
    if len(line) > LONGEST:
        raise MessageError(f"longer than {LONGEST} bytes")
    try:
        said = json.loads(line, parse_constant=_refuse, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise MessageError(f"no JSON: {error}") from error
    if not isinstance(said, dict):
        raise MessageError("no JSON object")
    if said == {"describe": True}:
        return Describe()
    if said == {"drive": True}:
        return Drive()
    if set(said) == {"measured"}:
        return _make_measured(said["measured"], joints)
    if set(said) == {"obstacles"}:
        return _make_obstacles(said["obstacles"])
    unknown = set(said) - {"time", "targets"}
    if unknown or not isinstance(said.get("targets"), dict):
        raise MessageError('give "targets", and "time" if you like')
    time = None if said.get("time") is None else _number(said["time"], math.inf)
    return _make_targets(time, said["targets"], layout)


def _make_targets(
    time: float | None, targets: Mapping[str, object], layout: TaskLayout
) -> TargetMessage:
    """Checks targets by name.

    Args:
        time: on the sender's clock [s], or None.
        targets: task name to a mapping of "position", "orientation" or both.

    Raises:
        MessageError: as `parse`.
    """
    if not targets:
        raise MessageError("no target")
    found: dict[int, np.ndarray] = {}
    for name, target in targets.items():
        if name not in layout.names:
            raise MessageError(f"no task {name[:40]!r}")
        task = layout.names.index(name)
        found[task] = _entries(target, layout.kinds[task])
    return TargetMessage(time, found)


def _make_measured(positions: object, joints: Collection[str]) -> Measured:
    """Checks measured positions by name.

    Args:
        positions: joint to position [rad or m].
        joints: that can be measured.

    Raises:
        MessageError: as `parse`.
    """
    if not isinstance(positions, dict) or not positions:
        raise MessageError("measured has the positions of joints by name")
    for name in positions:
        if name not in joints:
            raise MessageError(f"no joint {name[:40]!r}")
    return Measured({name: _number(x, _FARTHEST) for name, x in positions.items()})


def _make_obstacles(obstacles: object) -> ObstacleMessage:
    """Checks obstacles by name.

    Args:
        obstacles: name to "position", "radius" and "speed", or to None.

    Raises:
        MessageError: as `parse`.
    """
    if not isinstance(obstacles, dict) or not obstacles:
        raise MessageError("obstacles has where they are by name")
    found: dict[str, Heard | None] = {}
    for name, told in obstacles.items():
        if not 0 < len(name) <= _LONGEST_NAME:
            raise MessageError(
                f"an obstacle's name has 1 to {_LONGEST_NAME} characters"
            )
        if told is None:
            found[name] = None
            continue
        if not isinstance(told, dict) or set(told) != _OBSTACLE:
            raise MessageError("an obstacle has position, radius and speed, or is null")
        place = told["position"]
        if not isinstance(place, list) or len(place) != 3:
            raise MessageError("position has 3 numbers")
        x, y, z = (_number(value, _FARTHEST) for value in place)
        radius, speed = (_number(told[key], _FARTHEST) for key in ("radius", "speed"))
        if radius < 0.0 or speed < 0.0:
            raise MessageError("radius and speed are not negative")
        found[name] = Heard((x, y, z), radius, speed)
    return ObstacleMessage(found)


def as_targets(x: np.ndarray, layout: TaskLayout) -> dict[str, dict]:
    """Places as targets that could be sent, the inverse of `_make_targets`.

    Args:
        x: (size_x,) of the tasks, or longer.
    """
    numbers = iter(x.round(9).tolist())
    return {
        name: {
            key: [next(numbers) for _ in range(count)] if count > 1 else next(numbers)
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
        if not isinstance(values, list) or len(values) != count:
            raise MessageError(f"{key} has {count} numbers")
        numbers = [_number(value, _FARTHEST) for value in values]
        if key == "orientation":
            length = math.hypot(*numbers)
            if not 0.5 < length < 2.0:
                raise MessageError(f"a quaternion of length {length:.3g}")
            numbers = [number / length for number in numbers]
        entries += numbers
    return np.array(entries)


def _number(value: object, largest: float) -> float:
    # To Python, true is a number.
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MessageError(f"{str(value)[:40]!r} is no number")
    try:
        number = float(value)
    except OverflowError as error:
        raise MessageError("a number beyond all sense") from error
    if not math.isfinite(number) or abs(number) > largest:
        raise MessageError("a number beyond all sense")
    return number


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is no number")


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key twice")
    return found


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

    def to_line(self) -> bytes:
        """As JSON: numbers have as many digits as make sense for a robot."""
        # JSON has no infinity.
        distance, error = (
            round(x, 6) if math.isfinite(x) else None
            for x in (self.distance, self.tracking_error)
        )
        said = {
            "time": round(self.time, 6),
            "of": self.of,
            "status": self.status,
            "admitted": self.admitted,
            "why": self.why,
            "driver": self.driver,
            "distance": distance,
            "tracking_error": error,
            "tracking_joint": self.tracking_joint,
            "positions": self.positions.round(9).tolist(),
            "velocities": self.velocities.round(9).tolist(),
            "torques": self.torques.round(6).tolist(),
        }
        return json.dumps(said, separators=(",", ":")).encode() + b"\n"
