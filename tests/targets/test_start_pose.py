"""The start pose is valid whatever the targets are, and near them if it can be."""

import numpy as np
import pytest
from small_robots import chain_urdf, make_model

from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.targets.start_pose import solve_start_pose

MARGIN = 0.02 - 1e-9  # [m] and [rad]


def check_valid(model: ControlModel, q) -> None:
    """Distances and limits with their margins, or no less than the rest pose has."""
    rest = model.rest_positions()
    workspace, zero = model.MakeWorkspace(), np.zeros_like(q)
    before = model.evaluate(workspace, rest, zero)
    after = model.evaluate(workspace, q, zero)
    assert (after.d >= np.minimum(before.d, MARGIN) - 1e-12).all()
    at_rest = rest[model.controlled]
    lower = np.minimum(model.lower + MARGIN, at_rest)
    upper = np.maximum(model.upper - MARGIN, at_rest)
    assert (after.q >= lower).all() and (after.q <= upper).all()


def error(model: ControlModel, q, target) -> np.ndarray:
    state = model.evaluate(model.MakeWorkspace(), q, np.zeros_like(q))
    return state.p - model.layout.unpack(target).p


@pytest.fixture(scope="module")
def chain() -> ControlModel:
    return make_model(
        chain_urdf("zyzy", limits=(-1.8, 1.8)),
        pairs=[["l1", "post"], ["l2", "post"], ["l3", "post"], ["l0", "l3"]],
        rest_posture={"j0": -0.8, "j1": 0.5, "j2": 0.5, "j3": 0.5},
    )


def position(model, p) -> np.ndarray:
    return model.layout.pack(np.empty((0, 3, 3)), np.atleast_2d(p))


@pytest.mark.parametrize("seed", range(5))
def test_free_targets_are_reached(chain, seed):
    """Where some pose with a wide margin reaches them."""
    rng = np.random.default_rng(seed)
    workspace, zero = chain.MakeWorkspace(), np.zeros(4)
    for _ in range(100):
        q = chain.rest_positions() + rng.uniform(-0.4, 0.4, 4)
        state = chain.evaluate(workspace, q, zero)
        if state.d.min() > 0.1:
            break
    target = position(chain, state.p)
    found = solve_start_pose(chain, target, np.zeros(0))
    check_valid(chain, found)
    assert np.abs(error(chain, found, target)).max() < 2e-3


@pytest.mark.parametrize(
    "p",
    [[0.2, 0.5, 0.1], [5.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.2, 0.0], [-1, 0.5, 2]],
    ids=["in the post", "out of reach", "in the base", "behind the post", "behind"],
)
def test_impossible_targets_give_a_valid_pose(chain, p):
    target = position(chain, p)
    q = solve_start_pose(chain, target, np.zeros(0))
    check_valid(chain, q)
    # It does not stay at rest where there is something to gain.
    at_rest = np.linalg.norm(error(chain, chain.rest_positions(), target))
    assert np.linalg.norm(error(chain, q, target)) < at_rest


def test_rest_posture_that_is_not_valid_is_made_no_worse():
    """Beyond a limit and inside the post already."""
    model = make_model(
        chain_urdf("zz", limits=(-1.0, 1.0)).replace("0.2 0.5 0.1", "0.2 0.5 0"),
        pairs=[["l0", "post"], ["l1", "post"]],
        rest_posture={"j0": 1.1, "j1": 0.1},
    )
    q = solve_start_pose(model, position(model, [0.3, 0.5, 0.0]), np.zeros(0))
    check_valid(model, q)
    assert np.isfinite(q).all()


def test_unlimited_and_narrow_joints():
    """No margin can be kept in a range of 10 mrad."""
    urdf = chain_urdf("zzz", limits=None).replace(
        '<joint name="j1" type="continuous">',
        '<joint name="j1" type="revolute"><limit lower="-0.005" upper="0.005"/>',
    )
    model = make_model(urdf)
    target = position(model, [0.5, -0.4, 0.0])
    q = solve_start_pose(model, target, np.zeros(0))
    assert np.abs(q[1]) <= 0.005
    assert np.abs(error(model, q, target)).max() < 2e-3


def test_prescribed_joints_are_where_they_are_told():
    model = make_model(chain_urdf("zyz", rail="y"), prescribed_joints={"rail": "hold"})
    target = position(model, [0.5, 0.6, 0.1])
    q = solve_start_pose(model, target, np.array([0.4]))
    assert q[model.prescribed] == 0.4
    assert np.abs(error(model, q, target)).max() < 2e-3


def test_poses_are_reached_in_orientation_too():
    model = make_model(
        chain_urdf("zyzyzy"),
        [Task(frame="tip", kind="pose", orientation_weight=0.3)],
        rest_posture={"j1": 0.5, "j3": 0.7},
    )
    goal = np.array([0.3, 0.8, -0.4, 0.4, 0.3, 0.5])
    state = model.evaluate(model.MakeWorkspace(), goal, np.zeros(6))
    q = solve_start_pose(model, model.layout.pack(state.R, state.p), np.zeros(0))
    reached = model.evaluate(model.MakeWorkspace(), q, np.zeros(6))
    np.testing.assert_allclose(reached.p, state.p, atol=5e-3)
    np.testing.assert_allclose(reached.R, state.R, atol=2e-2)
