"""Accelerations within the effort limits, over whichever horizon leaves the most."""

from dataclasses import replace

import numpy as np
import pytest

from crar_drake import ControlModel, load_robot_description, position_tasks
from crar_drake.control.effort_limits import EffortLimits
from crar_drake.control.law import ControlLaw
from crar_drake.control.lookahead_parameters import LookaheadParameters
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.records import Solution
from crar_drake.equations.within_efforts import (
    NO_EXCESS,
    effort_excess,
    may_go_on,
    with_horizon,
    within_limits,
)

PERIOD, T = 5e-3, 0.05
AHEAD = LookaheadParameters(preview=0.1, horizon=T, longest_horizon=T)
PARAMETERS = CrarParameters(period=PERIOD, lookahead=AHEAD)


@pytest.fixture(scope="module")
def model() -> ControlModel:
    tasks = position_tasks(["left_wrist", "right_wrist"])
    return ControlModel.FromDescription(
        load_robot_description("upper_body"), tasks, time_step=PERIOD
    )


def random_efforts(seed: int, n: int = 4) -> tuple[np.ndarray, ...]:
    """Accelerations, velocities and rows of as many motors as joints."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n))
    efforts = np.empty((n, n + 2))
    efforts[:, :n], efforts[:, n] = root @ root.T + np.eye(n), rng.normal(0.0, 2.0, n)
    efforts[:, n + 1] = rng.uniform(10.0, 60.0, n)
    return 30.0 * rng.standard_normal(n), rng.standard_normal(n), efforts


@pytest.mark.parametrize("seed", range(20))
def test_what_is_within_the_limits_is(seed):
    nominal, v, efforts = random_efforts(seed)
    n, A = len(v), efforts[:, : len(v)]
    unbounded = np.full(n, np.inf)
    found, excess = within_limits(
        nominal, v, n - 1, efforts, -unbounded[:-1], unbounded[:-1], T, PERIOD
    )
    for vdot, beyond in zip(found, excess, strict=True):
        tau = A @ vdot + efforts[:, n]
        most = np.max(np.abs(tau) / efforts[:, n + 1]) - 1.0
        assert most <= beyond + 1e-6
        assert effort_excess(tau, efforts[:, n + 1]) == pytest.approx(max(most, 0.0))
        braking = np.append(-(v + PERIOD * vdot)[:-1] / T, vdot[-1])
        tau = A @ braking + efforts[:, n]
        goes_on = bool(np.all(np.abs(tau) <= 0.9 * efforts[:, n + 1]))
        assert may_go_on(vdot, v, n - 1, efforts, T, PERIOD) == goes_on


def test_another_horizon_is_as_if_it_had_been_given(model):
    made = [
        ControlLaw(
            model, replace(PARAMETERS, lookahead=replace(AHEAD, horizon=T_k))
        ).mode.numbers.value
        for T_k in (0.02, T)
    ]
    found = with_horizon(made[0], T)
    assert found.gains[:-1] == made[1].gains[:-1]
    assert found.admission == made[1].admission


@pytest.mark.parametrize("seed", range(12))
def test_one_horizon_alone_is_the_nearest_that_is_admitted(model, seed):
    """As `EffortLimits` finds it for modes without longer ones, by Drake's dynamics."""
    rng = np.random.default_rng(seed)
    law = ControlLaw(model, PARAMETERS)
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
    c = model.controlled
    q[model.controlled_positions] += rng.uniform(-0.2, 0.2, model.n)
    v[c] = rng.uniform(-1.0, 1.0, model.n)
    vdot = np.zeros_like(v)
    vdot[c] = rng.uniform(-600.0, 600.0, model.n)
    limits = EffortLimits(model, law.mode, PARAMETERS)
    workspace = model.MakeWorkspace()
    measured = law._measure(workspace, q, v)
    vdot, _ = law.mode.admit_again(measured, vdot)
    nothing = np.zeros(0)
    solution = Solution(vdot, nothing, nothing, nothing, nothing)
    limits.limit(workspace, measured, solution)
    found, _ = law.mode.limited(measured, vdot, limits.rows(workspace))
    assert solution.torque_limit[0] < 1.0
    np.testing.assert_allclose(found[: len(v)], solution.acceleration, atol=1e-4)
    tau = found[len(v) : len(v) + len(limits.limits)]
    np.testing.assert_allclose(tau, solution.actuation, atol=1e-4)


def test_what_a_mode_leaves_beyond_what_is_asked_of_it_is_not_clipped(
    model, monkeypatch
):
    """Clipped, the robot would do other than was admitted: of a Talos that boxes fast a
    joint at its speed limit then was beyond it by 1e-6 rad/s."""
    longer = replace(PARAMETERS, lookahead=replace(AHEAD, longest_horizon=2.0 * T))
    law = ControlLaw(model, longer)
    limits = EffortLimits(model, law.mode, longer)
    workspace, nv = model.MakeWorkspace(), model.plant.num_velocities()
    measured = law._measure(workspace, model.rest_positions(), np.zeros(nv))
    wanted = np.zeros(nv)
    wanted[model.controlled] = np.linspace(100.0, 600.0, model.n)

    def leaves_a_rest(measured, vdot, rows):
        """Some of what is wanted, which takes NO_EXCESS more than it may."""
        A, b, most = rows[:, :-2], rows[:, -2], (1.0 + 0.99 * NO_EXCESS) * rows[:, -1]
        slope = A @ vdot[model.order]
        share = np.min((most - np.sign(slope) * b) / np.maximum(np.abs(slope), 1e-9))
        tau = np.clip(share * slope + b, -rows[:, -1], rows[:, -1])
        after = np.concatenate((model.rest_positions(), np.zeros(nv)))
        rest = [share, 0.99 * NO_EXCESS]
        return np.concatenate((share * vdot, tau, rest, after)), {}

    monkeypatch.setattr(limits, "_torque_times", [])
    monkeypatch.setattr(limits._mode, "limited", leaves_a_rest)
    nothing = np.zeros(0)
    solution = Solution(wanted, nothing, nothing, nothing, nothing)
    limits.limit(workspace, measured, solution)
    taken = model.inverse_dynamics(workspace, solution.acceleration)
    np.testing.assert_array_equal(solution.actuation, taken)
    most = np.max(np.abs(taken) / limits.limits)
    assert 1.0 - 1e-5 < most <= 1.0 and solution.torque_limit[1] == 0.0
