"""Signed distances of convex hulls: boxes, and the convex pieces of meshes.

A capsule's axis is the hull of its two ends, a box that of its eight corners: what
holds for the one, (A3) to (A6), holds for any. Only the distance has no closed form.

Apart, the nearest points are found with simplices of the difference of both hulls, as
by Gilbert, Johnson and Keerthi (1988). Where the hulls meet, the distance is less than
zero: the shortest way that parts them is along the normal of a face, or across an edge
of each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.equations.compilation import Held, compiled, hold

# A distance is found to this [m]. Rounding, of robots' sizes, comes nowhere near it.
_ENOUGH = 1e-12
# Hulls nearer than this have no direction between them to speak of [m].
_TOUCHING = 1e-9
# So far apart hulls that meet are moved to see which points are nearest [m].
_PARTED = 1e-3
# A simplex comes nearer in each step, and is found in a dozen.
_MOST = 100


class Hulls(NamedTuple):
    """What is fixed of H hulls; made by `robot.collision_pairs`."""

    after: np.ndarray  # (H,) from a hull's middle, which stands for the start of its
    # axis, to its first corner, among all points
    corners: np.ndarray  # (H,) how many
    faces: np.ndarray  # (F, 3) three corners of each face, one of parallel faces
    edges: np.ndarray  # (E, 2) both ends of each edge, likewise
    first_face: np.ndarray  # (H + 1,) where its faces begin, and all end
    first_edge: np.ndarray  # (H + 1,) likewise


def no_hulls(count: int) -> tuple[np.ndarray, np.ndarray, Held]:
    """`hull_a`, `hull_b` and `hulls` of so many pairs of capsules."""
    none, nothing = np.full(count, -1), np.zeros(0, dtype=int)
    first = np.zeros(1, dtype=int)
    hulls = Hulls(
        *(nothing, nothing, nothing.reshape(-1, 3), nothing.reshape(-1, 2)),
        *(first, first.copy()),
    )
    return none, none.copy(), hold(hulls)


@compiled(loops=True)
def corners_of(
    at: np.ndarray, start: int, vector: int, hull: int, hulls: Hulls
) -> np.ndarray:
    """(V, 3) the points of which a shape, less its radius, is the hull [m].

    Args:
        at: (P, 3) points, where the shape's axis starts [m] and from there to its end
            among them at
        start, vector: and its corners if it is
        hull: one of
        hulls: and no capsule, -1.
    """
    if hull >= 0:
        first = start + hulls.after[hull]
        return at[first : first + hulls.corners[hull]].copy()
    ends = np.empty((2, 3))
    for c in range(3):
        ends[0, c] = at[start, c]
        ends[1, c] = at[start, c] + at[vector, c]
    return ends


@compiled(loops=True)
def _lowest(points, n):
    """Which of (V, 3) points is lowest along n (3,)."""
    which, low = 0, np.inf
    for i in range(len(points)):
        height = points[i, 0] * n[0] + points[i, 1] * n[1] + points[i, 2] * n[2]
        if height < low:
            which, low = i, height
    return which


@compiled(loops=True)
def _nearest_of_simplex(w, count):
    """The shares (4,) of up to four corners in what is nearest to the origin.

    Each candidate is a point of the simplex, so that none is too near, and one of
    them, inside it or within a face or an edge, is the nearest.

    Returns:
        The shares, and whether the origin is inside.
    """
    share, least = np.zeros(4), np.inf
    for i in range(count):
        for j in range(i, count):
            dd = ad = 0.0
            for c in range(3):
                d = w[j, c] - w[i, c]
                dd += d * d
                ad += w[i, c] * d
            t = min(max(-ad / dd, 0.0), 1.0) if dd > 0.0 else 0.0
            pp = 0.0
            for c in range(3):
                p = w[i, c] + t * (w[j, c] - w[i, c])
                pp += p * p
            if pp < least:
                least = pp
                share[:] = 0.0
                share[i] += 1.0 - t
                share[j] += t
    normal = np.empty(3)
    for i in range(count - 2):
        for j in range(i + 1, count - 1):
            for k in range(j + 1, count):
                e, f, a = w[j] - w[i], w[k] - w[i], w[i]
                normal[0] = e[1] * f[2] - e[2] * f[1]
                normal[1] = e[2] * f[0] - e[0] * f[2]
                normal[2] = e[0] * f[1] - e[1] * f[0]
                nn = normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2
                if not nn > 0.0:
                    continue
                # n . (f x a) and n . (a x e)
                s = normal[0] * (f[1] * a[2] - f[2] * a[1])
                s += normal[1] * (f[2] * a[0] - f[0] * a[2])
                s += normal[2] * (f[0] * a[1] - f[1] * a[0])
                t = normal[0] * (a[1] * e[2] - a[2] * e[1])
                t += normal[1] * (a[2] * e[0] - a[0] * e[2])
                t += normal[2] * (a[0] * e[1] - a[1] * e[0])
                if not (s > 0.0 and t > 0.0 and s + t < nn):
                    continue
                height = a[0] * normal[0] + a[1] * normal[1] + a[2] * normal[2]
                pp = height * height / nn
                if pp < least:
                    least = pp
                    share[:] = 0.0
                    share[i] = 1.0 - (s + t) / nn
                    share[j], share[k] = s / nn, t / nn
    if count < 4:
        return share, False
    # The origin is inside if it and each corner are on one side of the face opposite.
    for i in range(4):
        a, b, c = w[(i + 1) % 4], w[(i + 2) % 4], w[(i + 3) % 4]
        e, f = b - a, c - a
        normal[0] = e[1] * f[2] - e[2] * f[1]
        normal[1] = e[2] * f[0] - e[0] * f[2]
        normal[2] = e[0] * f[1] - e[1] * f[0]
        here = own = 0.0
        for k in range(3):
            here -= normal[k] * a[k]
            own += normal[k] * (w[i, k] - a[k])
        if not here * own > 0.0:
            return share, False
    return share, True


@compiled(loops=True)
def nearest_apart(
    a: np.ndarray, b: np.ndarray, shift: np.ndarray
) -> tuple[bool, float, np.ndarray, np.ndarray]:
    """Where the hulls of two sets of points are nearest, the first one moved.

    Args:
        a, b: (V, 3), (V', 3) points [m].
        shift: (3,) by which a is moved [m].

    Returns:
        Whether they are apart. If so: a bound of their distance from below, to within
        1e-12 of it, or NaN if there is one among the points [m]; (3,) the unit normal
        from b towards a; (3,) where a is nearest, moved [m].
    """
    # The simplex: corners of the difference, and of which points they are.
    w, of = np.zeros((4, 3)), np.zeros((4, 2), dtype=np.int64)
    share = np.zeros(4)
    share[0] = 1.0
    count, size, gap = 1, np.inf, np.nan
    v, n, x = np.empty(3), np.zeros(3), np.zeros(3)
    for c in range(3):
        w[0, c] = a[0, c] + shift[c] - b[0, c]
        v[c] = w[0, c]
    for _ in range(_MOST):
        length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if length < _TOUCHING:
            return False, 0.0, n, x
        if not length < size:
            break  # no nearer: as near as rounding lets it
        size = length
        for c in range(3):
            n[c], x[c] = v[c] / length, shift[c]
            for k in range(count):
                x[c] += share[k] * a[of[k, 0], c]
        i, j = _lowest(a, n), _lowest(b, -n)
        gap = 0.0
        for c in range(3):
            gap += n[c] * (a[i, c] + shift[c] - b[j, c])
        if size - gap <= _ENOUGH:
            break
        for c in range(3):
            w[count, c] = a[i, c] + shift[c] - b[j, c]
        of[count, 0], of[count, 1] = i, j
        share, inside = _nearest_of_simplex(w, count + 1)
        if inside:
            return False, 0.0, n, x
        kept = 0
        for k in range(count + 1):
            if share[k] > 0.0:
                w[kept], of[kept], share[kept] = w[k], of[k], share[k]
                kept += 1
        count = kept
        for c in range(3):
            v[c] = 0.0
            for k in range(count):
                v[c] += share[k] * w[k, c]
    return True, gap, n, x


@compiled(loops=True)
def _edges_of(points, hull, hulls):
    """(E, 3) the directions of a shape's edges, of a capsule its axis."""
    if hull < 0:
        return points[1:] - points[:1]
    first, end = hulls.first_edge[hull], hulls.first_edge[hull + 1]
    found = np.empty((end - first, 3))
    for k in range(first, end):
        found[k - first] = points[hulls.edges[k, 1]] - points[hulls.edges[k, 0]]
    return found


@compiled(loops=True)
def _span_of(points, hull, hulls):
    """(F, 2, 3) two directions in each of a shape's faces; a capsule has none."""
    if hull < 0:
        return np.empty((0, 2, 3))
    first, end = hulls.first_face[hull], hulls.first_face[hull + 1]
    found = np.empty((end - first, 2, 3))
    for k in range(first, end):
        corner = points[hulls.faces[k, 0]]
        found[k - first, 0] = points[hulls.faces[k, 1]] - corner
        found[k - first, 1] = points[hulls.faces[k, 2]] - corner
    return found


@compiled(loops=True)
def _gap_across(a, b, e, f, best, n):
    """The larger of `best` and the gap along e x f or against it, with its n."""
    x, y = e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2]
    z = e[0] * f[1] - e[1] * f[0]
    length = np.sqrt(x * x + y * y + z * z)
    ee = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
    ff = f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    # Of parallels the rounding alone has a direction.
    if not length > 1e-9 * np.sqrt(ee * ff):
        return best
    x, y, z = x / length, y / length, z / length
    low_a = low_b = np.inf
    high_a = high_b = -np.inf
    for i in range(len(a)):
        height = a[i, 0] * x + a[i, 1] * y + a[i, 2] * z
        low_a, high_a = min(low_a, height), max(high_a, height)
    for i in range(len(b)):
        height = b[i, 0] * x + b[i, 1] * y + b[i, 2] * z
        low_b, high_b = min(low_b, height), max(high_b, height)
    if low_a - high_b > best:
        best = low_a - high_b
        n[0], n[1], n[2] = x, y, z
    if low_b - high_a > best:
        best = low_b - high_a
        n[0], n[1], n[2] = -x, -y, -z
    return best


@compiled(loops=True)
def hull_distance(
    at: np.ndarray,
    start_a: int,
    vector_a: int,
    hull_a: int,
    start_b: int,
    vector_b: int,
    hull_b: int,
    hulls: Hulls,
) -> tuple[float, np.ndarray, np.ndarray]:
    """The signed distance of two shapes less their radii, of which one is a hull.

    Inside it is minus the depth: the largest of all gaps between the shadows of both on
    one direction, as it is outside. So it changes by no more than both move.

    Args:
        at, start_a, vector_a, hull_a: of the first shape, as of `corners_of`.
        start_b, vector_b, hull_b: of the second.
        hulls: of both.

    Returns:
        The distance [m]; (3,) the unit normal from b towards a; (3,) the point of a on
        the line of the shortest distance [m].
    """
    a = corners_of(at, start_a, vector_a, hull_a, hulls)
    b = corners_of(at, start_b, vector_b, hull_b, hulls)
    apart, d, n, x = nearest_apart(a, b, np.zeros(3))
    if apart:
        return d, n, x
    d = -np.inf
    for span in _span_of(a, hull_a, hulls):
        d = _gap_across(a, b, span[0], span[1], d, n)
    for span in _span_of(b, hull_b, hulls):
        d = _gap_across(a, b, span[0], span[1], d, n)
    edges = _edges_of(b, hull_b, hulls)
    for e in _edges_of(a, hull_a, hulls):
        for f in edges:
            d = _gap_across(a, b, e, f, d, n)
    shift = (_PARTED - d) * n
    _, _, _, x = nearest_apart(a, b, shift)
    return d, n, x - shift


@compiled(loops=True)
def shadow_rates(
    n: np.ndarray, points: np.ndarray, V: np.ndarray, half: float
) -> tuple[float, float, float, float]:
    """(A4) of a moving hull: the ends of its shadow on n where a time begins and ends.

    A point's shadow n . p moves at n . (v + w x p) to the first order, so that at t it
    is (n + t n x w) . p + t n . v: that of a resting hull on another direction.

    Args:
        n: (3,) unit direction.
        points: (V, 3) of which the shape is the hull [m].
        V: (6,) its spatial velocity about the world's origin.
        half: the time is within [-half, half].

    Returns:
        The lowest at -half and at half, the highest at -half and at half [m].
    """
    turned = half * np.array(
        [
            n[1] * V[2] - n[2] * V[1],
            n[2] * V[0] - n[0] * V[2],
            n[0] * V[1] - n[1] * V[0],
        ]
    )
    moved = half * (n[0] * V[3] + n[1] * V[4] + n[2] * V[5])
    low_0 = low_1 = np.inf
    high_0 = high_1 = -np.inf
    for i in range(len(points)):
        here, more = 0.0, moved
        for c in range(3):
            here += n[c] * points[i, c]
            more += turned[c] * points[i, c]
        low_0, high_0 = min(low_0, here - more), max(high_0, here - more)
        low_1, high_1 = min(low_1, here + more), max(high_1, here + more)
    return low_0, low_1, high_0, high_1
