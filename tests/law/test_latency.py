"""A state that is late, where the law is told by how much."""

from dataclasses import replace

import numpy as np
import pytest

from crar_drake import ControlModel, load_robot_description, position_tasks
from crar_drake.errors import ScenarioError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.solution import STATUS_BRAKING
from crar_drake.run import run_scenario
from crar_drake.simulation.disturbances import Disturbances
from crar_drake.simulation.scenario import Scenario

PERIOD, STEP = 5e-3, 1e-3
HANDS = ["left_wrist", "right_wrist"]


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return ControlModel.FromDescription(
        load_robot_description("upper_body"), position_tasks(HANDS), time_step=STEP
    )


def parameters(latency: float = 0.0) -> LookaheadParameters:
    return LookaheadParameters(period=PERIOD, blend_time=0.0, latency=latency)


def start(model: ControlModel) -> np.ndarray:
    """Positions with arms bent: none of its capsules are parallel."""
    q = model.rest_positions()
    q[model.controlled_positions] += 0.2 * np.random.default_rng(2).uniform(
        -1.0, 1.0, model.n
    )
    return q


def targets(model: ControlModel, count: int) -> np.ndarray:
    """Places to go to from there, the same at each step."""
    p = model.layout.unpack(model.tasks_at(start(model))).p
    away = np.array([[0.1, -0.05, 0.1], [0.1, 0.05, 0.05]])
    return np.tile(model.layout.pack(np.empty((0, 3, 3)), p + away), (count, 1))


@pytest.mark.parametrize("latency", [0.003, 0.015, 0.022])
def test_a_late_state_changes_nothing_where_the_robot_does_as_told(model, latency):
    """The plant is stepped here: v += h a, q += h v, a millisecond each."""
    wanted = targets(model, 60)
    nq, still = model.plant.num_positions(), model.prescribed_at(start(model))

    def moved(late: int, latency: float) -> np.ndarray:
        law = ControlLaw(model, parameters(latency))
        x = np.concatenate((start(model), np.zeros(model.plant.num_velocities())))
        past = [x]
        for target in wanted:
            seen = past[max(len(past) - 1 - late, 0)]
            a = law.step(seen[:nq], seen[nq:], target, still).acceleration
            for _ in range(round(PERIOD / STEP)):
                v = x[nq:] + STEP * a
                x = np.concatenate((x[:nq] + STEP * v, v))
                past.append(x)
        return np.array(past)

    right = moved(0, 0.0)
    told = moved(round(latency / STEP), latency)
    np.testing.assert_allclose(told, right, atol=1e-6)
    assert np.abs(right - right[0]).max() > 0.3  # it moved
    if latency > PERIOD:
        assert np.abs(moved(round(latency / STEP), 0.0) - right).max() > 0.1


def test_torque_between_steps_is_of_the_state_that_is_predicted(model):
    late = ControlLaw(model, parameters(0.007))
    rng = np.random.default_rng(3)
    q, v = (
        model.rest_positions(),
        0.2 * rng.standard_normal(model.plant.num_velocities()),
    )
    nq = len(q)
    a = late.step(q, v, targets(model, 1)[0], model.prescribed_at(q)).acceleration
    states = [(q, v)]
    for _ in range(3):
        v = states[-1][1] + STEP * a
        states.append((states[-1][0] + STEP * v, v))
        torque = late.torque(
            q[:nq], states[0][1]
        )  # measured: where it was at the start
        workspace = model.MakeWorkspace()
        model.plant.SetPositionsAndVelocities(
            workspace.plant_context, np.concatenate(states[-1])
        )
        np.testing.assert_allclose(
            torque, model.inverse_dynamics(workspace, a), atol=1e-6
        )


def test_a_plan_that_is_told_bears_a_state_15_ms_late():
    """In Drake's simulation it moves as if nothing were late."""
    scenario = Scenario(
        motion="dance",
        experiment="wrists",
        duration=1.0,
        controller=LookaheadParameters(period=PERIOD),
    )
    late = replace(scenario, disturbances=Disturbances(delay_periods=3))
    told = replace(late, controller=replace(late.controller, latency=3 * PERIOD))
    moved = [run_scenario(each, record=False).log.q for each in (scenario, told)]
    np.testing.assert_allclose(moved[1], moved[0], atol=1e-4)


def test_a_robot_that_is_off_is_braked_as_its_motors_can():
    """A violent stretch, 30 ms late, with masses that are 20 % more."""
    scenario = Scenario(
        motion="dance",
        experiment="wrists",
        controller=LookaheadParameters(period=PERIOD, latency=0.03),
        disturbances=Disturbances(1.2, delay_periods=6),
        duration=5.1,
    )
    summary = run_scenario(scenario, record=False).summary
    assert summary.violated_samples == 0


def test_it_goes_on_while_targets_are_lost(model):
    law = ControlLaw(model, parameters(0.01))
    q = start(model)
    v = np.zeros(model.plant.num_velocities())
    still = model.prescribed_at(q)
    law.step(q, v, targets(model, 1)[0], still)
    lost = law.step(q, v, np.full(model.layout.size, np.nan), still)
    assert lost.status[0] == STATUS_BRAKING
    # What it brakes from is the state that the first step has led to by now.
    assert np.abs(lost.acceleration[model.controlled]).max() > 0.1


@pytest.mark.parametrize("latency", [-1e-3, np.nan, np.inf])
def test_a_latency_is_a_time(latency):
    with pytest.raises(ScenarioError, match="latency"):
        LookaheadParameters(latency=latency).validate()
