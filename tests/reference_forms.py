"""Equations of the paper as it prints them, where the product computes others.

`docs/theory/equations.md` lists them as reference forms.
"""

import numpy as np

from crar_drake.equations.weighted_inverse import damped_inverse, inverse_times


def weighted_pseudo_inverse(J: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Eq. (16): J+ = W^-1 J^T (J W^-1 J^T)^-1.

    The product damps it, Eq. (34).

    Args:
        J: (m, n) task Jacobian of full row rank.
        W: (n,) diagonal of the weight matrix, positive.

    Returns:
        (n, m).

    Raises:
        numpy.linalg.LinAlgError: J has not full row rank.
    """
    # Rounding hides a singular matrix from the solver.
    if np.linalg.matrix_rank(J) < len(J):
        raise np.linalg.LinAlgError("J has not full row rank")
    return np.linalg.solve((J / W) @ J.T, J / W).T


def joint_limit_potential(
    q: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """The potential h whose gradient is Eq. (17): (u-l)^2 / (4 (u-q) (q-l)).

    Defined between finite limits only.

    Args:
        q, lower, upper: (n,) positions and limits [rad or m].

    Returns:
        (n,) h_i [1]; 1 in the middle of the range, infinite at the limits.
    """
    return (upper - lower) ** 2 / (4.0 * (upper - q) * (q - lower))


def distance_gradient(
    normal: np.ndarray, J_a: np.ndarray, J_b: np.ndarray
) -> np.ndarray:
    """Eq. (20): dd/dq = n^T (J_a - J_b), with n = (p_a - p_b) / d.

    The product computes it without the witness points' Jacobians,
    `distance_gradient_about_origin`.

    The unit normal stands for (p_a - p_b) / d, which has no value at d = 0 and
    the wrong sign inside. For geometry welded to the world J_b is 0.

    Args:
        normal: (Nc, 3) unit vectors from b towards a, in W.
        J_a, J_b: (Nc, 3, n) translational Jacobians of the witness points, in W.

    Returns:
        (Nc, n) gradients [m/rad or 1].
    """
    return np.einsum("ci,cin->cn", normal, J_a - J_b)


def collision_potential(
    d: np.ndarray,
    rho: float | np.ndarray,
    alpha: float | np.ndarray,
    beta: float | np.ndarray,
) -> np.ndarray:
    """Eqs. (22), (24): f_j = rho_j exp(-alpha_j d_j) d_j^-beta_j.

    The product needs the slope only, `collision_potential_slope`.

    Args:
        d: (Nc,) signed distances, positive [m].
        rho, alpha, beta: scalars or (Nc,); amplitude, decay [1/m], exponent.

    Returns:
        (Nc,) potentials.
    """
    return rho * np.exp(-alpha * d) * d**-beta


def null_space_projector(J: np.ndarray, J_star: np.ndarray) -> np.ndarray:
    """Eq. (31), below: N = I - J* J, (n, n).

    The product projects vectors, `project_to_null_space`.
    """
    return np.eye(J.shape[1]) - J_star @ J


def error_dynamics_residual(
    e: np.ndarray,
    e_dot: np.ndarray,
    e_ddot: np.ndarray,
    J: np.ndarray,
    qdot_c: np.ndarray,
    qdot: np.ndarray,
    Kp: float,
    Kv: float,
    Gv: float,
) -> np.ndarray:
    """Eq. (32): e_dd + Kv e_d + Kp e + J Gv (q_dot_c - q_dot), which is 0.

    Holds for full row rank, no damping and no orientation tasks; (m,).
    """
    return e_ddot + Kv * e_dot + Kp * e + J @ (Gv * (qdot_c - qdot))


def damped_weighted_pseudo_inverse(
    J: np.ndarray, W: np.ndarray, damping: float
) -> np.ndarray:
    """Eq. (34): J* (n, m) as a matrix, from `damped_inverse`; see there.

    The product needs products of J* only.
    """
    J_star = damped_inverse(J, W, damping)
    return np.array([inverse_times(J_star, e) for e in np.eye(len(J))]).T
