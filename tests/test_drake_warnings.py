"""Drake's warnings: collected, told once and short, and whole where asked for."""

import logging
from pathlib import Path

import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint

from crar_drake.commands import main
from crar_drake.drake_warnings import (
    collected_warnings,
    recorded_warnings,
)
from crar_drake.fresh_processes import FreshProcesses

# Things that real robots have in their URDFs and Drake warns of: joint friction, an
# inertia that cannot be, and a safety controller.
HEAD = """<robot name="noisy">
<link name="base"/>
<link name="odd">
<inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="5"/></inertial>
</link>
<joint name="weld" type="fixed"><parent link="base"/><child link="odd"/>
<safety_controller k_position="1"/></joint>
"""
JOINT = """<link name="link{0}">
<inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="joint{0}" type="revolute"><parent link="base"/><child link="link{0}"/>
<dynamics damping="0" friction="{0}.5"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
"""


@pytest.fixture
def noisy(tmp_path: Path) -> Path:
    """A URDF in a folder of a long name, with 20 joints that Drake warns of."""
    folder = tmp_path / ("deep" * 20)
    folder.mkdir()
    path = folder / "noisy.urdf"
    path.write_text(HEAD + "".join(JOINT.format(i) for i in range(20)) + "</robot>")
    return path


def parse(path: Path) -> MultibodyPlant:
    plant = MultibodyPlant(1e-3)
    Parser(plant).AddModels(str(path))
    return plant


def test_many_warnings_are_a_few_short_lines(noisy, capfd):
    with collected_warnings():
        for _ in range(5):
            plant = parse(noisy)
        assert capfd.readouterr().err == ""  # not before the end
    assert isinstance(plant.GetJointByName("joint7"), RevoluteJoint)
    lines = capfd.readouterr().err.splitlines()
    assert "--verbose" in lines[0]
    assert len(lines) == 4 and all(len(line) <= 100 for line in lines)
    friction = next(line for line in lines if "'friction'" in line)
    assert friction.strip().startswith("20 x ") and "(noisy.urdf:" in friction
    inertia = next(line for line in lines if "inertia" in line)
    assert "x While" not in inertia  # five times the same is one
    assert "did not pass the test" in inertia and "(noisy.urdf:4)" in inertia
    assert "deepdeep" not in "".join(lines)


def test_verbose_is_drakes_own_output(noisy, caplog, capfd):
    """Which pytest has put its own handlers in the way of."""
    with collected_warnings(verbose=True):
        parse(noisy)
    assert caplog.text.count("'friction'") == 20 and str(noisy) in caplog.text
    assert "Drake warns" not in capfd.readouterr().err


def test_warnings_come_before_an_error_and_the_logger_is_as_before(noisy, capfd):
    logger = logging.getLogger("drake")
    before = (logger.handlers[:], logger.propagate)
    with pytest.raises(ZeroDivisionError), collected_warnings():
        parse(noisy)
        raise ZeroDivisionError
    assert (logger.handlers, logger.propagate) == before
    assert "'friction'" in capfd.readouterr().err


def test_many_kinds_are_cut(capfd):
    with collected_warnings():
        logging.getLogger("drake").info("Meshcat listens")
    assert capfd.readouterr().err == ""
    with collected_warnings():
        for kind in "abcdefghijklmnop":
            logging.getLogger("drake").warning(f"something {kind * 500}")
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 9 and "9 kinds more" in lines[-1]
    assert all(len(line) <= 100 for line in lines)


def test_a_fresh_process_hands_its_warnings_over(noisy, capfd):
    """Also one whose call fails; a percent sign in a path is only a character."""
    odd = noisy.with_name("100%s.urdf")
    odd.write_text(noisy.read_text())
    with recorded_warnings() as texts, FreshProcesses(2) as pool:
        calls = [pool.submit(parse_and_fail, path) for path in (noisy, odd)]
        for call in calls:
            with pytest.raises(ValueError, match="after parsing"):
                call.result()
    assert len(texts) == 44 and any("100%s.urdf" in text for text in texts)
    assert "friction" not in capfd.readouterr().err


def parse_and_fail(path: Path) -> None:
    parse(path)
    raise ValueError("after parsing")


def test_a_command_tells_them_once(noisy, tmp_path, monkeypatch, capfd):
    """A run parses its robot several times over."""
    monkeypatch.chdir(tmp_path)
    (noisy.parent / "robot.yaml").write_text(
        "name: noisy\nmodel: noisy.urdf\nbase: base\ntask_frames: {tool: link3}\n"
        "pairs: []\n"
    )
    # The inertia that cannot be would stop the simulation.
    noisy.write_text(noisy.read_text().replace('izz="5"', 'izz="1"'))
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(
        f"robot: {noisy.parent / 'robot.yaml'}\ntasks: [{{frame: tool}}]\n"
        "keyframes: {tool: [{time: 0}, {time: 1}]}\nduration: 0.01\n"
    )
    status = main(["run", str(scenario), "--no-page"])
    text = capfd.readouterr().err
    # It has no motors, of which the run tells after its warnings.
    assert status == 2 and text.count("'friction'") == 1 and "20 x " in text
