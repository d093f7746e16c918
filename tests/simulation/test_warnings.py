"""What a run says that is no mistake: of the motion, its end, and the rest posture."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from small_robots import chain_urdf

from crar_drake.commands import main
from crar_drake.law.parameters import PaperParameters
from crar_drake.motion.report import Break, MotionReport, inspect
from crar_drake.run import run_scenario
from crar_drake.simulation.diagram import PrepareScenario
from crar_drake.simulation.scenario import Scenario, load_scenario
from crar_drake.simulation.warnings import run_warnings

KEYFRAMES = "keyframes: {tip: [{time: 0, xyz: [1, 0, 0]}, {time: 0.3, xyz: [1, 0, 0]}]}"


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def arm(folder: Path, more: str, controller: str = "{}") -> Scenario:
    """A scenario of a chain of two links, whose joints have limits of 0.1 and 1.5."""
    (folder / "arm.urdf").write_text(chain_urdf("zz", limits=(0.1, 1.5), extra=""))
    (folder / "robot.yaml").write_text(
        f"name: arm\nmodel: arm.urdf\nbase: base\n{more}"
    )
    (folder / "s.yaml").write_text(
        f"robot: robot.yaml\ntasks: [{{frame: tip}}]\n{KEYFRAMES}\n"
        f"controller: {controller}\n"
    )
    return load_scenario(folder / "s.yaml")


def warnings(scenario: Scenario, recorded: bool = False) -> list[str]:
    setup = PrepareScenario(scenario)
    report = inspect(setup.motion.performer) if setup.motion.performer else None
    return run_warnings(scenario, setup, report, recorded=recorded)


@pytest.fixture(scope="module")
def dance():
    scenario = load_scenario("dance_wrists")
    return scenario, PrepareScenario(scenario)


def test_shipped_scenarios_give_no_warning(dance):
    assert warnings(load_scenario("obstacle_arm"), recorded=True) == []
    scenario, setup = dance
    report = inspect(setup.motion.performer)
    assert run_warnings(scenario, setup, report, recorded=True) == []


def test_targets_below_the_floor(dance):
    """Of a robot that a motion moves; the deepest of them, and when."""
    scenario, setup = dance
    layout = setup.model.layout

    def lower(context: Context, output: BasicVector) -> None:
        time = context.get_time()
        found = layout.unpack(setup.motion.tasks_at(time))
        p, zero = found.p.copy(), np.zeros(layout.m)
        p[1, 2] = 0.5 - 0.62 * np.exp(-((time - 1.0) ** 2))
        output.SetFromVector(layout.pack(found.R, p, zero, zero))

    lowered = LeafSystem()
    lowered.DeclareVectorOutputPort("desired_tasks", layout.size, lower)
    motion = replace(setup.motion, MakeTaskSource=lambda: lowered)
    deep = replace(setup, motion=motion)

    def lines(scenario: Scenario) -> list[str]:
        found = run_warnings(scenario, deep, None, recorded=False)
        return [line for line in found if "FLOOR" in line]

    (line,) = lines(scenario)
    assert line.startswith("targets BELOW THE FLOOR: that of right_wrist is 120 mm")
    assert " at 1.0" in line or " at 0.9" in line
    # Where the run ends before, and where no motion moves the robot.
    assert lines(replace(scenario, duration=0.3)) == []
    assert lines(replace(scenario, motion="")) == []


def test_findings_are_repeated_in_one_line(dance):
    scenario, setup = dance
    clean = inspect(setup.motion.performer)

    def line(report: MotionReport, **changes) -> str:
        (text,) = run_warnings(
            replace(scenario, **changes), setup, report, recorded=False
        )
        return text

    one = replace(clean, flips=(Break("rthumb", 3, 3.0), Break("rthumb", 9, 3.0)))
    assert line(one) == (
        "motion: 1 finding: rthumb flips 2 times; see crar-drake show dance"
    )
    many = replace(
        one, jumps=(Break("neck", 3, 0.1), Break("waist", 3, 0.1)), doubts=("a giant",)
    )
    text = line(many, motion="my walk.amc", skeleton="a.asf", frame_rate=59.94)
    assert text == (
        "motion: 4 findings: a giant; rthumb flips 2 times; and 2 more; see "
        "crar-drake show 'my walk.amc' --skeleton a.asf --frame-rate 59.94"
    )


def test_a_duration_beyond_the_end_says_what_happens_then(dance):
    scenario, setup = dance
    end = setup.motion.duration
    assert run_warnings(
        replace(scenario, duration=end), setup, None, recorded=False
    ) == []  # fmt: skip
    (line,) = run_warnings(
        replace(scenario, duration=end + 1.0), setup, None, recorded=False
    )
    assert f"the motion ends at {end:.2f} s" in line and "stand still" in line


def test_beyond_the_end_the_targets_do_stand_still(folder):
    """What the warning says, seen in the log."""
    scenario = replace(load_scenario("dance_wrists"), duration=0.4, frame_rate=4000.0)
    scenario.controller = PaperParameters(constraints="none")
    log = run_scenario(scenario).log
    end = PrepareScenario(scenario).motion.duration
    assert 0.1 < end < 0.3
    after = log.desired_tasks[log.time > end + 1e-3]
    assert len(after) > 90
    np.testing.assert_array_equal(after[:, 6:], 0.0)
    np.testing.assert_array_equal(after[:, :6], after[:1, :6].repeat(len(after), 0))


@pytest.mark.parametrize(
    "posture, words",
    [
        ("{j0: 1.7, j1: 0.5}", ["j0 at 1.700 is beyond its limit 1.500 rad"]),
        ("{j0: 0.5}", ["j1 at 0.000 is beyond its limit 0.100 rad"]),
        ("{j0: 2.0, j1: -1}", ["j0 at 2.000", "j1 at -1.000", "limit 0.100"]),
    ],
)
def test_a_rest_posture_beyond_a_limit_is_said(folder, posture, words):
    (line,) = warnings(arm(folder, f"rest_posture: {posture}\n"))
    assert line.startswith("rest_posture: ") and "correct robot.yaml" in line
    for word in words:
        assert word in line


def test_a_rest_posture_within_its_limits_is_not(folder):
    assert warnings(arm(folder, "rest_posture: {j0: 1.5, j1: 0.1}\n")) == []


def test_where_the_run_starts_then_is_said_as_it_is(folder):
    for posture in ("{j0: 1.7, j1: 0.5}", "{j0: 0.5, j1: 0.0}"):
        for constraints in ("lookahead", "none"):
            scenario = arm(
                folder,
                f"rest_posture: {posture}\n",
                f"{{constraints: {constraints}}}",
            )
            result = run_scenario(scenario)
            (line,) = result.summary.warnings
            log = result.log
            beyond = ((log.q < 0.1 - 1e-6) | (log.q > 1.5 + 1e-6)).any(axis=1)
            assert beyond[0] == ("the run starts beyond" in line)
            back = "the controller brings it back" in line
            assert back == (beyond[0] and constraints == "lookahead")
            if back:
                excess = np.maximum(log.q - 1.5, 0.1 - log.q).max(axis=1)
                assert excess[-1] < 0.5 * excess[0]


def test_the_command_prints_and_keeps_them(folder, capsys):
    arm(folder, "rest_posture: {j0: 1.7, j1: 0.5}\n")
    argv = ["run", "s.yaml", "--duration", "0.31", "--out", "it"]
    assert main(argv) == 1
    printed = capsys.readouterr().out
    summary = json.loads((folder / "it/summary.json").read_text())
    assert len(summary["warnings"]) == 3
    for line, beginning in zip(
        summary["warnings"],
        [
            "duration: the keyframes end at 0.30 s",
            "rest_posture: j0",
            "model chain has",
        ],
        strict=True,
    ):
        assert line.startswith(beginning)
        assert f"warning: {line}\n" in printed
    assert summary["frame_rate"] is None and summary["frame_rate_source"] == ""
