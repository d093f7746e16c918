"""One-sided least squares by another method than the product's Newton steps."""

import numpy as np
from scipy.optimize import nnls


def one_sided_least_squares(
    A: np.ndarray, b: np.ndarray, G: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """argmin |A x - b|^2 + sum max(0, w_j - G_j x)^2, and the rows violated there.

    A slack t_j >= 0 that lifts row j's wish to w_j + t_j makes least squares of it.
    Without x, projected on what the columns of [A; G] do not reach, these are
    non-negative least squares in t, which Lawson's and Hanson's method solves.

    Args:
        A, b: (k, n), (k,) with the rank n.
        G, w: (C, n), (C,).
    """
    n, C = A.shape[1], len(w)
    if not C:
        return np.linalg.lstsq(A, b)[0], np.zeros(0, dtype=bool)
    stacked = np.vstack([A, G])
    right = np.concatenate([b, w])
    outside = np.linalg.qr(stacked, mode="complete")[0][:, n:].T
    slack, _ = nnls(outside[:, -C:], -outside @ right, maxiter=100 * C)
    violated = slack == 0.0
    # The slack of a row that just holds is a matter of rounding: settle these.
    for _ in range(20):
        x = np.linalg.lstsq(
            np.vstack([A, G[violated]]), np.concatenate([b, w[violated]])
        )[0]
        now = G @ x < w
        if (now == violated).all():
            break
        violated = now
    return x, violated
