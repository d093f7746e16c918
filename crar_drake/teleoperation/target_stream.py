"""Targets as they arrive, judged, and as the control law wants them at each instant."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.law.tasks import TaskLayout
from crar_drake.teleoperation.gate import Gate
from crar_drake.teleoperation.messages import PARTS, TargetMessage

# The velocity of a target is not believed for longer than this after it came [s].
_LONGEST_EXTRAPOLATION = 0.1
# Two targets of one task nearer in time than this have no velocity between them [s].
_SHORTEST = 1e-3

PASSED, CLAMPED, REJECTED, LATE = "passed", "clamped", "rejected", "late"


@dataclass
class _Track:
    """What one task was asked last."""

    x: np.ndarray  # (3,), (4,), (7,) or (1,) entries of x_d
    v: np.ndarray  # (3,), (6,) or (1,) its velocity, as in v_d
    sender: object  # who sent it
    sent: float  # on the sender's clock [s]
    arrived: float  # on ours [s]
    interval: float = 0.0  # to the one before [s]


class TargetStream:
    """Judges what arrives, and fills the time between with what it says.

    A target goes on at the speed between the last two for as long as these were apart,
    at most 0.1 s, and then stands still. What is too fast stands still at once, and is
    approached at a bounded speed, unless it is a joint.

    Attributes:
        layout: of the tasks.
        gate: what a target may be.
        counts: verdict to how many targets there were of it.
    """

    def __init__(self, layout: TaskLayout, gate: Gate, period: float) -> None:
        """
        Args:
            layout, gate: see the attributes.
            period: between two calls of `desired_at` [s].
        """
        self.layout, self.gate, self.counts = layout, gate, Counter()
        self._farthest = gate.speed * period
        self._largest_turn = gate.angular_speed * period
        # Where each task is in stacked vectors.
        sizes = [sum(n for _, n in PARTS[kind]) for kind in layout.kinds]
        ends = np.cumsum(sizes)
        self._x = [slice(end - n, end) for end, n in zip(ends, sizes, strict=True)]
        rows, nx = map(layout.rows_of, range(len(layout.kinds))), layout.size_x
        self._v = [slice(nx + each.start, nx + each.stop) for each in rows]
        self._tracks: dict[int, _Track] = {}
        self._stays: dict[int, np.ndarray] = {}  # of lost tasks
        self._last: np.ndarray | None = None  # (size,) what `limit` let through

    def take(
        self,
        message: TargetMessage,
        now: float,
        here: np.ndarray,
        sender: object = None,
    ) -> dict[int, str]:
        """Judges each target of a message; task to verdict.

        Args:
            now: on our clock, when it did [s].
            here: (layout.size,) [x; ...] where the robot's points are.
            sender: each has a clock of its own.
        """
        sent = now if message.time is None else message.time
        verdicts = {
            task: self._judge(task, x, sent, now, here, sender)
            for task, x in message.targets.items()
        }
        self.counts.update(verdicts.values())
        return verdicts

    def desired_at(self, now: float, here: np.ndarray) -> np.ndarray:
        """(layout.size,) [x_d; v_d; a_d]; NaN if there is no target of any task.

        A task whose targets are lost, or that never had one, is to stay where it was
        when that began.

        Args:
            now: on our clock [s].
            here: (layout.size,) [x; ...] where the robot's points are.
        """
        desired = np.zeros(self.layout.size)
        alive = False
        for task, kind in enumerate(self.layout.kinds):
            at, track = self._x[task], self._tracks.get(task)
            if track is not None and now - track.arrived <= self.gate.timeout:
                alive = True
                self._stays.pop(task, None)
                age = now - track.arrived
                if age < track.interval:
                    desired[self._v[task]] = track.v
                moved = min(age, track.interval) * track.v
                desired[at] = _moved(track.x, moved, kind)
            else:
                desired[at] = self._stays.setdefault(task, here[at].copy())
        if not alive:
            # Braking is not staying: where it ends is where a task will stay.
            self._stays.clear()
            desired[:] = np.nan
        return self.limit(desired, here)

    def limit(self, desired: np.ndarray, here: np.ndarray) -> np.ndarray:
        """(layout.size,) [x; v; a] within reach: targets that jump are approached.

        Of each period's targets a position or an orientation is passed as it is if it
        is no farther from what was passed before than the gate's speed leads in a
        period. Else it is what lies as far on the way there, a turn by the shorter way,
        and at rest: a law that plans would go on with a velocity, and past the end.
        Joints are passed.

        Args:
            desired: (layout.size,) [x_d; v_d; a_d]; NaN if there are no targets.
            here: (layout.size,) [x; ...] where the robot's points are, and where it
                begins at first and after targets were lost.
        """
        if np.isnan(desired).any():
            self._last = None
            return desired
        last, limited = here if self._last is None else self._last, desired.copy()
        for kind, x, v in zip(self.layout.kinds, self._x, self._v, strict=True):
            if kind == "joint":
                continue
            way = _difference(last[x], desired[x], kind)
            share = np.ones(len(way))
            turn, move = slice(_TURNS[kind]), slice(_TURNS[kind], None)
            for part, most in ((turn, self._largest_turn), (move, self._farthest)):
                length = np.linalg.norm(way[part])
                share[part] = most / length if length > most else 1.0
            if (share < 1.0).any():
                limited[x] = _moved(last[x], share * way, kind)
                limited[v] *= share == 1.0
        self._last = limited
        return limited

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
        if before is not None and (
            now - before.arrived > self.gate.timeout  # a sender may have started again
            or before.sender != sender  # whose clock says nothing of this one's
        ):
            before = None
        if before is not None and sent <= before.sent:
            return LATE
        away = _difference(here[self._x[task]], x, kind)[_TURNS[kind] :]
        if kind != "joint" and np.linalg.norm(away) > self.gate.distance:
            return REJECTED
        rows = self._v[task]
        track = _Track(x, np.zeros(rows.stop - rows.start), sender, sent, now)
        self._tracks[task] = track
        if before is None or sent - before.sent < _SHORTEST:
            return PASSED
        interval = sent - before.sent
        v = _difference(before.x, x, kind) / interval
        track.interval = min(interval, _LONGEST_EXTRAPOLATION)
        if self._too_fast(v, kind):
            return CLAMPED  # a jump is no motion that would go on
        track.v = v
        return PASSED

    def _too_fast(self, v: np.ndarray, kind: str) -> bool:
        gate, turns = self.gate, _TURNS[kind]
        fastest = gate.joint_speed if kind == "joint" else gate.speed
        return bool(
            np.linalg.norm(v[:turns]) > gate.angular_speed
            or np.linalg.norm(v[turns:]) > fastest
        )


# How many of the first rows of v_d are a turn, by the kind of task.
_TURNS = {"position": 0, "orientation": 3, "pose": 3, "joint": 0}


def _difference(x_0: np.ndarray, x_1: np.ndarray, kind: str) -> np.ndarray:
    """What leads from one target to the next in a unit of time, as in v_d."""
    if not _TURNS[kind]:
        return x_1 - x_0
    turn = (_rotation(x_1) * _rotation(x_0).inv()).as_rotvec()
    return np.concatenate((turn, x_1[4:] - x_0[4:]))


def _moved(x: np.ndarray, way: np.ndarray, kind: str) -> np.ndarray:
    """Where a way as of `_difference` leads."""
    if not _TURNS[kind]:
        return x + way
    turned = Rotation.from_rotvec(way[:3]) * _rotation(x)
    return np.concatenate((turned.as_quat()[[3, 0, 1, 2]], x[4:] + way[3:]))


def _rotation(x: np.ndarray) -> Rotation:
    """Of the quaternion at the beginning of x."""
    return Rotation.from_quat(x[[1, 2, 3, 0]])
