"""Ways of points and frames that a motion moves, with their derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydrake.trajectories import BsplineTrajectory

from crar_drake.motion.quaternion_spline import QuaternionSpline

# Takes a time [s]; returns (6,) velocity and (6,) acceleration, [angular; linear].
Lack = Callable[[float], tuple[np.ndarray, np.ndarray]]

_NOTHING = np.zeros(6)


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
    """The way of a frame H that turns about a point C: a hand about its wrist, the root
    about the waist.

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


class HeldTrajectory:
    """A way for who holds accelerations, and for a plant that takes steps.

    Who holds accelerations lags half a period h behind those of the instant: where a
    foot lands, by millimetres. With

        a = (v(t + h) - v(t)) / h

    the velocity is the way's own again at the end of each period, of what is
    accelerated evenly. Of what joints carry `lack` is what they need besides.

    A discrete plant moves by the velocity that it has at the *end* of its step, so that
    velocities that are the way's at the ends take it half a step ahead. It gets
    those of half a step before.
    """

    def __init__(
        self,
        way: PointTrajectory | CarriedTrajectory,
        hold: float,
        step: float,
        lack: Lack | None = None,
    ) -> None:
        """
        Args:
            way: with its velocities and accelerations as they are.
            hold: the period h [s].
            step: of the plant [s]; 0 if it is continuous.
            lack: to be added to velocity and acceleration; by default nothing.
        """
        self.end = way.end
        self._way, self._hold, self._late = way, hold, 0.5 * step
        self._lack = lack or (lambda time: (_NOTHING, _NOTHING))

    def orientation(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """R (3, 3), angular velocity (3,) and acceleration (3,) held from `time` on."""
        return self._held(self._way.orientation, time, slice(0, 3))

    def position(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """p (3,) [m], its velocity and its acceleration from `time` [s] on, in W."""
        return self._held(self._way.position, time, slice(3, 6))

    def _held(self, way, time: float, rows: slice):
        before = time - self._late
        v, then = way(before)[1], way(before + self._hold)[1]
        dv, da = self._lack(time)
        return way(time)[0], v + dv[rows], (then - v) / self._hold + da[rows]
