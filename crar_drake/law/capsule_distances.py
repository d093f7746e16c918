"""Signed distances of capsules, spheres and half spaces, and their gradients.

The paper takes the minimum distances and collision points of Eqs. (19)-(26) from
a collision library. For capsules (a sphere is one of length zero) the closed form
is exact and much faster than reading a library's answers one by one. A half space (the
ground) is always the second shape, the first one a sphere: the ends of a capsule are
two, the corners of a box eight. It is given by an axis, from a point of its surface
straight into it. A pair with a box or another convex hull is asked of
`hull_distances`, one by one.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.hull_distances import hull_distance, no_hulls
from crar_drake.law.vectors import cross, dot

# Below this sin^2 of the angle between two axes, cancellation spoils the plain
# formula for their nearest points: by 4e-9 m at 5e-8 rad where arms cross.
_NEARLY_PARALLEL = 1e-8
# Below this one they are parallel.
_PARALLEL = 1e-24
# Axes nearer than this [m] have no direction between them to speak of.
_TOUCHING = 1e-12


class ShapePairs(NamedTuple):
    """N pairs of shapes, whose axes are among P points.

    An axis is given by where it starts and by the vector from there to its end. That of
    a hull starts in its middle and has no length.
    """

    start_a: np.ndarray  # (N,) where the axes of a start, among the points
    start_b: np.ndarray
    to_vector: int  # so many places after its start is the vector of each axis
    radii: np.ndarray  # (N,) sums of both radii [m]
    balls: np.ndarray  # (N,) and of those of the balls about both [m]
    flat: np.ndarray  # (N,) bool, whether b is a half space
    # (N, nv) 1 where a joint moves a alone, -1 where it moves b alone, else 0
    moves: np.ndarray
    hull_a: np.ndarray  # (N,) which hull a is; -1 if none
    hull_b: np.ndarray
    hulls: Held  # of `Hulls`


class WatchedRows(NamedTuple):
    """The watched pairs of links: of each its nearest pair of shapes counts."""

    members: np.ndarray  # (Nc, most) pairs of shapes of each; the first fills up
    exact: np.ndarray  # (N,) bool, of which the closed form is not of a hull about it
    moves: np.ndarray  # (Nc, nv) as of `ShapePairs`


@compiled
def _to_unit(x):
    """x limited to [0, 1]; NaN stays."""
    return 0.0 if x < 0.0 else (1.0 if x > 1.0 else x)


@compiled
def nearest_points(
    at: np.ndarray, pairs: ShapePairs, some: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distances, normals and witness points of N pairs of capsules or hulls.

    The signed distance is that of the axes less both radii: exact outside, and
    inside the depth along the line between the axes' nearest points. Of parallel
    axes that face each other the witness points are in the middle of the overlap.
    Where the axes meet, the normal is perpendicular to both. Above a half space it is
    the height of the sphere's centre less its radius, and the normal is the half
    space's, everywhere. A hull takes the place of an axis, see `hull_distance`.

    Args:
        at: (P, 3) points, where the axes start [m] and from there to their ends
            among them [m].
        some: (N,) which of the pairs.

    Returns:
        (N,) signed distance [m]; (N, 3) unit normal from b towards a; (N, 3)
        witness points on the axis of a and (N, 3) on that of b [m]. The distance's
        gradient is the same at the axis as at the surface, since the offset between
        them is along the normal.
    """
    count = len(some)
    hulls, to_vector = pairs.hulls.value, pairs.to_vector
    d, normal = np.empty(count), np.empty((count, 3))
    nearest_a, nearest_b = np.empty((count, 3)), np.empty((count, 3))
    # Of a signed place Numba asks each time whether it counts from the end.
    for i in range(count):
        of = np.uintp(some[i])
        a, b = np.uintp(pairs.start_a[of]), np.uintp(pairs.start_b[of])
        u = np.uintp(pairs.start_a[of] + to_vector)
        v = np.uintp(pairs.start_b[of] + to_vector)
        if pairs.hull_a[of] >= 0 or pairs.hull_b[of] >= 0:
            far, n, x = hull_distance(
                *(at, pairs.start_a[of], pairs.hull_a[of], pairs.start_b[of]),
                *(pairs.hull_b[of], to_vector, hulls),
            )
            d[i] = far - pairs.radii[of]
            for c in range(3):
                normal[i, c], nearest_a[i, c] = n[c], x[c]
                nearest_b[i, c] = x[c] - far * n[c]
            continue
        a_0, a_1, a_2 = at[a, 0], at[a, 1], at[a, 2]
        b_0, b_1, b_2 = at[b, 0], at[b, 1], at[b, 2]
        u_0, u_1, u_2 = at[u, 0], at[u, 1], at[u, 2]
        v_0, v_1, v_2 = at[v, 0], at[v, 1], at[v, 2]
        r_0, r_1, r_2 = a_0 - b_0, a_1 - b_1, a_2 - b_2
        uv = u_0 * v_0 + u_1 * v_1 + u_2 * v_2
        ur = u_0 * r_0 + u_1 * r_1 + u_2 * r_2
        vr = v_0 * r_0 + v_1 * r_1 + v_2 * r_2
        uu = u_0 * u_0 + u_1 * u_1 + u_2 * u_2
        vv = v_0 * v_0 + v_1 * v_1 + v_2 * v_2
        # Of an axis without length the parameter does not matter.
        uu, vv = uu if uu > 0.0 else 1.0, vv if vv > 0.0 else 1.0
        determinant = uu * vv - uv * uv
        if determinant < _NEARLY_PARALLEL * uu * vv:
            s = _along_nearly_parallel(at[u], at[v], at[a] - at[b], uu, vv)
        else:
            s = (uv * vr - ur * vv) / determinant
        t = _to_unit((uv * _to_unit(s) + vr) / vv)
        s = _to_unit((uv * t - ur) / uu)
        x_0, x_1, x_2 = a_0 + s * u_0, a_1 + s * u_1, a_2 + s * u_2
        y_0, y_1, y_2 = b_0 + t * v_0, b_1 + t * v_1, b_2 + t * v_2
        n_0, n_1, n_2 = x_0 - y_0, x_1 - y_1, x_2 - y_2
        axis_distance = np.sqrt(n_0 * n_0 + n_1 * n_1 + n_2 * n_2)
        if axis_distance < _TOUCHING:
            n = _perpendicular(at[u], at[v])
            n_0, n_1, n_2 = n[0], n[1], n[2]
        else:
            n_0, n_1 = n_0 / axis_distance, n_1 / axis_distance
            n_2 = n_2 / axis_distance
        if pairs.flat[of]:
            along = 1.0 / np.sqrt(vv)
            height = -vr * along
            axis_distance = height
            n_0, n_1, n_2 = -v_0 * along, -v_1 * along, -v_2 * along
            y_0, y_1, y_2 = a_0 - height * n_0, a_1 - height * n_1, a_2 - height * n_2
        d[i] = axis_distance - pairs.radii[of]
        normal[i, 0], normal[i, 1], normal[i, 2] = n_0, n_1, n_2
        nearest_a[i, 0], nearest_a[i, 1], nearest_a[i, 2] = x_0, x_1, x_2
        nearest_b[i, 0], nearest_b[i, 1], nearest_b[i, 2] = y_0, y_1, y_2
    return d, normal, nearest_a, nearest_b


@compiled
def _along_nearly_parallel(u, v, r, uu, vv):
    """s without cancellation, of one pair: u, v, r (3,)."""
    normal = cross(u, v)
    determinant = dot(normal, normal)
    if determinant > _PARALLEL * uu * vv:
        return dot(cross(v, r), normal) / determinant
    # The ends of b as fractions of a bound the overlap; take its middle.
    end_0 = -dot(u, r) / uu
    end_1 = end_0 + dot(u, v) / uu
    low = min(max(min(end_0, end_1), 0.0), 1.0)
    high = min(max(max(end_0, end_1), 0.0), 1.0)
    return 0.5 * (low + high)


@compiled
def _perpendicular(u, v):
    """A unit vector (3,) perpendicular to both u and v (3,), as far as they have
    directions."""
    normal = cross(u, v)
    uu, vv = dot(u, u), dot(v, v)
    if uu * vv == 0.0 or np.sqrt(dot(normal, normal)) <= 1e-9 * np.sqrt(uu * vv):
        along = u if uu > 0.0 else v
        normal = np.zeros(3)
        least = 0
        for k in range(1, 3):
            if abs(along[k]) < abs(along[least]):
                least = k
        normal[least] = 1.0
        if uu > 0.0 or vv > 0.0:
            normal = cross(along, normal)
    return normal / np.sqrt(dot(normal, normal))


@compiled
def distance_gradient_about_origin(
    normal: np.ndarray, point: np.ndarray, S: np.ndarray, moves: np.ndarray
) -> np.ndarray:
    """Eq. (20) of all pairs as one product, (Nc, n) [m/rad or 1], from S.

    Both witness points lie on one line along the normal, so that a unit force along
    it has the same moment p x n about the world's origin at either. The wrench does
    work on joint j at the rate [p x n; n]^T S_j if j carries a, less that if it
    carries b: n^T (J_a - J_b).

    Args:
        normal: (Nc, 3) unit vectors from b towards a, in W.
        point: (Nc, 3) any point of the line through both witness points [m].
        S: (6, n) the joints' motion about the world's origin, angular above linear,
            see `kinematics.joint_motion`.
        moves: (Nc, n) 1 where the joint carries a alone, -1 where it carries b alone,
            else 0.
    """
    g = np.zeros(moves.shape)
    for i in range(len(moves)):
        x, y, z = point[i, 0], point[i, 1], point[i, 2]
        n_0, n_1, n_2 = normal[i, 0], normal[i, 1], normal[i, 2]
        w_0, w_1, w_2 = y * n_2 - z * n_1, z * n_0 - x * n_2, x * n_1 - y * n_0
        for j in range(moves.shape[1]):
            if moves[i, j] != 0.0:
                turning = w_0 * S[0, j] + w_1 * S[1, j] + w_2 * S[2, j]
                rate = turning + n_0 * S[3, j] + n_1 * S[4, j]
                g[i, j] = moves[i, j] * (rate + n_2 * S[5, j])
    return g


def capsule_distances(
    p_a0: np.ndarray,
    p_a1: np.ndarray,
    radius_a: np.ndarray,
    p_b0: np.ndarray,
    p_b1: np.ndarray,
    radius_b: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distances, normals and witness points of any capsules: `nearest_points`, once.

    Args:
        p_a0, p_a1: (N, 3) ends of the axes of the first capsules [m].
        radius_a: (N,) their radii [m].
        p_b0, p_b1, radius_b: likewise for the second capsules.

    Returns:
        (N,) signed distance [m]; (N, 3) unit normal from b towards a; (N, 3)
        witness points on the axis of a and (N, 3) on the axis of b [m].
    """
    u, v = p_a1 - p_a0, p_b1 - p_b0
    every, radii = np.arange(len(u)), radius_a + radius_b
    pairs = ShapePairs(
        start_a=every,
        start_b=every + len(u),
        to_vector=2 * len(u),
        radii=radii,
        balls=radii,
        flat=np.zeros(len(u), dtype=bool),
        moves=np.zeros((len(u), 0)),
        **no_hulls(len(u)),
    )
    return nearest_points(np.concatenate((p_a0, p_b0, u, v)), pairs, every)


# Drake's answers are at most so much too large where its search has ended [m].
_REFUTED = 1e-4


@compiled
def nearest_of_pairs(
    points: np.ndarray, asked: np.ndarray, pairs: ShapePairs, watched: WatchedRows
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the links of each watched pair are nearest, as SceneGraph has it.

    An answer that the closed form refutes is not taken: Drake's search ends too early
    now and then, and is then up to centimetres too large.

    Args:
        points: (P, 3) in W, the axes' starts and vectors among them [m].
        asked: (N, 7) what SceneGraph answers of all pairs of shapes: distance, normal
            from b to a, point fixed to a on the line of the shortest distance.

    Returns:
        (Nc,) signed distances [m]; (Nc, 3) unit normals from b to a; (Nc, 3) points
        fixed to a on the line of the shortest distance [m].
    """
    d, normal, p_WA, _ = nearest_points(points, pairs, np.arange(len(asked)))
    for k in range(len(asked)):
        if not watched.exact[k] or asked[k, 0] <= d[k] + _REFUTED:
            d[k], normal[k], p_WA[k] = asked[k, 0], asked[k, 1:4], asked[k, 4:]
    keep = np.empty(len(watched.members), dtype=np.int64)
    for i in range(len(keep)):
        keep[i] = watched.members[i, 0]
        for k in watched.members[i]:
            # A NaN counts as smaller than any number, so that it is not lost.
            if d[k] < d[keep[i]] or np.isnan(d[k]):
                keep[i] = k
    return d[keep], normal[keep], p_WA[keep]
