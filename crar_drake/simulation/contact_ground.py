"""A floor that a robot stands on by its soles, in Drake's contact simulation."""

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    CollisionFilterDeclaration,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from crar_drake.robot.description import RobotDescription, find_body

# The ball that is at each corner of a sole, its lowest point there.
_RADIUS = 0.005  # [m]
# Of hydroelastic balls [Pa], and of points [N/m]: a foot on soft corners would tip.
_MODULUS = 1e8
_STIFFNESS = 5e5
_DISSIPATION = 1.0  # Hunt and Crossley's, of points and hydroelastic pressure [s/m]


def add_contact_ground(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    description: RobotDescription,
    friction: float,
    height: float,
    model_instance: ModelInstanceIndex | None = None,
) -> None:
    """Adds a half space, and balls at the corners of the soles that touch it.

    Links touch the floor, too, should the robot fall, but not each other; the links
    with soles touch it by the balls alone.

    Args:
        plant: not finalized, with the robot as `AddRobot` left it.
        scene_graph: of the plant.
        description: of the robot, without a ground.
        friction: Coulomb's coefficient.
        height: of the floor in the world [m].
        model_instance: the robot, if other things are in the plant: these touch the
            floor and the robot.
    """
    balls = []
    for link, corners in description.soles.items():
        body = find_body(plant, link)
        up = _upwards(np.array(corners), body.default_com())
        for i, corner in enumerate(corners):
            properties = _material(friction)
            AddCompliantHydroelasticProperties(_RADIUS, _MODULUS, properties)
            balls.append(
                plant.RegisterCollisionGeometry(
                    body,
                    RigidTransform(np.array(corner) + _RADIUS * up),
                    Sphere(_RADIUS),
                    f"{link}_corner_{i}",
                    properties,
                )
            )
    properties = _material(friction)
    AddRigidHydroelasticProperties(properties)
    floor = plant.RegisterCollisionGeometry(
        plant.world_body(),
        RigidTransform([0.0, 0.0, height]),
        HalfSpace(),
        "floor",
        properties,
    )
    # Asked for now: what a plant hands out lives until it gets another shape.
    of_links = {
        plant.get_body(index).name(): plant.GetCollisionGeometriesForBody(
            plant.get_body(index)
        )
        for instance in map(ModelInstanceIndex, range(plant.num_model_instances()))
        for index in plant.GetBodyIndices(instance)
        if index != plant.world_body().index() and model_instance in (None, instance)
    }
    no_floor = [
        shape
        for link in description.soles
        for shape in of_links[find_body(plant, link).name()]
        if shape not in balls
    ]
    filters = CollisionFilterDeclaration()
    filters.ExcludeWithin(
        GeometrySet([g for shapes in of_links.values() for g in shapes])
    )
    filters.ExcludeBetween(GeometrySet(no_floor), GeometrySet([floor]))
    scene_graph.collision_filter_manager().Apply(filters)


def _material(friction: float) -> ProximityProperties:
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=_DISSIPATION,
        point_stiffness=_STIFFNESS,
        friction=CoulombFriction(friction, friction),
        properties=properties,
    )
    return properties


def _upwards(corners: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """(3,) unit normal of a sole, to the side where the link's mass is."""
    across = np.linalg.svd(corners - corners.mean(axis=0))[2][2]
    return across * np.sign(across @ (middle - corners.mean(axis=0)))
