"""Section IV: a short one runs, and a finding's verdict turns with its figure."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from small_logs import small_log

from benchmarks.section_iv.__main__ import main
from benchmarks.section_iv.findings import check_findings
from benchmarks.section_iv.plan import Plan, Simulation, make_plan
from benchmarks.section_iv.simulate import Outcome, Outcomes
from benchmarks.sweep.cases import Result
from crar_drake import fresh_processes
from crar_drake.simulation.scenario import load_scenario, parse_scenario

MOTIONS = ("dance", "boxing")
FACTORS = (0.2, 0.1, 0.05)
# rms error [m], power [W], peak torque [Nm], rms torque step [Nm]
FIGURES = {
    ("wrists", "velocity"): (0.030, 120.0, 900.0, 50.0),
    ("wrists", "acceleration"): (0.030, 100.0, 200.0, 1.0),
    ("wrists", "lookahead"): (0.030, 90.0, 200.0, 1.0),
    ("wrists", "inertia"): (0.032, 60.0, 200.0, 1.0),
    ("wrists", "less-damping"): (0.020, 110.0, 200.0, 1.0),
    ("upper-body", "velocity"): (0.060, 50.0, 400.0, 20.0),
    ("upper-body", "acceleration"): (0.065, 45.0, 100.0, 1.0),
    ("upper-body", "lookahead"): (0.060, 40.0, 100.0, 1.0),
}


def outcome(motion, experiment, series, error, power, peak, step, **changes) -> Outcome:
    result = Result(
        motion,
        experiment,
        "paper",
        "acceleration",
        1e-3,
        samples=1000,
        smallest_distance=0.02,
        smallest_pair="left_hand - pelvis",
        rms_task_error=error,
        mean_power=power,
        peak_torque=peak,
    )
    simulation = Simulation(motion, experiment, series, "", 1.0)
    return Outcome(simulation, replace(result, **changes), 0.0, step)


def made_up(changes: dict | None = None) -> Outcomes:
    """Data in which every finding holds, with changes by (experiment, series).

    A change concerns the boxing, or of the sweep and Fig. 3 the dance.
    """
    changes = changes or {}
    outcomes, damping = {}, {}
    for motion in MOTIONS:
        for (experiment, series), figures in FIGURES.items():
            on = changes.get((motion, experiment, series), {})
            o = outcome(motion, experiment, series, *figures, **on)
            outcomes[o.case.name] = o
    for constraints in ("paper", "none"):
        for level in ("velocity", "acceleration"):
            for value in FACTORS:
                small = value < 0.1
                power = 400.0 if small and level == "velocity" else 100.0
                error = 0.02 if small else 0.03
                on = changes.get((constraints, level, value), {})
                series = f"damping-{level}-{constraints}-{value:g}"
                figures = error, power, 100.0, 1.0
                o = outcome("dance", "wrists", series, *figures, **on)
                outcomes[o.case.name] = o
                damping[level, constraints, value] = o.case.name
    plan = Plan(MOTIONS, tuple(o.case for o in outcomes.values()), damping, None)
    return Outcomes(plan, outcomes)


def raw_log(pairs: int, sample: int):
    """Ten samples, one of which has `pairs` penetrating pairs."""
    distances = np.full((10, 8), 0.1)
    distances[sample, :pairs] = -0.01
    q = np.zeros((10, 3))
    return small_log(
        time=np.arange(10.0),
        q=q,
        v=q,
        actuation=q,
        desired_acceleration=q,
        signed_distances=distances,
        pair_names=np.array([f"a{i} - b{i}" for i in range(8)]),
    )


def verdicts(changes: dict | None = None, raw=None) -> dict[tuple[str, str], bool]:
    """By source and the beginning of the statement."""
    findings = check_findings(made_up(changes), lambda *_: raw or raw_log(6, 7))
    found = {(f.source, f.statement): f.holds for f in findings}
    assert len(found) == len(findings) == 15
    for f in findings:
        assert f.figures and f.criterion
        assert f.verdict == ("holds" if f.holds else "does not hold")
    return found


def test_all_hold_in_data_made_for_them():
    assert all(verdicts().values())


@pytest.mark.parametrize(
    "where, change, failing",
    [
        (
            ("dance", "upper-body", "velocity"),
            {"penetrating": 1},
            {"Fig. 3", "Section V"},
        ),
        (("boxing", "wrists", "acceleration"), {"beyond_limit": 1}, {"Section V"}),
        (
            ("boxing", "wrists", "inertia"),
            {"mean_power": 130.0},
            {"Section IV, on Fig. 7"},
        ),
    ],
)
def test_a_verdict_turns_with_its_figure(where, change, failing):
    found = verdicts({where: change})
    assert {source for (source, _), held in found.items() if not held} == failing


def test_a_short_reproduction(tmp_path, capsys, monkeypatch):
    plan = make_plan(["dance"], duration=0.1, damping_factors=(0.1,))
    paper = load_scenario("paper").controller
    gains = {s.series: parse_scenario(s.scenario).controller for s in plan.simulations}
    assert gains["acceleration"] == paper
    monkeypatch.setattr(
        "benchmarks.section_iv.__main__.make_plan", lambda *_, **__: plan
    )
    monkeypatch.setattr(fresh_processes, "FreshProcesses", ThreadPoolExecutor)
    argv = ["--out", str(tmp_path), "--jobs", "1"]
    kept = tmp_path / "results.json"
    text = ""
    for _ in range(2):  # the second finds all that the first left
        main(argv)
        printed = capsys.readouterr().out
        assert "### The paper's findings" in printed and "does not hold" in printed
        assert "| dance | acceleration level | " in printed
        figures = sorted(path.stem for path in (tmp_path / "figures").iterdir())
        assert len(figures) == 12 and "figure-2" in figures
        assert text in ("", kept.read_text())
        text = kept.read_text()
        assert text.count('"case"') == len(plan.simulations)
