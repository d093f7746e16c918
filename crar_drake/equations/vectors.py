"""Vector algebra on a few vectors, where NumPy's general functions are slow.

In arrays of columns (..., 3, N) the components of N vectors lie one below the other;
in arrays of rows (N, 3) beside each other.
"""

from __future__ import annotations

import numpy as np

_YZX, _ZXY = [1, 2, 0], [2, 0, 1]


def cross_rows(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of the rows of two (N, 3) arrays.

    numpy.cross takes several times as long on so few rows.
    """
    return a[:, _YZX] * b[:, _ZXY] - a[:, _ZXY] * b[:, _YZX]


def cross_columns(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of the columns of two (..., 3, N) arrays."""
    # Twice below itself, every cyclic order of the components is a slice.
    aa, bb = np.concatenate([a, a], axis=-2), np.concatenate([b, b], axis=-2)
    return aa[..., 1:4, :] * bb[..., 2:5, :] - aa[..., 2:5, :] * bb[..., 1:4, :]


def dot_columns(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (..., N) of the columns of two (..., 3, N) arrays."""
    return np.vecdot(a, b, axis=-2)


def clip_to_unit(x: np.ndarray) -> np.ndarray:
    """x limited to [0, 1]; numpy.clip takes several times as long on short arrays."""
    return np.minimum(np.maximum(x, 0.0), 1.0)
