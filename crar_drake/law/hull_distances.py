"""Signed distances of convex hulls: boxes, and the convex pieces of meshes.

A capsule's axis is the hull of its two ends, a box that of its eight corners: what
holds for the one, (A3) to (A6), holds for any. Only the distance has no closed form.

Apart, the nearest points are found with simplices of the difference of both hulls, as
by Gilbert, Johnson and Keerthi (1988). Where the hulls meet, the distance is less than
zero: the shortest way that parts them is along the normal of a face, or across an edge
of each.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import compiled, hold

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

    # (H,) from a hull's middle, which stands for the start of its axis, to its first
    # corner, among all points
    after: np.ndarray
    corners: np.ndarray  # (H,) how many
    faces: np.ndarray  # (F, 3) three corners of each face, one of parallel faces
    edges: np.ndarray  # (E, 2) both ends of each edge, one of parallel edges
    first_face: np.ndarray  # (H + 1,) where its faces begin, and all end
    first_edge: np.ndarray  # (H + 1,) where its edges begin, and all end


def no_hulls(count: int) -> dict[str, object]:
    """`hull_a`, `hull_b` and `hulls` of so many pairs of capsules."""
    nothing, first = np.zeros(0, dtype=int), np.zeros(1, dtype=int)
    hulls = Hulls(
        *(nothing, nothing, nothing.reshape(-1, 3), nothing.reshape(-1, 2)),
        *(first, first),
    )
    none = np.full(count, -1)
    return {"hull_a": none, "hull_b": none, "hulls": hold(hulls)}


@compiled
def corners_of(
    at: np.ndarray, start: int, hull: int, to_vector: int, hulls: Hulls
) -> np.ndarray:
    """(V, 3) the points of which a shape, less its radius, is the hull [m].

    Args:
        at: (P, 3) points, among them where the shape's axis starts [m], the vector from
            there to its end, and the corners of hulls.
        start: which of the points is the start.
        to_vector: so many places after it is the vector.
        hull: which of `hulls` the shape is; -1 of a capsule or sphere.
    """
    if hull >= 0:
        first = start + hulls.after[hull]
        return at[first : first + hulls.corners[hull]].copy()
    return np.stack((at[start], at[start] + at[start + to_vector]))


@compiled
def _lowest(points, x, y, z):
    """Which of (V, 3) points is lowest along (x, y, z), and how low it is."""
    which, low = 0, np.inf
    for i in range(len(points)):
        height = points[i, 0] * x + points[i, 1] * y + points[i, 2] * z
        if height < low:
            which, low = i, height
    return which, low


@compiled
def _determinant(a, b, c):
    """Of three rows (3,)."""
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


@compiled
def _nearest_of_simplex(w, count, share):
    """The shares of up to four corners in what is nearest to the origin, in place.

    That is in a vertex, an edge or a face of the last corner, which has come since the
    nearest point of the others was found. Each candidate is a point of the simplex, so
    that none is too near.

    Args:
        w: (4, 3) corners, of which there are
        count: the last one at count - 1.
        share: (4,) where the shares are put.

    Returns:
        Whether the origin is inside.
    """
    last, least = count - 1, np.inf
    x, y, z = w[last, 0], w[last, 1], w[last, 2]
    for i in range(count):  # edges; with i = last, the corner itself
        a, b, c = w[i, 0] - x, w[i, 1] - y, w[i, 2] - z
        length = a * a + b * b + c * c
        t = 0.0
        if length > 0.0:
            t = min(max(-(x * a + y * b + z * c) / length, 0.0), 1.0)
        p, q, r = x + t * a, y + t * b, z + t * c
        if p * p + q * q + r * r < least:
            least = p * p + q * q + r * r
            share[:] = 0.0
            share[last] = 1.0 - t
            share[i] += t
    for i in range(last - 1):  # faces
        a, b, c = w[i, 0] - x, w[i, 1] - y, w[i, 2] - z
        for j in range(i + 1, last):
            d, e, f = w[j, 0] - x, w[j, 1] - y, w[j, 2] - z
            k, m, n = b * f - c * e, c * d - a * f, a * e - b * d  # the normal
            length = k * k + m * m + n * n
            if not length > 0.0:
                continue
            s = k * (y * f - z * e) + m * (z * d - x * f) + n * (x * e - y * d)
            t = k * (b * z - c * y) + m * (c * x - a * z) + n * (a * y - b * x)
            s, t = -s, -t
            height = x * k + y * m + z * n
            if s > 0.0 and t > 0.0 and s + t < length:
                if height * height < least * length:
                    least = height * height / length
                    share[:] = 0.0
                    share[last] = 1.0 - (s + t) / length
                    share[i], share[j] = s / length, t / length
    if count < 4:
        return False
    # Inside, the origin and each corner are on one side of the face opposite: the
    # volumes with the origin in the place of a corner have one sign.
    a, b = _determinant(w[1], w[2], w[3]), _determinant(w[0], w[2], w[3])
    c, d = _determinant(w[0], w[1], w[3]), _determinant(w[0], w[1], w[2])
    return (a > 0.0 and b < 0.0 and c > 0.0 and d < 0.0) or (
        a < 0.0 and b > 0.0 and c < 0.0 and d > 0.0
    )


@compiled
def to_nearest(
    w: np.ndarray, of: np.ndarray, count: int, share: np.ndarray, v: np.ndarray
) -> tuple[bool, int]:
    """Takes a simplex to the part of it that has the point nearest to the origin.

    Args:
        w, count, share: as of `_nearest_of_simplex`. Corners without a share go.
        of: (4, 2) of which points the corners are the difference.
        v: (3,) where the nearest point is put.

    Returns:
        Whether the origin is outside, and how many corners are left.
    """
    outside, kept = not _nearest_of_simplex(w, count, share), 0
    for k in range(count):
        if share[k] > 0.0:
            for c in range(3):
                w[kept, c] = w[k, c]
            of[kept, 0], of[kept, 1] = of[k, 0], of[k, 1]
            share[kept] = share[k]
            kept += 1
    for c in range(3):
        v[c] = 0.0
        for k in range(kept):
            v[c] += share[k] * w[k, c]
    return outside, kept


@compiled
def nearest_apart(
    a: np.ndarray, b: np.ndarray, shift: np.ndarray, i: int, j: int, close: float
) -> tuple[bool, float, np.ndarray, np.ndarray]:
    """Where the hulls of two sets of points are nearest, the first one moved.

    Args:
        a, b: (V, 3), (V', 3) points [m].
        shift: (3,) by which a is moved [m].
        i, j: points of a and b to begin with.
        close: a bound is sought until it is this share of the distance.

    Returns:
        Whether they are apart. If so: a bound of their distance from below, as close,
        or to within 1e-12 of it, or NaN if there is one among the points [m]; (3,) the
        unit normal from b towards a; (3,) where a is nearest, moved [m].
    """
    # The simplex: corners of the difference, and of which points they are.
    w, of = np.zeros((4, 3)), np.zeros((4, 2), dtype=np.int64)
    share = np.zeros(4)
    share[0] = 1.0
    count, size, gap, apart = 1, np.inf, np.nan, True
    v, n, x = np.empty(3), np.zeros(3), np.zeros(3)
    for c in range(3):
        w[0, c] = a[i, c] + shift[c] - b[j, c]
        v[c] = w[0, c]
    of[0, 0], of[0, 1] = i, j
    for _ in range(_MOST):
        length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if length < _TOUCHING:
            apart = False
        if not apart or not length < size:
            break  # no nearer: as near as rounding lets it
        size = length
        for c in range(3):
            n[c], x[c] = v[c] / length, shift[c]
            for k in range(count):
                x[c] += share[k] * a[of[k, 0], c]
        i, _ = _lowest(a, n[0], n[1], n[2])
        j, _ = _lowest(b, -n[0], -n[1], -n[2])
        gap = 0.0
        for c in range(3):
            w[count, c] = a[i, c] + shift[c] - b[j, c]
            gap += n[c] * w[count, c]
        if size - gap <= _ENOUGH or gap > close * size:
            break
        of[count, 0], of[count, 1] = i, j
        apart, count = to_nearest(w, of, count + 1, share, v)
    return apart, gap, n, x


@compiled
def _directions(points, first, corners):
    """(M, k - 1, 3) from the first of k corners to the others, of a hull's edges or
    faces; `first` says where these begin in `corners` (N, k), and end."""
    found = np.empty((first[1] - first[0], corners.shape[1] - 1, 3))
    for i in range(len(found)):
        of = corners[first[0] + i]
        for k in range(1, len(of)):
            for c in range(3):
                found[i, k - 1, c] = points[of[k], c] - points[of[0], c]
    return found


@compiled
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
    for sign in (1.0, -1.0):
        _, low = _lowest(a, sign * x, sign * y, sign * z)
        _, high = _lowest(b, -sign * x, -sign * y, -sign * z)
        if low + high > best:
            best = low + high
            n[0], n[1], n[2] = sign * x, sign * y, sign * z
    return best


@compiled
def hull_distance(
    at: np.ndarray,
    start_a: int,
    hull_a: int,
    start_b: int,
    hull_b: int,
    to_vector: int,
    hulls: Hulls,
) -> tuple[float, np.ndarray, np.ndarray]:
    """The signed distance of two shapes less their radii, of which one is a hull.

    Inside it is minus the depth: the largest of all gaps between the shadows of both on
    one direction, as it is outside. So it changes by no more than both move.

    Args:
        at, to_vector: as of `corners_of`.
        start_a, hull_a: of the first shape, as there.
        start_b, hull_b: of the second.

    Returns:
        The distance [m]; (3,) the unit normal from b towards a; (3,) the point of a on
        the line of the shortest distance [m].
    """
    a = corners_of(at, start_a, hull_a, to_vector, hulls)
    b = corners_of(at, start_b, hull_b, to_vector, hulls)
    apart, d, n, x = nearest_apart(a, b, np.zeros(3), 0, 0, 1.0)
    if apart:
        return d, n, x
    d = -np.inf
    for hull, points in ((hull_a, a), (hull_b, b)):
        if hull >= 0:
            for span in _directions(points, hulls.first_face[hull:], hulls.faces):
                d = _gap_across(a, b, span[0], span[1], d, n)
    edges_a, edges_b = a[1:] - a[:1], b[1:] - b[:1]  # of a capsule
    if hull_a >= 0:
        edges_a = _directions(a, hulls.first_edge[hull_a:], hulls.edges)[:, 0].copy()
    if hull_b >= 0:
        edges_b = _directions(b, hulls.first_edge[hull_b:], hulls.edges)[:, 0].copy()
    for e in edges_a:
        for f in edges_b:
            d = _gap_across(a, b, e, f, d, n)
    shift = (_PARTED - d) * n
    _, _, _, x = nearest_apart(a, b, shift, 0, 0, 1.0)
    return d, n, x - shift
