"""The projection: the step nearest to the nominal that keeps rows.

With the braking time constant T an acceleration is a velocity: s = q_dot + T q_ddot is
how fast the place moves where the robot would come to rest. All that constraints ask of
a step is linear in s: rows g s >= least, (L7) of `docs/theory/theorem.md`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.one_sided import one_sided_nearest, one_sided_nearest_in

# What a row weighs that is to hold: the norm of a step is of the order of 1, so that
# what it gives way is not seen.
_HARD = 1e6
_NOTHING = np.zeros(0)


class Rows(NamedTuple):
    """C rows g s >= least on s (n,) of the controlled joints."""

    g: np.ndarray  # (C, n)
    least: np.ndarray  # (C,)
    weight: np.ndarray  # (C,) of the square of what a row lacks


def hard_rows(g: np.ndarray, least: np.ndarray, others: np.ndarray = _NOTHING) -> Rows:
    """Rows that are to hold.

    Args:
        g: (C, n), or (C, nv) on s (nv,) of all joints, of which
        others: (nv - n,) the last ones have these s, whatever is taken.
        least: (C,).
    """
    if len(others):
        n = g.shape[1] - len(others)
        g, least = np.ascontiguousarray(g[:, :n]), least - g[:, n:] @ others
    return Rows(g, least, np.full(len(least), _HARD))


def stacked(rows: Sequence[Rows]) -> Rows:
    """All rows as one; at least one `Rows` must be given."""
    if len(rows) == 1:
        return rows[0]
    return Rows(*map(np.concatenate, zip(*rows, strict=True)))


@compiled
def clipped(s: np.ndarray, lowest: np.ndarray, highest: np.ndarray) -> np.ndarray:
    """s (n,) within bounds (n,)."""
    return np.minimum(np.maximum(s, lowest), highest)


@compiled
def project(
    nominal: np.ndarray,
    g: np.ndarray,
    least: np.ndarray,
    weight: np.ndarray,
    lowest: np.ndarray,
    highest: np.ndarray,
    root: np.ndarray,
) -> np.ndarray:
    """argmin |L^T (s - nominal)|^2 + sum weight_j max(0, least_j - g_j s)^2, clipped;
    (n,).

    Args:
        nominal: (n,) [rad/s or m/s].
        g, least, weight: of `Rows`.
        lowest, highest: (n,) bounds with 0 between them [rad/s or m/s].
        root: (n, n) L, lower triangular; (0, 0) for the identity.
    """
    by = np.sqrt(weight)
    rows, desired = by[:, np.newaxis] * g, by * least
    if len(root):
        s = one_sided_nearest_in(root, nominal, rows, desired)
    else:
        s = one_sided_nearest(nominal, rows, desired)
    return clipped(s, lowest, highest)
