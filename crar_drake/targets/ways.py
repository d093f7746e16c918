"""Ways of points and frames that a motion moves, with their derivatives."""

import numpy as np
from pydrake.trajectories import BsplineTrajectory

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import low_pass, spline
from crar_drake.motion.performer import Performer
from crar_drake.motion.quaternion_spline import QuaternionSpline
from crar_drake.motion.retarget import RetargetedMotion

# Below this neck and head have no direction worth keeping [m].
_SHORTEST_NECK = 1e-3


class PointTrajectory:
    """The way of a joint centre."""

    def __init__(self, position: BsplineTrajectory) -> None:
        """
        Args:
            position: p_WC, three rows, from time 0 [m].
        """
        self.end = position.end_time()
        self._derivatives = [position.MakeDerivative(k) for k in range(3)]

    def position(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """p (3,) [m], its velocity and its acceleration at `time` [s], in W.

        After the end it stands still there.
        """
        p, v, a = (f.value(min(time, self.end)).ravel() for f in self._derivatives)
        return (p, v, a) if time <= self.end else (p, np.zeros(3), np.zeros(3))


class CarriedTrajectory:
    """The way of a frame H that turns about a point C: of a hand about its wrist.

    Its position is p_WH = p_WC + R_WH p_CH_H.
    """

    def __init__(
        self, point: PointTrajectory, orientation: QuaternionSpline, arm: np.ndarray
    ) -> None:
        """
        Args:
            point: the way of C.
            orientation: R_WH, as long as the point's way.
            arm: (3,) p_CH_H, from C to H, in H [m].
        """
        self.end = point.end
        self._point, self._orientation, self._arm = point, orientation, arm

    def orientation(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """R (3, 3), angular velocity (3,) and acceleration (3,) at `time`, in W."""
        return self._orientation(time)

    def position(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """p (3,) [m], its velocity and its acceleration at `time` [s], in W."""
        p, v, a = self._point.position(time)
        R, omega, alpha = self._orientation(time)
        arm = R @ self._arm
        turning = np.cross(omega, arm)
        return p + arm, v + turning, a + np.cross(alpha, arm) + np.cross(omega, turning)


def head_way(
    performer: Performer, retargeted: RetargetedMotion, length: float, cutoff: float
) -> PointTrajectory:
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
    norm = np.linalg.norm(way, axis=1, keepdims=True)
    # Written so that a NaN fails, too.
    if not norm.min() >= _SHORTEST_NECK:
        raise MotionError(
            f"motion {performer.name}: neck and head coincide in frame "
            f"{int(norm.argmin()) + 1}, so that the neck has no direction"
        )
    return PointTrajectory(
        spline(retargeted.time, retargeted.positions["neck"] + length * way / norm)
    )
