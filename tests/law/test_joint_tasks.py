"""Tasks of kind joint: their rows, and that the damping does not bias them."""

import numpy as np
import pytest
from small_robots import chain_urdf, make_model, random_state

from crar_drake.errors import ModelError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import PaperParameters
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task, joint_tasks

TASKS = [
    Task(frame="tip", kind="pose", position_weight=3.0),
    *joint_tasks(["j2", "j0"], 0.5),
    Task(frame="l1", position_weight=2.0),
    *joint_tasks(["j1", "j3"]),
]


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return make_model(chain_urdf("zxyz"), TASKS)


def consistent(model: ControlModel, seed: int):
    """A state, joint accelerations, and the targets that all tasks have of them."""
    q, v = random_state(model, seed)
    a = np.random.default_rng(seed).normal(size=model.n)
    state = model.evaluate(model.MakeWorkspace(), q, v)
    targets = model.layout.pack(
        state.R,
        state.p,
        state.v,
        state.J @ a + state.Jdot_qdot,
        q[model.layout.rows.joints],
    )
    return q, v, a, targets


def test_the_rows_of_other_tasks_are_those_without_joints(model):
    """Of the tasks before and after them."""
    q, v = random_state(model, 4)
    others = make_model(chain_urdf("zxyz"), [x for x in TASKS if x.kind != "joint"])
    state, alone = (m.evaluate(m.MakeWorkspace(), q, v) for m in (model, others))
    rows = np.setdiff1d(np.arange(model.m), model.layout.joint_rows)
    np.testing.assert_array_equal(state.J[rows], alone.J)
    np.testing.assert_array_equal(state.Jdot_qdot[rows], alone.Jdot_qdot)
    assert (np.abs(alone.J).max(axis=1) > 0.1).sum() > 7


@pytest.mark.parametrize("constraints", ["none", "paper"])
def test_consistent_targets_are_followed_without_bias(model, constraints):
    """The acceleration is the targets' own although the inverse is damped."""
    gains = PaperParameters(constraints=constraints, damping=0.5, blend_time=0.0)
    for seed in range(5):
        q, v, a, targets = consistent(model, seed)
        found = ControlLaw(model, gains).step(q, v, targets)
        np.testing.assert_allclose(found.acceleration, a, atol=1e-7)
        np.testing.assert_allclose(found.constrained_velocity, v, atol=1e-8)
        np.testing.assert_allclose(found.task_error, 0.0, atol=1e-12)


def test_other_targets_give_the_least_squares_about_the_preference(model):
    """Against NumPy's least squares of |S (J x - b)|^2 + lambda^2 |x - x_0|^2."""
    damping, rng = 0.3, np.random.default_rng(4)
    gains = PaperParameters(constraints="none", damping=damping, blend_time=0.0)
    q, v, _, targets = consistent(model, 7)
    layout = model.layout
    targets[layout.size_x + layout.m :] += rng.normal(size=layout.m)
    targets[layout.joint_entries] += 0.1 * rng.normal(size=4)
    state = model.evaluate(model.MakeWorkspace(), q, v)
    desired = layout.unpack(targets)
    e = np.zeros(layout.m)
    e[layout.joint_rows] = desired.q - q[layout.rows.joints]
    K, Kp, S = gains.K, gains.Kp, model.row_weights
    levels = []
    for b in (desired.v + K * e, desired.a + Kp * e - state.Jdot_qdot):
        x_0 = np.zeros(4)
        x_0[layout.rows.joints] = b[layout.joint_rows]
        A = np.vstack([S[:, None] * state.J, damping * np.eye(4)])
        levels.append(np.linalg.lstsq(A, np.r_[S * b, damping * x_0], rcond=None)[0])
    qdot_c, alpha = levels
    found = ControlLaw(model, gains).step(q, v, targets)
    np.testing.assert_allclose(found.task_error, e, atol=1e-12)
    np.testing.assert_allclose(found.constrained_velocity, qdot_c, atol=1e-9)
    np.testing.assert_allclose(
        found.acceleration, alpha + gains.Gv * (qdot_c - v), atol=1e-8
    )


def test_they_are_blended_in_from_where_the_joint_is(model):
    q, v, _, targets = consistent(model, 3)
    targets[model.layout.joint_entries] += 0.5
    law = ControlLaw(model, PaperParameters(constraints="none"))
    first = law.step(q, 0.0 * v, targets)
    # At rest and at the start of the blending nothing is asked of a joint.
    rows = model.layout.joint_rows
    assert np.abs(first.task_error[rows] - 0.5).max() < 1e-12
    assert np.abs(first.constrained_velocity).max() < 1e-9


def test_wrong_joints_are_named():
    urdf = chain_urdf("zz")
    for task, text in (
        (Task(kind="joint", joint="j7"), "'j7' is no controlled joint"),
        (Task(kind="joint", frame="tip"), "joint: give the name of the joint"),
        (Task(kind="joint"), "give the name of the joint"),
        (Task(frame="tip", joint="j0"), "only for kind joint"),
    ):
        with pytest.raises(ModelError, match=text):
            make_model(urdf, [task])
