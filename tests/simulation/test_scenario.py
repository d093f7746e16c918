"""Scenario files: what is shipped, what is refused and how it is said."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from crar_drake.errors import ScenarioError
from crar_drake.law.parameters import PaperParameters
from crar_drake.robot.description import robot_names
from crar_drake.robot.task import EXPERIMENTS
from crar_drake.simulation.scenario import (
    Scenario,
    check_multiple,
    load_scenario,
    parse_scenario,
    scenario_names,
)
from crar_drake.targets.keyframes import Keyframe, keyframe_way

VALID = "motion: dance\nexperiment: wrists\n"


@pytest.mark.parametrize("name", scenario_names())
def test_shipped_scenarios_are_valid(name):
    scenario = load_scenario(name)
    assert scenario.description and scenario.robot in robot_names()
    assert scenario.task_list()


def test_shipped_scenarios_cover_the_paper():
    """Its two experiments, and another robot; other motions are options."""
    scenarios = [load_scenario(name) for name in scenario_names()]
    covered = {(s.motion, s.experiment) for s in scenarios if s.robot == "upper_body"}
    assert covered >= {("dance", e) for e in EXPERIMENTS}
    assert "paper" in scenario_names()
    assert any(s.robot != "upper_body" and s.keyframes for s in scenarios)


def test_by_path_by_name_and_by_path_of_a_shipped_one(tmp_path: Path):
    file = tmp_path / "mine.yaml"
    file.write_text(VALID + "duration: 3\n")
    assert load_scenario(file).duration == 3.0
    by_name, by_path = (
        load_scenario(name) for name in ("dance_wrists", "diagrams/dance_wrists.yaml")
    )
    assert by_name.to_yaml() == by_path.to_yaml()


def test_nested_values_keep_the_other_defaults():
    scenario = parse_scenario(
        VALID + "controller: {constraints: paper, Kp: 100, Kv: 9}\n"
        "plant_config: {time_step: 0.0005}\n"
        "simulator_config: {target_realtime_rate: 1.0}\n"
        "simulated_robot: {contact: true}"
    )
    assert (scenario.controller.Kp, scenario.controller.velocity_gain) == (100.0, 9.0)
    assert scenario.controller.Gv == PaperParameters().Gv
    assert scenario.plant_config.discrete_contact_approximation == "lagged"
    assert scenario.simulator_config.max_step_size == 1e-2
    assert scenario.simulator_config.target_realtime_rate == 1.0
    assert scenario.simulated_robot.contact
    assert not scenario.simulated_robot.effort_limits


@pytest.mark.parametrize("name", scenario_names())
def test_round_trip(name):
    scenario = load_scenario(name)
    assert parse_scenario(scenario.to_yaml()).to_yaml() == scenario.to_yaml()


REFUSED = [
    (VALID + "controller: {constraint: paper}", ["did you mean 'constraints'"]),
    (VALID + "controller: {balance: {frictoin: 1}}", ["'friction'"]),
    (VALID + "controller: {lookahead: {horizon: 1}}", ["unknown key 'lookahead'"]),
    (
        VALID + "controller: {respect_effort_limits: true}",
        ["'effort_limits'"],
    ),
    (VALID + "controller: {Kp: 100}", ["controller.Kp", "constraints: paper"]),
    (VALID + "controller: {constraints: qp}", ["none, paper, lookahead"]),
    (VALID + "simulated_robot: {contacts: true}", ["did you mean 'contact'"]),
    ("experiment: wrists", ["either motion", "neither"]),
    (VALID + "keyframes: {a: [{time: 0}, {time: 1}]}", ["either motion", "both"]),
    ("motion: dance", ["either experiment or tasks", "neither"]),
    (VALID + "tasks: [{frame: neck}]", ["either experiment or tasks", "both"]),
    ("motion: dance\nexperiment: wrist", ["wrist", "did you mean 'wrists'"]),
    ("motion: a\ntasks: [{frame: x, point: [1, 2]}]", ["point", "three"]),
    ("motion: a\ntasks: [{frame: x, kind: place}]", ["place", "orientation"]),
    (VALID + "duration: -1", ["duration"]),
    (VALID + "cutoff: 0", ["cutoff"]),
    (VALID + "log_period: 0", ["log_period"]),
    (VALID + "controller: {constraints: none, level: torque}", ["level", "velocity"]),
    (VALID + "controller: {nominal: {damping: -0.1}}", ["damping", "-0.1"]),
    (VALID + "controller: {constraints: paper, Kp: .nan}", ["controller.Kp"]),
    (VALID + "controller: {period: 0.0015}", ["controller.period", "0.001"]),
    (VALID + "controller: {period: 0.0005}", ["controller.period", "choose"]),
    (VALID + "plant_config: {time_step: -0.001}", ["plant_config.time_step"]),
]


@pytest.mark.parametrize("text, words", REFUSED)
def test_refused(text, words):
    """With the file's name, the key and a remedy, in less than a screenful."""
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, "my/file.yaml")
    message = str(caught.value)
    assert message.startswith("my/file.yaml: ") and len(message) < 500
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    "period, step", [(1e-3, 1e-3), (5e-3, 1e-3), (0.1, 1e-4), (0.0123, 0.0)]
)
def test_multiples(period, step):
    check_multiple("controller.period", period, step)


@pytest.mark.parametrize("period, step", [(1e-3, 2e-3), (2.5e-3, 1e-3), (1e-3, 0.6e-3)])
def test_no_multiples(period, step):
    with pytest.raises(ScenarioError, match=f"p: {period:g} s.*{step:g} s"):
        check_multiple("p", period, step)


def frames(*times: float, **changes) -> list[Keyframe]:
    return [Keyframe(time=t, **changes) for t in times]


@pytest.mark.parametrize(
    "keyframes, words",
    [
        (frames(0.0), ["at least two"]),
        (frames(0.0, 1.0, 1.0), ["increase"]),
        (frames(1.0, 0.0), ["increase"]),
        (frames(0.0, np.nan), ["increase"]),
        (frames(0.0, 1.0, xyz=[0.0, 0.0]), ["xyz", "three"]),
        (frames(0.0, 1.0, rpy_deg=[0.0, 0.0, np.inf]), ["rpy_deg"]),
    ],
)
def test_refused_keyframes(keyframes, words):
    with pytest.raises(ScenarioError) as caught:
        keyframe_way("tool", keyframes)
    for word in ["tool", *words]:
        assert word in str(caught.value)


def test_validate_of_a_scenario_made_in_python():
    with pytest.raises(ScenarioError, match="either motion"):
        Scenario(experiment="wrists").validate()
    Scenario(experiment="wrists", motion="dance").validate()


def test_paths_are_looked_for_beside_the_file(tmp_path, monkeypatch):
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "walk.amc").write_text("")
    (folder / "walk.yaml").write_text("motion: walk.amc\nexperiment: wrists\n")
    monkeypatch.chdir(tmp_path)
    assert load_scenario(folder / "walk.yaml").motion == str(folder / "walk.amc")


def test_another_start_time_is_refused():
    text = "motion: dance\nexperiment: wrists\nsimulator_config: {start_time: 1.0}\n"
    with pytest.raises(ScenarioError, match="start_time"):
        parse_scenario(text)


def test_a_log_of_another_drake_can_be_read():
    """Settings of Drake's own that nobody changed are not spelt out."""
    text = VALID + "plant_config: {time_step: 0.0005}\n"
    scenario = parse_scenario(text)
    assert yaml.safe_load(scenario.to_yaml())["plant_config"] == {"time_step": 0.0005}
    assert "visualization" not in scenario.to_yaml()
    assert parse_scenario(scenario.to_yaml()).to_yaml() == scenario.to_yaml()
    with pytest.raises(ScenarioError, match=r"simulator_config.new \(line "):
        parse_scenario(VALID + "simulator_config: {new: 1}\n")


def test_speed_limits_in_the_file():
    text = (
        "motion: dance\nexperiment: wrists\ncontroller:\n  velocity_scale: 0.5\n"
        "  velocity_limits: {left_elbow: 3, torso_yaw: .inf}\n"
    )
    controller = parse_scenario(text).controller
    assert controller.velocity_scale == 0.5
    assert controller.velocity_limits == {"left_elbow": 3.0, "torso_yaw": math.inf}
    again = parse_scenario(parse_scenario(text).to_yaml()).controller
    assert again == controller and again.effort_limits
    with pytest.raises(ScenarioError, match="left_elbow.*expected a number"):
        parse_scenario(text.replace("elbow: 3", "elbow: fast"))
    with pytest.raises(ScenarioError, match=r"velocity_limits\.left_elbow: -3.0 must"):
        parse_scenario(text.replace("elbow: 3", "elbow: -3"))


def test_long_runs_are_logged_at_a_lower_rate():
    scenario = Scenario()
    assert scenario.log_period_for(60.0) == 1e-3
    assert scenario.log_period_for(600.0) == pytest.approx(1e-2)
    assert scenario.log_period_for(61.0) == pytest.approx(2e-3)
    scenario.log_period = 0.05
    assert scenario.log_period_for(1.0) == 0.05
