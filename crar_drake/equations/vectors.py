"""Vector algebra on a few rows, where NumPy's general functions are slow."""

from __future__ import annotations

import numpy as np

_YZX, _ZXY = [1, 2, 0], [2, 0, 1]


def cross_rows(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of the rows of two (N, 3) arrays.

    numpy.cross takes several times as long on so few rows.
    """
    return a[:, _YZX] * b[:, _ZXY] - a[:, _ZXY] * b[:, _YZX]
