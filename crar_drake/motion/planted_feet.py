"""When a foot stands on the floor: low and slow, with hysteresis.

A foot becomes planted when it is both low and slow, and stays so until it is higher, or
faster, than a second threshold: without two of them, a foot at rest would be lifted and
set down again by noise.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ContactThresholds:
    """What is low and slow."""

    height_on: float = 0.015  # above the floor [m]
    height_off: float = 0.03  # above the floor [m]
    speed_on: float = 0.2  # [m/s]
    speed_off: float = 0.5  # [m/s]


def standing(
    height: np.ndarray, speed: np.ndarray, thresholds: ContactThresholds
) -> np.ndarray:
    """(N,) whether the foot is planted in each step, with hysteresis.

    Args:
        height: (N,) above the floor [m].
        speed: (N,) [m/s].
        thresholds: from which on it is, and from which on no longer.
    """
    on = (height <= thresholds.height_on) & (speed <= thresholds.speed_on)
    off = (height > thresholds.height_off) | (speed > thresholds.speed_off)
    planted, now = np.zeros(len(height), dtype=bool), False
    for step in range(len(height)):
        now = bool(on[step] or (now and not off[step]))
        planted[step] = now
    return planted


def runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """Start and end (exclusive) of each stretch of true ones."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return list(
        zip(
            np.flatnonzero(edges == 1).tolist(),
            np.flatnonzero(edges == -1).tolist(),
            strict=True,
        )
    )


def without_short(flags: np.ndarray, shortest: int) -> np.ndarray:
    """Flags whose stretches of fewer than `shortest` entries are taken over by what is
    around them: first the gaps are closed, then what is short is dropped."""
    flags = flags.copy()
    for start, end in runs(~flags):
        if end - start < shortest and start > 0 and end < len(flags):
            flags[start:end] = True
    return lasting(flags, shortest)


def lasting(flags: np.ndarray, shortest: int) -> np.ndarray:
    """Flags without stretches of fewer than `shortest` entries."""
    flags = flags.copy()
    for start, end in runs(flags):
        if end - start < shortest:
            flags[start:end] = False
    return flags
