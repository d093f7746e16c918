"""Real robots of example-robot-data: close fits, and some of a real motion."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from crar_drake.judging.mesh_judge import MeshJudge
from crar_drake.judging.referee import Referee
from crar_drake.robot.description import import_file
from crar_drake.robot_import import import_robot, load_choices
from crar_drake.robot_import.capsule_fitting import EXCESS, fit_link
from crar_drake.robot_import.meshes import link_parts
from crar_drake.robot_import.robot_files import find_urdf
from crar_drake.robot_import.source_urdf import read_urdf
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario, load_scenario


@pytest.mark.parametrize(
    "robot, links",
    [
        ("g1_29dof_rev_1_0", {"torso_link": 6, "left_elbow_link": 3}),
        ("talos_full_v2", {"arm_left_4_link": 5, "base_link": 14}),
    ],
)
def test_fits_are_close(robot_data, robot, links):
    read = read_urdf(find_urdf(robot)[0])
    for link, most in links.items():
        fit = fit_link(link_parts(read.links[link]))
        assert fit.good(EXCESS) and len(fit.capsules) <= most


@pytest.mark.parametrize("robot", ["g1", "g1_whole_body", "talos", "talos_whole_body"])
def test_shipped_choices_fit_the_urdf(robot_data, robot):
    choices = load_choices(import_file(robot))
    read = read_urdf(find_urdf(choices.source)[0])
    named = {link for pair in choices.pairs for link in pair}
    named |= {frame.link for frame in choices.frames.values()}
    assert named <= set(read.links)
    assert set(choices.locked) <= set(read.joints)
    mimics = {j.name for j in read.joints.values() if j.mimic}
    assert mimics <= set(choices.locked)
    # Nothing is left to be guessed.
    for key in (
        "facing",
        "base",
        "locked",
        "segments",
        "frames",
        "rest_posture",
        "pairs",
    ):
        assert getattr(choices, key) is not None
    pairs = [frozenset(pair) for pair in choices.pairs]
    assert len(set(pairs)) == len(pairs)


@pytest.fixture(scope="module")
def imported(robot_data, tmp_path_factory):
    """The folder of a shipped robot's choices, imported once."""

    @cache
    def folder(robot: str, most: int) -> Path:
        made = tmp_path_factory.mktemp(robot)
        text = import_file(robot).read_text()
        (made / "import.yaml").write_text(text + f"most_capsules: {most}\n")
        import_robot("", made)
        return made

    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "robot, most, name, duration",
    [
        pytest.param("g1", 3, "g1_dance", 1.0, marks=pytest.mark.long),
        ("g1", 1, "g1_dance_hands", 0.4),
        pytest.param("talos", 3, "talos_boxing", 1.0, marks=pytest.mark.long),
    ],
)
def test_some_of_a_real_motion(imported, cmu, robot, most, name, duration):
    """Untouched by referee and real meshes, within limits, and efforts if asked for."""
    scenario: Scenario = load_scenario(name)
    scenario.robot, scenario.duration = str(imported(robot, most)), duration
    result = run_scenario(scenario, record=False)
    model, q = result.setup.model, result.log.q
    judged = Referee(model.plant, model.scene_graph, model.description.pairs)
    assert judged.violations(q[::10]).num_violated == 0
    assert MeshJudge(model.description).judge(q[::50]).num_penetrating == 0
    if scenario.controller.effort_limits:
        assert (np.abs(result.log.actuation) <= model.actuator_limits + 1e-9).all()
    assert result.summary.rms_task_error < 0.25


@pytest.mark.slow
@pytest.mark.parametrize(
    "robot, name",
    [
        ("g1_whole_body", "g1_standing"),
        pytest.param("talos_whole_body", "talos_standing", marks=pytest.mark.long),
    ],
)
def test_a_real_robot_stands(imported, cmu, robot, name):
    """On its soles, in contact, while its hands begin to follow a person's."""
    scenario: Scenario = load_scenario(name)
    scenario.robot, scenario.duration = str(imported(robot, 3)), 1.0
    result = run_scenario(scenario, record=False)
    stood = result.summary.stance
    assert stood.fell is None
    assert stood.lean < np.radians(5.0)
    assert stood.slide < 0.01 and stood.lift < 0.01
    assert result.summary.violated_samples == 0
    assert np.abs(result.log.q[-1] - result.log.q[0])[7:].max() > 0.1
