"""Distances of shapes for the referee: a way of its own, in the open."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from scipy.spatial import ConvexHull

# Two edges whose sine is below have no common normal.
_PARALLEL = 1e-12


def capsule_distance(
    p_a0: ArrayLike,
    p_a1: ArrayLike,
    radius_a: ArrayLike,
    p_b0: ArrayLike,
    p_b1: ArrayLike,
    radius_b: ArrayLike,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed distances of capsules, and where their axes are nearest.

    The signed distance is the distance of the two axis segments minus both radii.
    Outside it is exactly the distance of the surfaces. Inside it is exactly minus
    the penetration depth, the shortest translation that parts the capsules: along
    the line between the nearest axis points, or, where the axes cross, along their
    common normal.

    The axis distance is the minimum over the unit square of the convex quadratic
    |a(s) - b(t)|², with a(s) = p_a0 + s (p_a1 - p_a0) and b(t) likewise. Its
    minimum lies either at a stationary point inside, or on one of the four edges,
    each a point against a segment. Every candidate is a pair of points of the
    segments, so that none can be too small, and one of them is the minimum. For
    parallel and for degenerate segments the edges alone contain a minimum.

    Args:
        p_a0, p_a1: (..., 3) ends of the axis of each a [m], equal for a sphere.
        radius_a: (...) radius of each a [m].
        p_b0, p_b1, radius_b: likewise for b, in the same frame.

    Returns:
        The signed distances (...) [m], and the (..., 3) witness points on the axes of
        a and of b, in the frame of the arguments. Where several are equally near
        (parallel axes), it is one of them.
    """
    a0, a1, b0, b1 = (np.asarray(p, dtype=float) for p in (p_a0, p_a1, p_b0, p_b1))
    candidates = [
        # The four edges: an end of one segment against the whole other one.
        (a0, _nearest_on_segment(a0, b0, b1)),
        (a1, _nearest_on_segment(a1, b0, b1)),
        (_nearest_on_segment(b0, a0, a1), b0),
        (_nearest_on_segment(b1, a0, a1), b1),
    ]
    # Inside: w + s u - t v is along the common normal u x v of both lines. Crossed
    # with v and projected on the normal, t drops out and s remains. Where s is
    # inaccurate (nearly parallel), the point is still one of the segment, and the
    # nearest point of b to it makes it a fair candidate.
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    normal = np.cross(u, v)
    squared = _dot(normal, normal)
    s = -_dot(np.cross(w, v), normal) / np.where(squared > 0.0, squared, 1.0)
    p = a0 + np.clip(s, 0.0, 1.0)[..., None] * u
    candidates.append((p, _nearest_on_segment(p, b0, b1)))

    least, p_a, p_b = np.inf, a0, b0
    for on_a, on_b in candidates:
        far = np.sqrt(_dot(on_a - on_b, on_a - on_b))
        nearer = (far < least)[..., None]
        p_a, p_b = np.where(nearer, on_a, p_a), np.where(nearer, on_b, p_b)
        least = np.minimum(far, least)
    return least - radius_a - radius_b, p_a, p_b


class Polytope(NamedTuple):
    """A hull with all its triangles; or an axis, without any."""

    points: np.ndarray  # (V, 3) [m]
    triangles: np.ndarray  # (F, 3) of points
    edges: np.ndarray  # (E, 2) of points; those within a face among them


class Axis(NamedTuple):
    """The axis of a capsule (or sphere) with its radius; or a hull, whose middle it is.

    Of a half space `start` is on its surface, `end` straight above, and the radius is
    infinite.
    """

    start: np.ndarray  # (3,) [m]
    end: np.ndarray  # (3,) [m]
    radius: float  # [m]
    hull: Polytope | None = None

    @property
    def ends(self) -> np.ndarray:
        """(N, 3) points of which the axis is the hull [m]."""
        if self.hull is not None:
            return self.hull.points
        return np.array([self.start, self.end])

    @property
    def ball(self) -> float:
        """The radius of a ball about the axis' middle with all of the shape [m]."""
        if self.hull is not None:
            return float(np.linalg.norm(self.hull.points - self.start, axis=1).max())
        return math.dist(self.start, self.end) / 2.0 + self.radius

    def moved(self, X: RigidTransform) -> "Axis":
        """The shape in the frame that X leads to."""
        hull = self.hull
        if hull is not None:
            hull = hull._replace(points=X.multiply(hull.points.T).T)
        return Axis(X.multiply(self.start), X.multiply(self.end), self.radius, hull)


def distance_of_axes(a: Axis, b: Axis, enough: float = math.inf) -> float:
    """The signed distance of two shapes; of which one may be a half space [m].

    Args:
        a, b: in the world.
        enough: of hulls that are as far apart a bound will do, which is no less [m].
    """
    if math.isinf(a.radius):
        a, b = b, a
    if math.isinf(b.radius):
        # A shape is lowest at an end.
        up = b.end - b.start
        return min(float(up @ (end - b.start)) for end in a.ends) - a.radius
    if a.hull is None and b.hull is None:
        return float(capsule_distance(*a[:3], *b[:3])[0])
    a_hull, b_hull = (x.hull or axis_polytope(x.start, x.end) for x in (a, b))
    radii = a.radius + b.radius
    return polytope_distance(a_hull, b_hull, enough + radii) - radii


def _dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (x * y).sum(axis=-1)


def _nearest_on_segment(
    p: np.ndarray, start: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """The points of segments (perhaps of no length) that are nearest to points."""
    u = end - start
    uu = _dot(u, u)
    share = _dot(p - start, u) / np.where(uu > 0.0, uu, 1.0)
    return start + np.clip(share, 0.0, 1.0)[..., None] * u


# --- boxes and convex hulls: by their faces and edges -----------------------------
#
# Every pair of features is measured, where the law searches: a corner against each
# face, an edge against each edge. Where hulls meet, what parts them soonest is along
# the normal of a face, or across an edge of each.


def polytope(points: np.ndarray) -> Polytope:
    """The hull of (N, 3) points."""
    found = ConvexHull(points)
    number = np.full(len(points), -1)
    number[found.vertices] = np.arange(len(found.vertices))
    triangles = number[found.simplices]
    sides = np.concatenate(
        [triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]
    )
    edges = np.unique(np.sort(sides, axis=1), axis=0)
    return Polytope(np.array(points)[found.vertices], triangles, edges)


def axis_polytope(start: np.ndarray, end: np.ndarray) -> Polytope:
    """A capsule's axis from and to (3,) points."""
    return Polytope(
        np.array([start, end]), np.zeros((0, 3), dtype=int), np.array([[0, 1]])
    )


def polytope_distance(a: Polytope, b: Polytope, enough: float = np.inf) -> float:
    """The signed distance: where they meet minus the shortest way that parts them [m].

    Args:
        a, b: of which one is a hull, in one frame.
        enough: of what is shown to be as far apart a bound from below will do, which
            is no less [m].
    """
    if (apart := _gap_on(_face_normals(a, b), a, b)) >= enough:
        return apart
    parting = _largest_gap(a, b)
    if parting <= 0.0:
        return parting
    a_0, a_1 = (a.points[a.edges[:, k], None] for k in (0, 1))
    b_0, b_1 = (b.points[None, b.edges[:, k]] for k in (0, 1))
    of_edges, _, _ = capsule_distance(a_0, a_1, 0.0, b_0, b_1, 0.0)
    return min(float(of_edges.min()), _above_triangles(a, b), _above_triangles(b, a))


def _largest_gap(a: Polytope, b: Polytope) -> float:
    """Between the shadows of both, over all normals of faces and across edges [m]."""
    along_a, along_b = (
        x.points[x.edges[:, 1]] - x.points[x.edges[:, 0]] for x in (a, b)
    )
    across = np.cross(along_a[:, None], along_b[None]).reshape(-1, 3)
    size = np.outer(*(np.linalg.norm(x, axis=1) for x in (along_a, along_b))).ravel()
    across = across[np.linalg.norm(across, axis=1) > _PARALLEL * size]
    return _gap_on(np.concatenate([_face_normals(a, b), across]), a, b)


def _face_normals(a: Polytope, b: Polytope) -> np.ndarray:
    """(N, 3) of both, of any length."""
    triangles = np.concatenate([of.points[of.triangles] for of in (a, b)])
    p, q, r = np.moveaxis(triangles, 1, 0)
    return np.cross(q - p, r - p)


def _gap_on(n: np.ndarray, a: Polytope, b: Polytope) -> float:
    """The largest gap between the shadows of both on (N, 3) directions [m]."""
    n = n[np.linalg.norm(n, axis=1) > 0.0]
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    on_a, on_b = n @ a.points.T, n @ b.points.T
    gaps = (on_a.min(1) - on_b.max(1)).max(), (on_b.min(1) - on_a.max(1)).max()
    return float(max(gaps))


def _above_triangles(of: Polytope, hull: Polytope) -> float:
    """The smallest height of a point above a triangle that it is above [m]."""
    if not len(hull.triangles):
        return np.inf
    p, q, r = np.moveaxis(hull.points[hull.triangles], 1, 0)
    e, f = q - p, r - p
    n = np.cross(e, f)
    nn = (n * n).sum(axis=1)
    to = of.points[:, None] - p  # (V, F, 3)
    s = (n * np.cross(to, f)).sum(axis=-1) / nn
    t = (n * np.cross(e, to)).sum(axis=-1) / nn
    height = np.abs((to * n).sum(axis=-1)) / np.sqrt(nn)
    above = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    return float(height[above].min(initial=np.inf))
