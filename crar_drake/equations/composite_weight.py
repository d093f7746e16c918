"""The composite constraint matrix: Eqs. (27) and (28)."""

from __future__ import annotations

import numpy as np


def composite_index(num_pairs: int) -> float:
    """Eq. (28): a = 1 / (Nc + 1), for Nc watched pairs."""
    return 1.0 / (num_pairs + 1)


def composite_weights(W_JL: np.ndarray, W_COL: np.ndarray, a: float) -> np.ndarray:
    """Eq. (27): W = a W_JL + (1 - a) W_COL, all diagonal.

    Args:
        W_JL: (n,) diagonal of Eq. (18).
        W_COL: (n,) diagonal of Eq. (26).
        a: share of the joint limits, between 0 and 1.

    Returns:
        (n,) diagonal of W.
    """
    return a * W_JL + (1.0 - a) * W_COL
