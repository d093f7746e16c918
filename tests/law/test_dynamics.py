"""Torques and inertia of a robot, against Drake's own."""

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    LinearSpringDamper,
    MultibodyForces,
    PrismaticSpring,
    RevoluteSpring,
)
from pydrake.systems.framework import DiagramBuilder
from small_robots import add_plant, chain_urdf

from crar_drake.errors import ModelError
from crar_drake.law.dynamics import inertia_matrix, joint_torques
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.dynamics import find_dynamics
from crar_drake.robot.kinematics import JointTree
from crar_drake.robot.model import ControlModel

URDF = chain_urdf("zyxz", rail="y", damping=0.7, gear_ratio=30.0)


def chain(time_step: float, springs: bool = False) -> ControlModel:
    """A slide, rotors, damping; and where asked for springs."""
    plant, scene_graph = add_plant(
        DiagramBuilder(), URDF, time_step=time_step, finalize=False
    )
    if springs:
        plant.AddForceElement(RevoluteSpring(plant.GetJointByName("j1"), 0.3, 5.0))
        plant.AddForceElement(PrismaticSpring(plant.GetJointByName("rail"), 0.1, 40.0))
    plant.Finalize()
    return ControlModel.FromPlant(plant, scene_graph, RobotDescription(), [])


def shipped(name: str) -> ControlModel:
    return ControlModel.FromDescription(load_robot_description(name), [])


ROBOTS = {
    "upper_body": lambda: shipped("upper_body"),
    "obstacle_arm": lambda: shipped("obstacle_arm"),
    "discrete": lambda: chain(2e-3),
    "continuous": lambda: chain(0.0),
    "springs": lambda: chain(1e-3, springs=True),
}


def of_drake(plant: MultibodyPlant, q, v, vdot) -> tuple[np.ndarray, np.ndarray]:
    """(nv,) torques and (nv, nv) inertia; damping counts at the end of a step."""
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, np.concatenate((q, v)))
    forces = MultibodyForces(plant)
    plant.CalcForceElementsContribution(context, forces)
    late = np.zeros(len(v))
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        if joint.num_velocities():
            (damping,) = joint.default_damping_vector()
            late[joint.velocity_start()] = plant.time_step() * damping
    tau = plant.CalcInverseDynamics(context, vdot, forces) + late * vdot
    return tau, plant.CalcMassMatrix(context) + np.diag(late)


@pytest.mark.parametrize("robot", ROBOTS)
def test_torques_and_inertia_are_drakes(robot):
    """To 1e-12 of the largest entry, at states and accelerations of any size."""
    model = ROBOTS[robot]()
    rng, nv = np.random.default_rng(1), model.plant.num_velocities()
    dynamics = model.dynamics.value
    for _ in range(50):
        q, v, vdot = rng.uniform(-3.0, 3.0, nv), *rng.normal(size=(2, nv))
        v, vdot = rng.choice([0.0, 1.0, 20.0]) * v, rng.choice([0.0, 1.0, 1e3]) * vdot
        tau, H = of_drake(model.plant, q, v, vdot)
        for found, expected in (
            (joint_torques(q, v, vdot, dynamics), tau),
            (inertia_matrix(q, dynamics), H),
        ):
            assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_they_are_those_that_the_model_commands():
    model, rng = chain(5e-3), np.random.default_rng(2)
    workspace, nv = model.MakeWorkspace(), model.plant.num_velocities()
    q, v, vdot = rng.normal(size=(3, nv))
    model.evaluate(workspace, q, v)
    tau = model.inverse_dynamics(workspace, vdot)
    found = model.effort_of_joints @ joint_torques(q, v, vdot, model.dynamics.value)
    np.testing.assert_allclose(found, tau, rtol=1e-12)


def test_a_force_that_is_not_known_is_refused():
    plant, _ = add_plant(DiagramBuilder(), URDF, finalize=False)
    ends = plant.world_body(), plant.GetBodyByName("l3")
    plant.AddForceElement(
        LinearSpringDamper(ends[0], [0, 0, 1], ends[1], [0, 0, 0], 0.5, 9.0, 0.1)
    )
    plant.Finalize()
    with pytest.raises(ModelError, match="effort limits: .* LinearSpringDamper"):
        find_dynamics(plant, JointTree(plant), np.zeros(plant.num_velocities()))
