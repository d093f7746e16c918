"""The benchmark measures what it says; how fast that is, no test asks."""

import os

import numpy as np
import pytest

from benchmarks.step import measure_growth, measure_simulations, measure_steps
from benchmarks.step_compiling import measure_process
from benchmarks.step_robots import make_robot
from benchmarks.step_timing import Step, fit_growth, samples_of_run
from crar_drake.errors import CrarError
from crar_drake.law.parameters import CONSTRAINTS
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario


@pytest.mark.parametrize("mode", ["paper", "lookahead"])
def test_the_timed_steps_are_those_of_the_simulation(mode):
    parameters = CONSTRAINTS[mode](blend_time=0.01)
    scenario = Scenario(
        motion="dance", experiment="wrists", controller=parameters, duration=0.03
    )
    run = run_scenario(scenario, record=False)
    step = Step(run.setup.model, parameters, samples_of_run(run))
    for _ in range(2):
        for actuation in run.log.actuation:
            assert step.take() > 0.0
            np.testing.assert_array_equal(step.torque, actuation)
        step.restart()


def test_its_tables():
    steps = measure_steps(0.06, cases=["wrists"])
    assert [row[0] for row in steps.rows] == ["wrists, paper", "wrists, lookahead"]
    simulations = measure_simulations(0.06, repeats=1)
    assert [row[1] for row in simulations.rows] == ["no", "yes"] * 2
    growth = measure_growth(3, {"pairs": [(7, 1, 5, 0), (7, 1, 9, 0)]})
    assert [row[:3] for row in growth.rows] == [
        ["pairs", mode, "5, 9"] for mode in ("paper", "lookahead")
    ]
    for table in (steps, simulations, growth):
        assert all(len(row) == len(table.columns) for row in table.rows)


@pytest.mark.parametrize("robot", [(7, 2, 5, 0), (14, 1, 10, 190)])
def test_robots_have_the_numbers_asked_for(robot):
    joints, tasks, near, far = robot
    model = make_robot(*robot)
    assert (model.n, model.n_p, model.m) == (joints, 0, 3 * tasks)
    assert len(model.pairs) == len(set(model.pairs.names)) == near + far


def test_growth_of_a_power_law():
    sizes = [1.0, 10.0, 100.0]
    grown = fit_growth(sizes, [3e-6 * s**1.5 for s in sizes])
    assert grown["exponent"] == pytest.approx(1.5)
    assert grown["last_exponent"] == pytest.approx(1.5)
    line = fit_growth([0, 10, 30], [5e-6, 6e-6, 8e-6])
    assert line["per_unit"] == pytest.approx(1e-7)
    assert line["last_over_first"] == pytest.approx(1.6)


@pytest.mark.slow
def test_what_a_process_takes_to_be_ready():
    """Here where all is compiled already."""
    times = measure_process(dict(os.environ), "none")
    assert 0.0 < times["cpu"] and 0.0 < times["wall"]
    with pytest.raises(CrarError, match="cannot be measured: .*'nine'"):
        measure_process(dict(os.environ), "nine")
