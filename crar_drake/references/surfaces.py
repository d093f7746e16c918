"""Surfaces of triangles that frames of a robot carry, and how far two of them are.

Convex hulls are never farther apart than what they hold. Where a plane parts them by
enough, Coal is not asked for the distance of the triangles.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from crar_drake.law.compilation import compiled
from crar_drake.law.hull_distances import nearest_apart

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

# A plane is kept while it leaves free this share of the way between two points, and
# sought until it leaves that.
_KEPT, _SOUGHT = 0.65, 0.9


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

    def distance(
        self, other: Surface, R: np.ndarray, p: np.ndarray, enough: float
    ) -> float:
        """How far triangles are apart, 0 where they meet; or enough, if that is less
        [m].

        Args:
            other: B, this being A.
            R, p: (3, 3) R_AB and (3,) p_AB, of the frames that carry them [m].
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

        Args: as of `distance`.
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
    def hull(self) -> np.ndarray:
        """(H, 3) corners of the convex hull; all vertices if it is flat [m]."""
        with suppress(QhullError):
            return self.vertices[ConvexHull(self.vertices).vertices]
        return self.vertices

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
        inside_box = p_FQ[((p_FQ > lower) & (p_FQ < upper)).all(axis=1)]
        return _one_is_inside(inside_box, self.vertices, self.faces)


class HullsOfPairs:
    """How far the convex hulls of pairs of surfaces are apart, pose after pose."""

    def __init__(self, pairs: Sequence[tuple[Surface, Surface]]) -> None:
        """
        Args:
            pairs: P of A and B.
        """
        surfaces = list(dict.fromkeys(itertools.chain.from_iterable(pairs)))
        number = {surface: k for k, surface in enumerate(surfaces)}
        self._of = np.array([[number[x] for x in pair] for pair in pairs], dtype=int)
        hulls = [np.zeros((0, 3)), *(surface.hull for surface in surfaces)]
        self._corners = np.concatenate(hulls)
        self._first = np.cumsum([len(hull) for hull in hulls])
        self._planes = np.zeros((len(pairs), 10))
        self._corner = np.zeros(len(pairs), dtype=int)

    def apart(self, pair: np.ndarray, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        """(M,) what planes leave free between all their corners at least, 0 where no
        plane is found [m].

        Args:
            pair: (M,) which pairs; poses of one after the other are best close.
            R, p: (M, 3, 3) R_AB and (M, 3) p_AB, of the frames that carry them [m].
        """
        at = self._corners, self._first, self._of, self._planes, self._corner
        return _hulls_apart(*at, pair, np.ascontiguousarray(R), np.ascontiguousarray(p))


@compiled
def _hulls_apart(corners, first, of, planes, corner, pair, R, p):
    """As `HullsOfPairs.apart`.

    Args:
        corners: (C, 3) of all hulls; first: (S + 1,) where each begins, and all end.
        of: (P, 2) which hulls are a pair.
        planes: (P, 10) of each pair what was found last: the plane's normal from A to
            B, the points nearest to each other in A and B, and how far A goes along the
            normal; corner: (P,) which corner of A goes so far; changed in place.
    """
    found, still = np.empty(len(pair)), np.zeros(3)
    for k in range(len(pair)):
        plane, i, j = planes[pair[k]], of[pair[k], 0], of[pair[k], 1]
        b = corners[first[j] : first[j + 1]]
        x, y, z, way, free = 0.0, 0.0, 0.0, 0.0, np.inf
        for r in range(3):
            x += R[k, r, 0] * plane[r]
            y += R[k, r, 1] * plane[r]
            z += R[k, r, 2] * plane[r]
            apart = p[k, r] - plane[3 + r]
            for c in range(3):
                apart += R[k, r, c] * plane[6 + c]
            way += apart * apart
        near = 0
        for v in range(len(b)):
            along = x * b[v, 0] + y * b[v, 1] + z * b[v, 2]
            if along < free:
                near, free = v, along
        for r in range(3):
            free += plane[r] * p[k, r]
        free -= plane[9]
        if not (free > 0.0 and free >= _KEPT * np.sqrt(way)):
            placed = np.empty_like(b)
            for v in range(len(b)):
                for r in range(3):
                    placed[v, r] = p[k, r]
                    for c in range(3):
                        placed[v, r] += R[k, r, c] * b[v, c]
            a = corners[first[i] : first[i + 1]]
            parted, gap, n, nearest = nearest_apart(
                a, placed, still, corner[pair[k]], near, _SOUGHT
            )
            if parted and gap > free:
                free = gap
                plane[9] = -np.inf
                for r in range(3):
                    plane[r], plane[3 + r], plane[6 + r] = -n[r], nearest[r], 0.0
                    for c in range(3):
                        behind = nearest[c] - gap * n[c] - p[k, c]
                        plane[6 + r] += R[k, c, r] * behind
                for v in range(len(a)):
                    along = -(n[0] * a[v, 0] + n[1] * a[v, 1] + n[2] * a[v, 2])
                    if along > plane[9]:
                        plane[9], corner[pair[k]] = along, v
        found[k] = max(free, 0.0)
    return found


@compiled
def _one_is_inside(points, vertices, faces):
    """Whether the winding number of a surface about one of some points is more than
    half a turn.

    Args:
        points: (P, 3); vertices: (V, 3) [m]; faces: (M, 3) indices of vertices.
    """
    arms, length = np.empty((3, 3)), np.empty(3)
    for q in range(len(points)):
        turns = 0.0
        for f in range(len(faces)):
            for i in range(3):
                for c in range(3):
                    arms[i, c] = vertices[faces[f, i], c] - points[q, c]
                a, b, c = arms[i]
                length[i] = np.sqrt(a * a + b * b + c * c)
            # Solid angles: A. van Oosterom and J. Strackee, 1983.
            a, b, c = arms
            above = a[0] * (b[1] * c[2] - b[2] * c[1])
            above += a[1] * (b[2] * c[0] - b[0] * c[2])
            above += a[2] * (b[0] * c[1] - b[1] * c[0])
            below = length[0] * length[1] * length[2]
            for i in range(3):
                u, v, other = arms[i], arms[(i + 1) % 3], length[(i + 2) % 3]
                below += (u[0] * v[0] + u[1] * v[1] + u[2] * v[2]) * other
            turns += np.arctan2(above, below)
        if abs(turns) / (2.0 * np.pi) > _HALF_TURN:
            return True
    return False


def _measured(a, b, R: np.ndarray, p: np.ndarray, found: coal.DistanceResult) -> float:
    """By Coal, of two of its shapes; `found` is filled in."""
    return coal.distance(a, _IN_PLACE, b, coal.Transform3s(R, p), _ASKED, found)
