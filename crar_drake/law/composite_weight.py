"""The composite constraint matrix: Eqs. (27) and (28), and one with the inertia."""

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.vectors import add_to_diagonal, cholesky


def composite_index(num_pairs: int) -> float:
    """Eq. (28): a = 1 / (Nc + 1), for Nc watched pairs."""
    return 1.0 / (num_pairs + 1)


@compiled
def composite_weights(W_JL: np.ndarray, W_COL: np.ndarray, a: float) -> np.ndarray:
    """Eq. (27): W = a W_JL + (1 - a) W_COL, all diagonal, (n,).

    Args:
        W_JL: (n,) diagonal of Eq. (18).
        W_COL: (n,) diagonal of Eq. (26).
        a: share of the joint limits, between 0 and 1.
    """
    return a * W_JL + (1.0 - a) * W_COL


@compiled
def inertia_weight(H: np.ndarray, W: np.ndarray) -> np.ndarray:
    """The paper's "dynamically consistent weight matrix" (end of Section IV).

    W of Eq. (27) is the identity, plus a penalty for joints near constraints. Here
    the joint-space inertia takes the identity's place:

        W_H = H / det(H)^(1/n) + (W - I).

    Far from constraints the inverse of Eq. (16) is then the dynamically consistent
    one, H^-1 J^T (J H^-1 J^T)^-1 (Khatib 1987): of all velocities that do the
    tasks it has the least kinetic energy. A joint whose weight goes to infinity
    stops, and the others do the least for the robot with that joint locked. (The
    congruence W^1/2 H W^1/2 would also stop it, but the others would then move as
    if it were free.) Dividing by the geometric mean of H's eigenvalues takes out the
    unit and leaves the determinant that the identity has, so that the damping
    factor of Eq. (34) stays comparable. The sum is positive definite, because H is,
    and no weight is below 1.

    Args:
        H: (n, n) joint-space inertia matrix, symmetric positive definite [kg m^2].
        W: (n,) diagonal of Eq. (27), at least 1.

    Returns:
        (n, n) symmetric positive definite.
    """
    logdet = 2.0 * np.log(np.diag(cholesky(H))).sum()
    W_H = H * np.exp(-logdet / len(H))
    add_to_diagonal(W_H, W - 1.0)
    return W_H
