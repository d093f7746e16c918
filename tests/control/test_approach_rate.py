"""Pairs and limits as bounds of how fast they are approached (`approach_rate`)."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from crar_drake import ControlModel, load_robot_description, position_tasks
from crar_drake.control.law import ControlLaw
from crar_drake.control.lookahead_parameters import LookaheadParameters
from crar_drake.control.modes import validate
from crar_drake.control.parameters import CrarParameters
from crar_drake.errors import ScenarioError

PERIOD, HORIZON, KAPPA, NU, DAMPING = 1e-3, 0.04, 50.0, 0.2, 0.02
GUARD = LookaheadParameters(
    preview=0.0,
    horizon=HORIZON,
    approach_rate=KAPPA,
    guard_norm="tasks",
    guard_damping=NU,
    slip_time_constant=1e3,  # no slip: the state is not always what was commanded
)
BOUNDED = CrarParameters(
    lookahead=GUARD,
    period=PERIOD,
    blend_time=0.0,
    damping=DAMPING,
    respect_effort_limits=False,
)
TASKS = ["left_elbow", "right_elbow", "left_wrist", "right_wrist"]


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return ControlModel.FromDescription(
        load_robot_description("upper_body"), position_tasks(TASKS)
    )


def towards(model: ControlModel, p: np.ndarray) -> np.ndarray:
    return model.layout.pack(np.empty((0, 3, 3)), p)


def jacobian(model: ControlModel, q: np.ndarray) -> np.ndarray:
    """By Drake, of the tasks by the controlled joints."""
    plant, world = model.plant, model.plant.world_frame()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    return np.vstack(
        [
            plant.CalcJacobianTranslationalVelocity(
                context,
                JacobianWrtVariable.kV,
                plant.GetFrameByName(model.description.task_frames[task]),
                np.zeros(3),
                world,
                world,
            )[:, model.controlled]
            for task in TASKS
        ]
    )


def nearest(model: ControlModel, q, v, s_0, d_min=5e-3, margin=0.02) -> np.ndarray:
    """s by Drake's Clarabel: the bounds hard, the distances by finite differences."""
    n, workspace = model.n, model.MakeWorkspace()
    q_s = q + HORIZON * v

    def distances(x):
        return model.evaluate_distances(workspace, x).d

    def gradients(x):
        lines = []
        for joint in np.flatnonzero(model.controlled_positions):
            step = np.zeros(len(x))
            step[joint] = 1e-6
            lines.append((distances(x + step) - distances(x - step)) / 2e-6)
        return np.array(lines).T

    at_q, at_s = gradients(q), gradients(q_s)
    of_v = v[model.controlled]

    def speeds(h, margin, fastest):
        rate = np.where(h > margin, KAPPA, GUARD.retreat_rate)
        return np.minimum(rate * (margin - h), fastest)

    rows = [
        (distances(q_s), at_s, 0.0),
        (distances(q) + HORIZON * at_q @ of_v, at_q, (at_s - at_q) @ of_v),
    ]
    program = MathematicalProgram()
    x = program.NewContinuousVariables(n)
    J = jacobian(model, q)
    N = J.T @ J + NU**2 * np.eye(n)
    program.AddQuadraticCost(2.0 * N, -2.0 * N @ s_0, x)
    for h, g, drift in rows:
        least = speeds(h, d_min, GUARD.retreat_speed) - drift
        program.AddLinearConstraint(g, least, np.full(len(h), np.inf), x)
    joints, fastest = q_s[model.controlled_positions], GUARD.joint_retreat_speed
    program.AddBoundingBoxConstraint(
        speeds(joints - model.lower, margin, fastest),
        -speeds(model.upper - joints, margin, fastest),
        x,
    )
    result = ClarabelSolver().Solve(program)
    assert result.is_success()
    return result.GetSolution(x)


def wish(model: ControlModel, q, v, p_d, parameters: CrarParameters) -> np.ndarray:
    """s_0 by Eqs. (13), (14), (15), (30), (34), (35) at m >= n, with W = I."""
    plant, context = model.plant, model.plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    world, of_v = plant.world_frame(), v[model.controlled]
    J, frames = jacobian(model, q), model.description.task_frames
    e, bias = [], []
    for task, p in zip(TASKS, p_d, strict=True):
        frame = plant.GetFrameByName(frames[task])
        e.append(p - frame.CalcPose(context, world).translation())
        of = (context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world)
        bias.append(plant.CalcBiasTranslationalAcceleration(*of).ravel())
    e, bias = np.concatenate(e), np.concatenate(bias)
    Kp, Gv = parameters.Kp, parameters.Gv
    a_r = Kp * e - 2.0 * np.sqrt(Kp) * (J @ of_v) - bias
    J_star = np.linalg.solve(J.T @ J + DAMPING**2 * np.eye(model.n), J.T)
    z = Gv * (J_star @ (parameters.K * e) - of_v)
    s_0 = of_v + HORIZON * (J_star @ a_r + z)
    fastest = parameters.lookahead.filled(PERIOD, plans=False).nominal_speed_limit
    return s_0 / max(1.0, np.abs(s_0).max() / fastest)


def test_a_step_is_the_nearest_that_keeps_all_bounds(model):
    """Against a quadratic program of Drake's Jacobians and differences of distances."""
    rng = np.random.default_rng(3)
    law = ControlLaw(model, BOUNDED)
    rest = model.rest_positions()
    still = model.prescribed_at(rest)
    judged = 0
    while judged < 12:
        q = rest.copy()
        q[model.controlled_positions] = rng.uniform(
            np.maximum(model.lower, -1.0), np.minimum(model.upper, 1.0)
        )
        v = np.zeros(model.plant.num_velocities())
        v[model.controlled] = rng.uniform(-1.0, 1.0, model.n)
        p_d = model.layout.unpack(model.tasks_at(q)).p + rng.uniform(-0.2, 0.2, (4, 3))
        law.reset()
        solution = law.step(q, v, towards(model, p_d), still)
        if solution.admission[0] != 0.0 or not solution.admission[3]:
            continue
        s = v[model.controlled] + HORIZON * solution.acceleration[model.controlled]
        s_0 = wish(model, q, v, p_d, BOUNDED)
        if np.abs(s - s_0).max() < 0.1:
            continue
        np.testing.assert_allclose(s, nearest(model, q, v, s_0), atol=2e-3)
        judged += 1


def test_a_margin_shrinks_at_most_at_the_approach_rate(model):
    """Hands are sent through each other: step by step where the robot would come to
    rest is nearer by no more than the rate's share of what was left."""
    law, workspace = ControlLaw(model, BOUNDED), model.MakeWorkspace()
    q = model.rest_positions()
    still, v = model.prescribed_at(q), np.zeros(model.plant.num_velocities())
    p_d = model.layout.unpack(model.tasks_at(q)).p[[1, 0, 3, 2]]  # left and right
    left = []
    for _ in range(600):
        solution = law.step(q, v, towards(model, p_d), still)
        command = solution.position_command
        q, v = command[: len(q)], command[len(q) :]
        d = model.evaluate_distances(workspace, q + HORIZON * v).d
        left.append(d.min() - GUARD.distance_margin)
    left = np.array(left)
    assert left.min() > -1e-4
    assert left[-1] < 1e-3  # it went there
    # To the first order of a period: rows are linear where they are made.
    assert (left[1:] >= (1.0 - KAPPA * PERIOD) * left[:-1] - 1e-4).all()
    assert (left[1:] < (1.0 - 0.5 * KAPPA * PERIOD) * left[:-1]).any()  # and it bound


def test_nothing_weighs_before_the_guard(model):
    """q_dot_c is that of no constraints, beside a contact as well."""
    rng = np.random.default_rng(8)
    q = model.rest_positions()
    still, v = model.prescribed_at(q), np.zeros(model.plant.num_velocities())
    p_d = model.layout.unpack(model.tasks_at(q)).p + rng.uniform(-0.3, 0.3, (4, 3))
    free = replace(BOUNDED, constraints="none")
    bounded, alone = (
        ControlLaw(model, parameters).step(q, v, towards(model, p_d), still)
        for parameters in (BOUNDED, free)
    )
    np.testing.assert_allclose(
        bounded.constrained_velocity, alone.constrained_velocity, atol=1e-12
    )
    np.testing.assert_array_equal(bounded.constraint_weights, np.ones(model.n))


def test_a_rate_too_high_for_the_period_is_refused():
    for rate, refused in ((50.0, False), (51.0, True)):
        parameters = replace(
            BOUNDED, period=0.02, lookahead=replace(GUARD, approach_rate=rate)
        )
        if refused:
            with pytest.raises(ScenarioError, match=r"approach_rate.*at most 50/s"):
                validate(parameters)
        else:
            validate(parameters)
