"""Gaps in recorded points: filled where they are short, reported where they are not."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from crar_drake.motion.planted_feet import runs

# Longer than this a cubic spline says nothing of what a limb did meanwhile: voluntary
# motion of up to 6 Hz has a period of 0.17 s. A straight line is put there instead.
LONGEST_GAP = 0.2  # [s]


@dataclass(frozen=True)
class Gap:
    """Frames first..last of a point that are missing."""

    first: int  # its number, from 1
    last: int  # as well
    filled: str  # "spline", "line", or "held" (at the beginning or end)

    @property
    def frames(self) -> int:
        """How many they are."""
        return self.last - self.first + 1


def fill_gaps(samples: np.ndarray, frame_rate: float) -> tuple[np.ndarray, list[Gap]]:
    """Fills missing frames of a point.

    Args:
        samples: (T, 3); a frame with a NaN is missing.
        frame_rate: samples per second [Hz].

    Returns:
        The samples without gaps, all NaN if there are fewer than two frames to go by,
        and the gaps.
    """
    seen = np.isfinite(samples).all(axis=1)
    if seen.all():
        return samples, []
    index = np.arange(len(samples))
    if np.count_nonzero(seen) < 2:
        return np.full_like(samples, np.nan), [Gap(1, len(samples), "held")]
    filled = samples.copy()
    cubic = CubicSpline(index[seen], samples[seen])
    gaps = []
    for begin, end in runs(~seen):
        missing = index[begin:end]
        if begin == 0 or end == len(samples):
            how = "held"
            filled[missing] = samples[end if begin == 0 else begin - 1]
        elif (end - begin) / frame_rate <= LONGEST_GAP:
            how = "spline"
            filled[missing] = cubic(missing)
        else:
            how = "line"
            share = (missing - (begin - 1))[:, None] / (end - begin + 1)
            filled[missing] = (1 - share) * samples[begin - 1] + share * samples[end]
        gaps.append(Gap(begin + 1, end, how))
    return filled, gaps


def fill_all(
    points: dict[str, np.ndarray], frame_rate: float
) -> tuple[dict[str, np.ndarray], tuple[str, ...], tuple[str, ...]]:
    """Fills the gaps of all points; those that are never seen are left out.

    Returns:
        The points; a note on short gaps; findings, a line for each point with gaps that
        no spline fills.
    """
    filled, short, many, findings = {}, [], 0, []
    for name, samples in points.items():
        whole, gaps = fill_gaps(samples, frame_rate)
        if not np.isfinite(whole).all():
            continue
        filled[name] = whole
        by_spline = [gap for gap in gaps if gap.filled == "spline"]
        short, many = short + by_spline, many + bool(by_spline)
        if rest := [gap for gap in gaps if gap.filled != "spline"]:
            worst = max(rest, key=lambda gap: gap.frames)
            findings.append(
                f"{name} is hidden {len(rest)} times too long for a spline"
                f" or at an end, at most in frames {worst.first} to {worst.last} "
                f"({worst.frames / frame_rate:.2f} s): it goes straight there, or "
                "stands still"
            )
    notes = ()
    if short:
        notes = (
            f"{len(short)} gaps of {many} points, {sum(gap.frames for gap in short)} "
            f"frames in all and none longer than {LONGEST_GAP:g} s, are filled by "
            "splines",
        )
    return filled, notes, tuple(findings)
