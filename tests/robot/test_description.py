"""Robot descriptions: what is shipped, what is refused, how names are found."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from small_robots import add_plant, chain_urdf
from standing_robots import CORNERS

from crar_drake.errors import ModelError
from crar_drake.robot import description as robot_description
from crar_drake.robot.description import (
    RobotDescription,
    RootPose,
    find_body,
    find_frame,
    find_joint,
    import_file,
    imported_names,
    load_robot_description,
    nearest,
    robot_names,
    whole_body_name,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task


@pytest.fixture(scope="module")
def plant() -> MultibodyPlant:
    """Two chains with equal names of links, one of which is named apart."""
    plant, _ = add_plant(DiagramBuilder(), chain_urdf("zz"), finalize=False)
    parser = Parser(plant)
    parser.SetAutoRenaming(True)
    (second,) = parser.AddModelsFromString(chain_urdf("z"), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base", second))
    plant.Finalize()
    return plant


def write(folder: Path, text: str, model: str | None = None) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.yaml").write_text(text)
    if model is not None:
        (folder / "arm.urdf").write_text(model)
    return folder / "robot.yaml"


SHIPPED = [name for name in robot_names() if import_file(name) is None]


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    """The folder of imported robots, an empty one."""
    folder = tmp_path / "cache"
    monkeypatch.setattr(robot_description, "imported_robots_folder", lambda: folder)
    return folder


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_robots_by_name_folder_and_file(name):
    by_name = load_robot_description(name)
    by_folder = load_robot_description(by_name.folder)
    by_file = load_robot_description(Path(by_name.folder) / "robot.yaml")
    assert by_name == by_folder == by_file
    assert by_name.name == name and by_name.pairs


@pytest.mark.parametrize("name", sorted({*robot_names()} - {*SHIPPED}))
def test_robots_that_need_an_import_name_the_command(name, cache):
    with pytest.raises(ModelError, match=f"crar-drake import-robot {name}` once"):
        load_robot_description(name)
    text = f"name: {name}\nmodel: arm.urdf\nbase: base\n"
    write(cache / name, text, chain_urdf("zz"))
    made_from = cache / name / "import.yaml"
    made_from.write_text("source: old.urdf")
    with pytest.raises(ModelError, match=f"import-robot {name}` again"):
        load_robot_description(name)
    made_from.write_bytes(import_file(name).read_bytes())
    assert load_robot_description(name).folder == str(cache / name)


def test_an_imported_robot_has_a_name(cache):
    write(cache / "mine", "name: m\nmodel: arm.urdf\nbase: base\n", chain_urdf("zz"))
    assert imported_names() == ["mine"]
    assert load_robot_description("mine").name == "m"
    with pytest.raises(ModelError, match="did you mean 'mine'"):
        load_robot_description("mnie")


def test_a_description_of_ones_own(tmp_path):
    file = write(
        tmp_path,
        "name: mine\nmodel: arm.urdf\nbase: base\ntask_frames: {hand: tip}\n"
        "pairs: [[l1, post]]\nrest_posture: {j0: 0.3}\n",
        chain_urdf("zz"),
    )
    model = ControlModel.FromDescription(
        load_robot_description(file), [Task(frame="hand")]
    )
    assert model.n == 2 and model.pairs.names == (("l1", "post"),)
    np.testing.assert_array_equal(model.rest_positions(), [0.3, 0.0])
    assert model.layout.names == ("hand",)


@pytest.mark.parametrize(
    "text, model, words",
    [
        ("model: arm.urdf\nbse: x", "", ["bse"]),
        ("model: gone.urdf", None, ["gone.urdf", "robot.yaml"]),
        ("name: x", None, ["model"]),
        ("model: arm.urdf\npairs: [[a, b, c]]", "", ["pairs", "two different"]),
        ("model: arm.urdf\npairs: [[a, a]]", "", ["pairs", "two different"]),
        (
            "model: arm.urdf\nprescribed_joints: {j: waist.w}",
            "",
            ["waist.w", "waist.x", "hold"],
        ),
        ("model: [", None, ["robot.yaml"]),
    ],
)
def test_refused_files(tmp_path, text, model, words):
    file = write(tmp_path, text, model)
    with pytest.raises(ModelError) as caught:
        load_robot_description(file)
    for word in words:
        assert word in str(caught.value)


def test_unknown_robot_has_a_nearest_name():
    with pytest.raises(ModelError, match="did you mean 'upper_body'"):
        load_robot_description("uper_body")


@pytest.mark.parametrize(
    "text, model, words",
    [
        ("base: bse", chain_urdf("zz"), ["bse", "did you mean 'base'"]),
        ("base: base", "<robot name='x'><link", ["arm.urdf"]),
        ("base: base", "", ["arm.urdf"]),
    ],
)
def test_refused_models(tmp_path, text, model, words):
    file = write(tmp_path, f"model: arm.urdf\n{text}", model)
    with pytest.raises(ModelError) as caught:
        ControlModel.FromDescription(load_robot_description(file), [Task(frame="tip")])
    for word in words:
        assert word in str(caught.value)


def test_names_are_found_plain_or_scoped(plant):
    assert find_joint(plant, "j1").name() == "j1"
    for find in (find_frame, find_body):
        first, second = find(plant, "chain::l0"), find(plant, "chain_1::l0")
        assert first.index() != second.index()
        assert find(plant, "l1").index() == find(plant, "chain::l1").index()


def test_ambiguous_names_ask_for_their_model(plant):
    for find in (find_frame, find_body, find_joint):
        name = "j0" if find is find_joint else "l0"
        these = f"several models; write chain::{name} or chain_1::{name}"
        with pytest.raises(ModelError, match=these):
            find(plant, name)


@pytest.mark.parametrize("name", ["tipp", "chain::tipp", "chian::tip", "", "::", "a::"])
@pytest.mark.parametrize("find", [find_frame, find_body, find_joint])
def test_unknown_names_are_model_errors(plant, find, name):
    with pytest.raises(ModelError, match="has no"):
        find(plant, name)


def test_nearest():
    assert nearest("lefft_hand", ["left_hand", "head"]) == (
        "; did you mean 'left_hand'?"
    )
    assert nearest("zzz", ["b", "a", "a"]) == "; known are a, b"
    assert nearest("zzz", []) == ""
    many = nearest("zzz", [f"{number:02}" for number in range(80)])
    assert ", 38, 39 and 40 more" in many and ", 40" not in many


def test_default_description_is_valid():
    RobotDescription().validate()


BAD_SOLES = [
    ([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]], "at least three corners"),
    ([[0.1, 0.0], [0.0, 0.1], [0.0, 0.0]], "three numbers each"),
    ([[0.1, 0.0, 0.0], [0.0, np.nan, 0.0], [0.0, 0.0, 0.0]], "finite"),
    ([[0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.3, 0.0, 0.0]], "on one line"),
    ([[x, y, 0.03 * (x > 0) * (y > 0)] for x, y in CORNERS], "off a plane"),
]
ABOVE = [["a", "ground"]]
NO_PAIR = r"ground: 0.0, but no pair names 'ground'.*\[left_foot"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"root": "loose", "base": "body"}, "root: 'loose' is none of fixed, presc"),
        ({"root": "prescribed"}, "needs the name of the link that floats"),
        ({"root_pose": RootPose(xyz=[0.0, np.nan, 1.0])}, "root_pose.xyz"),
        ({"root_pose": RootPose(rpy=[0.0])}, "root_pose.rpy"),
        ({"pairs": [["a", "b"], ["a", "b"]]}, "twice"),
        ({"pairs": [["a", "b"], ["b", "a"]]}, "twice"),
        ({"pairs": [("a", "b"), ["b", "a"]]}, "twice"),
        (
            {"ground": np.nan, "pairs": [["a", "ground"]]},
            "ground: nan must be a height",
        ),
        ({"ground": 0.0, "pairs": [["a", "b"]]}, NO_PAIR),
        *(({"soles": {"foot": x}}, f"soles: foot: .*{told}") for x, told in BAD_SOLES),
    ],
)
def test_descriptions_that_cannot_be(changes, message):
    with pytest.raises(ModelError, match=f"robot a: .*{message}"):
        RobotDescription(name="a", **changes).validate()


def test_reference_motions_find_the_whole_body_by_the_robots_name(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert whole_body_name("g1") == "g1_whole_body"
    assert whole_body_name("g1_whole_body") == "g1_whole_body"
    assert whole_body_name("upper_body") == "upper_body"  # there is no longer one
    (tmp_path / "g1").mkdir()  # a folder of one's own is what it is
    assert whole_body_name("g1") == "g1"
