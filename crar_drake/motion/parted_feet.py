"""Feet that pass and stand beside each other with room between them, seen from above.

A person's legs touch each other in passing, and a robot's are thicker. Where the
targets of both feet are in the same place, both feet must give way, also the one that
stands. So it is decided before: a foot that comes down beside one that stands, stands
farther off it; a foot in the air goes round the other.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.spatial.transform import Rotation

from crar_drake.motion.held_feet import FootMotion, dwelling
from crar_drake.motion.leg_shape import LegShape
from crar_drake.motion.performer import SIDES
from crar_drake.motion.planted_feet import runs
from crar_drake.motion.smooth_steps import bridge, smooth_flags

# Between two soles: shells are thicker than soles are wide [m].
_ROOM = 0.03
_AROUND = 0.15  # [s] before and after, in which a foot goes round the other
_ROUNDS = 4  # in which what is pushed apart may meet anew


def part_feet(
    feet: Mapping[str, FootMotion], legs: Mapping[str, LegShape], rate: float
) -> dict[str, np.ndarray]:
    """How feet are to be shifted for them to be apart.

    Where both stand already as the motion begins, and where two that are in the air
    go through each other, room may be lacking.

    Args:
        feet: side to poses.
        legs: side to the robot's leg.
        rate: samples per second [Hz].

    Returns:
        Side to (T, 2) horizontal shifts [m], constant while the foot is planted.
    """
    apart = _ROOM + sum(0.5 * float(np.ptp(legs[s].points[:, 1])) for s in SIDES)
    lines = {s: _middle_line(feet[s], legs[s]) for s in SIDES}
    kept, free, margin = kept_and_free(feet, rate)
    shifts = _stand_apart(lines, kept, apart)
    total = np.maximum(sum(free.values()), 1e-6)
    for side in SIDES:
        shifts[side] = bridge(shifts[side], kept[side], rate, 0.0)
    for _ in range(_ROUNDS):
        left, right = (lines[s] + shifts[s][:, None] for s in SIDES)
        push = _pushes(left, right, apart)
        if not push.any():
            break
        way = spread(push, margin)
        for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
            # Who is more in the air gives way more; who stands, not at all.
            share = free[side] ** 2 / total
            shifts[side] = shifts[side] + sign * share[:, None] * way
    return shifts


def _middle_line(foot: FootMotion, leg: LegShape) -> np.ndarray:
    """(T, 2, 2) heel and ball, from above [m]."""
    R = Rotation.from_quat(foot.turns).as_matrix()
    ends = [foot.positions + R @ point for point in (leg.heel, leg.ball)]
    return np.stack(ends, axis=1)[..., :2]


def _stand_apart(lines, kept, apart: float) -> dict[str, np.ndarray]:
    """Side to (T, 2) shifts, one for each stretch in which a foot stays; 0 elsewhere.

    Of two that stand, the one that came later gives way.
    """
    shifts = {s: np.zeros((len(kept[s]), 2)) for s in SIDES}
    stands = {s: np.zeros(len(kept[s]), dtype=bool) for s in SIDES}
    stretches = [(start, end, s) for s in SIDES for start, end in runs(kept[s])]
    for start, end, side in sorted(stretches):
        other = SIDES[1 - SIDES.index(side)]
        both = start + np.flatnonzero(stands[other][start:end])
        there = lines[other][both] + shifts[other][both, None]
        for _ in range(_ROUNDS if len(both) and start else 0):
            here = lines[side][both] + shifts[side][both, None]
            if side == "left":
                pushes = _pushes(here, there, apart)
            else:
                pushes = -_pushes(there, here, apart)
            shifts[side][start:end] += pushes[np.linalg.norm(pushes, axis=1).argmax()]
        stands[side][start:end] = True
    return shifts


def _pushes(left: np.ndarray, right: np.ndarray, apart: float) -> np.ndarray:
    """(T, 2) what lines (T, 2, 2) lack to be apart: ways for the left one [m].

    Away from the nearest point of the other; if they cross, to the left of the right
    foot.
    """
    found = np.full(len(left), np.inf)
    away = np.zeros((len(left), 2))
    for a, b, sign in ((left, right, 1.0), (right, left, -1.0)):
        along = b[:, 1] - b[:, 0]
        square = np.maximum(np.sum(along**2, axis=1), 1e-12)
        for end in range(2):
            way = a[:, end] - b[:, 0]
            share = np.clip(np.sum(way * along, axis=1) / square, 0.0, 1.0)
            way = way - share[:, None] * along
            distance = np.linalg.norm(way, axis=1)
            nearer = distance < found
            found = np.where(nearer, distance, found)
            away = np.where(nearer[:, None], sign * way, away)
    across = right[:, 1] - right[:, 0]
    across = np.column_stack([-across[:, 1], across[:, 0]])
    crossing = _cross(left, right)
    away = np.where(crossing[:, None] | (found < 1e-6)[:, None], across, away)
    found = np.where(crossing, -found, found)
    direction = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    return np.maximum(apart - found, 0.0)[:, None] * direction


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) whether two lines cross."""

    def side(line: np.ndarray, point: np.ndarray) -> np.ndarray:
        u, w = line[:, 1] - line[:, 0], point - line[:, 0]
        return u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]

    apart_b = side(a, b[:, 0]) * side(a, b[:, 1]) < 0.0
    return apart_b & (side(b, a[:, 0]) * side(b, a[:, 1]) < 0.0)


def kept_and_free(
    feet: Mapping[str, FootMotion], rate: float
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], int]:
    """Side to (T,) when it stays where it is, and to (T,) how much it is in the air,
    from 0 to 1; and in how many samples before and after it goes round the other."""
    kept = {s: dwelling(feet[s].planted, rate) for s in SIDES}
    margin = max(1, round(_AROUND * rate))
    return kept, {s: 1.0 - smooth_flags(kept[s], margin) for s in SIDES}, margin


def spread(push: np.ndarray, margin: int) -> np.ndarray:
    """Smooth pushes that begin before they are needed, and end after.

    Args:
        push: (T, k) what is needed.
        margin: how long before and after [samples].
    """
    size = np.linalg.norm(push, axis=1)
    window = np.hanning(2 * margin + 3)[1:-1]
    window /= window.sum()

    def mean(x: np.ndarray) -> np.ndarray:
        return np.convolve(np.pad(x, margin, mode="edge"), window, mode="valid")

    # Directions by the mean of what pushes nearby, sizes by the largest of it.
    way = np.column_stack([mean(column) for column in push.T])
    norm = np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    largest = mean(maximum_filter1d(size, 2 * margin + 1, mode="nearest"))
    return way * (largest / norm)[:, None] if size.any() else way
