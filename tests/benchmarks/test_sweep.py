"""The sweep: what is run, what is kept, and what is told of it."""

from concurrent.futures import Executor, Future, ThreadPoolExecutor

import pytest

from benchmarks.sweep.__main__ import main
from benchmarks.sweep.cases import (
    Case,
    Result,
    make_cases,
    read_results,
    run_case,
    run_sweep,
)
from benchmarks.sweep.report import sweep_tables
from crar_drake import fresh_processes
from crar_drake.errors import CrarError
from crar_drake.law.parameters import PaperParameters
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario

CASES = make_cases(["a", "b", "c"], constraints=["paper", "lookahead"])


def made_up(case: Case, **changes) -> Result:
    """A result with figures that a file must not round, and words that CSV quotes."""
    figures = {
        "duration": 1.0,
        "samples": 1001,
        "smallest_distance": 0.1 + 0.2,
        "smallest_pair": 'left, "hand" - right',
        "rms_task_error": 1.0 / 3.0,
    }
    return Result(**vars(case), **(figures | changes))


class Counting(Executor):
    """Makes results up instead of simulating, and knows what it was asked for."""

    def __init__(self) -> None:
        self.cases: list[Case] = []

    def submit(self, function, case, scenario):
        assert function is run_case
        self.cases.append(case)
        future = Future()
        future.set_result(made_up(case))
        return future


def test_a_case_is_judged_at_every_step_of_the_plant(monkeypatch):
    case = Case("reaching", "wrists", "none", "acceleration", 5e-3)
    # The case replaces the scenario's tasks and modes, and nothing else of it.
    base = Scenario(motion="dance", experiment="upper-body", duration=2.0)
    limits = PaperParameters.speed_limits
    monkeypatch.setattr(  # for the motion to be too fast
        PaperParameters, "speed_limits", lambda *given: 0.02 * limits(*given)
    )
    result = run_case(case, base.to_yaml())
    assert result.case == case and not result.error
    assert result.samples == 2001 and result.duration == pytest.approx(2.0)

    base.motion, base.experiment, base.log_period = "reaching", "wrists", 1e-3
    base.controller = PaperParameters(constraints="none", period=5e-3)
    run = run_scenario(base)
    # The summary has the controller's distances, the result the referee's.
    assert result.violated
    assert result.penetrating == run.summary.penetrating_samples
    assert result.beyond_limit == run.summary.beyond_limit_samples
    distances = run.log.signed_distances
    assert result.smallest_distance == pytest.approx(distances.min(), abs=1e-9)
    assert result.beyond_speed == run.summary.beyond_speed_samples > 0
    assert result.largest_speed_excess == run.summary.largest_speed_excess > 0.0
    assert result.smallest_pair == run.summary.smallest_distance_pair
    assert result.largest_excess == pytest.approx(run.summary.largest_excess)


def test_what_is_finished_is_kept_and_a_line_that_was_cut_off_run_again(tmp_path):
    out = tmp_path / "results.csv"
    results = run_sweep(CASES, out, executor=Counting())
    last = read_results(out)[-1]
    assert {repr(r) for r in read_results(out)} == {repr(r) for r in results}
    whole = out.read_text()
    out.write_text(whole[:-10])
    counting = Counting()
    run_sweep(CASES, out, executor=counting)
    assert counting.cases == [last.case]
    assert out.read_text() == whole
    out.write_text("name,age\nx,3\n")
    with pytest.raises(CrarError, match="not a sweep's file"):
        run_sweep(CASES, out, executor=counting)


def test_the_tables_have_a_column_a_mode_and_a_row_a_clip():
    results = [
        made_up(case, penetrating=25 * (case.constraints == "paper")) for case in CASES
    ]
    modes, _, clips, _ = sweep_tables(results)  # of wrists, of the upper body
    assert modes.columns == ["", "paper, 1 ms", "lookahead, 1 ms"]
    assert ["samples penetrating", "75", "0"] in modes.rows
    assert ["clips in violation", "3", "0"] in modes.rows
    assert [row[0] for row in clips.rows] == ["a", "b", "c"]
    assert clips.rows[0][2] == "333.3 / 333.3" and clips.rows[0][6] == "0 / 25"


def test_the_command_simulates_tells_and_continues(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fresh_processes, "FreshProcesses", ThreadPoolExecutor)
    argv = "dance --experiment wrists --jobs 1 --period 0.005 --out it/all.csv".split()
    assert main([*argv, "--constraints", "paper,lookahead", "--duration", "0.1"]) == 0
    printed = capsys.readouterr()
    assert "### Modes, wrists" in printed.out and "2/2" in printed.err
    assert printed.out.splitlines()[-1] == "it/all.csv"
    assert [r.duration for r in read_results("it/all.csv")] == pytest.approx([0.1] * 2)
    # What differs between the results' scenarios is not in the results.
    assert main([*argv, "--duration", "0.2"]) == 2
    assert "another --scenario, --duration or --frame-rate" in capsys.readouterr().err
