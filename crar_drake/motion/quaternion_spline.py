"""Smooth orientations through given ones, with exact derivatives."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import Akima1DInterpolator, CubicSpline
from scipy.spatial.transform import Rotation


def sign_continuous(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (T, 4) with signs such that none is far from the one before.

    Q and -Q are the same orientation; the nearer is the shorter way.
    """
    dots = np.sum(quaternions[1:] * quaternions[:-1], axis=1)
    signs = np.cumprod(np.where(dots < 0.0, -1.0, 1.0))
    return quaternions * np.append(1.0, signs)[:, None]


def still_spline(times: np.ndarray, samples: np.ndarray) -> Akima1DInterpolator:
    """Through samples (T, k), once continuously differentiable, constant where two
    samples and their neighbours are the same: another spline would swing there.

    Akima's piecewise cubic with modified weights, as SciPy has it.
    """
    return Akima1DInterpolator(times, samples, method="makima")


class QuaternionSpline:
    """Orientations along a cubic spline through quaternions, normalised.

    They are twice continuously differentiable, or once if `still`. From one sample to
    the next the way is the shorter one.

    Attributes:
        start, end: the first and the last time [s].
    """

    def __init__(
        self,
        times: np.ndarray,
        quaternions: np.ndarray,
        bc_type: str = "not-a-knot",
        still: bool = False,
    ) -> None:
        """
        Args:
            times: (T,) increasing [s].
            quaternions: (T, 4), order x y z w, of either sign, none of them zero.
            bc_type: of the ends, as of SciPy's CubicSpline.
            still: whether what does not turn from sample to sample does not in between,
                see `still_spline`; `bc_type` says nothing then.
        """
        self.start, self.end = float(times[0]), float(times[-1])
        quaternions = sign_continuous(quaternions)
        if still:
            self._spline = still_spline(times, quaternions)
        else:
            self._spline = CubicSpline(times, quaternions, bc_type=bc_type)

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
