"""Vector algebra on a few rows, where NumPy's general functions are slow."""

from __future__ import annotations

import numpy as np

_YZX, _ZXY = [1, 2, 0], [2, 0, 1]


def cross_rows(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of the rows of two (N, 3) arrays.

    numpy.cross takes several times as long on so few rows.
    """
    return a[:, _YZX] * b[:, _ZXY] - a[:, _ZXY] * b[:, _YZX]


def clip_to_unit(x: np.ndarray) -> np.ndarray:
    """x limited to [0, 1]; numpy.clip takes several times as long on short arrays."""
    return np.minimum(np.maximum(x, 0.0), 1.0)
