"""Ways of tasks over time, with their derivatives."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.trajectories import BsplineTrajectory

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import low_pass, spline
from crar_drake.motion.performer import Performer
from crar_drake.motion.quaternion_spline import QuaternionSpline
from crar_drake.motion.retarget import RetargetedMotion

# time [s] to a value, its velocity and its acceleration
Way = Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class TaskWay:
    """The way of one task, which stands still after `end`.

    What no task of its layout asks for may be left out.
    """

    end: float  # [s]
    position: Way | None = None  # p (3,) [m], its velocity and acceleration, in W
    # R (3, 3), angular velocity (3,) [rad/s] and acceleration (3,) [rad/s^2], in W
    orientation: Way | None = None
    joint: Way | None = None  # q of a joint [rad or m], its velocity and acceleration


def held(derivatives: Callable[[float, int], np.ndarray], start: float, end: float):
    """A `Way` along what has derivatives, at rest before its start and after its end.

    Args:
        derivatives: time [s] and order, 0 to 2, to a value.
    """

    def at(time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        t = min(max(time, start), end)
        x, v, a = (derivatives(t, order) for order in range(3))
        return (x, v, a) if t == time else (x, np.zeros_like(v), np.zeros_like(a))

    return at


def point_way(position: BsplineTrajectory) -> TaskWay:
    """The way of a joint centre.

    Args:
        position: p_WC, three rows, from time 0 [m].
    """
    orders = [position.MakeDerivative(k) for k in range(3)]
    end = position.end_time()
    return TaskWay(end, held(lambda t, order: orders[order].value(t).ravel(), 0.0, end))


def carried_way(
    point: TaskWay, orientation: QuaternionSpline, arm: np.ndarray
) -> TaskWay:
    """The way of a frame H that turns about a point C: of a hand about its wrist.

    Its position is p_WH = p_WC + R_WH p_CH_H.

    Args:
        point: the way of C.
        orientation: R_WH, as long as the point's way.
        arm: (3,) p_CH_H, from C to H, in H [m].
    """

    def position(time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        p, v, a = point.position(time)
        R, omega, alpha = orientation(time)
        p_CH = R @ arm
        turning = np.cross(omega, p_CH)
        return (
            p + p_CH,
            v + turning,
            a + np.cross(alpha, p_CH) + np.cross(omega, turning),
        )

    return TaskWay(point.end, position, orientation)


def head_way(
    performer: Performer, retargeted: RetargetedMotion, length: float, cutoff: float
) -> TaskWay:
    """The way of the head: from the neck as the performer's is.

    Args:
        performer: with a head.
        retargeted: where the neck is.
        length: from the robot's neck to its head [m].
        cutoff: of the low-pass [Hz].

    Raises:
        MotionError: the performer has no head, or it is where his neck is.
    """
    if "head" not in performer.positions:
        raise MotionError(f"motion {performer.name}: it has no head; leave that out")
    p = performer.positions
    way = low_pass(p["head"] - p["neck"], performer.frame_rate, cutoff)
    way = length * performer.directions("neck", "head", way)
    return point_way(spline(retargeted.time, retargeted.positions["neck"] + way))
