"""The weighted pseudo-inverse and its damped form: Eqs. (16) and (34)."""

from __future__ import annotations

import numpy as np


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
        W: (n,) diagonal of the weight matrix, positive.
        damping: lambda [m].

    Returns:
        (n, m).
    """
    WinvJT = J.T / W[:, None]
    m, n = J.shape
    if damping > 0.0 and n < m:
        # The same matrix by the push-through identity, and the smaller system:
        # (J^T J + lambda^2 W)^-1 J^T.
        normal = J.T @ J
        normal.flat[:: n + 1] += damping**2 * W
        return np.linalg.solve(normal, J.T)
    core = J @ WinvJT
    core.flat[:: m + 1] += damping**2
    return np.linalg.solve(core, WinvJT.T).T  # core is symmetric


def null_space_projector(J: np.ndarray, J_star: np.ndarray) -> np.ndarray:
    """Eq. (31), below: N = I - J* J, (n, n)."""
    return np.eye(J.shape[1]) - J_star @ J
