"""The sweep: what is run, and what is told of it."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from benchmarks.sweep.__main__ import main
from benchmarks.sweep.cases import Case, Result, make_cases, run_case
from benchmarks.sweep.tables import sweep_tables
from crar_drake import fresh_processes
from crar_drake.law.parameters import PaperParameters
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario


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


def test_the_tables_have_a_column_a_mode_and_a_row_a_clip():
    figures = {"duration": 1.0, "samples": 1001, "rms_task_error": 1.0 / 3.0}
    results = [
        Result(**vars(c), **figures, penetrating=25 * (c.constraints == "paper"))
        for c in make_cases(["a", "b", "c"], constraints=["paper", "lookahead"])
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
    argv = "dance --tasks wrists --jobs 1 --period 0.005 --out it/all.json".split()
    argv += ["--constraints", "paper,lookahead", "--duration"]
    main([*argv, "0.1"])
    printed = capsys.readouterr()
    assert "### Modes, wrists" in printed.out and "2/2" in printed.err
    assert "| dance | 0.1 s |" in printed.out
    assert printed.out.splitlines()[-1] == "it/all.json"
    kept = (tmp_path / "it" / "all.json").read_text()
    main([*argv, "0.1"])  # finds all that the first left
    assert (tmp_path / "it" / "all.json").read_text() == kept
    # What all cases have in common belongs to the results.
    main([*argv, "0.2"])
    assert "| dance | 0.2 s |" in capsys.readouterr().out
