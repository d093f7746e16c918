"""A robot that looks another way than +x is found, and turned."""

import numpy as np
import pytest
from small_urdfs import humanoid, joint, link, robot, write

from crar_drake.errors import ModelError
from crar_drake.robot.description import load_robot_description, robot_diagram
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS, position_tasks
from crar_drake.robot_import import import_robot
from crar_drake.robot_import.anatomy import find_anatomy, find_leg_chains
from crar_drake.robot_import.body_frames import guess_frames
from crar_drake.robot_import.facing import (
    guess_facing,
    side_of_names,
    turned,
)
from crar_drake.robot_import.meshes import with_looks
from crar_drake.robot_import.robot_files import find_urdf
from crar_drake.robot_import.source_urdf import read_urdf

YAW = {"+x": 0.0, "+y": np.pi / 2, "-x": np.pi, "-y": -np.pi / 2}


def looking(facing: str, text: str) -> str:
    """The robot on a root link of its own, whose axis `facing` it looks along."""
    weld = (
        '<joint name="turned" type="fixed"><parent link="stand"/>'
        f'<child link="pelvis"/><origin rpy="0 0 {YAW[facing]}"/></joint>'
    )
    return text.replace("</robot>", f"{link('stand', mass=0.0)}{weld}</robot>")


def with_feet(text: str) -> str:
    """Shins and feet for the small humanoid, toes ahead."""
    parts = []
    for side in ("left", "right"):
        parts += [
            link(f"{side}_shin"),
            joint(f"{side}_knee", f"{side}_leg", f"{side}_shin", xyz="0 0 -0.35"),
            link(f"{side}_foot", '<box size="0.2 0.08 0.04"/>', "0.05 0 -0.03"),
            joint(f"{side}_ankle", f"{side}_shin", f"{side}_foot", xyz="0 0 -0.3"),
        ]
    return text.replace("</robot>", "".join(parts) + "</robot>")


def nameless(text: str) -> str:
    return text.replace("left", "first").replace("right", "other")


def guess(folder, text: str):
    read = with_looks(read_urdf(write(folder, text)))
    return read, guess_facing(read)


@pytest.mark.parametrize("facing", YAW)
def test_names_say_it(tmp_path, facing):
    read, found = guess(tmp_path, looking(facing, humanoid()))
    assert (found.facing, found.doubt) == (facing, "")
    assert "names" in found.why and "feet" not in found.why
    there = turned(read, found.facing)
    frames, X = guess_frames(there, find_anatomy(there)), there.poses()
    shoulder = frames["left_shoulder"]
    p_F = X[shoulder.link].multiply(np.array(shoulder.point))
    np.testing.assert_allclose(p_F, [0, 0.2, 0.4], atol=1e-5)
    assert shoulder.link.startswith("left")


@pytest.mark.parametrize("facing", YAW)
def test_feet_say_it(tmp_path, facing):
    read, found = guess(tmp_path, looking(facing, nameless(with_feet(humanoid()))))
    assert (found.facing, found.doubt) == (facing, "")
    assert "feet" in found.why and "names" not in found.why
    there = turned(read, facing)
    feet = {"first_foot", "other_foot"}
    legs = find_leg_chains(there, find_anatomy(there)) or ()
    assert {leg.joints[-1].child for leg in legs} == feet


def test_nothing_says_it(tmp_path):
    _, found = guess(tmp_path, looking("-x", nameless(humanoid())))
    assert found.facing == "+x" and "neither names nor feet" in found.doubt


def test_names_and_feet_contradict_each_other(tmp_path):
    text = with_feet(humanoid()).replace("0.05 0 -0.03", "-0.05 0 -0.03")
    _, found = guess(tmp_path, text)
    assert found.facing == "+x" and "contradict" in found.doubt


def test_no_arms(tmp_path):
    text = robot([link("a"), link("b"), joint("j", "a", "b")])
    _, found = guess(tmp_path, text)
    assert found.facing == "+x" and not found.doubt


@pytest.mark.parametrize(
    "a, b, side",
    [
        ("left_arm_1", "right_arm_1", 1),
        ("RARM_LINK4", "LARM_LINK4", -1),
        ("AL3", "AR3", 1),
        ("arml_wri2", "armr_wri2", 1),
        ("arm_1", "arm_2", 0),
        ("lower", "lower_b", 0),
    ],
)
def test_side_of_names(a, b, side):
    assert side_of_names(a, b) == side


def left_hand(folder) -> np.ndarray:
    """Where it is in the world, with all joints at zero."""
    _, plant, _ = robot_diagram(load_robot_description(folder))
    context = plant.CreateDefaultContext()
    return plant.GetBodyByName("left_arm_hand").EvalPoseInWorld(context).translation()


def test_the_imported_robot_looks_along_x(tmp_path):
    """Its left hand is at +y, and `facing` in the file overrides the guess."""
    urdf = write(tmp_path, looking("-x", humanoid()))
    file = tmp_path / "import.yaml"
    report = import_robot(urdf, tmp_path, most_capsules=1)
    assert report.choices.facing == "-x" and "facing: -x" in file.read_text()
    assert any("turned to face +x" in note for note in report.notes)
    tasks = position_tasks(EXPERIMENTS["upper-body"])
    description = load_robot_description(tmp_path)
    model = ControlModel.FromDescription(description, tasks)
    context = model.plant.CreateDefaultContext()
    model.plant.SetPositions(context, model.rest_positions())

    def p_W(name: str) -> np.ndarray:
        return model.plant.GetBodyByName(name).EvalPoseInWorld(context).translation()

    elbow, hand = p_W("left_arm_fore"), p_W("left_arm_hand")
    assert elbow[1] > 0.15
    assert hand[0] > elbow[0] + 0.1  # the elbow bends forward
    out = tmp_path / "against"
    import_robot(urdf, out, most_capsules=1, facing="+x", base="fixed", pairs=[])
    assert left_hand(out)[1] < -0.15


def test_a_fixed_base_is_turned_too(tmp_path):
    urdf = write(tmp_path, looking("+y", humanoid()))
    import_robot(urdf, tmp_path, most_capsules=1, base="fixed", pairs=[])
    np.testing.assert_allclose(left_hand(tmp_path)[:2], [0.0, 0.2], atol=1e-6)


def test_refused(tmp_path):
    with pytest.raises(ModelError, match="facing: 'north' is none of"):
        import_robot(write(tmp_path, humanoid()), tmp_path, facing="north")


@pytest.mark.parametrize(
    "name, facing", [("icub", "-x"), ("romeo", "+x"), ("talos_full_v2", "+x")]
)
def test_real_robots(robot_data, name, facing):
    read = read_urdf(find_urdf(name)[0])
    assert guess_facing(read).facing == facing
