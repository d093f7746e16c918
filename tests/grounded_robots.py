"""Small robots above a half space, for tests."""

from collections.abc import Sequence

from pydrake.geometry import HalfSpace
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from small_robots import CAPSULE, add_plant, chain_urdf

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


def above_ground() -> ControlModel:
    """A prescribed rail carries capsules and spheres, above and into a slope."""
    return grounded(
        chain_urdf("zyzyz", rail="y", limits=(-1.2, 1.3), shapes=(CAPSULE, SPHERE)),
        RigidTransform(RollPitchYaw(0.2, -0.3, 0.0), [0.0, 0.0, -0.25]),
        [Task(frame="tip", kind="pose", orientation_weight=0.4)],
        prescribed_joints={"rail": "hold"},
        pairs=[["l2", "ground"], ["ground", "l4"], ["l4", "l0"]],
    )
