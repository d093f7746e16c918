"""Distances of boxes and convex hulls for the referee: by their faces and edges.

Every pair of features is measured, in the open, where the law searches: a corner
against each face, an edge against each edge. Where hulls meet, what parts them soonest
is along the normal of a face, or across an edge of each.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

# Two edges whose sine is below have no common normal.
_PARALLEL = 1e-12


class Polytope(NamedTuple):
    """A hull with all its triangles; or an axis, without any."""

    points: np.ndarray  # (V, 3) [m]
    triangles: np.ndarray  # (F, 3) of points
    edges: np.ndarray  # (E, 2) of points; those within a face among them


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
    of_edges = _between_segments(
        a.points[a.edges[:, 0]],
        a.points[a.edges[:, 1]],
        b.points[b.edges[:, 0]],
        b.points[b.edges[:, 1]],
    )
    return min(of_edges, _above_triangles(a, b), _above_triangles(b, a))


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


def _between_segments(
    a_0: np.ndarray, a_1: np.ndarray, b_0: np.ndarray, b_1: np.ndarray
) -> float:
    """The smallest distance of N segments and M others [m].

    Each candidate is a pair of points of two segments, as of `capsule_distance`.
    """
    a_0, a_1, b_0, b_1 = a_0[:, None], a_1[:, None], b_0[None], b_1[None]
    least = min(
        _to_segments(a_0, b_0, b_1),
        _to_segments(a_1, b_0, b_1),
        _to_segments(b_0, a_0, a_1),
        _to_segments(b_1, a_0, a_1),
    )
    u, v, w = a_1 - a_0, b_1 - b_0, a_0 - b_0
    normal = np.cross(u, v)
    squared = (normal * normal).sum(axis=-1)
    fair = squared > 0.0
    s = -(np.cross(w, v) * normal).sum(axis=-1) / np.where(fair, squared, 1.0)
    p = a_0 + np.clip(s, 0.0, 1.0)[..., None] * u
    return min(least, _to_segments(p, b_0, b_1))


def _to_segments(p: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """The smallest distance of points to segments, all (..., 3) [m]."""
    u = end - start
    uu = (u * u).sum(axis=-1)
    t = ((p - start) * u).sum(axis=-1) / np.where(uu > 0.0, uu, 1.0)
    off = p - start - np.clip(t, 0.0, 1.0)[..., None] * u
    return float(np.sqrt((off * off).sum(axis=-1).min()))
