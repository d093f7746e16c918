"""Constrained resolved acceleration: Eqs. (3), (10), (12), (13), (15), (30)-(35).

`J_star` is Eq. (34) everywhere. Where some joints are prescribed, the caller moves
their share to the right-hand side: J_p v_p at the velocity level, J_p a_p at the
acceleration level.
"""

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.weighted_inverse import (
    DampedInverse,
    inverse_times,
    project_to_null_space,
)


@compiled
def constrained_velocity(J_star: DampedInverse, v_r: np.ndarray) -> np.ndarray:
    """Eq. (15): q_dot_c = J+ (v_d + K e), constrained by the weight in J+, (n,).

    With W = I it is Eq. (9).

    Args:
        J_star: Eq. (34).
        v_r: (m,) v_d + K e of Eq. (9), less the prescribed joints' share.
    """
    return inverse_times(J_star, v_r)


@compiled
def velocity_level_acceleration(
    qdot_c: np.ndarray, previous: np.ndarray, period: float
) -> np.ndarray:
    """Eqs. (3), (10): alpha = q_ddot_r = d/dt q_dot_r, over one control step, (n,).

    Args:
        qdot_c: (n,) Eq. (15) at this step [rad/s].
        previous: (n,) the same at the previous step; at the first step, where there
            is no difference to take, qdot_c itself: alpha is then 0 (no spike).
        period: control period [s].
    """
    return (qdot_c - previous) / period


@compiled
def null_space_motion(
    qdot_c: np.ndarray, qdot: np.ndarray, GvN: float | np.ndarray
) -> np.ndarray:
    """Eq. (33): zeta = GvN (q_dot_c - q_dot), (n,) [rad/s^2]."""
    return GvN * (qdot_c - qdot)


@compiled
def acceleration_level_acceleration(
    J_star: DampedInverse, J: np.ndarray, a_r: np.ndarray, zeta: np.ndarray
) -> np.ndarray:
    """Eqs. (13), (31), (35): alpha = J+ (a_r - Jdot qdot) [+ N zeta if m < n], (n,).

    Args:
        J_star: Eq. (34).
        J: (m, n) task Jacobian.
        a_r: (m,) Eq. (14), less the bias Jdot qdot and the prescribed joints' share
            [rad/s^2, m/s^2].
        zeta: (n,) Eq. (33) [rad/s^2].
    """
    alpha = inverse_times(J_star, a_r)
    m, n = J.shape
    if m < n:
        alpha += project_to_null_space(J_star, J, zeta)
    return alpha


@compiled
def constrained_resolved_acceleration(
    alpha: np.ndarray, qdot_c: np.ndarray, qdot: np.ndarray, Gv: float | np.ndarray
) -> np.ndarray:
    """Eqs. (12), (30): alpha_c = alpha + Gv (q_dot_c - q_dot), (n,).

    With alpha of Eq. (10) it is Eq. (12) with K_qv = H Gv, the reading taken here:
    both levels then differ in alpha only.

    Args:
        alpha: (n,) Eq. (10) or Eq. (35) [rad/s^2].
        qdot_c: (n,) Eq. (15) [rad/s].
        qdot: (n,) present velocity [rad/s].
        Gv: gain, a scalar or (n,) [1/s].
    """
    return alpha + Gv * (qdot_c - qdot)
