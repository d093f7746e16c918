"""Smooth orientations through given ones, with exact derivatives."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation


def sign_continuous(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (T, 4) with signs such that none is far from the one before.

    Q and -Q are the same orientation; the nearer is the shorter way.
    """
    dots = np.sum(quaternions[1:] * quaternions[:-1], axis=1)
    signs = np.cumprod(np.where(dots < 0.0, -1.0, 1.0))
    return quaternions * np.append(1.0, signs)[:, None]


class QuaternionSpline:
    """Orientations along a cubic spline through quaternions, normalised.

    They are twice continuously differentiable. From one sample to the next the way
    is the shorter one.

    Attributes:
        start, end: the first and the last time [s].
    """

    def __init__(
        self, times: np.ndarray, quaternions: np.ndarray, bc_type: str = "not-a-knot"
    ) -> None:
        """
        Args:
            times: (T,) increasing [s].
            quaternions: (T, 4), order x y z w, of either sign, none of them zero.
            bc_type: of the ends, as of SciPy's CubicSpline.
        """
        self.start, self.end = float(times[0]), float(times[-1])
        self._spline = CubicSpline(times, sign_continuous(quaternions), bc_type=bc_type)

    def __call__(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """R (3, 3), angular velocity (3,) [rad/s] and acceleration (3,) [rad/s^2].

        Both are expressed in the frame that R turns into. Before the start and after
        the end the orientation stays what it is there.

        Args:
            time: [s].
        """
        moving = self.start <= time <= self.end
        t = min(max(time, self.start), self.end)
        Q = self._spline(t)
        R = Rotation.from_quat(Q).as_matrix()
        if not moving:
            return R, np.zeros(3), np.zeros(3)
        # omega = 2 Im(Q_dot / Q), whatever the length of Q, and its derivative.
        inverse = Q * [-1.0, -1.0, -1.0, 1.0] / (Q @ Q)
        rate = _product(self._spline(t, 1), inverse)
        rate_dot = _product(self._spline(t, 2), inverse) - _product(rate, rate)
        return R, 2.0 * rate[:3], 2.0 * rate_dot[:3]


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The product (4,) of two quaternions (x, y, z, w), of any length."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(vector, a[3] * b[3] - a[:3] @ b[:3])
