"""The collision potential and its weight: Eqs. (19)-(26)."""

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.vectors import sum_columns

# Below this distance [m] the magnitude of Eq. (23) is taken at this distance: at
# d = 0 it is infinite, and for d < 0 the printed formula shrinks again.
DISTANCE_CLAMP = 1e-3


@compiled
def collision_potential_slope(
    d: np.ndarray,
    rho: float | np.ndarray,
    alpha: float | np.ndarray,
    beta: float | np.ndarray,
) -> np.ndarray:
    """Eq. (23): df/dd = -rho exp(-alpha d) d^-beta (beta/d + alpha), (Nc,) [1/m].

    Below DISTANCE_CLAMP, in contact and in penetration it is taken there.

    Args:
        d: (Nc,) signed distances [m].
        rho, alpha, beta: scalars or (Nc,); amplitude, decay [1/m], exponent.
    """
    d = np.maximum(d, DISTANCE_CLAMP)
    return -rho * np.exp(-alpha * d) * d**-beta * (beta / d + alpha)


@compiled
def distance_gradient_about_origin(
    normal: np.ndarray, point: np.ndarray, S: np.ndarray, moves: np.ndarray
) -> np.ndarray:
    """Eq. (20) of all pairs as one product, (K, Nc, n) [m/rad or 1], from S.

    Both witness points lie on one line along the normal, so that a unit force along
    it has the same moment p x n about the world's origin at either. The wrench does
    work on joint j at the rate [p x n; n]^T S_j if j carries a, less that if it
    carries b: n^T (J_a - J_b).

    Args:
        normal: (K Nc, 3) unit vectors from b towards a, in W, in K configurations.
        point: (K Nc, 3) any point of the line through both witness points [m].
        S: (K, 6, n) the joints' motion about the world's origin, angular above
            linear, see `kinematics.joint_motion`.
        moves: (Nc, n) 1 where the joint carries a alone, -1 where it carries b
            alone, else 0.
    """
    K, Nc, n = len(S), len(moves), S.shape[2]
    g = np.zeros((K, Nc, n))
    for k in range(K):
        for i in range(Nc):
            row = k * Nc + i
            x, y, z = point[row, 0], point[row, 1], point[row, 2]
            n_0, n_1, n_2 = normal[row, 0], normal[row, 1], normal[row, 2]
            w_0, w_1, w_2 = y * n_2 - z * n_1, z * n_0 - x * n_2, x * n_1 - y * n_0
            for j in range(n):
                if moves[i, j] != 0.0:
                    turning = w_0 * S[k, 0, j] + w_1 * S[k, 1, j] + w_2 * S[k, 2, j]
                    rate = turning + n_0 * S[k, 3, j] + n_1 * S[k, 4, j]
                    g[k, i, j] = moves[i, j] * (rate + n_2 * S[k, 5, j])
    return g


@compiled
def collision_gradient(slope: np.ndarray, dd_dq: np.ndarray) -> np.ndarray:
    """Eqs. (19), (25): grad f_j = (df_j/dd_j) (dd_j/dq), (Nc, n).

    Args:
        slope: (Nc,) Eq. (23).
        dd_dq: (Nc, n) Eq. (20).
    """
    return slope[:, np.newaxis] * dd_dq


@compiled
def collision_proximity(gradient: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The |grad f_i| that Eq. (21) compares between steps, (Nc, n).

    Down to DISTANCE_CLAMP it is the magnitude of Eq. (25); below, where the slope
    is clamped, it goes on growing linearly with the depth, so that going deeper
    is distinguished from coming out.

    Args:
        gradient: (Nc, n) Eq. (25).
        d: (Nc,) signed distances, not clamped [m].
    """
    depth = np.maximum(DISTANCE_CLAMP - d, 0.0) / DISTANCE_CLAMP
    return np.abs(gradient) * (1.0 + depth)[:, np.newaxis]


@compiled
def pair_weights(
    gradient: np.ndarray, proximity: np.ndarray, previous: np.ndarray
) -> np.ndarray:
    """Eq. (21): the diagonals of W_COL_j, one row per pair.

    Args:
        gradient: (Nc, n) Eq. (25) at the present step.
        proximity: (Nc, n) `collision_proximity` at the present step.
        previous: (Nc, n) the same at the previous step; zeros at the first step,
            where the change counts as 0, that is as approaching.

    Returns:
        (Nc, n) 1 + |grad f_i| where the pair approaches, else 1.
    """
    return 1.0 + np.abs(gradient) * (proximity >= previous)


@compiled
def collision_weights(W_COL_j: np.ndarray) -> np.ndarray:
    """Eq. (26): the diagonal of W_COL, the mean of the W_COL_j; (n,) ones without any.

    Args:
        W_COL_j: (Nc, n) Eq. (21).
    """
    if not len(W_COL_j):
        return np.ones(W_COL_j.shape[1])
    return sum_columns(W_COL_j) / len(W_COL_j)
