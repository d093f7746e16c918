"""Velocities of samples, as the tools that make reference motions take them: central
differences, one-sided at the ends."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def difference(samples: np.ndarray, step: float) -> np.ndarray:
    """(T, k) rates of change of (T, k) samples that are `step` apart [s]."""
    if len(samples) < 2:
        return np.zeros_like(samples)
    return np.gradient(samples, step, axis=0)


def turning(R: Rotation, step: float) -> np.ndarray:
    """(T, 3) angular velocities in the world [rad/s]."""
    if len(R) < 2:
        return np.zeros((len(R), 3))
    inner = (R[2:] * R[:-2].inv()).as_rotvec() / (2.0 * step)
    first, last = ((R[i + 1] * R[i].inv()).as_rotvec() / step for i in (0, len(R) - 2))
    return np.vstack([first, inner, last])
