"""How far convex hulls are apart, at many poses: a plane between them says it.

Nearest points are sought as in `equations.hull_distances`, but hulls of meshes have a
thousand corners. So what is farthest in a direction is found from corner to corner
along edges. That may end too early where corners are rounded. A distance is therefore
what the plane across the nearest points leaves free between all corners: a bound from
below, whatever was found.

Compiled, this is faster than a library; as plain Python it is far slower.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crar_drake.equations.compilation import Held, compiled, hold
from crar_drake.equations.hull_distances import to_nearest

# Nearest points are found until the distance is known to this [m].
_ENOUGH = 1e-9
# Nearer hulls have no direction between them to speak of [m].
_TOUCHING = 1e-9
_MOST = 100  # steps, each with a simplex that is nearer


class HullCorners(NamedTuple):
    """Hulls, each in its frame."""

    points: np.ndarray  # (V, 3) corners of all [m]
    # (H + 1,) the first of each, and how many there are; of what has no volume there
    # are none
    first: np.ndarray
    # (E,) corners at the other ends of edges, as indices of `points`
    beside: np.ndarray
    # (V + 1,) where those of each corner begin, and how many there are
    edges: np.ndarray


def hull_corners(hulls: Sequence[tuple[np.ndarray, np.ndarray]]) -> Held:
    """Holds `HullCorners`.

    Args:
        hulls: (V, 3) corners [m] and (F, 3) triangles of them each.
    """
    first = np.cumsum([0, *(len(points) for points, _ in hulls)])
    points = np.concatenate([np.zeros((0, 3)), *(points for points, _ in hulls)])
    faces = [f + start for (_, f), start in zip(hulls, first[:-1], strict=True)]
    a, b, c = np.concatenate([np.zeros((0, 3), dtype=int), *faces]).T
    ends = np.concatenate([a, b, c, b, c, a]), np.concatenate([b, c, a, a, b, c])
    one, other = np.divmod(np.unique(ends[0] * len(points) + ends[1]), len(points) or 1)
    edges = np.searchsorted(one, np.arange(len(points) + 1))
    return hold(HullCorners(points, first, other, edges))


@compiled
def farthest(hulls: HullCorners, start: int, x: float, y: float, z: float) -> int:
    """The corner that is farthest along (x, y, z), from another of its hull."""
    points, best = hulls.points, start
    most = x * points[best, 0] + y * points[best, 1] + z * points[best, 2]
    while True:
        corner = best
        for k in range(hulls.edges[corner], hulls.edges[corner + 1]):
            i = hulls.beside[k]
            at = x * points[i, 0] + y * points[i, 1] + z * points[i, 2]
            if at > most:
                most, best = at, i
        if best == corner:
            return best


@compiled
def hull_gaps(
    pairs: np.ndarray, R: np.ndarray, p: np.ndarray, corners: Held
) -> tuple[np.ndarray, np.ndarray]:
    """How far hulls A and B are apart at least, and where they are nearest.

    Args:
        pairs: (K, 2) which hulls A and B are.
        R, p: (K, 3, 3) R_AB, and (K, 3) p_AB [m].
        corners: holds `HullCorners`.

    Returns:
        (K,) distances, 0 or less where nothing says that they are apart [m]; (K, 2, 3)
        the nearest points p_AP and p_AQ [m].
    """
    hulls = corners.value
    points = hulls.points
    gaps, nearest = np.full(len(pairs), -np.inf), np.zeros((len(pairs), 2, 3))
    w, of, share = np.zeros((4, 3)), np.zeros((4, 2), dtype=np.int64), np.zeros(4)
    v, n_B = np.empty(3), np.empty(3)
    for k in range(len(pairs)):
        first_a, last_a = hulls.first[pairs[k, 0]], hulls.first[pairs[k, 0] + 1]
        first_b, last_b = hulls.first[pairs[k, 1]], hulls.first[pairs[k, 1] + 1]
        if first_a == last_a or first_b == last_b:
            continue
        i, j, count, size, apart = first_a, first_b, 0, np.inf, True
        share[:] = 0.0
        for c in range(3):
            v[c] = p[k, c]
            for d in range(3):
                v[c] += R[k, c, d] * points[j, d]
            v[c] -= points[i, c]
        # v: from A to B, the nearest of the simplex, which has corners b - a.
        for _ in range(_MOST):
            length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
            apart = apart and length > _TOUCHING
            if not apart or (count and not length < size):
                break
            if count:
                size = length
            x, y, z = v[0] / length, v[1] / length, v[2] / length
            for c in range(3):
                n_B[c] = R[k, 0, c] * x + R[k, 1, c] * y + R[k, 2, c] * z
            i = farthest(hulls, i, x, y, z)
            j = farthest(hulls, j, -n_B[0], -n_B[1], -n_B[2])
            for c in range(3):
                w[count, c] = p[k, c] - points[i, c]
                for d in range(3):
                    w[count, c] += R[k, c, d] * points[j, d]
            gap = x * w[count, 0] + y * w[count, 1] + z * w[count, 2]
            if count and size - gap <= _ENOUGH:
                break
            of[count, 0], of[count, 1] = i, j
            apart, count = to_nearest(w, of, count + 1, share, v)
        if not apart:
            continue
        for c in range(3):
            for m in range(count):
                nearest[k, 0, c] += share[m] * points[of[m, 0], c]
            nearest[k, 1, c] = nearest[k, 0, c] + v[c]
        length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        x, y, z = v[0] / length, v[1] / length, v[2] / length
        low, high = np.inf, -np.inf
        for i in range(first_a, last_a):
            at = x * points[i, 0] + y * points[i, 1] + z * points[i, 2]
            high = max(high, at)
        for c in range(3):
            n_B[c] = R[k, 0, c] * x + R[k, 1, c] * y + R[k, 2, c] * z
        for j in range(first_b, last_b):
            at = n_B[0] * points[j, 0] + n_B[1] * points[j, 1] + n_B[2] * points[j, 2]
            low = min(low, at)
        gaps[k] = low + x * p[k, 0] + y * p[k, 1] + z * p[k, 2] - high
    return gaps, nearest
