"""Smooth weights, steps and bounds over samples of time."""

import numpy as np

from crar_drake.motion.planted_feet import runs


def smooth_step(s: np.ndarray) -> np.ndarray:
    """From 0 to 1 as s does, with no slope and no curvature at either end."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def smooth_flags(flags: np.ndarray, margin: int) -> np.ndarray:
    """(T,) weights: 1 where a flag is set, 0 farther than `margin` samples from all,
    twice continuously differentiable in between."""
    if not flags.any():
        return np.zeros(len(flags))
    at = np.flatnonzero(flags)
    samples = np.arange(len(flags))
    weight_off = np.ones(len(flags))
    for start, end in runs(flags):
        away = np.maximum(np.maximum(start - samples, samples - (end - 1)), 0)
        weight_off *= smooth_step(away / (margin + 1.0))
    weight_off[at] = 0.0
    return 1.0 - weight_off


def soft_positive(x: np.ndarray, width: float) -> np.ndarray:
    """Smooth and positive: nearly x where that is far above `width`, nearly 0 far
    below -`width`."""
    return 0.5 * (x + np.sqrt(x**2 + width**2))


def bridge(
    values: np.ndarray, known: np.ndarray, rate: float, settle: float
) -> np.ndarray:
    """Fills gaps smoothly: from the value and the slope at one edge to those at the
    other, the slopes dying out within `settle` [s]; beyond the ends constant.

    Args:
        values: (T, k), used where they are known.
        known: (T,) whether they are.
        rate: samples per second [Hz].
        settle: [s].
    """
    filled = values.copy()
    if not known.any():
        return np.zeros_like(values)
    for start, end in runs(~known):
        before, after = start - 1, end  # known, unless beyond the ends
        i = np.arange(start, end)
        if before < 0:
            here = values[after] + np.zeros((len(i), 1))
        elif after >= len(values):
            here = values[before] + np.zeros((len(i), 1))
        else:
            share = smooth_step((i - before) / (after - before))[:, None]
            here = values[before] + share * (values[after] - values[before])
        reach = max(2.0, min(settle * rate, 0.5 * (end - start + 1)))
        if before > 0 and known[before - 1]:
            slope = values[before] - values[before - 1]
            t = (i - before)[:, None]
            here = here + slope * t * (1.0 - smooth_step(t / reach))
        if after + 1 < len(values) and known[after + 1]:
            slope = values[after + 1] - values[after]
            t = (i - after)[:, None]
            here = here + slope * t * (1.0 - smooth_step(-t / reach))
        filled[start:end] = here
    return filled
