"""Targets as they arrive, judged, and as the control law wants them at each instant."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.law.tasks import TaskLayout
from crar_drake.teleoperation.messages import PARTS, TargetMessage

# The velocity of a target is not believed for longer than this after it came [s].
_LONGEST_EXTRAPOLATION = 0.1
# Two targets of one task nearer in time than this have no velocity between them [s].
_SHORTEST = 1e-3

PASSED, CLAMPED, REJECTED, LATE = "passed", "clamped", "rejected", "late"
VERDICTS = (PASSED, CLAMPED, REJECTED, LATE)


@dataclass(frozen=True)
class Gate:
    """What a target may be."""

    speed: float = 1.5  # that targets are approached at, at most [m/s]
    angular_speed: float = 6.0  # the same of orientations [rad/s]
    # faster targets of tasks that are joints count as clamped, and are taken to be at
    # rest where they are. How fast joints go is bounded by the robot's own speed limits
    # alone [rad/s or m/s].
    joint_speed: float = 3.0
    # targets that are farther than this from where the robot's point is are rejected,
    # but for joints [m]
    distance: float = 1.0
    # without a new target for so long the targets are lost: the robot brakes [s]
    timeout: float = 0.25


@dataclass
class _Track:
    """What one task was asked last."""

    x: np.ndarray  # (3,), (4,), (7,) or (1,) entries of x_d
    v: np.ndarray  # (3,), (6,) or (1,) its velocity, as in v_d
    sender: object  # who sent it
    sent: float  # on the sender's clock [s]
    arrived: float  # on ours [s]
    interval: float = 0.0  # to the one before [s]


class RateLimiter:
    """Approaches targets that jump, at a bounded speed.

    Of each period's targets a position or an orientation is passed as it is if it is no
    farther from what was passed before than the gate's speed leads in a period. Else it
    is what lies as far on the way there, a turn by the shorter way, and at rest: a law
    that plans would go on with a velocity, and past the end. Joints are passed.
    """

    def __init__(self, layout: TaskLayout, gate: Gate, period: float) -> None:
        """
        Args:
            period: between two calls [s].
        """
        self._layout = layout
        self._farthest = gate.speed * period
        self._largest_turn = gate.angular_speed * period
        self._last: np.ndarray | None = None  # (size,) what was passed before

    def limit(self, desired: np.ndarray, here: np.ndarray) -> np.ndarray:
        """(layout.size,) [x; v; a] within reach.

        Args:
            desired: (layout.size,) [x_d; v_d; a_d]; NaN if there are no targets.
            here: (layout.size,) [x; ...] where the robot's points are, and where it
                begins at first and after targets were lost.
        """
        if np.isnan(desired).any():
            self._last = None
            return desired
        last, limited = here if self._last is None else self._last, desired.copy()
        layout, at_v = self._layout, self._layout.size_x
        for x, rows in zip(layout.position_entries, layout.linear_rows, strict=True):
            way = desired[x] - last[x]
            share = _share(way, self._farthest)
            if share < 1.0:
                limited[x] = last[x] + share * way
                limited[at_v + rows] = 0.0
        for x, rows in zip(layout.quaternion_entries, layout.angular_rows, strict=True):
            way = _velocity(last[x], desired[x], "orientation")
            share = _share(way, self._largest_turn)
            if share < 1.0:
                limited[x] = _turned(last[x], share * way)
                limited[at_v + rows] = 0.0
        self._last = limited
        return limited


def _share(way: np.ndarray, most: float) -> float:
    """The share of a way (3,) that is as long as `most`, at most 1."""
    length = np.linalg.norm(way)
    return most / length if length > most else 1.0


@dataclass
class TargetStream:
    """Judges what arrives, and fills the time between with what it says.

    A target goes on at the speed between the last two for as long as these were apart,
    at most 0.1 s, and then stands still. What is too fast stands still at once, and is
    approached at a bounded speed, unless it is a joint.
    """

    layout: TaskLayout  # of the tasks
    gate: Gate  # what a target may be
    period: float  # between two calls of `desired_at` [s]
    # verdict to how many targets there were of it
    counts: Counter = field(default_factory=Counter)
    _tracks: dict[int, _Track] = field(default_factory=dict)
    _stays: dict[int, np.ndarray] = field(default_factory=dict)  # of lost tasks

    def __post_init__(self) -> None:
        self._limiter = RateLimiter(self.layout, self.gate, self.period)

    def take(
        self,
        message: TargetMessage,
        now: float,
        here: np.ndarray,
        sender: object = None,
    ) -> bool:
        """Judges each target of a message; whether any was kept.

        Args:
            now: on our clock, when it did [s].
            here: (layout.size,) [x; ...] where the robot's points are.
            sender: each has a clock of its own.
        """
        kept = False
        sent = now if message.time is None else message.time
        for task, x in message.targets.items():
            verdict = self._judge(task, x, sent, now, here, sender)
            self.counts[verdict] += 1
            kept |= verdict in (PASSED, CLAMPED)
        return kept

    def desired_at(self, now: float, here: np.ndarray) -> np.ndarray:
        """(layout.size,) [x_d; v_d; a_d]; NaN if there is no target of any task.

        A task whose targets are lost, or that never had one, is to stay where it was
        when that began.

        Args:
            now: on our clock [s].
            here: (layout.size,) [x; ...] where the robot's points are.
        """
        layout = self.layout
        desired = np.zeros(layout.size)
        alive = False
        for task, kind in enumerate(layout.kinds):
            track = self._tracks.get(task)
            if track is not None and now - track.arrived <= self.gate.timeout:
                alive = True
                self._stays.pop(task, None)
                x, v = _extrapolated(track, now - track.arrived, kind)
                first = layout.size_x + layout.rows_of(task).start
                desired[first : first + len(v)] = v
            else:
                x = self._stays.setdefault(task, here[self._entries(task)].copy())
            desired[self._entries(task)] = x
        if not alive:
            # Braking is not staying: where it ends is where a task will stay.
            self._stays.clear()
            desired[:] = np.nan
        return self._limiter.limit(desired, here)

    def _judge(
        self,
        task: int,
        x: np.ndarray,
        sent: float,
        now: float,
        here: np.ndarray,
        sender: object,
    ) -> str:
        kind, before = self.layout.kinds[task], self._tracks.get(task)
        if before is not None and now - before.arrived > self.gate.timeout:
            before = None  # it was lost: a sender may have started again
        if before is not None and before.sender != sender:
            before = None  # whose clock says nothing of this one's
        if before is not None and sent <= before.sent:
            return LATE
        at = _position(x, kind)
        if at is not None and kind != "joint":
            away = np.linalg.norm(at - _position(here[self._entries(task)], kind))
            if away > self.gate.distance:
                return REJECTED
        track = _Track(x, np.zeros(self._num_rows(task)), sender, sent, now)
        verdict = PASSED
        if before is not None and sent - before.sent >= _SHORTEST:
            interval = sent - before.sent
            track.v = _velocity(before.x, x, kind) / interval
            track.interval = min(interval, _LONGEST_EXTRAPOLATION)
            verdict = CLAMPED if self._too_fast(track.v, kind) else PASSED
        if verdict == CLAMPED:
            # A jump is no motion that would go on.
            track.v = np.zeros_like(track.v)
        self._tracks[task] = track
        return verdict

    def _too_fast(self, v: np.ndarray, kind: str) -> bool:
        gate = self.gate
        if kind == "joint":
            return abs(v[0]) > gate.joint_speed
        turns, moves = {
            "position": (v[:0], v),
            "orientation": (v, v[:0]),
            "pose": (v[:3], v[3:]),
        }[kind]
        return bool(
            np.linalg.norm(turns) > gate.angular_speed
            or np.linalg.norm(moves) > gate.speed
        )

    def _num_rows(self, task: int) -> int:
        rows = self.layout.rows_of(task)
        return rows.stop - rows.start

    def _entries(self, task: int) -> slice:
        sizes = [sum(n for _, n in PARTS[kind]) for kind in self.layout.kinds]
        start = sum(sizes[:task])
        return slice(start, start + sizes[task])


def _position(x: np.ndarray, kind: str) -> np.ndarray | None:
    """The position among a task's entries of x_d, if it has one."""
    return {"position": x, "pose": x[4:], "joint": x}.get(kind)


def _velocity(x_0: np.ndarray, x_1: np.ndarray, kind: str) -> np.ndarray:
    """What leads from one target to the next in a unit of time, as in v_d."""
    if kind in ("position", "joint"):
        return x_1 - x_0
    turn = (_rotation(x_1) * _rotation(x_0).inv()).as_rotvec()
    return turn if kind == "orientation" else np.concatenate((turn, x_1[4:] - x_0[4:]))


def _extrapolated(
    track: _Track, age: float, kind: str
) -> tuple[np.ndarray, np.ndarray]:
    """Entries of x_d and rows of v_d, `age` after the target came."""
    if age >= track.interval:
        age, v = track.interval, np.zeros_like(track.v)
    else:
        v = track.v
    moved = age * track.v
    if kind in ("position", "joint"):
        return track.x + moved, v
    quaternion = _turned(track.x, moved[:3])
    if kind == "orientation":
        return quaternion, v
    return np.concatenate((quaternion, track.x[4:] + moved[3:])), v


def _turned(x: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """The quaternion (4,) at the beginning of x, turned by phi (3,) in the world."""
    return (Rotation.from_rotvec(phi) * _rotation(x)).as_quat()[[3, 0, 1, 2]]


def _rotation(x: np.ndarray) -> Rotation:
    return Rotation.from_quat(x[[1, 2, 3, 0]])
