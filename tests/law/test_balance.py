"""A law that keeps a standing robot balanced, and what cannot stand.

That it does, whatever is asked: `tests/acceptance/test_balance_attacked.py`.
"""

from dataclasses import replace

import numpy as np
import pytest
from ground_demand import ground_wrench
from scipy.spatial import ConvexHull
from standing_robots import APART, PAD, standing_robot, tipping_cell

from crar_drake.errors import ModelError, ScenarioError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import BalanceParameters, LookaheadParameters
from crar_drake.robot.model import ControlModel
from crar_drake.robot.soles import masses_on_soles, shrunk, sole_corners
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import position_tasks

PERIOD = 0.01


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return standing_robot(tmp_path_factory.mktemp("robot") / "stander")


def model_of(description, time_step=0.0) -> ControlModel:
    return ControlModel.FromDescription(
        description, position_tasks(["hand"]), time_step=time_step
    )


def parameters(**changes) -> LookaheadParameters:
    given = {"period": PERIOD, "balance": BalanceParameters(), "braking_time": 0.1}
    return LookaheadParameters(**(given | changes))


def outside(whole, model, Q, V, A) -> np.ndarray:
    """How far centres of pressure are outside the soles less 2 cm, by Drake [m];
    infinitely far where the ground would have to pull."""
    floating = model_of(whole)
    q = np.tile(floating.rest_positions(), (len(Q), 1))
    rates = np.zeros((2, len(Q), floating.plant.num_velocities()))
    names = list(floating.position_names), list(floating.velocity_names)
    ours = [n for n, name in enumerate(model.position_names) if name in names[0]]
    joints = [model.position_names[n] for n in ours]
    at_q, at_v = ([of.index(name) for name in joints] for of in names)
    q[:, at_q], rates[0][:, at_v], rates[1][:, at_v] = (x[:, ours] for x in (Q, V, A))
    soles = sole_corners(model)
    faces = ConvexHull(shrunk(np.concatenate(soles), 0.02)[:, :2]).equations
    centres = ground_wrench(floating.plant, q, *rates).centres(soles[0][0, 2])
    far = (centres @ faces[:, :2].T + faces[:, 2]).max(axis=1)
    return np.nan_to_num(far, nan=np.inf)


def test_a_law_that_is_balanced_anyway_is_left_as_it_is(whole):
    model = model_of(standing_description(whole))
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
    tasks = model.tasks_at(q)
    tasks[:3] += 1e-3
    both = [
        ControlLaw(model, parameters(balance=given)).step(
            q, v, tasks, model.prescribed_at(q)
        )
        for given in (None, BalanceParameters())
    ]
    np.testing.assert_array_equal(both[0].acceleration, both[1].acceleration)
    np.testing.assert_array_equal(both[0].actuation, both[1].actuation)
    assert both[1].balance[0] == 0.0


def test_what_cannot_be_balanced(whole):
    standing = standing_description(whole)
    held = {**standing.prescribed_joints}
    knee = "left_knee"
    cases = [
        (replace(standing, soles={}), {}, ModelError, "needs soles"),
        (
            replace(standing, prescribed_joints=held | {knee: "waist.x"}),
            {},
            ScenarioError,
            "left_knee: the motion moves the base",
        ),
        (
            replace(standing, soles={"left_foot": standing.soles["left_foot"]}),
            {},
            ScenarioError,
            "not balanced in its rest posture",
        ),
        (
            standing,
            {"balance": BalanceParameters(friction=-1.0)},
            ScenarioError,
            "controller.balance.friction: -1.0 must be positive",
        ),
        (
            standing,
            {"balance": BalanceParameters(margin=0.1)},
            ModelError,
            "leaves nothing of soles",
        ),
    ]
    for description, changes, error, words in cases:
        with pytest.raises(error, match=words):
            ControlLaw(model_of(description), parameters(**changes))


def test_a_push_is_told_and_nothing_gets_worse(whole):
    """From a state that no law of ours would have come to."""
    model = model_of(standing_description(whole))
    law = ControlLaw(model, parameters())
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
    v[model.controlled] = [14.0, 4.0]
    tasks, prescribed = model.tasks_at(q), model.prescribed_at(q)
    first = None
    for _ in range(30):
        a = law.step(q, v, tasks, prescribed).acceleration
        lacks = outside(whole, model, q[None], v[None], a[None])[0]
        first = lacks if first is None else first
        assert lacks <= max(first, 0.0) + 1e-3
        q, v = q + PERIOD * v + 0.5 * PERIOD**2 * a, v + PERIOD * a
    assert first > 0.0 and lacks < 0.0


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return tipping_cell(tmp_path_factory.mktemp("robot") / "cell")


def test_the_margin_of_small_feet_is_that_of_their_hull(cell):
    """It is larger than a foot."""
    model = model_of(cell)
    ControlLaw(model, parameters())
    hull = shrunk(np.concatenate(sole_corners(model)), 0.02)
    np.testing.assert_allclose(np.abs(hull[:, :2]), APART + PAD - 0.02)
    np.testing.assert_allclose(hull[:, 2], 0.2)


def test_what_stands_on_the_feet_counts_and_no_post_beside_them(cell):
    masses = masses_on_soles(model_of(cell))
    mass = masses.inertia[:, 3, 3]
    assert mass.sum() == pytest.approx(5.0 + 4 * 0.2 + 3.0 + 2.0)
    assert mass[0] == pytest.approx(5.0 + 4 * 0.2)
    # On a world that has feet of its own everything stands.
    corners = [[0.2, 0.2, 0.0], [-0.2, 0.2, 0.0], [0.0, -0.2, 0.0]]
    everything = masses_on_soles(model_of(replace(cell, soles={"world": corners})))
    assert everything.inertia[:, 3, 3].sum() == pytest.approx(mass.sum() + 50.0)


def test_what_does_not_stand_on_the_feet_together(cell):
    post = {"post": cell.soles["foot_1"]}
    with pytest.raises(
        ModelError, match="post: nothing but the world joins it to foot"
    ):
        masses_on_soles(model_of(replace(cell, soles=cell.soles | post)))
    with pytest.raises(ModelError, match="upper_arm moves, but does not stand on post"):
        masses_on_soles(model_of(replace(cell, soles=post)))
