"""A log finds its robot again, or says what it looked for and where."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from crar_drake.commands import main
from crar_drake.errors import ModelError, ScenarioError
from crar_drake.resources import data_folder
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_robot
from crar_drake.results.summary import summarize
from crar_drake.robot import description as robot_description
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import load_scenario, parse_scenario

SHIPPED = (data_folder("diagrams") / "obstacle_arm.yaml").read_text()


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with a robot of its own and a scenario that names it relatively."""
    folder = tmp_path / "project"
    shutil.copytree(data_folder("models") / "obstacle_arm", folder / "robots" / "arm")
    for name, robot in (("folder", "robots/arm"), ("file", "robots/arm/robot.yaml")):
        text = SHIPPED.replace("robot: obstacle_arm", f"robot: {robot}")
        assert robot in text
        (folder / f"{name}.yaml").write_text(text)
    return folder


def run(scenario: str) -> None:
    """From the working directory; leaves log/log.npz there."""
    argv = ["run", scenario, "--duration", "0.05", "--no-page", "--out", "log"]
    assert main(argv) == 0


@pytest.mark.parametrize("scenario", ["folder", "file"])
def test_playback_and_judge_from_another_folder(
    scenario, project, tmp_path, monkeypatch, capsys, refused
):
    # The scenario is named relatively, too, from a third place.
    (project / "runs").mkdir()
    monkeypatch.chdir(project / "runs")
    run(f"../{scenario}.yaml")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    log = "../project/runs/log/log.npz"
    assert capsys.readouterr().out.startswith("arm following keyframes")
    assert main(["judge", log]) == 0
    assert "0 in penetration" in capsys.readouterr().out
    assert main(["show", log, "--out", "page.html"]) == 0
    assert (elsewhere / "page.html").stat().st_size > 100_000


def test_a_robot_that_moved_is_named_and_can_be_given(
    project, tmp_path, monkeypatch, capsys, refused
):
    monkeypatch.chdir(project)
    run("folder.yaml")
    capsys.readouterr()
    moved = (project / "robots").rename(tmp_path / "moved")
    monkeypatch.chdir(tmp_path)
    for command in ("judge", "show"):
        message = refused(command, "project/log/log.npz")
        assert str(project / "robots" / "arm" / "robot.yaml") in message
        assert "--robot" in message
    argv = ["judge", "project/log/log.npz", "--robot", str(moved / "arm")]
    assert main(argv) == 0
    assert "0 in penetration" in capsys.readouterr().out
    # Another robot than that of the run is told from it.
    assert "nor a frame 'tool'" in refused(*argv[:-1], "upper_body")


def test_a_name_stays_a_name(monkeypatch, tmp_path):
    """What is shipped is found by its name, wherever it is installed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "obstacle_arm").mkdir()  # not a robot
    scenario = load_scenario("obstacle_arm")
    scenario.duration = 0.01
    log = run_scenario(scenario).log
    assert parse_scenario(log.scenario).robot == "obstacle_arm"
    assert load_logged_robot(log).name == "obstacle_arm"


def test_an_import_that_is_not_in_the_cache_names_the_command(
    tmp_path, monkeypatch, refused
):
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario("obstacle_arm")
    scenario.duration = 0.01
    log = run_scenario(scenario).log
    monkeypatch.setattr(
        robot_description, "imported_robots_folder", lambda: Path("nowhere")
    )
    for robot, command in (
        ("g1", "crar-drake import-robot g1"),  # its import file is shipped
        ("romeo", "crar-drake import-robot romeo"),
    ):
        imported = log.scenario.replace("robot: obstacle_arm", f"robot: {robot}")
        replace(log, scenario=imported).save("log.npz")
        for argv in (["judge", "log.npz"], ["show", "log.npz"]):
            assert command in refused(*argv)
        Path("s.yaml").write_text(f"robot: {robot}\nmotion: dance\nexperiment: wrists")
        assert command in refused("run", "s.yaml")
    assert not Path("playback.html").exists()


def test_a_mistyped_path_says_where_it_was_looked_for(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = project / "wrong.yaml"
    file.write_text(SHIPPED.replace("robot: obstacle_arm", "robot: robots/leg"))
    with pytest.raises(ScenarioError) as caught:
        load_scenario(file)
    for words in ("robots/leg", str(project), str(tmp_path)):
        assert words in str(caught.value)


def test_a_robot_that_changed_is_refused(project, monkeypatch, capsys, refused):
    monkeypatch.chdir(project)
    run("folder.yaml")
    capsys.readouterr()
    description = project / "robots" / "arm" / "robot.yaml"
    lines = description.read_text().splitlines(keepends=True)
    last_pair = max(i for i, line in enumerate(lines) if line.startswith("  - ["))
    description.write_text("".join(lines[:last_pair] + lines[last_pair + 1 :]))
    log = SimulationLog.load("log/log.npz")
    assert len(load_logged_robot(log).pairs) == len(log.pair_names) - 1
    for command in ("judge", "show"):
        message = refused(command, "log/log.npz")
        assert "14 watched pairs but robot obstacle_arm 13" in message
    with pytest.raises(ModelError, match="no robot 'gone'"):
        load_logged_robot(log, robot="gone")


def test_the_figures_of_a_run_are_those_of_its_log(project, monkeypatch):
    monkeypatch.chdir(project)
    scenario = replace(load_scenario("folder.yaml"), duration=0.05)
    before = scenario.to_yaml()
    result = run_scenario(scenario, "it", record=False)
    assert scenario.to_yaml() == before
    again = summarize(
        SimulationLog.load("it/log.npz"),
        result.summary.wall_time,
        warnings=result.summary.warnings,
    )
    written = json.loads(Path("it/summary.json").read_text())
    assert written == json.loads(again.to_json())
    assert Path(written["robot"]).is_absolute()
