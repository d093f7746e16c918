"""Small robots above a half space, for tests."""

from collections.abc import Sequence

from pydrake.geometry import HalfSpace
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from small_robots import add_plant

from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

SPHERE = '<sphere radius="0.06"/>'


def add_ground(plant: MultibodyPlant, X_WG: RigidTransform) -> None:
    """A half space on the world, below the plane z = 0 of a frame G."""
    plant.RegisterCollisionGeometry(
        plant.world_body(), X_WG, HalfSpace(), "ground", CoulombFriction(1.0, 1.0)
    )


def grounded(
    urdf: str,
    X_WG: RigidTransform,
    tasks: Sequence[Task] = (Task(frame="tip"),),
    **description,
) -> ControlModel:
    """The robot, its base welded to the world, and a ground."""
    plant, scene_graph = add_plant(DiagramBuilder(), urdf, finalize=False)
    add_ground(plant, X_WG)
    plant.Finalize()
    return ControlModel.FromPlant(
        plant, scene_graph, RobotDescription(**description), tasks
    )
