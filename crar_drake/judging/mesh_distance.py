"""Signed distances of triangle meshes: exact outside, bounds of the depth inside.

FCL (python-fcl) finds the nearest triangles, whatever the meshes' shapes. Of meshes
without a common point it cannot tell apart from inside: winding numbers do.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property

import numpy as np
from pydrake.math import RigidTransform
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

try:
    import fcl
except ImportError:  # of an extra, which `link_meshes.check_installed` asks for
    fcl = None

# The depth is searched to this [m].
_DEPTH_TOLERANCE = 1e-5

# Touching triangles whose normals are tried as ways out.
_MOST_CONTACTS = 16

# A hull is wider by this on all sides: it holds the part in spite of rounding, and a
# flat part has one [m].
HULL_MARGIN = 1e-5

# Solid angles that are computed at a time.
_BLOCK = 1_000_000


class TriangleMesh:
    """A rigid body's surface in its frame B.

    Attributes:
        vertices: (N, 3) p_BV, equal ones merged [m].
        faces: (M, 3) indices of vertices.
        lower, upper: (3,) corners of the bounding box in B [m].
        centre: (3,) of the bounding box [m].
        radius: of the ball around `centre` that holds all vertices [m].
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        """
        Args:
            vertices: (N, 3) p_BV [m].
            faces: (M, 3) indices of vertices, counterclockwise seen from outside.

        Raises:
            ValueError: there is no triangle, an index is of no vertex, or a vertex is
                not finite.
        """
        vertices = np.asarray(vertices, dtype=float).reshape(-1, 3)
        faces = np.asarray(faces, dtype=int).reshape(-1, 3)
        if not len(faces):
            raise ValueError("a mesh without triangles")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise ValueError("a triangle has a corner that is no vertex")
        if not np.isfinite(vertices).all():
            raise ValueError("a vertex is not finite")
        # Files repeat a vertex for each of its triangles; whether the surface is
        # closed and what hangs together is seen only without that.
        self.vertices, merged = np.unique(vertices, axis=0, return_inverse=True)
        a, b, c = (faces := merged.reshape(-1)[faces]).T
        self.faces = faces[(a != b) & (b != c) & (c != a)]
        if not len(self.faces):
            raise ValueError("all triangles are without area")
        corners = self.vertices[self.faces].reshape(-1, 3)
        self.lower, self.upper = corners.min(axis=0), corners.max(axis=0)
        self.centre = (self.lower + self.upper) / 2.0
        self.radius = float(np.linalg.norm(corners - self.centre, axis=1).max())
        self._tree = fcl.BVHModel()
        self._tree.beginModel(len(self.vertices), len(self.faces))
        self._tree.addSubModel(self.vertices, self.faces)
        self._tree.endModel()

    @cached_property
    def is_closed(self) -> bool:
        """Whether each edge is there as often one way as the other.

        Then winding numbers are whole, also where closed pieces share edges.
        """
        start, end = self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T
        size = len(self.vertices)
        there, back = np.sort(start * size + end), np.sort(end * size + start)
        return bool(np.array_equal(there, back))

    @cached_property
    def one_vertex_each(self) -> np.ndarray:
        """(K, 3) one vertex of each of the K connected pieces of the surface [m]."""
        a, b, c = self.faces.T
        rows, columns = np.concatenate([a, b]), np.concatenate([b, c])
        size = len(self.vertices)
        graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size, size))
        _, piece = connected_components(graph, directed=False)
        used = np.unique(self.faces)
        _, first = np.unique(piece[used], return_index=True)
        return self.vertices[used[first]]

    def winding_numbers(self, p_BQ: np.ndarray) -> np.ndarray:
        """How often the surface goes around each point, (P,).

        Of a closed surface it is 1 (or -1, if the triangles face inward) inside and 0
        outside. Of one with holes it is in between: the generalized winding number
        (A. Jacobson, L. Kavan, O. Sorkine-Hornung, 2013), the sum of the triangles'
        solid angles over 4 pi.

        Args:
            p_BQ: (P, 3) points that are not on the surface [m].
        """
        points = np.asarray(p_BQ, dtype=float).reshape(-1, 3)
        corners = self.vertices[self.faces]
        numbers = np.zeros(len(points))
        step = max(1, _BLOCK // len(corners))
        for start in range(0, len(points), step):
            some = points[start : start + step]
            a, b, c = (corners[None, :, i] - some[:, None] for i in range(3))
            la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
            # A. van Oosterom and J. Strackee, 1983.
            above = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
            below = (
                la * lb * lc
                + np.einsum("pfi,pfi->pf", a, b) * lc
                + np.einsum("pfi,pfi->pf", b, c) * la
                + np.einsum("pfi,pfi->pf", c, a) * lb
            )
            angles = 2.0 * np.arctan2(above, below)
            numbers[start : start + step] = angles.sum(axis=1) / (4.0 * np.pi)
        return numbers

    def has_inside(self, p_BQ: np.ndarray) -> bool:
        """Whether any of some points is inside.

        Of a surface with holes, inside is where its winding number is beyond one half.

        Args:
            p_BQ: (P, 3) points that are not on the surface [m].
        """
        points = np.asarray(p_BQ, dtype=float).reshape(-1, 3)
        within = ((points > self.lower) & (points < self.upper)).all(axis=1)
        if not within.any():
            return False
        return bool((np.abs(self.winding_numbers(points[within])) > 0.5).any())

    def placed(self, X_AB: RigidTransform) -> fcl.CollisionObject:
        """The mesh for FCL, at a pose in another frame A."""
        X = fcl.Transform(X_AB.rotation().matrix(), X_AB.translation())
        return fcl.CollisionObject(self._tree, X)


def hull_mesh(vertices: np.ndarray) -> TriangleMesh:
    """The surface of the convex hull of (N, 3) points, wider by `HULL_MARGIN`."""
    with suppress(QhullError):  # it is flat, or a needle
        vertices = vertices[ConvexHull(vertices).vertices]
    steps = HULL_MARGIN * np.concatenate([np.eye(3), -np.eye(3)])
    points = (vertices[:, None] + steps).reshape(-1, 3)
    points = points[ConvexHull(points).vertices]
    hull = ConvexHull(points)
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    outward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) > 0
    faces = np.where(outward[:, None], hull.simplices, hull.simplices[:, ::-1])
    return TriangleMesh(points, faces)


def mesh_distance(a: TriangleMesh, b: TriangleMesh, X_AB: RigidTransform) -> float:
    """Signed distance of two meshes [m].

    Apart, it is the distance of their nearest triangles. Where triangles intersect, or
    one mesh is inside the other, it is minus the length of a translation that parts
    them (`penetration_depth`).

    Args:
        a, b: the meshes, each in its own frame, A and B.
    """
    gap = distance_apart(a, b, X_AB)
    return gap if gap > 0.0 else -penetration_depth(a, b, X_AB)


def distance_apart(a: TriangleMesh, b: TriangleMesh, X_AB: RigidTransform) -> float:
    """Distance of the nearest triangles [m]; 0 where meshes meet (`meshes_meet`)."""
    gap = triangle_distance(a, b, X_AB)
    return gap if gap > 0.0 and not _one_holds_other(a, b, X_AB) else 0.0


def triangle_distance(a: TriangleMesh, b: TriangleMesh, X_AB: RigidTransform) -> float:
    """Distance of the nearest triangles [m]; 0 or less where some intersect."""
    placed = a.placed(RigidTransform()), b.placed(X_AB)
    return float(fcl.distance(*placed, fcl.DistanceRequest(), fcl.DistanceResult()))


def meshes_meet(a: TriangleMesh, b: TriangleMesh, X_AB: RigidTransform) -> bool:
    """Whether triangles of two meshes intersect, or one mesh is inside the other."""
    touch = fcl.collide(
        a.placed(RigidTransform()),
        b.placed(X_AB),
        fcl.CollisionRequest(),
        fcl.CollisionResult(),
    )
    return bool(touch) or _one_holds_other(a, b, X_AB)


def penetration_depth(a: TriangleMesh, b: TriangleMesh, X_AB: RigidTransform) -> float:
    """Length of a short translation that parts two meshes which meet [m], positive.

    The penetration depth is that of the shortest one. Here only some directions are
    tried: the axes of both frames and the normals of intersecting triangles, so that
    the result is an upper bound. It is exact (to 0.01 mm) where the shortest way out is
    along one of them, as of boxes, or of a flat face.
    """
    R = X_AB.rotation().matrix()
    p_A, p_B = a.vertices, b.vertices @ R.T + X_AB.translation()
    directions = _ways_out(a, b, X_AB)
    # Beyond this translation of b a plane is between the meshes.
    apart = (directions @ p_A.T).max(axis=1) - (directions @ p_B.T).min(axis=1)
    depth = np.inf
    for far, n in sorted(zip(apart, directions, strict=True), key=lambda way: way[0]):
        if np.isfinite(depth) and _meet_moved(a, b, X_AB, n * depth):
            continue
        # Not every translation between is tried: a surface may part and meet again.
        near, far = 0.0, min(float(far), depth)
        while far - near > _DEPTH_TOLERANCE:
            middle = (near + far) / 2.0
            if _meet_moved(a, b, X_AB, n * middle):
                near = middle
            else:
                far = middle
        depth = far
    return max(depth, _DEPTH_TOLERANCE)


def _ways_out(a: TriangleMesh, b: TriangleMesh, X_AB: RigidTransform) -> np.ndarray:
    """(D, 3) different unit vectors in A along which b may leave a."""
    R = X_AB.rotation().matrix()
    result = fcl.CollisionResult()
    request = fcl.CollisionRequest(num_max_contacts=_MOST_CONTACTS, enable_contact=True)
    fcl.collide(a.placed(RigidTransform()), b.placed(X_AB), request, result)
    lines = np.concatenate(
        [
            np.eye(3),
            R.T,
            _normals(a, [contact.b1 for contact in result.contacts]),
            _normals(b, [contact.b2 for contact in result.contacts]) @ R.T,
        ]
    )
    both = np.concatenate([lines, -lines])
    _, first = np.unique(both.round(6) + 0.0, axis=0, return_index=True)
    return both[np.sort(first)]


def _normals(mesh: TriangleMesh, faces: list[int]) -> np.ndarray:
    p, q, r = np.moveaxis(mesh.vertices[mesh.faces[np.unique(faces).astype(int)]], 1, 0)
    normals = np.cross(q - p, r - p)
    lengths = np.linalg.norm(normals, axis=1)
    return normals[lengths > 0.0] / lengths[lengths > 0.0, None]


def _meet_moved(a, b, X_AB: RigidTransform, translation: np.ndarray) -> bool:
    moved = RigidTransform(X_AB.rotation(), X_AB.translation() + translation)
    return meshes_meet(a, b, moved)


def _one_holds_other(a: TriangleMesh, b: TriangleMesh, X_AB: RigidTransform) -> bool:
    """Whether a piece of one is inside the other, if no triangles intersect.

    Then each connected piece is inside or outside as a whole.
    """
    if a.has_inside(X_AB.multiply(b.one_vertex_each.T).T):
        return True
    return b.has_inside(X_AB.inverse().multiply(a.one_vertex_each.T).T)
