"""Which joints are legs, arms, hands and head, and which of them are locked."""

import re
import shutil

import numpy as np
import pytest
from small_urdfs import humanoid, write

from crar_drake.commands import main
from crar_drake.errors import ModelError
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import position_tasks
from crar_drake.robot_import import import_robot, load_choices
from crar_drake.robot_import.anatomy import find_anatomy
from crar_drake.robot_import.joint_groups import guess_locked, joint_groups
from crar_drake.robot_import.meshes import with_looks
from crar_drake.robot_import.robot_files import find_urdf
from crar_drake.robot_import.source_urdf import read_urdf

SIDES = ("left", "right")
FINGERS = {f"{side}_arm_finger_{i}" for side in SIDES for i in (1, 2)}


def groups_of(robot) -> dict[str, set[str]]:
    """Group to its joints."""
    robot = with_looks(robot)
    found: dict[str, set[str]] = {}
    for name, group in joint_groups(robot, find_anatomy(robot)).items():
        found.setdefault(group, set()).add(name)
    return found


def test_the_small_humanoid(tmp_path):
    robot = read_urdf(write(tmp_path, humanoid()))
    assert groups_of(robot) == {
        "trunk": {"waist_yaw"},
        "head": {"neck_joint"},
        "legs": {"left_hip", "right_hip"},
        "arms": {f"{side}_arm_{i}" for side in SIDES for i in range(1, 7)},
        "hands": FINGERS,
    }


@pytest.mark.parametrize(
    "name, legs, hands, head",
    [
        ("g1_29dof_with_hand_rev_1_0", 12, 14, 0),
        ("talos_full_v2", 12, 14, 2),
        ("romeo", 12, 0, 4),
    ],
)
def test_real_humanoids(robot_data, name, legs, hands, head):
    robot = read_urdf(find_urdf(name)[0])
    groups = groups_of(robot)
    assert len(groups["legs"]) == legs
    assert len(groups.get("head", ())) == head
    if hands:
        assert len(groups["hands"]) == hands
    words = ("leg", "hip", "knee", "ankle")
    assert all(any(w in n.lower() for w in words) for n in groups["legs"])


@pytest.mark.parametrize(
    "name", ["g1_29dof_with_hand_rev_1_0", "talos_full_v2", "panda", "tiago_dual"]
)
def test_by_default_all_is_locked_that_no_hand_hangs_on(robot_data, name):
    robot = read_urdf(find_urdf(name)[0])
    anatomy = find_anatomy(robot)
    if anatomy is None:
        return
    arms = (anatomy.left, anatomy.right)
    way = {j.name for arm in arms for j in robot.path_to(arm.joints[-1].child)}
    assert set(guess_locked(robot, anatomy)) == {
        joint.name
        for joint in robot.joints.values()
        if joint.kind != "fixed" and (joint.name not in way or not joint.moves)
    }


@pytest.mark.parametrize(
    "lock, locked",
    [
        ((), FINGERS),
        (("legs",), FINGERS | {"left_hip", "right_hip"}),
        (("head", "hands"), FINGERS | {"neck_joint"}),
    ],
)
def test_groups_are_locked_as_asked(tmp_path, lock, locked):
    """Fingers that follow each other are locked in any case."""
    path = write(tmp_path, humanoid())
    robot = with_looks(read_urdf(path))
    assert set(guess_locked(robot, find_anatomy(robot), lock)) == locked


def test_the_whole_body_is_controlled(tmp_path):
    path, out = write(tmp_path, humanoid()), tmp_path / "out"
    assert main(["import-robot", str(path), "--out", str(out), "--whole-body"]) == 0
    choices = load_choices(out / "import.yaml")
    assert choices.lock == [] and set(choices.locked) == FINGERS
    description = load_robot_description(out)
    model = ControlModel.FromDescription(description, position_tasks(["left_hand"]))
    assert {"left_hip", "right_hip", "neck_joint"} <= set(model.joint_names)
    assert "left_leg" in {link for pair in choices.pairs for link in pair}
    # Again, with and without saying so.
    before = (out / "import.yaml").read_text()
    import_robot("", out, lock=[])
    import_robot("", out)
    assert (out / "import.yaml").read_text() == before
    with pytest.raises(ModelError, match=r"is there already: write lock: \[legs\]"):
        import_robot("", out, lock=["legs"])


def test_the_ground_of_a_root_that_floats(tmp_path):
    """All links are kept above it, so far below the soles as pairs keep apart."""
    path, out = write(tmp_path, humanoid()), tmp_path / "out"
    import_robot(str(path), out, lock=[])
    file = out / "import.yaml"
    assert load_robot_description(out).ground is None
    file.write_text(re.sub("base: \\w+", "base: floating", file.read_text()))
    import_robot("", out)
    described = load_robot_description(out)
    assert load_choices(file).ground == described.ground == -0.005
    above = {a for a, b in described.pairs if b == "ground"}
    report = (out / "report.txt").read_text()
    (note,) = re.findall("ground at -5 mm: (.*)", report)
    model = ControlModel.FromDescription(described, position_tasks(["left_hand"]))
    heights = model.evaluate(
        model.MakeWorkspace(), model.rest_positions(), np.zeros(model.n + model.n_p)
    ).d[-len(above) :]
    assert heights.min() >= 0.005 - 1e-6
    assert note.startswith(f"{len(above)} links are watched against it")
    file.write_text(file.read_text().replace("ground: -0.005", "ground: -.inf"))
    import_robot("", out)
    without = load_robot_description(out)
    assert without.ground is None
    assert without.pairs == [p for p in described.pairs if p[1] != "ground"]
    assert described.without_ground() == without


def test_an_import_that_says_what_is_locked_keeps_it(imported, tmp_path):
    folder = tmp_path / "again"
    shutil.copytree(imported.folder, folder)
    before = (folder / "import.yaml").read_text()
    with pytest.raises(ModelError, match="is there already"):
        import_robot("", folder, lock=[])
    assert (folder / "import.yaml").read_text() == before


def test_a_group_that_is_none(tmp_path, capsys):
    path, out = write(tmp_path, humanoid()), tmp_path / "out"
    assert main(["import-robot", str(path), "--out", str(out), "--lock", "tail"]) == 2
    assert "lock: 'tail' is none of legs, arms" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    "robot, options, told",
    [
        ("g1", ["--whole-body"], "g1_29dof_rev_1_0"),
        ("g1_whole_body", ["--base", "fixed"], "comes with its base"),
    ],
)
def test_a_shipped_robot_has_its_own(
    robot_data, tmp_path, capsys, robot, options, told
):
    out = tmp_path / "out"
    assert main(["import-robot", robot, "--out", str(out), *options]) == 2
    assert told in capsys.readouterr().err
    assert not out.exists()
