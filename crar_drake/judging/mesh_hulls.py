"""Convex hulls of the meshes of a robot's links, and how far apart they are."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Convex, GeometryId
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import ConvexHull, QhullError

from crar_drake.judging.mesh_distance import TriangleMesh, distance_apart
from crar_drake.robot_import.link_meshes import LinkMesh

# A flat part's points are moved apart by this, for it to have a hull; all parts' are,
# for the hull to hold the part in spite of rounding [m].
HULL_MARGIN = 1e-5


class Hulls:
    """Signed distances between the links' convex hulls, one for each part of a link.

    Drake knows how deep convex shapes penetrate. Apart, its distances of large hulls
    were seen to be off by up to 11 mm, so that there FCL measures the hulls' faces.
    """

    def __init__(self, links: list[LinkMesh]) -> None:
        # In a plant of their own, of free bodies: their poses are known, and the
        # robot's own collision shapes and filters play no part.
        builder = DiagramBuilder()
        self._plant, self._scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        self._bodies, self._parts = [], []
        for index, link in enumerate(links):
            body = self._plant.AddRigidBody(f"link_{index}")
            self._bodies.append(body)
            self._parts.append(
                [
                    self._hull(body, part.vertices, f"{index}_{number}")
                    for number, part in enumerate(link.parts)
                ]
            )
        self._plant.Finalize()
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = self._plant.GetMyMutableContextFromRoot(self._root)
        self._graph_context = self._scene_graph.GetMyContextFromRoot(self._root)

    def place(self, poses: list[RigidTransform]) -> None:
        """Moves the links there (X_WL)."""
        self._poses = poses
        for body, pose in zip(self._bodies, poses, strict=True):
            self._plant.SetFreeBodyPose(self._context, body, pose)
        port = self._scene_graph.get_query_output_port()
        self._query = port.Eval(self._graph_context)

    def distance(self, i: int, j: int) -> float:
        """Of the links number i and j: the smallest over their parts [m]."""
        X_AB = self._poses[i].InvertAndCompose(self._poses[j])
        return min(
            self._part_distance(a, b, X_AB)
            for a in self._parts[i]
            for b in self._parts[j]
        )

    def _hull(self, body, vertices: np.ndarray, name: str) -> _Hull:
        points = _hull_points(vertices)
        geometry = self._plant.RegisterCollisionGeometry(
            body,
            RigidTransform(),
            Convex(points.T, name),
            name,
            CoulombFriction(0.0, 0.0),
        )
        return _Hull(geometry, _hull_mesh(points))

    def _part_distance(self, a: _Hull, b: _Hull, X_AB: RigidTransform) -> float:
        gap = distance_apart(a.mesh, b.mesh, X_AB)
        if gap > 0.0:
            return gap
        query = self._query.ComputeSignedDistancePairClosestPoints
        return min(0.0, query(a.geometry, b.geometry).distance)


@dataclass(frozen=True)
class _Hull:
    """A part's hull, for Drake and as triangles."""

    geometry: GeometryId
    mesh: TriangleMesh


def _hull_mesh(points: np.ndarray) -> TriangleMesh:
    hull = ConvexHull(points)
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    outward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) > 0
    faces = np.where(outward[:, None], hull.simplices, hull.simplices[:, ::-1])
    return TriangleMesh(points, faces)


def _hull_points(vertices: np.ndarray) -> np.ndarray:
    """(N, 3) points whose hull has a volume and holds the vertices."""
    with suppress(QhullError):  # it is flat, or a needle
        vertices = vertices[ConvexHull(vertices).vertices]
    steps = HULL_MARGIN * np.concatenate([np.eye(3), -np.eye(3)])
    points = (vertices[:, None] + steps).reshape(-1, 3)
    return points[ConvexHull(points).vertices]
