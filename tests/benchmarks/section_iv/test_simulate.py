"""One simulation's figures, and what is kept of a plan that was stopped."""

import json
import math
from concurrent.futures import Executor, Future
from dataclasses import replace

import numpy as np
import pytest
from small_logs import small_log

from benchmarks.section_iv import simulate as module
from benchmarks.section_iv.plan import Plan, make_plan
from benchmarks.section_iv.simulate import (
    Outcome,
    analyse,
    finished,
    log_path,
    page_path,
    run_plan,
    simulate,
)
from crar_drake.errors import CrarError
from crar_drake.results.log import SimulationLog


class Inline(Executor):
    """Runs at once, in the caller's thread, and counts."""

    def __init__(self) -> None:
        self.calls = []

    def submit(self, function, /, *arguments):
        self.calls.append(arguments)
        future = Future()
        try:
            future.set_result(function(*arguments))
        except RuntimeError as error:
            future.set_exception(error)
        return future


@pytest.fixture(scope="module")
def plan() -> Plan:
    """The two simulations of the raw dance, very short."""
    whole = make_plan(["dance"], duration=0.05, damping_factors=[0.1])
    raw = tuple(s for s in whole.simulations if s.series == "raw")
    return replace(whole, simulations=raw, damping={})


@pytest.fixture
def out(plan, tmp_path):
    run_plan(plan, tmp_path, executor=Inline())
    return tmp_path


def test_details_are_what_the_log_says():
    """By hand: the small log has three samples and two controlled joints."""
    W = np.array([[1.0, 1.0], [1.05, 1.0], [1.05, 1.2]])
    details = analyse(small_log(constraint_weights=W), np.array([0, 2, 7]))
    assert details.violated_share == pytest.approx(2 / 3)
    # Errors of hand and tool: 5 and 0 mm, 0 and 12 mm, 0 and 5 mm.
    squares = 0.5 * np.array([5.0**2, 12.0**2, 5.0**2])
    assert details.error_otherwise == pytest.approx(1e-3 * math.sqrt(squares[0]))
    assert details.error_in_violation == pytest.approx(
        1e-3 * math.sqrt(squares[1:].mean())
    )
    assert details.squared_error_in_violation == pytest.approx(
        squares[1:].sum() / squares.sum()
    )
    # Powers: |10 * 1| + |3 * 2|, |-30 * -2| + 0, 0 + |-8 * 4|.
    assert details.power_otherwise == pytest.approx(16.0)
    assert details.power_in_violation == pytest.approx((60.0 + 32.0) / 2)
    assert details.power_of_peaks == pytest.approx(60.0 / 108.0)
    # Swing is beyond 1 rad in the second sample only.
    assert details.limited_joint == "swing"
    assert details.limited_joint_share == pytest.approx(1 / 3)
    steps = np.array([-40.0, 31.0, 2.0, -13.0])
    assert details.rms_torque_step == pytest.approx(np.sqrt((steps**2).mean()))
    # The largest torque is in the second sample, W jumps in the third.
    assert (details.spikes_at_jumps, details.jumps) == (0.0, pytest.approx(1 / 3))


def test_without_violations_there_is_no_figure_for_them():
    details = analyse(small_log(), np.zeros(3, dtype=int))
    assert details.violated_share == details.squared_error_in_violation == 0.0
    assert math.isnan(details.error_in_violation)
    assert math.isnan(details.power_in_violation)


def test_a_simulation_leaves_result_log_and_page(plan, out):
    for simulation in plan.simulations:
        log = SimulationLog.load(log_path(simulation, out))
        outcome = finished(plan, out)[simulation.name]
        assert outcome.result.samples == len(log.time) == 51
        error = np.sum(log.task_error.reshape(51, -1, 3) ** 2, axis=2)
        assert outcome.result.rms_task_error == pytest.approx(np.sqrt(error.mean()))
        assert "</html>" in page_path(simulation, out).read_text()


def test_what_is_finished_is_not_run_again(plan, out):
    again = Inline()
    told = []
    outcomes = run_plan(plan, out, executor=again, progress=lambda *a: told.append(a))
    assert again.calls == told == []
    assert list(outcomes) == [s.name for s in plan.simulations]
    for outcome in outcomes.values():  # NaN is not equal to itself
        assert math.isnan(outcome.result.resting_distance)


def test_what_is_missing_damaged_or_of_another_scenario_is_run_again(plan, out):
    first, second = plan.simulations
    page_path(first, out).unlink()
    assert list(finished(plan, out)) == [second.name]
    path = out / "results" / f"{second.name}.json"
    text = path.read_text()
    for damaged in ("", text[: len(text) // 2], "[]", text.replace('"jumps"', '"x"')):
        path.write_text(damaged)
        assert finished(plan, out) == {}
    path.write_text(text.replace('"version": "', '"version": "0'))
    assert finished(plan, out) == {}
    path.write_text(text)
    changed = replace(second, scenario=second.scenario.replace("30", "31"))
    assert finished(replace(plan, simulations=(changed,)), out) == {}
    again = Inline()
    run_plan(plan, out, executor=again)
    assert [s.name for s, _ in again.calls] == [first.name]
    assert len(finished(plan, out)) == 2


def test_longest_first_and_progress_counts_what_was_there(plan, tmp_path, monkeypatch):
    def made_up(simulation, out):
        return Outcome(simulation, None, None)

    monkeypatch.setattr(module, "simulate", made_up)
    first, second = plan.simulations
    longer = replace(plan, simulations=(first, replace(second, duration=9.0)))
    executor, told = Inline(), []
    run_plan(
        longer, tmp_path, executor=executor, progress=lambda *a: told.append(a[:2])
    )
    assert [s.name for s, _ in executor.calls] == [second.name, first.name]
    assert told == [(1, 2), (2, 2)]


def test_a_simulation_that_fails_says_why_and_is_tried_again(plan, tmp_path):
    simulation = replace(
        plan.simulations[0],
        scenario=plan.simulations[0].scenario.replace(
            "motion: dance", "motion: gone.amc"
        ),
    )
    outcome = simulate(simulation, str(tmp_path))
    assert "gone.amc: there is no such" in outcome.result.error
    assert outcome.details is None
    record = json.loads((tmp_path / "results" / f"{simulation.name}.json").read_text())
    assert math.isnan(record["result"]["rms_task_error"])
    assert finished(replace(plan, simulations=(simulation,)), tmp_path) == {}


def test_a_process_that_dies_names_its_simulation(plan, tmp_path, monkeypatch):
    def die(simulation, out):
        raise RuntimeError("the process of simulate ended with code -9")

    monkeypatch.setattr(module, "simulate", die)
    with pytest.raises(CrarError, match="dance_.*_raw: the process of simulate ended"):
        run_plan(plan, tmp_path, executor=Inline())
