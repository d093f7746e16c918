"""The kinematics of the joints' tree, against Drake's own; joints of every kind."""

import numpy as np
import pytest
from moving_shapes import every_joint
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    BodyIndex,
    JacobianWrtVariable,
    RpyFloatingJoint,
    SpatialInertia,
)

from crar_drake.errors import ModelError
from crar_drake.law.kinematics import (
    joint_motion,
    link_poses,
    place_points,
)
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.kinematics import JointTree
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task


def plant_of(robot: str) -> MultibodyPlant:
    if robot == "every joint":
        return every_joint()[0]
    description = load_robot_description(robot)
    frame = next(iter(description.task_frames))
    return ControlModel.FromDescription(description, [Task(frame=frame)]).plant


@pytest.fixture(scope="module", params=["upper_body", "obstacle_arm", "every joint"])
def plant(request) -> MultibodyPlant:
    return plant_of(request.param)


def configurations(plant: MultibodyPlant) -> np.ndarray:
    """Anywhere, over several turns."""
    return np.random.default_rng(0).uniform(-5.0, 5.0, (20, plant.num_positions()))


def test_link_poses_are_drakes(plant: MultibodyPlant) -> None:
    joints, context = JointTree(plant), plant.CreateDefaultContext()
    configured = configurations(plant)
    X = link_poses(configured, joints.tree, joints.tree.every)
    X = X.reshape(len(configured), -1, 4, 3)
    for q, X_WL in zip(configured, X, strict=True):
        plant.SetPositions(context, q)
        for i in range(plant.num_bodies()):
            body = plant.get_body(BodyIndex(i))
            frame, X_LB = joints.place(body)
            expected = plant.EvalBodyPoseInWorld(context, body).GetAsMatrix34()
            R, p = X_WL[frame, :3].T, X_WL[frame, 3]
            found = np.hstack([R, p[:, None]]) @ X_LB.GetAsMatrix4()
            np.testing.assert_allclose(found, expected, atol=1e-12)


def test_joint_motion_is_drakes_jacobian_about_the_worlds_origin(
    plant: MultibodyPlant,
) -> None:
    joints, context = JointTree(plant), plant.CreateDefaultContext()
    W, placed = plant.world_frame(), joints.axes(np.arange(plant.num_velocities()))
    configured = configurations(plant)
    X = link_poses(configured, joints.tree, joints.tree.every)
    points = place_points(X, *joints.select(placed))
    for q, S in zip(configured, joint_motion(points), strict=True):
        plant.SetPositions(context, q)
        for i in range(1, plant.num_bodies()):
            body = plant.get_body(BodyIndex(i))
            p_B = plant.EvalBodyPoseInWorld(context, body).inverse().translation()
            expected = plant.CalcJacobianSpatialVelocity(
                context, JacobianWrtVariable.kV, body.body_frame(), p_B, W, W
            )
            carried = joints.moved_by[joints.place(body)[0]]
            np.testing.assert_allclose(S * carried, expected, atol=1e-11)


def test_every_kind_of_joint_is_among_the_cases() -> None:
    plant, _ = every_joint()
    kinds = {plant.get_joint(i).type_name() for i in plant.GetJointIndices()}
    assert {"planar", "universal", "screw", "prismatic", "revolute", "weld"} <= kinds
    joints = JointTree(plant)
    both = joints.turns.any(axis=1) & joints.slides.any(axis=1)
    assert both.sum() == 1  # the screw


@pytest.mark.parametrize("kind", ["ball", "rpy floating"])
def test_joints_whose_velocities_are_no_rates_are_refused(kind: str) -> None:
    plant = MultibodyPlant(1e-3)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    body = plant.AddRigidBody("ball", inertia)
    frames = plant.world_frame(), body.body_frame()
    if kind == "ball":
        plant.AddJoint(BallRpyJoint("socket", *frames))
    else:
        plant.AddJoint(RpyFloatingJoint("socket", *frames))
    plant.Finalize()
    with pytest.raises(ModelError, match="socket.*not the rates of its positions"):
        JointTree(plant)
