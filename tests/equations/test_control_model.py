"""Eqs. (1), (2), (5), (6), (20), (29) on the robot: what the equations are fed with.

Independent of the control model's own batched formulas: finite differences, and
Drake's mass matrix, bias term and gravity one by one.
"""

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.equations.tasks import orientation_error
from crar_drake.robot.description import (
    RobotDescription,
    add_robot,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

H = 1e-6  # step of the finite differences [s]


def tasks_of(description: RobotDescription) -> list[Task]:
    """Tasks of each kind, off the frames' origins."""
    frames = list(description.task_frames)
    return [
        Task(frame=frames[-1], kind="pose", name="pose", point=[0.03, -0.05, 0.1]),
        Task(frame=frames[0], kind="position", name="position", point=[0.1, 0, 0.02]),
        Task(frame=frames[-1], kind="orientation", name="orientation"),
    ]


@pytest.fixture(scope="module", params=["upper_body", "obstacle_arm"])
def description(request) -> RobotDescription:
    return load_robot_description(request.param)


@pytest.fixture(scope="module")
def model(description) -> ControlModel:
    return ControlModel.FromDescription(description, tasks_of(description))


def random_states(model: ControlModel, count: int = 6):
    """Positions within the limits, and velocities."""
    rng = np.random.default_rng(1)
    lower = np.maximum(model.plant.GetPositionLowerLimits(), -1.5)
    upper = np.minimum(model.plant.GetPositionUpperLimits(), 1.5)
    for _ in range(count):
        q = rng.uniform(lower, upper)
        yield q, rng.normal(size=model.plant.num_velocities())


def task_motion(model: ControlModel, before, after, dt: float) -> np.ndarray:
    """(m,) velocity of the tasks from their poses at two instants."""
    v = np.empty(model.m)
    v[model.layout.angular_rows] = orientation_error(before.R, after.R) / dt
    v[model.layout.linear_rows] = (after.p - before.p) / dt
    return v


def test_task_velocities_are_the_derivatives_of_the_poses(model):
    """Eq. (5), with the prescribed joints' share."""
    workspace = model.MakeWorkspace()
    for q, v in random_states(model):
        before, now, after = (
            model.evaluate(workspace, q + k * H * v, v) for k in (-1, 0, 1)
        )
        np.testing.assert_allclose(
            now.v, task_motion(model, before, after, 2 * H), atol=1e-7
        )
        np.testing.assert_allclose(
            now.J @ now.qdot + now.J_p @ now.qdot_p, now.v, atol=1e-12
        )


def test_bias_is_the_acceleration_left_without_joint_acceleration(model):
    """Eq. (6) with q_dd = 0: d/dt v = Jdot qdot."""
    workspace = model.MakeWorkspace()
    for q, v in random_states(model):
        before, now, after = (
            model.evaluate(workspace, q + k * H * v, v) for k in (-1, 0, 1)
        )
        np.testing.assert_allclose(
            now.Jdot_qdot, (after.v - before.v) / (2 * H), atol=1e-6
        )


def test_distance_gradients_are_the_derivatives_of_the_distances(model):
    """Eq. (20), for controlled and prescribed joints, on every watched pair."""
    workspace = model.MakeWorkspace()
    assert len(model.evaluate(workspace, *next(random_states(model))).d) >= 3
    compared = 0
    for q, v in random_states(model):
        before, now, after = (
            model.evaluate(workspace, q + k * H * v, v) for k in (-1, 0, 1)
        )
        rate = (after.d - before.d) / (2 * H)
        expected = now.dd_dq @ now.qdot + now.dd_dq_p @ now.qdot_p
        # A pair of several shapes may change its nearest two within the step.
        smooth = np.abs(after.d - 2 * now.d + before.d) < 1e-10
        compared += smooth.sum()
        np.testing.assert_allclose(rate[smooth], expected[smooth], atol=1e-4)
    assert compared > 0.9 * 6 * len(now.d)


def test_inverse_dynamics_is_the_printed_sum(model):
    """Eqs. (2), (29): H alpha + C qdot + tau_g; the plant is discrete, so its joint
    damping (if any) acts implicitly, on q_dd."""
    plant, workspace = model.plant, model.MakeWorkspace()
    rng = np.random.default_rng(2)
    damping = np.zeros(plant.num_velocities())
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        rows = slice(
            joint.velocity_start(), joint.velocity_start() + joint.num_velocities()
        )
        damping[rows] = joint.default_damping_vector()
    for q, v in random_states(model):
        alpha = rng.normal(size=plant.num_velocities())
        model.evaluate(workspace, q, v)
        tau = model.inverse_dynamics(workspace, alpha)
        context = plant.CreateDefaultContext()
        plant.SetPositionsAndVelocities(context, np.r_[q, v])
        mass = plant.CalcMassMatrixViaInverseDynamics(context)
        bias = plant.CalcBiasTerm(context)
        gravity = -plant.CalcGravityGeneralizedForces(context)
        expected = mass @ alpha + bias + gravity
        expected += damping * (v + plant.time_step() * alpha)
        efforts = plant.MakeActuationMatrix() @ tau
        np.testing.assert_allclose(efforts, expected, atol=1e-9)


def test_a_matching_plant_accelerates_as_commanded(description):
    """Eqs. (1)-(3): q_dd of the same robot, a continuous plant without contact."""
    plant = MultibodyPlant(0.0)
    add_robot(plant, description)
    for index in plant.GetJointActuatorIndices():
        plant.get_joint_actuator(index).set_effort_limit(np.inf)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    model = ControlModel.FromDescription(
        description, tasks_of(description), time_step=0.0
    )
    workspace = model.MakeWorkspace()
    rng = np.random.default_rng(3)
    for q, v in random_states(model):
        alpha = rng.normal(size=plant.num_velocities())
        model.evaluate(workspace, q, v)
        tau = model.inverse_dynamics(workspace, alpha)
        plant.SetPositionsAndVelocities(context, np.r_[q, v])
        plant.get_actuation_input_port().FixValue(context, tau)
        derivatives = plant.EvalTimeDerivatives(context).CopyToVector()
        np.testing.assert_allclose(
            derivatives[plant.num_positions() :], alpha, atol=1e-8
        )
