"""Surfaces of triangles that frames of a robot carry, and how far two of them are.

Coal finds the distances: of convex hulls, and of triangles. Hulls are never farther
apart than what they hold.
"""

from __future__ import annotations

import itertools
from contextlib import suppress
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

try:
    import coal
except ImportError:  # of an extra, which `link_meshes.check_installed` asks for
    coal = None
else:
    _IN_PLACE, _ASKED = coal.Transform3s(), coal.DistanceRequest(True)

# Pieces of a surface are divided until their boxes have no longer edge [m].
_PIECE = 0.12

# A winding number beyond is that of a point inside.
_HALF_TURN = 0.5


class Surface:
    """Triangles in the frame F that carries them.

    Attributes:
        frame: number of F.
        vertices: (N, 3) p_FV [m]; faces: (M, 3) indices of them.
        corners: (8, 3) of its bounding box along the axes of F [m].
        centre: (3,) of the box [m]; radius: of the ball about it with all vertices [m].
    """

    def __init__(self, frame: int, vertices: np.ndarray, faces: np.ndarray) -> None:
        """
        Args:
            frame: number of F.
            vertices: (V, 3) p_FV [m]; those that are of no face are left out.
            faces: (M, 3) indices of them.
        """
        used, faces = np.unique(faces, return_inverse=True)
        self.frame, self.vertices, self.faces = frame, vertices[used], faces
        self.faces = faces.reshape(-1, 3)
        box = np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])
        self.corners = np.array(list(itertools.product(*box.T)))
        self.centre = box.mean(axis=0)
        arms = self.vertices - self.centre
        self.radius = float(np.linalg.norm(arms, axis=1).max())

    def hull_distance(self, other: Surface, R: np.ndarray, p: np.ndarray) -> float:
        """How far the convex hulls are apart at least, 0 or less where nothing says
        that they are [m].

        What a plane leaves free between all their corners: Coal seeks the farthest
        corner from one to the next, which may end too early, so that its distance may
        be too large.

        Args:
            other: B, this being A.
            R, p: (3, 3) R_AB and (3,) p_AB, of the frames that carry them [m].
        """
        if self._hull is None or other._hull is None:
            return -np.inf
        (hull, corners), (other_hull, others) = self._hull, other._hull
        found = coal.DistanceResult()
        if not _measured(hull, other_hull, R, p, found) > 0.0:
            return 0.0
        n = found.normal
        return float((others @ (R.T @ n)).min() + n @ p - (corners @ n).max())

    def distance(
        self, other: Surface, R: np.ndarray, p: np.ndarray, enough: float
    ) -> float:
        """How far triangles are apart, 0 where they meet; or enough, if that is less
        [m].

        Args: as of `hull_distance`, and
            enough: [m].
        """
        return max(0.0, self._of_triangles(other, R, p, enough)[0])

    def nearest(
        self, other: Surface, R: np.ndarray, p: np.ndarray, enough: float
    ) -> tuple[float, np.ndarray | None, np.ndarray | None]:
        """The distance of triangles, 0 where they meet, and their nearest points p_AP
        and p_AQ [m]; enough or more, and no points, if that is less.

        Args: as of `distance`.
        """
        d = self.hull_distance(other, R, p)
        if d >= enough:
            return d, None, None
        d, found = self._of_triangles(other, R, p, enough)
        if d >= enough:
            return d, None, None
        return max(0.0, d), found.getNearestPoint1(), found.getNearestPoint2()

    def _of_triangles(
        self, other: Surface, R: np.ndarray, p: np.ndarray, enough: float
    ) -> tuple[float, coal.DistanceResult]:
        """What Coal finds nearer than enough; arguments as of `distance`."""
        found = coal.DistanceResult()
        # Coal looks for nothing that is farther.
        found.min_distance = enough
        return _measured(self._triangles, other._triangles, R, p, found), found

    def one_inside(self, other: Surface, R: np.ndarray, p: np.ndarray) -> bool:
        """Whether a connected part of one is inside the other, if no triangles meet.

        Args: as of `hull_distance`.
        """
        return self._holds(other._one_vertex_each @ R.T + p) or other._holds(
            (self._one_vertex_each - p) @ R
        )

    @cached_property
    def pieces(self) -> list[Surface]:
        """The surface in pieces; their triangles are its own."""
        whole, small = [self.faces], []
        while whole:
            faces = whole.pop()
            middles = self.vertices[faces].mean(axis=1)
            corners = self.vertices[faces].reshape(-1, 3)
            lower, upper = corners.min(axis=0), corners.max(axis=0)
            axis = int((upper - lower).argmax())
            low = middles[:, axis] < 0.5 * (lower + upper)[axis]
            if (upper - lower)[axis] <= _PIECE or low.all() or not low.any():
                small.append(faces)
            else:
                whole += [faces[low], faces[~low]]
        return [Surface(self.frame, self.vertices, faces) for faces in small]

    @cached_property
    def _hull(self) -> tuple[coal.Convex, np.ndarray] | None:
        """With its corners (H, 3) [m]; None if it is flat: its triangles are asked."""
        with suppress(QhullError):
            hull = ConvexHull(self.vertices)
            number = np.empty(len(self.vertices), dtype=int)
            number[hull.vertices] = np.arange(len(hull.vertices))
            points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
            points.extend(list(corners := self.vertices[hull.vertices]))
            triangles = number[hull.simplices].tolist()
            faces.extend([coal.Triangle(*three) for three in triangles])
            return coal.Convex(points, faces), corners
        return None

    @cached_property
    def _triangles(self) -> coal.BVHModelOBBRSS:
        tree = coal.BVHModelOBBRSS()
        tree.beginModel(len(self.faces), len(self.vertices))
        tree.addVertices(self.vertices)
        tree.addTriangles(self.faces)
        tree.endModel()
        return tree

    @cached_property
    def _one_vertex_each(self) -> np.ndarray:
        """(K, 3) a vertex of each of the K connected parts of the surface [m]."""
        a, b, c = self.faces.T
        edges = np.concatenate([a, b]), np.concatenate([b, c])
        size = len(self.vertices)
        graph = coo_array((np.ones(len(edges[0])), edges), shape=(size, size))
        _, part = connected_components(graph, directed=False)
        return self.vertices[np.unique(part, return_index=True)[1]]

    def _holds(self, p_FQ: np.ndarray) -> bool:
        """Whether one of some points is inside, by the surface's winding number.

        Args:
            p_FQ: (P, 3) points that are not on the surface [m].
        """
        lower, upper = self.corners[0], self.corners[-1]
        for p in p_FQ[((p_FQ > lower) & (p_FQ < upper)).all(axis=1)]:
            a, b, c = np.moveaxis(self.vertices[self.faces] - p, 1, 0)
            la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
            # Solid angles: A. van Oosterom and J. Strackee, 1983.
            ab, bc, ca = (np.sum(x * y, axis=1) for x, y in ((a, b), (b, c), (c, a)))
            above = np.sum(a * np.cross(b, c), axis=1)
            angles = np.arctan2(above, la * lb * lc + ab * lc + bc * la + ca * lb)
            if abs(angles.sum()) / (2.0 * np.pi) > _HALF_TURN:
                return True
        return False


def _measured(a, b, R: np.ndarray, p: np.ndarray, found: coal.DistanceResult) -> float:
    """By Coal, of two of its shapes; `found` is filled in."""
    return coal.distance(a, _IN_PLACE, b, coal.Transform3s(R, p), _ASKED, found)
