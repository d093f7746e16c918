"""Convex hulls: what a box, a convex shape or a mesh of SceneGraph's is taken for."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from pydrake.geometry import Box, Convex, Cylinder, Ellipsoid, Mesh, Shape
from scipy.spatial import ConvexHull, QhullError

from crar_drake.errors import ModelError
from crar_drake.law.hull_distances import Hulls

# Of the prism about a cylinder: 2 % of the radius are lost.
_SIDES = 16
# Directions that differ by less count as one [rad].
_PARALLEL = 1e-9


@dataclass(frozen=True)
class Hull:
    """The convex hull of V corners."""

    corners: np.ndarray  # (V, 3) in the frame that they are given in [m]
    faces: np.ndarray  # (F, 3) three corners of each face, one of parallel faces
    edges: np.ndarray  # (E, 2) both ends of each edge, one of parallel edges


def shape_corners(shape: Shape) -> np.ndarray | None:
    """(V, 3) points in the geometry frame of which a shape is the hull [m].

    SceneGraph takes a mesh for its hull, too, where distances are asked. What is round
    is within the hull: a cylinder within a prism, an ellipsoid within a polyhedron.

    Returns:
        None of a shape that is none: of spheres, capsules and others.

    Raises:
        ModelError: the file of a mesh cannot be read.
    """
    if isinstance(shape, Box):
        half = 0.5 * shape.size()
        return np.array([half * signs for signs in product((-1.0, 1.0), repeat=3)])
    if isinstance(shape, Cylinder):
        angles = 2.0 * np.pi / _SIDES * np.arange(_SIDES)
        ring = shape.radius() / np.cos(np.pi / _SIDES) * np.exp(1j * angles)
        half = np.full(_SIDES, 0.5 * shape.length())
        ends = [np.column_stack((ring.real, ring.imag, z)) for z in (-half, half)]
        return np.concatenate(ends)
    if isinstance(shape, Ellipsoid):
        return np.array([shape.a(), shape.b(), shape.c()]) * _around_ball()
    if not isinstance(shape, Convex | Mesh):
        return None
    try:
        hull = shape.GetConvexHull()
    except RuntimeError as error:
        raise ModelError(f"its hull cannot be found: {error}") from error
    return np.array([hull.vertex(i) for i in range(hull.num_vertices())])


def is_round(shape: Shape) -> bool:
    """Whether the hull of `shape_corners` is larger than the shape."""
    return isinstance(shape, Cylinder | Ellipsoid)


@cache
def _around_ball() -> np.ndarray:
    """(42, 3) corners of a polyhedron about the unit ball: those of an icosahedron, and
    the middles of its edges."""
    golden = 0.5 + 0.5 * 5.0**0.5
    corners = [
        np.roll([0.0, one, two * golden], k)
        for k in range(3)
        for one in (-1.0, 1.0)
        for two in (-1.0, 1.0)
    ]
    middles = [
        0.5 * (a + b)
        for i, a in enumerate(corners)
        for b in corners[:i]
        if np.linalg.norm(a - b) < 2.0 + 1e-9
    ]
    points = np.array(corners + middles)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    offsets = -ConvexHull(points).equations[:, 3]  # of the faces, from the middle
    return points / offsets.min()


def hull_of(points: np.ndarray) -> Hull:
    """The hull of points (N, 3) [m].

    Raises:
        ModelError: they have no hull with a volume.
    """
    try:
        found = ConvexHull(points)
    except (QhullError, ValueError) as error:
        raise ModelError(
            "it is flat, or has fewer than four points; give it a thickness"
        ) from error
    number = np.full(len(points), -1)
    number[found.vertices] = np.arange(len(found.vertices))
    triangles, normals = number[found.simplices], found.equations[:, :3]
    faces = triangles[_one_of_parallels(normals)]
    edges = []
    for i, neighbors in enumerate(found.neighbors):
        for k, j in enumerate(neighbors):
            # The triangle's side opposite to its corner k; between parts of one face
            # there is none.
            if i < j and np.linalg.norm(np.cross(normals[i], normals[j])) > _PARALLEL:
                edges.append(np.delete(triangles[i], k))
    edges = np.array(edges, dtype=int).reshape(-1, 2)
    corners = np.ascontiguousarray(points[found.vertices], dtype=float)
    along = corners[edges[:, 1]] - corners[edges[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return Hull(corners, faces, edges[_one_of_parallels(along)])


def _one_of_parallels(directions: np.ndarray) -> list[int]:
    """Which of unit vectors (N, 3) are left if each line is to be there once."""
    kept: list[int] = []
    for i, direction in enumerate(directions):
        if kept:
            across = np.cross(directions[kept], direction)
            if (np.linalg.norm(across, axis=1) <= _PARALLEL).any():
                continue
        kept.append(i)
    return kept


def numbers_of_hulls(hulls: Sequence[Hull], after: Sequence[int]) -> Hulls:
    """Hulls for the equations; `after` says of each how far after its middle its first
    corner stands, among all points."""

    def starts(lists: Sequence[np.ndarray]) -> np.ndarray:
        return np.cumsum([0, *map(len, lists)])

    faces, edges = [hull.faces for hull in hulls], [hull.edges for hull in hulls]
    return Hulls(
        np.array(after, dtype=int),
        np.array([len(hull.corners) for hull in hulls], dtype=int),
        np.concatenate([np.zeros((0, 3), dtype=int), *faces]),
        np.concatenate([np.zeros((0, 2), dtype=int), *edges]),
        starts(faces),
        starts(edges),
    )
