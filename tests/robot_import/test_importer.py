"""The imported folder: what Drake reads of it, what is kept, what is refused."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from small_urdfs import humanoid, humanoid_with_legs, joint, link, robot, write

from crar_drake.errors import ModelError
from crar_drake.judging.referee import Referee
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS, position_tasks
from crar_drake.robot_import import import_robot, load_choices
from crar_drake.robot_import.robot_folder import DESCRIPTION
from crar_drake.targets.motion import segment_lengths

TASKS = position_tasks(EXPERIMENTS["upper-body"])
WAIST = ["waist_x", "waist_y", "waist_z", "waist_heading"]


@pytest.fixture(scope="module")
def model(imported) -> ControlModel:
    return ControlModel.FromDescription(load_robot_description(imported.folder), TASKS)


def source_model(folder: Path):
    """The URDF as Drake reads it itself: the independent source."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModels(str(folder / "small.urdf"))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("pelvis"))
    plant.Finalize()
    return plant


def test_joints(model):
    assert set(model.prescribed_names) == set(WAIST)
    arms = [f"{s}_arm_{i}" for s in ("left", "right") for i in range(1, 7)]
    assert set(model.joint_names) == {"waist_yaw", *arms}
    elbow = model.joint_names.index("left_arm_4")
    assert (model.lower[elbow], model.upper[elbow]) == (-2.2, 0.0)
    v = model.controlled[elbow]
    assert model.effort_limits[v] == 20.0
    assert model.velocity_limits[v] == 5.0
    assert np.isfinite(model.velocity_limits[model.controlled]).all()
    assert np.isinf(model.velocity_limits[model.prescribed]).all()
    assert np.isinf(model.effort_limits[model.prescribed]).all()


def test_it_moves_as_the_source_does(imported, model):
    """Poses and inverse dynamics are those of the URDF itself, read by Drake."""
    source = source_model(imported.folder)
    rng = np.random.default_rng(0)
    theirs, ours = source.CreateDefaultContext(), model.plant.CreateDefaultContext()
    for name in model.joint_names:
        q = rng.uniform(-1.0, 0.0)
        source.GetJointByName(name).set_angle(theirs, q)
        model.plant.GetJointByName(name).set_angle(ours, q)
    for body in ("left_arm_hand", "right_arm_finger", "head", "right_leg"):
        X_source = source.GetBodyByName(body).EvalPoseInWorld(theirs)
        X_ours = model.plant.GetBodyByName(body).EvalPoseInWorld(ours)
        assert X_ours.IsNearlyEqualTo(X_source, 1e-6)
    gravity = source.CalcGravityGeneralizedForces(theirs)
    here = model.plant.CalcGravityGeneralizedForces(ours)
    for name in model.joint_names:
        there = gravity[source.GetJointByName(name).velocity_start()]
        mine = here[model.plant.GetJointByName(name).velocity_start()]
        assert mine == pytest.approx(there, abs=1e-6)


def test_pairs_are_clear_at_rest_and_can_meet(imported, model):
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    assert (referee.distances(model.rest_positions()) > 5e-3).all()
    rng = np.random.default_rng(5)
    lower = np.maximum(model.plant.GetPositionLowerLimits(), -np.pi)
    upper = np.minimum(model.plant.GetPositionUpperLimits(), np.pi)
    q = rng.uniform(lower, upper, size=(300, len(lower)))
    least = np.min([referee.distances(row) for row in q], axis=0)
    assert np.mean(least < 0.05) > 0.8
    pairs = {frozenset(pair) for pair in model.description.pairs}
    assert frozenset(("left_arm_hand", "head")) in pairs
    assert frozenset(("left_arm_hand", "left_arm_finger")) not in pairs
    assert frozenset(("left_leg", "right_leg")) not in pairs


def test_fingers_are_one_with_the_hand(imported):
    segments = load_choices(imported.folder / "import.yaml").segments
    for side in ("left", "right"):
        fingers = [f"{side}_arm_finger", f"{side}_arm_thumb"]
        assert segments[f"{side}_arm_hand"] == fingers
        assert not set(fingers) & set(imported.fits)


def test_a_forearm_is_fitted_as_a_forearm(tmp_path):
    """Where no wrist moves (H1), hand and forearm are one body and two segments."""
    text = humanoid()
    for side in ("left", "right"):
        for index in (5, 6):
            name = f'<joint name="{side}_arm_{index}" type='
            text = text.replace(f'{name}"revolute"', f'{name}"fixed"')
    path = write(tmp_path, text)
    report = import_robot(str(path), tmp_path / "out")
    assert report.choices.segments == {}
    for name, length in (("left_arm_fore", 0.16), ("left_arm_hand", 0.12)):
        points = [(c.p_L0, c.p_L1) for c in report.fits[name].capsules]
        # Capsules of a link are as long as it is, not as it and the other.
        assert np.ptp(np.array(points).reshape(-1, 3)[:, 2]) <= length


def test_corrections_are_kept(imported, tmp_path):
    folder = tmp_path / "again"
    shutil.copytree(imported.folder, folder)
    file = folder / "import.yaml"
    before = file.read_text()
    import_robot("", folder)
    assert file.read_text() == before
    # The head is freed; the pairs are to be guessed again.
    text = before.replace("  neck_joint: 0.0\n", "")
    link = next(iter(imported.fits))
    sole = {link: [[0.1, 0.0, -0.2], [0.0, 0.1, -0.2], [0.0, -0.1, -0.2]]}
    text = f"soles: {sole}\n{text}"
    file.write_text(text[: text.index("# watched segment pairs")])
    report = import_robot("", folder)
    assert set(report.guessed) == {"pairs"}
    assert "neck_joint" not in load_choices(file).locked
    assert file.read_text().startswith(text[: text.index("# watched")].rstrip())
    model = load_robot_model(folder)
    assert "neck_joint" in model.joint_names and model.description.soles == sole


def load_robot_model(folder: Path) -> ControlModel:
    return ControlModel.FromDescription(load_robot_description(folder), TASKS)


def test_locked_joints_are_welded_where_the_file_says(imported, tmp_path):
    folder = tmp_path / "sitting"
    shutil.copytree(imported.folder, folder)
    file = folder / "import.yaml"
    file.write_text(file.read_text().replace("left_hip: 0.0", "left_hip: -1.2"))
    import_robot("", folder)
    ours, source = load_robot_model(folder).plant, source_model(imported.folder)
    theirs = source.CreateDefaultContext()
    source.GetJointByName("left_hip").set_angle(theirs, -1.2)
    expected = source.GetBodyByName("left_leg").EvalPoseInWorld(theirs)
    context = ours.CreateDefaultContext()
    pose = ours.GetBodyByName("left_leg").EvalPoseInWorld(context)
    assert pose.IsNearlyEqualTo(expected, 1e-6)


def test_an_arm_is_fixed_and_has_a_tool(tmp_path):
    parts = [link("base", '<sphere radius="0.1"/>')]
    names = ["base", *(f"l{i}" for i in range(5))]
    for i, name in enumerate(names[1:]):
        parts += [
            link(name, '<capsule radius="0.03" length="0.1"/>', "0 0 0.1", mass=i),
            joint(f"j{i}", names[i], name, "0 1 0", "0 0 0.2"),
        ]
    path = write(tmp_path, robot(parts))
    (tmp_path / "out").mkdir()
    report = import_robot(path, tmp_path / "out")
    description = load_robot_description(tmp_path / "out")
    assert description.base == "base"
    assert description.task_frames == {"tool": "tool_point"}
    assert report.choices.frames["tool"].link == "l4"
    # The first link had no mass although it moves.
    assert any("l0" in note and "moves" in note for note in report.notes)
    assert any(
        "the tool at the end" in how and "needs waist" in how
        for how in report.guessed.values()
    )


@pytest.mark.parametrize("declared", [True, False])
def test_a_root_named_world_is_the_world(tmp_path, declared):
    """So many arms have it; Drake welds such a link itself, and knows it undeclared."""
    parts = [link("world", mass=0.0)] if declared else []
    for i, below in enumerate(["world", "l0", "l1"]):
        parts += [
            link(f"l{i}", '<capsule radius="0.03" length="0.1"/>', "0 0 0.1"),
            joint(f"j{i}", below, f"l{i}", "0 1 0", "0 0 0.2"),
        ]
    urdf = write(tmp_path, robot(parts))
    import_robot(urdf, tmp_path, most_capsules=1)
    description = load_robot_description(tmp_path)
    model = ControlModel.FromDescription(description, position_tasks(["l2"]))
    source = Parser(plant := MultibodyPlant(0.0))
    source.AddModels(str(tmp_path / "small.urdf"))
    plant.Finalize()
    assert model.plant.num_velocities() == plant.num_velocities() == 3
    assert model.plant.CalcTotalMass(
        model.plant.CreateDefaultContext()
    ) == pytest.approx(plant.CalcTotalMass(plant.CreateDefaultContext()))
    with pytest.raises(ModelError, match="'world', which cannot move; write fixed"):
        import_robot(urdf, tmp_path / "moved", base="prescribed")


def two_joints(extra: str = "", **options) -> str:
    parts = [link("a", '<sphere radius="0.1"/>'), link("b"), link("c")]
    parts += [joint("ab", "a", "b", **options), joint("bc", "b", "c", extra=extra)]
    return robot(parts)


@pytest.mark.parametrize(
    "text, choices, words",
    [
        (two_joints('<mimic joint="ab"/>'), "locked: {}", ["'bc' mimics 'ab'", "lock"]),
        (
            two_joints('<mimic joint="ab"/>'),
            "locked: {bc: 0.0}",
            ["'ab' is mimicked by 'bc'", "locked, too"],
        ),
        (two_joints(kind="planar"), "locked: {}", ["'ab' is planar", "locked"]),
        (
            two_joints().replace("revolute", "fixed"),
            "locked: {}",
            ["small.urdf: no joint of it moves"],
        ),
        (two_joints(), "locked: {ab: 0.0, bc: 0.0}", ["no joint is left"]),
        (two_joints(), "locked: {ab: 3.0}", ["ab: 3 is beyond"]),
        (two_joints(), "locked: {abc: 0.0}", ["abc", "did you mean"]),
        (two_joints(), "frames: {waist: {link: aa}}", ["waist", "'aa'"]),
        (two_joints(), "segments: {a: [b]}", ["'b' is not welded to 'a'"]),
        (two_joints(), "pairs: [[a, d]]", ["'d' has no collision shape"]),
        (two_joints(), "rest_posture: {cb: 1.0}", ["rest_posture", "cb"]),
        (
            two_joints(),
            "soles: {d: [[0, 0, 0], [1, 0, 0], [0, 1, 0]]}",
            ["soles", "no link 'd'"],
        ),
        (two_joints(), "soles: {c: [[0, 0, 0]]}", ["soles: c", "three corners"]),
        (two_joints(), "base: float", ["base", "float", "floating", "prescribed"]),
        (two_joints(), "lcoked: {}", ["lcoked", "did you mean 'locked'"]),
    ],
)
def test_refused(tmp_path, text, choices, words):
    write(tmp_path, text)
    (tmp_path / "import.yaml").write_text(f"source: small.urdf\n{choices}\n")
    with pytest.raises(ModelError) as caught:
        import_robot("", tmp_path)
    for word in words:
        assert word in str(caught.value)
    assert not (tmp_path / DESCRIPTION).exists()


def test_a_folder_belongs_to_one_robot(imported, tmp_path):
    other = write(tmp_path, humanoid(), "other.urdf")
    with pytest.raises(ModelError, match="was made from small.urdf"):
        import_robot(other, imported.folder)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"most_capsules": 3}, "is there already: write most_capsules: 3 into it and"),
        ({"facing": "-y"}, "is there already: write facing: -y into it"),
        ({"pairs": [("head", "pelvis")]}, "is there already: write your pairs into it"),
        ({"locked": {"neck": 1.0}}, "is there already: write your locked into it"),
        ({"name": "other"}, "is there already: write name: other into it"),
        ({"pair": []}, "pair: unknown key of an import; did you mean 'pairs'"),
        ({"cap": 1}, "cap: unknown key of an import"),
    ],
)
def test_nothing_that_is_given_is_dropped(imported, given, message):
    before = contents(imported.folder)
    with pytest.raises(ModelError, match=message):
        import_robot("", imported.folder, **given)
    assert contents(imported.folder) == before


def test_what_is_given_may_be_tuples_and_may_be_given_again(tmp_path):
    parts = [link("base")]
    for i, below in enumerate(["base", "l0", "l1"]):
        parts += [
            link(f"l{i}", '<capsule radius="0.03" length="0.1"/>', "0 0 0.1"),
            joint(f"j{i}", below, f"l{i}", "0 1 0", "0 0 0.2"),
        ]
    given = {
        "most_capsules": 1,
        "base": "fixed",
        "pairs": [("l0", "l2")],
        "lock": ("legs",),
        "locked": {"j1": 0.123456789},
        "package_paths": (tmp_path,),
    }
    urdf = write(tmp_path, robot(parts))
    import_robot(urdf, tmp_path, **given)
    before = (tmp_path / "import.yaml").read_bytes()
    choices = load_choices(tmp_path / "import.yaml")
    assert (choices.pairs, choices.lock) == ([["l0", "l2"]], ["legs"])
    assert choices.package_paths == [str(tmp_path)]
    import_robot(urdf, tmp_path, **given)
    assert (tmp_path / "import.yaml").read_bytes() == before


def contents(folder: Path) -> dict[Path, bytes]:
    return {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    "key, wrong",
    [
        ("rest_posture", "rest_posture: {left_arm_9: 0.1}"),
        ("pairs", "pairs: [[torso, nothing]]"),
        ("base", "base: hanging"),
        ("locked", "locked: {left_hip: 9.0}"),
        ("frames", "frames: {waist: {link: torso, point: [0, 0]}}"),
    ],
)
def test_a_refused_import_changes_nothing(imported, tmp_path, key, wrong):
    """Not even where most of the files had been made before it was refused."""
    folder = tmp_path / "again"
    shutil.copytree(imported.folder, folder)
    file = folder / "import.yaml"
    lines = file.read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(f"{key}:"))
    end = start + 1
    while end < len(lines) and lines[end].startswith(" "):
        end += 1
    file.write_text("\n".join([*lines[:start], *lines[end:], wrong]) + "\n")
    before = contents(folder)
    with pytest.raises(ModelError):
        import_robot("", folder)
    assert contents(folder) == before


def test_a_robot_that_cannot_be_read_leaves_no_folder(tmp_path):
    bad = link("a", '<mesh filename="bad.stl"/>')
    (tmp_path / "bad.stl").write_text("solid nothing")
    path = write(tmp_path, robot([bad, link("b"), joint("j", "a", "b")]))
    with pytest.raises(ModelError, match="'a'.*bad.stl"):
        import_robot(path, tmp_path / "new" / "out")
    assert not (tmp_path / "new").exists()


def test_triangles_of_an_earlier_import_go(imported, tmp_path):
    folder = tmp_path / "again"
    shutil.copytree(imported.folder, folder)
    old = folder / "triangles" / "head_1.obj"
    assert not old.exists()
    old.write_text("v 0 0 0\n")
    import_robot("", folder)
    assert not old.exists() and (folder / "triangles" / "head_0.obj").exists()


@pytest.mark.parametrize("root", ["pelvis", "world"])
def test_two_arms_on_a_fixed_base(tmp_path, root):
    """As Baxter's: it stands on the floor, so that its waist has a height."""
    text = humanoid()
    if root == "world":
        weld = joint("weld", "world", "pelvis", xyz="0 0 3", kind="fixed")
        text = text.replace("</robot>", link("world", mass=0.0) + weld + "</robot>")
    urdf, file = write(tmp_path, text), tmp_path / "import.yaml"
    report = import_robot(urdf, tmp_path, most_capsules=1, base="fixed", pairs=[])
    assert report.choices.rest_posture["waist_z"] == pytest.approx(0.8)
    again = file.read_text()
    import_robot("", tmp_path)
    assert file.read_text() == again
    model = load_robot_model(tmp_path)
    assert model.n_p == 0
    lengths = segment_lengths(model)
    assert lengths["waist"] == pytest.approx(0.8)
    assert lengths["neck"] == pytest.approx(0.4)


def test_a_humanoid_on_a_root_named_world_moves(tmp_path):
    """As orcabot's: the link is left out, and the motion drives the robot."""
    weld = joint("weld", "world", "pelvis", kind="fixed")
    text = humanoid().replace("</robot>", link("world", mass=0.0) + weld + "</robot>")
    report = import_robot(write(tmp_path, text), tmp_path, most_capsules=1, pairs=[])
    assert report.choices.base == "prescribed"
    assert report.choices.frames["waist"].link == "pelvis"
    assert any("'world' is left out" in note for note in report.notes)
    assert set(load_robot_model(tmp_path).prescribed_names) == set(WAIST)


def test_arms_and_legs_are_clear_of_each_other_at_rest(tmp_path):
    """Thick shanks stand apart by their hips' roll, and then they are watched."""
    thin = humanoid_with_legs()
    slender = '<cylinder radius="0.05" length="0.66"/>'
    assert thin.count(slender) == 2
    thick = thin.replace(slender, '<sphere radius="0.11"/>').replace(
        'xyz="0 0 -0.37"', 'xyz="0 0 -0.05"'
    )
    rolls = {}
    for name, text in (("thin", thin), ("thick", thick)):
        folder = tmp_path / name
        urdf = write(folder, text)
        report = import_robot(urdf, folder, most_capsules=1, lock=["hands"])
        rest, pairs = report.choices.rest_posture, report.choices.pairs
        assert "knees bent" in report.guessed["rest_posture"]
        rolls[name] = rest.get("left_roll_joint", 0.0)
        assert rest.get("right_roll_joint", 0.0) == -rolls[name]
        assert {"left_leg", "right_leg"} in [set(pair) for pair in pairs]
    assert rolls["thin"] == 0.0 and rolls["thick"] == pytest.approx(0.1)
