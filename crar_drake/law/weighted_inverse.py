"""The weighted pseudo-inverse and its damped form: Eqs. (16) and (34)."""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.vectors import (
    add_to_diagonal,
    cholesky,
    cholesky_solve,
    cholesky_solve_matrix,
    gram,
    product,
    times,
)


class DampedInverse(NamedTuple):
    """J* of Eq. (34), ready to be multiplied; made by `damped_inverse`."""

    B: np.ndarray  # (n, m) W^-1 J^T if m < n, else J^T
    # lower Cholesky factor: if m < n (m, m) of J W^-1 J^T + lambda^2 I, else (n, n) of
    # J^T J + lambda^2 W
    L: np.ndarray


@compiled
def damped_inverse(J: np.ndarray, W: np.ndarray, damping: float) -> DampedInverse:
    """Eq. (34): J* = W^-1 J^T (J W^-1 J^T + lambda^2 I)^-1.

    Always exists for lambda > 0. By the push-through identity it is also
    (J^T J + lambda^2 W)^-1 J^T: of the two the smaller system is factorised. What is
    needed of J* are its products, `inverse_times`.

    Args:
        J: (m, n) task Jacobian, any rank.
        W: (n,) diagonal of the weight matrix, positive, or the whole matrix (n, n),
            symmetric positive definite.
        damping: lambda [m], positive.
    """
    m, n = J.shape
    J_T = np.ascontiguousarray(J.T)
    if m < n:
        if W.ndim == 1:
            B = J_T / W[:, np.newaxis]
        else:
            B = cholesky_solve_matrix(cholesky(W), J_T)
        core = product(J, B)
        add_to_diagonal(core, np.full(m, damping**2))
        return DampedInverse(B, cholesky(core))
    M = gram(J)
    if W.ndim == 1:
        add_to_diagonal(M, damping**2 * W)
    else:
        M += damping**2 * W
    return DampedInverse(J_T, cholesky(M))


@compiled
def inverse_times(J_star: DampedInverse, x: np.ndarray) -> np.ndarray:
    """Eq. (34) at work: J* x (n,) of x (m,)."""
    n, m = J_star.B.shape
    if m < n:
        return times(J_star.B, cholesky_solve(J_star.L, x))
    return cholesky_solve(J_star.L, times(J_star.B, x))


@compiled
def project_to_null_space(
    J_star: DampedInverse, J: np.ndarray, zeta: np.ndarray
) -> np.ndarray:
    """Eq. (31), below: N zeta = zeta - J* J zeta, (n,) of zeta (n,)."""
    return zeta - inverse_times(J_star, times(J, zeta))
