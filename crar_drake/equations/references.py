"""Reference velocity and acceleration of the tasks: Eqs. (9) and (14)."""

from __future__ import annotations

import numpy as np


def reference_velocity(
    v_d: np.ndarray, e: np.ndarray, K: float | np.ndarray
) -> np.ndarray:
    """Eq. (9), in brackets: v_d + K e, also the right-hand side of Eq. (15).

    Args:
        v_d: (m,) desired task velocity [rad/s, m/s].
        e: (m,) task error of Eq. (11) [rad, m].
        K: gain, a scalar or (m,) [1/s].

    Returns:
        (m,) [rad/s, m/s].
    """
    return v_d + K * e


def reference_acceleration(
    a_d: np.ndarray,
    v_d: np.ndarray,
    v: np.ndarray,
    e: np.ndarray,
    Kp: float | np.ndarray,
    Kv: float | np.ndarray,
) -> np.ndarray:
    """Eq. (14): a_r = a_d + Kv (v_d - v) + Kp e.

    Args:
        a_d: (m,) desired task acceleration [rad/s^2, m/s^2].
        v_d: (m,) desired task velocity [rad/s, m/s].
        v: (m,) present task velocity [rad/s, m/s].
        e: (m,) task error of Eq. (11) [rad, m].
        Kp: gain, a scalar or (m,) [1/s^2].
        Kv: gain, a scalar or (m,) [1/s].

    Returns:
        (m,) [rad/s^2, m/s^2].
    """
    return a_d + Kv * (v_d - v) + Kp * e
