"""`run` with another robot, and with what is no scenario."""

import shutil
from pathlib import Path

import pytest
from small_walker import walker

from crar_drake.commands import main
from crar_drake.errors import ModelError
from crar_drake.resources import data_folder
from crar_drake.results.log import SimulationLog
from crar_drake.simulation.diagram import PrepareScenario
from crar_drake.simulation.scenario import Scenario, parse_scenario
from crar_drake.teleoperation.serving import make_server


@pytest.fixture(autouse=True)
def empty_folder(tmp_path, monkeypatch):
    """Each test runs in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_run_takes_a_robot_a_motion_and_an_experiment(empty_folder, capsys):
    shutil.copytree(data_folder("models") / "upper_body", empty_folder / "mine")
    argv = ["run", "--robot", "mine", "--motion", "boxing", "--tasks", "wrists"]
    assert main([*argv, "--duration", "0.05", "--no-page"]) == 0
    log = SimulationLog.load("out/dance_boxing_mine_wrists/log.npz")
    scenario = parse_scenario(log.scenario)
    assert Path(scenario.robot) == empty_folder / "mine"
    assert (scenario.motion, scenario.experiment) == ("boxing", "wrists")
    assert scenario.controller.constraints == "lookahead"
    # A robot alone names its folder, too.
    argv = ["run", "dance_wrists", "--robot", "mine", "--duration", "0.05"]
    assert main([*argv, "--no-page"]) == 0
    assert (empty_folder / "out/dance_wrists_mine/log.npz").is_file()


@pytest.mark.parametrize("command", ["run", "play"])
@pytest.mark.parametrize("before", [[], ["--motion"]])
def test_a_robots_own_motion_is_recognised(command, before, empty_folder, refused):
    (empty_folder / "dance.csv").write_text("0,0,0.7,0,0,0,1,0.1,0.2\n" * 3)
    told = refused(command, *before, "dance.csv")
    assert "dance.csv is a motion of a robot's own joints" in told
    assert "crar-drake judge" in told and "crar-drake clean" in told


def test_a_persons_motion_is_no_scenario(empty_folder, refused):
    (empty_folder / "walk.bvh").write_text("HIERARCHY\n")
    told = refused("run", "walk.bvh")
    assert "give it as --motion walk.bvh" in told


def test_a_base_that_floats_is_refused_where_the_law_moves_it(empty_folder, refused):
    """By its name, and with what to do instead."""
    (empty_folder / "mine").mkdir()
    walker(empty_folder / "mine")
    told = refused("run", "--robot", "mine")
    assert "root: prescribed: its base 'pelvis' floats" in told
    assert "root: fixed" in told and "crar-drake retarget" in told
    with pytest.raises(ModelError, match="'pelvis' floats"):
        PrepareScenario(Scenario(robot="mine", motion="dance", experiment="wrists"))
    with pytest.raises(ModelError, match="'pelvis' floats"):
        make_server("dance", robot="mine", port=0)
