"""A whole humanoid is imported on a root that floats; a key and an option say else."""

import numpy as np
import pytest
from small_urdfs import humanoid, humanoid_with_legs, write

from crar_drake.errors import ModelError
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import position_tasks
from crar_drake.robot_import import import_robot

HEIGHT = 0.75 + 0.70  # of the pelvis: hips, legs, and the shins' cylinders below [m]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    write(folder, humanoid_with_legs())
    return folder


@pytest.fixture(scope="module")
def imported(folder):
    urdf, out = folder / "small.urdf", folder / "out"
    return import_robot(urdf, out, most_capsules=1, lock=[], pairs=[])


def test_it_floats_at_its_standing_height(imported):
    assert imported.choices.base == "floating"
    assert "legs" in imported.guessed["base"]
    description = load_robot_description(imported.folder)
    assert (description.root, description.base) == ("prescribed", "pelvis")
    assert not description.prescribed_joints
    assert "waist_z" not in description.rest_posture
    model = ControlModel.FromDescription(description, position_tasks(["left_foot"]))
    assert model.floats
    assert model.plant.num_positions() == model.plant.num_velocities() + 1
    legs = {f"{s}_{j}_joint" for s in ("left", "right") for j in ("knee", "ankle")}
    assert legs <= set(model.joint_names)
    robot = WholeBody(description)
    assert robot.root == "pelvis"
    # Its lowest point is on the floor: the shins' cylinders, which hang straight.
    z = description.root_pose.xyz[2]
    np.testing.assert_allclose(description.root_pose.xyz[:2], 0.0)
    assert z == pytest.approx(HEIGHT, abs=0.02)
    for point in ("hip", "knee", "foot"):
        assert f"left_{point}" in description.task_frames


def test_facing_turns_the_root_at_rest(folder, tmp_path):
    choices = {"facing": "-x", "base": "floating", "pairs": [], "frames": {}}
    choices |= {"most_capsules": 1, "rest_posture": {"waist_z": 1.0}}
    import_robot(folder / "small.urdf", tmp_path, **choices)
    pose = load_robot_description(tmp_path).root_pose
    np.testing.assert_allclose(pose.xyz, [0.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(np.abs(pose.rpy), [0.0, 0.0, np.pi], atol=1e-6)


def test_without_legs_or_with_a_key_it_does_not_float(tmp_path):
    short = tmp_path / "short"
    urdf = write(short, humanoid())
    report = import_robot(urdf, short, most_capsules=1, lock=[], pairs=[])
    assert report.choices.base == "prescribed"
    # What the file says is kept, and an option does not change it.
    with pytest.raises(ModelError, match="write base: floating into it"):
        file = short / "import.yaml"
        assert "base: prescribed" in file.read_text()
        import_robot("", short, base="floating")
