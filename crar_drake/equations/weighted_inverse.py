"""The weighted pseudo-inverse and its damped form: Eqs. (16) and (34)."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv


def weighted_pseudo_inverse(J: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Eq. (16): J+ = W^-1 J^T (J W^-1 J^T)^-1.

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
    return damped_weighted_pseudo_inverse(J, W, 0.0)


def damped_weighted_pseudo_inverse(
    J: np.ndarray, W: np.ndarray, damping: float
) -> np.ndarray:
    """Eq. (34): J* = W^-1 J^T (J W^-1 J^T + lambda^2 I)^-1.

    Always exists for lambda > 0.

    Args:
        J: (m, n) task Jacobian, any rank.
        W: (n,) diagonal of the weight matrix, positive, or the whole matrix (n, n),
            symmetric positive definite.
        damping: lambda [m].

    Returns:
        (n, m).
    """
    m, n = J.shape
    if damping > 0.0 and n < m:
        # The same matrix by the push-through identity, and the smaller system:
        # (J^T J + lambda^2 W)^-1 J^T.
        normal = J.T @ J
        if W.ndim == 2:
            normal += damping**2 * W
        else:
            normal.flat[:: n + 1] += damping**2 * W
        return _solve_spd(normal, J.T)
    JWinv = J / W if W.ndim == 1 else _solve_spd(W, J.T).T
    core = JWinv @ J.T
    core.flat[:: m + 1] += damping**2
    return _solve_spd(core, JWinv).T


def _solve_spd(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """X of A X = B for a symmetric positive definite A, by Cholesky."""
    if not A.size:
        return np.zeros(B.shape)
    _, X, info = dposv(A, B)
    if info:
        raise np.linalg.LinAlgError("the matrix is singular: damp it, or check for NaN")
    return X


def null_space_projector(J: np.ndarray, J_star: np.ndarray) -> np.ndarray:
    """Eq. (31), below: N = I - J* J, (n, n)."""
    return np.eye(J.shape[1]) - J_star @ J
