"""The outermost points of a robot's links: what could touch the ground."""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Capsule, Role, SceneGraph, Sphere
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, RigidBody

from crar_drake.robot.collision_pairs import standing_points
from crar_drake.robot_import.capsule_fitting import hull_vertices
from crar_drake.robot_import.link_meshes import LinkMesh, has_meshes, read_link_meshes
from crar_drake.robot_import.meshes import vertices_of


@dataclass(frozen=True, eq=False)
class LinkOutline:
    """A link as balls: the vertices of its hull, or the ends of its capsules."""

    points: np.ndarray  # (V, 3) p_BV, in the link's frame [m]
    radii: np.ndarray  # (V,) around them; 0 of vertices [m]


def link_outlines(
    plant: MultibodyPlant, scene_graph: SceneGraph, meshes: list[LinkMesh] | None = None
) -> dict[str, LinkOutline]:
    """Link to its outline, of those that have a shape: of a finalized plant whose links
    have meshes (of `read_link_meshes`, if read already), or capsules and spheres."""
    if has_meshes(plant, scene_graph):
        outlines = {}
        if meshes is None:
            meshes = read_link_meshes(plant, scene_graph)
        for link in meshes:
            hull = hull_vertices(vertices_of(link.parts))
            outlines[link.name] = LinkOutline(hull, np.zeros(len(hull)))
    else:
        outlines = capsule_outlines(plant, scene_graph)
    outlines.pop("world", None)
    return outlines


def links_outward(plant: MultibodyPlant, frame: Frame) -> tuple[str, ...]:
    """Names of the link that a frame is on, and of all that hang on it."""
    first: RigidBody = frame.body()
    found, queue = [], [first]
    while queue:
        body = queue.pop()
        found.append(body.name())
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            if joint.parent_body().index() == body.index():
                queue.append(joint.child_body())
    return tuple(found)


def capsule_outlines(
    plant: MultibodyPlant, scene_graph: SceneGraph
) -> dict[str, LinkOutline]:
    """Link to the outline of its capsules and spheres, of those that have any."""
    inspector, outlines = scene_graph.model_inspector(), {}
    for index in range(plant.num_bodies()):
        body = plant.get_body(BodyIndex(index))
        points, radii = [], []
        frame = plant.GetBodyFrameIdOrThrow(body.index())
        for geometry in inspector.GetGeometries(frame, Role.kProximity):
            shape = inspector.GetShape(geometry)
            if isinstance(shape, Sphere | Capsule):
                X_BG = inspector.GetPoseInFrame(geometry)
                for p_G, radius in standing_points(shape):
                    points.append(X_BG.multiply(p_G))
                    radii.append(radius)
        if points:
            outlines[body.name()] = LinkOutline(np.array(points), np.array(radii))
    return outlines
