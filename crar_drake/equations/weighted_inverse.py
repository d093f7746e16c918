"""The weighted pseudo-inverse and its damped form: Eqs. (16) and (34)."""

from __future__ import annotations

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.vectors import (
    add_to_diagonal,
    cholesky,
    cholesky_solve,
    gram,
    times,
    transposed_times,
)


@compiled
def damped_normal_matrix(J: np.ndarray, W: np.ndarray, damping: float) -> np.ndarray:
    """The matrix M = J^T J + lambda^2 W that Eq. (34) inverts, see `damped_inverse`.

    Args:
        J: (m, n) task Jacobian, any rank.
        W: (n,) diagonal of the weight matrix, positive, or the whole matrix (n, n),
            symmetric positive definite.
        damping: lambda [m], positive.

    Returns:
        (n, n) symmetric positive definite.
    """
    M = gram(J)
    if W.ndim == 1:
        add_to_diagonal(M, damping**2 * W)
    else:
        M += damping**2 * W
    return M


@compiled
def damped_inverse(J: np.ndarray, W: np.ndarray, damping: float) -> np.ndarray:
    """Eq. (34): J* = W^-1 J^T (J W^-1 J^T + lambda^2 I)^-1, as the factor of M.

    By the push-through identity J* = M^-1 J^T with M = J^T J + lambda^2 W: an n x n
    system that is positive definite for any m and any rank, if lambda > 0. What is
    needed of J* are its products, `inverse_times`.

    Args:
        J, W, damping: see `damped_normal_matrix`.

    Returns:
        (n, n) lower Cholesky factor of M.
    """
    return cholesky(damped_normal_matrix(J, W, damping))


@compiled
def inverse_times(factor: np.ndarray, J: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Eq. (34) at work: J* x (n,) of x (m,), from `damped_inverse` and J (m, n)."""
    return cholesky_solve(factor, transposed_times(J, x))


@compiled
def project_to_null_space(
    factor: np.ndarray, J: np.ndarray, zeta: np.ndarray
) -> np.ndarray:
    """Eq. (31), below: N zeta = zeta - J* J zeta, (n,) of zeta (n,)."""
    return zeta - inverse_times(factor, J, times(J, zeta))


def weighted_pseudo_inverse(J: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Eq. (16): J+ = W^-1 J^T (J W^-1 J^T)^-1.

    A reference form: the product damps it, Eq. (34).

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


def damped_weighted_pseudo_inverse(
    J: np.ndarray, W: np.ndarray, damping: float
) -> np.ndarray:
    """Eq. (34): J* (n, m) as a matrix, from `damped_inverse`; see there.

    A reference form: the product needs products of J* only.
    """
    factor = damped_inverse(J, W, damping)
    return np.array([inverse_times(factor, J, e) for e in np.eye(len(J))]).T


def null_space_projector(J: np.ndarray, J_star: np.ndarray) -> np.ndarray:
    """Eq. (31), below: N = I - J* J, (n, n).

    A reference form: the product projects vectors, `project_to_null_space`.
    """
    return np.eye(J.shape[1]) - J_star @ J
