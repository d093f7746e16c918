"""Signed distances of capsules, spheres and half spaces, for all pairs at once.

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
from crar_drake.law.vectors import cross, dot, smallest

# Below this sin^2 of the angle between two axes, cancellation spoils the plain
# formula for their nearest points: by 4e-9 m at 5e-8 rad where arms cross.
_NEARLY_PARALLEL = 1e-8
# Below this one they are parallel.
_PARALLEL = 1e-24
# Axes nearer than this [m] have no direction between them to speak of.
_TOUCHING = 1e-12


class CapsuleSizes(NamedTuple):
    """What is fixed of N pairs of capsules; made by `capsule_sizes`."""

    uu: np.ndarray  # (N,) squared lengths of the axes of a [m^2]
    vv: np.ndarray  # (N,) and of b
    per_uu: np.ndarray  # (N,) their inverses, 1 for spheres [1/m^2]
    per_vv: np.ndarray
    uu_vv: np.ndarray  # (N,) their products, 1 where one is a sphere [m^4]
    radii: np.ndarray  # (N,) sums of both radii [m]
    balls: np.ndarray  # (N,) and of those of the balls about both [m]
    flat: np.ndarray  # (N,) bool, whether b is a half space


def capsule_sizes(
    length_a: np.ndarray,
    radius_a: np.ndarray,
    length_b: np.ndarray,
    radius_b: np.ndarray,
    flat_b: np.ndarray | None = None,
) -> CapsuleSizes:
    """The sizes of N pairs of capsules.

    Args:
        length_a, length_b: (N,) of the axes, 0 for spheres [m].
        radius_a, radius_b: (N,) [m].
        flat_b: (N,) bool, where b is a half space, of radius 0, and a a sphere; by
            default nowhere.
    """
    uu, vv = np.square(length_a), np.square(length_b)
    # Of an axis without length the parameter does not matter.
    product = uu * vv
    return CapsuleSizes(
        uu=uu,
        vv=vv,
        per_uu=1.0 / np.where(uu > 0.0, uu, 1.0),
        per_vv=1.0 / np.where(vv > 0.0, vv, 1.0),
        uu_vv=np.where(product > 0.0, product, 1.0),
        radii=radius_a + radius_b,
        balls=0.5 * (np.sqrt(uu) + np.sqrt(vv)) + (radius_a + radius_b),
        flat=np.zeros(len(uu), dtype=bool) if flat_b is None else flat_b,
    )


class ShapePairs(NamedTuple):
    """The shapes of Nr rows, in K configurations of P points each.

    A row is a watched pair, of which the nearest shapes count, or a pair of its shapes.
    The shape pairs of one watched pair stand side by side: those in closed form, whose
    axes are among the points, and others whose nearest points are asked elsewhere. Of
    those in closed form, Ns, all are looked at or some, K Nf.
    """

    start_a: np.ndarray  # (K Ns,) where the axes of a start, among all points
    start_b: np.ndarray
    # (K Ns,) the vectors from there to their ends, each as many places after its start
    vector_a: np.ndarray
    vector_b: np.ndarray
    sizes: CapsuleSizes  # (K Ns,)
    shapes: np.ndarray  # (K Nf,) which of these are looked at
    # (Ns,) the row of each among what SceneGraph is asked; -1 of hulls about shapes
    order: np.ndarray
    members: np.ndarray  # (K Nr, most) shape pairs of each row; the first fills up
    moves: np.ndarray  # (Nr, nv) see `collisions.distance_gradient_about_origin`
    hull_a: np.ndarray  # (K Ns,) which hull a is, whose axis is its middle; -1 if none
    hull_b: np.ndarray
    hulls: Held  # of `Hulls`


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
        at: (K P, 3) points, where the axes start [m] and from there to their ends
            among them [m].
        some: (N,) which of the pairs.

    Returns:
        (N,) signed distance [m]; (N, 3) unit normal from b towards a; (N, 3)
        witness points on the axis of a and (N, 3) on that of b [m]. The distance's
        gradient is the same at the axis as at the surface, since the offset between
        them is along the normal.
    """
    count = len(some)
    sizes, hulls = pairs.sizes, pairs.hulls.value
    d, normal = np.empty(count), np.empty((count, 3))
    nearest_a, nearest_b = np.empty((count, 3)), np.empty((count, 3))
    # Of a signed place Numba asks each time whether it counts from the end.
    for i in range(count):
        of = np.uintp(some[i])
        a, b = np.uintp(pairs.start_a[of]), np.uintp(pairs.start_b[of])
        u, v = np.uintp(pairs.vector_a[of]), np.uintp(pairs.vector_b[of])
        if pairs.hull_a[of] >= 0 or pairs.hull_b[of] >= 0:
            far, n, x = hull_distance(
                at,
                pairs.start_a[of],
                pairs.vector_a[of],
                pairs.hull_a[of],
                pairs.start_b[of],
                pairs.vector_b[of],
                pairs.hull_b[of],
                hulls,
            )
            d[i] = far - sizes.radii[of]
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
        determinant = sizes.uu_vv[of] - uv * uv
        if determinant < _NEARLY_PARALLEL * sizes.uu_vv[of]:
            s = _along_nearly_parallel(
                np.array([u_0, u_1, u_2]),
                np.array([v_0, v_1, v_2]),
                np.array([r_0, r_1, r_2]),
                sizes.uu[of],
                sizes.vv[of],
            )
        else:
            s = (uv * vr - ur * sizes.vv[of]) / determinant
        t = _to_unit((uv * _to_unit(s) + vr) * sizes.per_vv[of])
        s = _to_unit((uv * t - ur) * sizes.per_uu[of])
        x_0, x_1, x_2 = a_0 + s * u_0, a_1 + s * u_1, a_2 + s * u_2
        y_0, y_1, y_2 = b_0 + t * v_0, b_1 + t * v_1, b_2 + t * v_2
        n_0, n_1, n_2 = x_0 - y_0, x_1 - y_1, x_2 - y_2
        axis_distance = np.sqrt(n_0 * n_0 + n_1 * n_1 + n_2 * n_2)
        if axis_distance < _TOUCHING:
            n = _perpendicular(np.array([u_0, u_1, u_2]), np.array([v_0, v_1, v_2]))
            n_0, n_1, n_2 = n[0], n[1], n[2]
        else:
            n_0, n_1, n_2 = (
                n_0 / axis_distance,
                n_1 / axis_distance,
                n_2 / axis_distance,
            )
        if sizes.flat[of]:
            along = np.sqrt(sizes.per_vv[of])
            height = -vr * along
            axis_distance = height
            n_0, n_1, n_2 = -v_0 * along, -v_1 * along, -v_2 * along
            y_0, y_1, y_2 = a_0 - height * n_0, a_1 - height * n_1, a_2 - height * n_2
        d[i] = axis_distance - sizes.radii[of]
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
    sizes = capsule_sizes(
        np.linalg.norm(u, axis=1), radius_a, np.linalg.norm(v, axis=1), radius_b
    )
    every = np.arange(len(u))
    a, b, along_a, along_b = (every + i * len(u) for i in range(4))
    members = every[:, np.newaxis]
    moves = np.zeros((len(u), 0))
    pairs = ShapePairs(
        *(a, b, along_a, along_b, sizes, every, every, members, moves),
        *no_hulls(len(u)),
    )
    return nearest_points(np.concatenate((p_a0, p_b0, u, v)), pairs, every)


# Drake's answers are at most so much too large where its search has ended [m].
_REFUTED = 1e-4


@compiled
def nearest_of_pairs(
    points: np.ndarray, asked: np.ndarray, pairs: ShapePairs
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the shapes of each row are nearest.

    Args:
        points: (K, P, 3) in W, the axes' starts and vectors among them [m].
        asked: (N, 7) what SceneGraph answers of all shapes: distance, normal from b to
            a, point fixed to a on the line of the shortest distance; (0, 7) where it is
            not asked. An answer that the closed form refutes is not taken: Drake's
            search ends too early now and then, and is then up to centimetres too large.

    Returns:
        (K Nr,) signed distances [m]; (K Nr, 3) unit normals from b to a; (K Nr, 3)
        points fixed to a on the line of the shortest distance [m].
    """
    d, normal, p_WA, _ = nearest_points(points.reshape(-1, 3), pairs, pairs.shapes)
    if len(asked):
        exact = d, normal, p_WA
        d, normal = asked[:, 0].copy(), asked[:, 1:4].copy()
        p_WA = asked[:, 4:].copy()
        for k in range(len(pairs.order)):
            row = pairs.order[k]
            if row >= 0 and not d[row] <= exact[0][k] + _REFUTED:
                d[row], normal[row], p_WA[row] = exact[0][k], exact[1][k], exact[2][k]
    if len(d) == len(pairs.members):
        return d, normal, p_WA
    keep = smallest(d, pairs.members)
    return d[keep], normal[keep], p_WA[keep]
