"""Legs that pass and stand beside each other with room between them, knees and all.

Soles are apart before (`parted_feet`), but a robot's thighs and shanks are thicker
than a person's, and its knees are where its feet and hips put them. Where two legs
would be in one place, both feet must give way, also the one that stands. So it is
decided before: a foot that is in the air goes, or turns, out of the way; one that comes
down where its leg meets the other's stands elsewhere, or turned.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from crar_drake.motion.held_feet import FootMotion
from crar_drake.motion.parted_feet import kept_and_free, spread
from crar_drake.motion.performer import SIDES
from crar_drake.motion.planted_feet import runs
from crar_drake.motion.smooth_steps import bridge, smooth_step

_ARM = 0.15  # [m] that a foot may be moved by rather than turned by a radian
_FARTHEST = 0.05  # [m] that a foot is moved by at most, a round
# What of a foot's moves helps so little is none: a leg may be stretched [m/m].
_LEAST_EFFECT = 0.1


@dataclass(frozen=True, eq=False)
class LegRoom:
    """How near the legs are to each other, and what parts them.

    Attributes:
        lacking: (T,) what their distance lacks [m], 0 where they are apart.
        effects: side to (T, 3), how it changes with the place of that foot, x and y
            [m/m], and with its turn about the vertical [m/rad].
    """

    lacking: np.ndarray
    effects: Mapping[str, np.ndarray]


def part_legs(
    feet: Mapping[str, FootMotion], room: LegRoom, rate: float
) -> dict[str, np.ndarray]:
    """How feet are to be moved for their legs to be apart, as far as that is linear.

    Args:
        feet: side to poses.
        room: of the legs that these feet make.
        rate: samples per second [Hz].

    Returns:
        Side to (T, 3) moves x, y [m] and about the vertical [rad], constant while the
        foot is planted.
    """
    unit = np.array([1.0, 1.0, _ARM])
    effects = {s: room.effects[s] / unit for s in SIDES}
    kept, free, margin = kept_and_free(feet, rate)
    first = _least(effects, _who_gives(kept), room.lacking)
    moves = {s: _of_contacts(first[s], kept[s], margin, rate) for s in SIDES}
    done = sum(np.sum(effects[s] * moves[s], axis=1) for s in SIDES)
    rest = np.maximum(room.lacking - np.maximum(done, 0.0), 0.0)
    for side, more in _least(effects, free, rest).items():
        if more.any():
            moves[side] = moves[side] + free[side][:, None] * spread(more, margin)
    return {s: moves[s] / unit for s in SIDES}


def _least(effects, shares, lacking: np.ndarray) -> dict[str, np.ndarray]:
    """Side to the (T, 3) least moves that give what is lacking, by each one's share."""
    gain = sum(shares[s] * np.sum(effects[s] ** 2, axis=1) for s in SIDES)
    scale = lacking / np.maximum(gain, _LEAST_EFFECT**2)
    moves = {s: (shares[s] * scale)[:, None] * effects[s] for s in SIDES}
    for move in moves.values():
        size = np.linalg.norm(move, axis=1)
        move *= np.minimum(1.0, _FARTHEST / np.maximum(size, 1e-12))[:, None]
    return moves


def _who_gives(kept: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Side to (T,) shares: who is in the air, or else came down later."""
    since = {}
    for side in SIDES:
        since[side] = np.full(len(kept[side]), np.inf)  # in the air: yet to come
        for start, end in runs(kept[side]):
            since[side][start:end] = start
    left, right = (since[s] for s in SIDES)
    share = np.where(left > right, 1.0, np.where(left < right, 0.0, 0.5))
    return {"left": share, "right": 1.0 - share}


def _of_contacts(
    needed: np.ndarray, kept: np.ndarray, margin: int, rate: float
) -> np.ndarray:
    """(T, 3) moves, one for each stretch in which a foot stays, bridged in between:
    what is needed most in it, or right before or after it."""
    moves = np.zeros_like(needed)
    for start, end in runs(kept):
        near = np.arange(max(0, start - margin), min(len(kept), end + margin))
        away = np.maximum(np.maximum(start - near, near - (end - 1)), 0)
        wanted = needed[near] * (1.0 - smooth_step(away / margin))[:, None]
        # Another contact that is as near has moves of its own.
        wanted[kept[near] & (away > 0)] = 0.0
        moves[start:end] = wanted[np.linalg.norm(wanted, axis=1).argmax()]
    return bridge(moves, kept, rate, 0.0) if kept.any() else moves
