"""Reading a robot's own URDF: what is found, and what is refused."""

import re

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from small_urdfs import humanoid, joint, link, robot, write

from crar_drake.errors import ModelError
from crar_drake.resources import install_command
from crar_drake.robot_import.robot_files import default_name, find_urdf
from crar_drake.robot_import.source_urdf import read_urdf

MESH = '<mesh filename="{}"/>'


def test_tree_and_poses(tmp_path):
    source = read_urdf(write(tmp_path, humanoid()))
    assert source.root == "pelvis" and source.name == "small_humanoid"
    way = [j.name for j in source.path_to("left_arm_fore")]
    assert way == ["waist_yaw", *(f"left_arm_{i}" for i in range(1, 5))]
    X = source.poses()
    np.testing.assert_allclose(X["left_arm_fore"].translation(), [0, 0.2, 0.15])
    # A quarter turn of the trunk to the left brings the left elbow behind.
    X = source.poses({"waist_yaw": np.pi / 2})
    np.testing.assert_allclose(
        X["left_arm_fore"].translation(), [-0.2, 0, 0.15], atol=1e-12
    )


def test_a_joint_turns_about_its_axis_after_its_origin(tmp_path):
    text = robot(
        [
            link("a"),
            link("b"),
            '<joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
            '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/><axis xyz="0 0 2"/>'
            '<limit lower="-1" upper="1"/></joint>',
        ]
    )
    read = read_urdf(write(tmp_path, text)).joints["j"]
    expected = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [1, 2, 3]) @ RigidTransform(
        RollPitchYaw(0, 0, 0.5), np.zeros(3)
    )
    assert read.transform(0.5).IsNearlyEqualTo(expected, 1e-12)


def closed_chain() -> str:
    parts = [link("a"), link("b"), link("c")]
    parts += [joint("ab", "a", "b"), joint("ac", "a", "c"), joint("bc", "b", "c")]
    return robot(parts)


def ring() -> str:
    parts = [link("a"), link("b"), link("c")]
    return robot([*parts, joint("bc", "b", "c"), joint("cb", "c", "b")])


@pytest.mark.parametrize(
    "text, words",
    [
        (closed_chain(), ["closed chain", "'ac'", "'bc'", "'c'"]),
        (ring(), ["closed chain", "b, c"]),
        (robot([link("a"), link("b")]), ["not one tree", "a, b"]),
        (robot([link("a"), joint("j", "a", "bb")]), ["'j'", "'bb'"]),
        (robot([link("a"), link("b"), joint("j", "a", "b", kind="screw")]), ["screw"]),
        (robot([link("a"), link("b"), joint("j", "a", "b", "0 0 0")]), ["no length"]),
        (
            robot(
                [
                    link("a"),
                    '<drake:ball_constraint name="loop"/>',
                ]
            ),
            ["drake:ball_constraint", "closes a chain"],
        ),
        (robot([link("a", MESH.format("hand.stl"))]), ["hand.stl", "link a"]),
        (
            robot([link("a", MESH.format("package://acme_robot/hand.stl"))]),
            ["acme_robot", "--package-path"],
        ),
        ("<sdf/>", ["not a URDF", "<sdf>"]),
        ("<robot", ["not a URDF"]),
        (robot([]), ["no links"]),
    ],
)
def test_refused(tmp_path, text, words):
    path = write(tmp_path, text)
    with pytest.raises(ModelError) as caught:
        read_urdf(path)
    for word in [str(path), *words]:
        assert word in str(caught.value)


def test_a_mesh_with_other_capitals_is_read(tmp_path):
    """As of files that were made where capitals do not count; if it is the only one."""
    folder = tmp_path / "acme" / "meshes"
    folder.mkdir(parents=True)
    (folder / "Hand.STL").write_bytes(b"")
    for address, told in (
        ("package://acme/meshes/hand.stl", None),
        ("acme/meshes/hand.stl", None),
        ("package://acme/meshes", "(link a)"),  # a folder is no mesh
        ("package://acme/none/hand.stl", "(link a)"),
        ("acme/meshes/hand.stl", "(link a; there is HAND.stl; there is Hand.STL)"),
    ):
        path = write(tmp_path, robot([link("a", MESH.format(address))]))
        if told is None:
            read = read_urdf(path)
            assert read.links["a"].visual[0].path == folder / "Hand.STL"
            (note,) = read.notes
            assert "capitals" in note and "Hand.STL" in note
            continue
        if "HAND" in told:
            (folder / "HAND.stl").write_bytes(b"")
        with pytest.raises(ModelError, match="files are missing") as caught:
            read_urdf(path)
        assert f"{address} {told}" in str(caught.value)


@pytest.mark.parametrize("where", ["argument", "environment", "ancestor", "manifest"])
def test_packages_are_found(tmp_path, monkeypatch, where):
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    text = robot([link("a", MESH.format("package://acme/meshes/hand.stl"))])
    root = tmp_path / "some" / ("acme" if where != "manifest" else "checkout")
    (root / "meshes").mkdir(parents=True)
    (root / "meshes" / "hand.stl").touch()
    if where == "manifest":
        (root / "package.xml").write_text("<package><name>acme</name></package>")
    inside = where in ("ancestor", "manifest")
    path = write(root / "urdf" if inside else tmp_path / "elsewhere", text)
    paths = [tmp_path / "some"] if where == "argument" else []
    if where == "environment":
        monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / 'some'}")
    shape = read_urdf(path, paths).links["a"].visual[0]
    assert shape.path == root / "meshes" / "hand.stl"


def test_unknown_robots(robot_data, tmp_path):
    with pytest.raises(ModelError, match="no URDF, SDF or MJCF at"):
        find_urdf(tmp_path / "nothing.urdf")
    with pytest.raises(ModelError, match="did you mean 'panda'"):
        find_urdf("pnda")
    with pytest.raises(ModelError, match="has no robots/none.urdf"):
        find_urdf("example-robot-data:robots/none.urdf")


def test_without_the_package_names_are_refused(monkeypatch):
    from crar_drake.robot_import import robot_files

    monkeypatch.setattr(robot_files, "robot_data_folder", lambda: None)
    with pytest.raises(ModelError, match=re.escape(install_command("robots"))):
        find_urdf("panda")


@pytest.mark.parametrize("xyz", ["1.5 2 -3", "1.5, 2, -3", "1.5,2,-3", "1,5 2 -3"])
def test_numbers_with_commas(tmp_path, xyz):
    """ARMAR-6 has them."""
    text = robot([link("a"), link("b"), joint("j", "a", "b", xyz=xyz)])
    read = read_urdf(write(tmp_path, text))
    np.testing.assert_array_equal(read.joints["j"].X_PC.translation(), [1.5, 2.0, -3.0])
    assert any("commas" in note for note in read.notes) == ("," in xyz)


@pytest.mark.parametrize("rgba", ["0.15 0.15 0.15 0 1", "1 0 0", "255 0 0 1", "red"])
def test_a_colour_that_is_none_is_left_out(tmp_path, rgba):
    """Stretch 4 has one of five numbers."""
    text = robot([link("a", '<sphere radius="0.1"/>'), link("b"), joint("j", "a", "b")])
    assert "0.2 0.4 0.8 1" in text
    read = read_urdf(write(tmp_path, text.replace("0.2 0.4 0.8 1", rgba)))
    assert read.links["a"].visual[0].rgba is None
    (note,) = read.notes
    assert f"material 'm': '{rgba}' is no colour" in note


@pytest.mark.parametrize(
    "text, words",
    [
        (joint("j", "a", "b", xyz="1 2"), ["joint 'j'", "'1 2' is not three numbers"]),
        (joint("j", "a", "b", axis="0 0 up"), ["joint 'j'", "not made of numbers"]),
        (joint("j", "a", "b", limits='lower="-1" upper=""'), ["'' is not a number"]),
        (link("c", mass="heavy"), ["link 'c'", "'heavy'"]),
        (link("c", '<sphere radius="big"/>'), ["link 'c'", "'big'"]),
    ],
)
def test_what_is_no_number_is_named(tmp_path, text, words):
    path = write(tmp_path, robot([link("a"), link("b"), text]))
    with pytest.raises(ModelError) as caught:
        read_urdf(path)
    for word in [str(path), *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "shape",
    [
        '<sphere radius="0.0"/>',
        '<box size="0 0.1 0.1"/>',
        '<cylinder radius="0.1" length="0"/>',
        '<mesh filename="a.obj" scale="1 0 1"/>',
        '<mesh filename="a.obj" scale="1 -1e-9 1"/>',
    ],
)
def test_shapes_without_size_are_left_out(tmp_path, shape):
    """ARMAR-4 has spheres of radius 0."""
    read = read_urdf(write(tmp_path, robot([link("a", shape)])))
    assert read.is_bare("a")
    assert "link a" in read.notes[0] and "left out" in read.notes[0]


def test_a_bare_root_named_world_can_be_taken_off(tmp_path):
    text = robot(
        [link("world", mass=0.0), link("a"), link("b")]
        + [joint("weld", "world", "a", kind="fixed"), joint("j", "a", "b")]
    )
    read = read_urdf(write(tmp_path, text))
    bare = read.without_world()
    assert bare.root == "a" and set(bare.joints) == {"j"}
    assert set(bare.poses()) == {"a", "b"} and bare.parent_joint("a") is None
    # A joint that moves it, or geometry of its own, is another thing.
    moving = text.replace('"fixed"', '"revolute"')
    assert read_urdf(write(tmp_path, moving, "m.urdf")).without_world() is None
    assert bare.without_world() is None


@pytest.mark.parametrize(
    "file, element, name",
    [
        ("hugo.urdf", "other", "hugo"),
        ("hugo_v2/model.urdf", "other", "hugo_v2"),
        ("hugo_v2/urdf/robot.urdf", "other", "hugo_v2"),
        ("urdf/robots/model.urdf", "a hugo", "a_hugo"),
    ],
)
def test_default_names(tmp_path, file, element, name):
    path = write(tmp_path, robot([link("a")], element), file)
    assert default_name(path) == name


def test_a_robot_element_that_says_nothing(tmp_path):
    path = write(tmp_path, robot([link("a")], "model"), "hugo/model.urdf")
    assert read_urdf(path).name == "hugo"
