"""Reading a robot's SDF: as Drake reads it, and what is refused."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from small_sdfs import (
    FEATURES,
    WEDGE,
    joint,
    link,
    model,
    sdf,
    write_features,
)
from small_urdfs import write
from source_robots import random_positions, spatial_inertia

from crar_drake.errors import ModelError
from crar_drake.robot_import import import_robot
from crar_drake.robot_import.link_bodies import read_inertia
from crar_drake.robot_import.meshes import link_parts
from crar_drake.robot_import.robot_files import default_name, find_urdf
from crar_drake.robot_import.source_file import read_robot


def read(folder, text: str):
    """The text, read as a file small.sdf."""
    return read_robot(write(folder, text, "small.sdf"))


def drake_plant(path, *packages) -> MultibodyPlant:
    """The SDF as Drake reads it without shapes, of which it would refuse some."""
    plant = MultibodyPlant(0.0)
    parser = Parser(plant)
    for folder in packages:
        parser.package_map().Add(folder.name, str(folder))
    parser.AddModels(str(path))
    plant.Finalize()
    return plant


def drake_poses(plant, positions) -> dict[str, RigidTransform]:
    """Pose of each link, by its scoped name without the model's."""
    context = plant.CreateDefaultContext()
    q = plant.GetPositions(context)
    for name, position in positions.items():
        q[plant.GetJointByName(name).position_start()] = position
    plant.SetPositions(context, q)
    instances = map(ModelInstanceIndex, range(plant.num_model_instances()))
    bodies = [plant.get_body(i) for m in instances for i in plant.GetBodyIndices(m)]
    return {
        body.scoped_name().get_full().partition("::")[2]: (
            plant.EvalBodyPoseInWorld(context, body)
        )
        for body in bodies
    }


@pytest.fixture(scope="module")
def features(tmp_path_factory):
    """The path of the file with all features, and the robot that is read."""
    path = write_features(tmp_path_factory.mktemp("features"))
    return path, read_robot(path)


# What the included model's links are called, whose base is not the only one.
LINKS = {
    "upper": "upper",
    "wrist": "wrist",
    "hand::base": "hand_base",
    "hand::left": "left",
    "hand::right": "right",
}


def test_it_moves_as_drake_says(features):
    path, robot = features
    positions = random_positions(robot)
    assert set(positions) == {"beside", "slide", "left_slide", "right_turn"}
    mine, theirs = (
        robot.poses(positions),
        drake_poses(drake_plant(path, path.parent / "gripper"), positions),
    )
    for there, here in LINKS.items():
        expected = theirs["base"].inverse() @ theirs[there]
        assert (mine["base"].inverse() @ mine[here]).IsNearlyEqualTo(expected, 1e-9)


def test_frames_are_where_the_file_says(features):
    X = features[1].poses()
    expected = X["base"] @ RigidTransform(RollPitchYaw(0.3, 0, 0.1), [0, 0.1, 0.2])
    assert X["shoulder"].IsNearlyEqualTo(expected, 1e-12)
    p_WG = X["wrist"].inverse() @ X["grip"]
    assert p_WG.IsNearlyEqualTo(RigidTransform(np.array([0, 0, 0.05])), 1e-12)


def test_inertias_limits_and_what_moves_them(features):
    path, robot = features
    plant = drake_plant(path, path.parent / "gripper")
    inertia, complaint = read_inertia(robot.links["base"])
    assert not complaint
    there = plant.GetBodyByName("base", plant.GetModelInstanceByName("features"))
    np.testing.assert_allclose(
        spatial_inertia(inertia).CopyToFullMatrix6(),
        there.CalcSpatialInertiaInBodyFrame(
            plant.CreateDefaultContext()
        ).CopyToFullMatrix6(),
        rtol=1e-9,
        atol=1e-12,
    )
    # SDF's own idea of a link without an inertia, 1 kg and 1 kg m^2, is none.
    assert robot.links["upper"].inertia is None
    beside, slide, right = (robot.joints[n] for n in ("beside", "slide", "right_turn"))
    assert (beside.kind, slide.kind, right.kind) == (
        "revolute",
        "prismatic",
        "continuous",
    )
    assert (beside.lower, beside.upper) == (-1.0, 2.0)
    assert (beside.effort, beside.velocity, beside.damping) == (30.0, 4.0, 0.5)
    assert (slide.lower, slide.upper) == (-0.1, 0.2)
    assert slide.effort is None and slide.velocity is None
    # -2 (q - 0.02) + 0.1
    assert (right.mimic, right.multiplier) == ("left_slide", -2.0)
    assert right.offset == pytest.approx(0.14)


def test_looks(features):
    links = features[1].links
    (look,) = links["base"].visual
    assert isinstance(look.geometry, Box) and look.rgba == (0, 1, 0, 1)
    np.testing.assert_array_equal(look.geometry.size(), [0.2, 0.4, 0.1])
    assert any("ground" in note and "base" in note for note in features[1].notes)
    assert [type(s.geometry) for s in links["wrist"].visual] == [Capsule]
    assert [type(s.geometry) for s in links["wrist"].collision] == [Sphere]
    # A collision of a format that Drake refuses, turned about z, mirrored and scaled.
    assert not links["upper"].visual
    (part,) = link_parts(links["upper"])
    x, y, z = (WEDGE * [0.1, -0.2, 0.3]).T
    expected = np.column_stack([-y, x, z]) + [0.01, 0.02, 0.03]
    near = np.linalg.norm(part.vertices[:, None] - expected, axis=2)
    assert (near.min(axis=0) < 1e-6).all() and (near.min(axis=1) < 1e-6).all()
    # An included model's address is beside that model.
    (mesh,) = links["hand_base"].visual
    assert mesh.path == features[0].parent / "gripper" / "wedge.stl"


@pytest.mark.parametrize("address", ["gripper", "model://gripper", "gripper/hand.sdf"])
def test_what_is_included_may_be_a_folder(features, tmp_path, address):
    """Which of its files is the model says model.config."""
    text = FEATURES.replace("model://gripper/hand.sdf", address)
    robot = read_robot(write_features(tmp_path, text))
    assert set(robot.links) == set(features[1].links)
    (tmp_path / "gripper" / "hand.sdf").rename(tmp_path / "gripper" / "model.sdf")
    if address.endswith("gripper"):
        with pytest.raises(ModelError, match="gripper"):
            read_robot(tmp_path / "features.sdf")
        (tmp_path / "gripper" / "model.config").unlink()
        assert set(read_robot(tmp_path / "features.sdf").links) == set(robot.links)


def test_packages_are_found_as_those_of_a_urdf(features, tmp_path):
    text = FEATURES.replace("meshes/wedge.stl", "model://shapes/wedge.stl")
    path = write_features(tmp_path, text)
    with pytest.raises(ModelError, match="packages.*not found: shapes.*--package-path"):
        read_robot(path)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "meshes").rename(tmp_path / "elsewhere" / "shapes")
    link = read_robot(path, [tmp_path / "elsewhere"]).links["upper"]
    assert link.collision[0].path.is_file()


def test_a_root_that_lies_is_carried_upright(tmp_path):
    chain = [link("a"), link("b", "0 0 1 0 0 0"), joint("ab", "a", "b")]
    lying = model("<pose>1 2 3 1.5707963267948966 0 0</pose>", *chain)
    robot = read(tmp_path, sdf(lying))
    assert robot.root == "a_upright"
    p = robot.poses()["b"].translation()
    np.testing.assert_allclose(p, [0, -1, 0], atol=1e-9)
    # Mounted in the world it is where it stands.
    weld = '<joint name="w" type="fixed"><parent>world</parent><child>a</child></joint>'
    robot = read(tmp_path, sdf(lying.replace("</model>", f"{weld}</model>")))
    assert robot.root == "world"
    np.testing.assert_allclose(robot.poses()["b"].translation(), [1, 1, 3], atol=1e-9)
    assert read(tmp_path, sdf(model(*chain))).root == "a"


def test_of_a_world_only_the_robot_is_read(tmp_path):
    table = model("<static>true</static>", link("top"), name="table")
    robot = model(link("a"), link("b"), joint("ab", "a", "b"), name="arm")
    text = sdf(f'<world name="w">{table}{robot}</world>')
    found = read(tmp_path, text)
    assert set(found.links) == {"a", "b"} and found.name == "arm"
    assert any("table" in note and "not the robot's" in note for note in found.notes)
    two = text.replace("</world>", robot.replace("arm", "other") + "</world>")
    with pytest.raises(
        ModelError, match=r"arm \(1 joints\), other \(1 joints\).*alone"
    ):
        read(tmp_path, two)


def test_a_closed_chain_is_told_as_that_of_an_mjcf(tmp_path):
    parts = [link(name) for name in "abc"]
    parts += [joint("ab", "a", "b"), joint("bc", "b", "c")]
    robot = read(tmp_path, sdf(model(*parts, joint("ac", "a", "c", "ball"))))
    (loop,) = robot.loops
    assert (loop.name, loop.joints) == ("ac", ("ab", "bc"))
    assert not any("gapes" in note for note in robot.notes)


BAD = {
    "not well-formed": (sdf(model(link("a"))[:-3]), ["small.sdf", "line 1"]),
    "no number": (
        sdf("\n\n", model(link("a"), link("b"), joint("ab", "a", "b"))).replace(
            "<upper>1<", "<upper>one<"
        ),
        ["small.sdf:3", "upper"],
    ),
    "no such link": (
        sdf(model(link("a"), joint("ab", "a", "b"))),
        ["small.sdf", "'?b|\\[b", "ab"],
    ),
    "no such frame": (
        sdf(model(link("a"), link("b"), joint("ab", "a", "b"))).replace(
            "<pose>", '<pose relative_to="nothing">', 1
        ),
        ["small.sdf", "nothing"],
    ),
    "no joint": (sdf(model(link("a"))), ["no joint that turns or slides"]),
    "two trees": (
        sdf(model(link("a"), link("b"), link("c"), joint("ab", "a", "b"))),
        ["not one tree", "a, c"],
    ),
    "one limit": (
        sdf(model(link("a"), link("b"), joint("ab", "a", "b"))).replace(
            "<upper>1</upper>", ""
        ),
        ["'ab'", "-1 to inf rad: give both limits"],
    ),
    "no mesh": (
        sdf("\n\n", model(link("a"), link("b"), joint("ab", "a", "b"))).replace(
            "<sphere><radius>0.05</radius></sphere>",
            "<mesh><uri>nothing.stl</uri></mesh>",
            1,
        ),
        [r"nothing.stl \(line 3\)"],
    ),
    "no included model": (
        sdf(model(link("a"), "\n<include><uri>model://x</uri></include>")),
        ["packages that are not found: x"],
    ),
    "another kind of joint": (
        sdf("\n", model(link("a"), link("b"), joint("ab", "a", "b", "gearbox"))),
        ["small.sdf:2", "gearbox"],
    ),
    "a bushing": (
        sdf(
            model(
                link("a"),
                link("b"),
                joint("ab", "a", "b"),
                "<drake:linear_bushing_rpy/>",
            )
        ).replace("<sdf ", '<sdf xmlns:drake="http://drake.mit.edu" '),
        ["closes a chain"],
    ),
}


@pytest.mark.parametrize("text, words", BAD.values(), ids=BAD)
def test_what_is_refused(tmp_path, text, words):
    with pytest.raises(ModelError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message and "collision of" not in message
    for word in words:
        assert re.search(word, message), message


def test_joints_of_other_kinds_have_to_be_locked(tmp_path):
    chain = [link(name) for name in "abcdef"]
    kinds = ("revolute", "screw", "revolute", "ball", "revolute")
    for kind, parent, child in zip(kinds, "abcde", "bcdef", strict=True):
        chain.append(joint(f"{kind}_{child}", parent, child, kind))
    path = write(tmp_path, sdf(model(*chain)), "small.sdf")
    with pytest.raises(ModelError, match="'screw_c' is screw.*add it to locked"):
        import_robot(path, tmp_path / "out", locked={})


def test_a_file_that_says_nothing_is_named_after_its_model(tmp_path):
    path = write(tmp_path / "models" / "urdf", sdf(model(name="arm")), "model.sdf")
    assert default_name(path) == "arm"


def test_cassie(robot_data):
    """A file that others wrote: STL meshes by model://, axes in the model's frame, and
    rods that close chains."""
    path, name = find_urdf("cassie_v2")
    assert name.endswith(":robots/cassie_description/robots/cassie_v2.sdf")
    robot = read_robot(path)
    X = robot.poses()
    root = ElementTree.parse(path).getroot()
    for element in root.iter("link"):
        *xyz, r, p, y = map(float, element.findtext("pose").split())
        expected = RigidTransform(RollPitchYaw(r, p, y), xyz)
        there = RigidTransform(np.array([0.0, 0.0, 1.01])) @ X[element.get("name")]
        assert there.IsNearlyEqualTo(expected, 1e-5), element.get("name")
    assert len(robot.loops) == 4
    # The crank and the foot, of limits from -2.44 to -0.61, are not locked at zero.
    gaping = [
        note.partition(" ")[0] for note in robot.notes if "gapes by 211 mm" in note
    ]
    assert sorted(gaping) == ["left-plantar-foot-joint", "right-plantar-foot-joint"]
    assert all(link_parts(link) for link in list(robot.links.values())[:5])
    # A chain that no rod closes, moved: as Drake does without those joints.
    text = path.read_text()
    for loop in robot.loops:
        text = re.sub(
            rf'<joint name="{loop.name}".*?</joint>', "", text, flags=re.DOTALL
        )
    plant = MultibodyPlant(0.0)
    parser = Parser(plant)
    parser.package_map().Add("example-robot-data", str(robot_data))
    parser.AddModelsFromString(text, "sdf")
    plant.Finalize()
    positions = random_positions(robot)
    mine, theirs = robot.poses(positions), drake_poses(plant, positions)
    for name in robot.links:
        if name in theirs:
            expected = theirs["pelvis"].inverse() @ theirs[name]
            assert (mine["pelvis"].inverse() @ mine[name]).IsNearlyEqualTo(
                expected, 1e-9
            )


def test_files_that_include_themselves_are_refused(tmp_path):
    """Drake's reader would crash."""
    text = (
        '<sdf version="1.9"><model name="{}"><include><uri>{}</uri></include>'
        '<link name="a"/></model></sdf>'
    )
    (tmp_path / "a.sdf").write_text(text.format("m", "b.sdf"))
    (tmp_path / "b.sdf").write_text(text.format("n", "a.sdf"))
    with pytest.raises(ModelError, match="a.sdf: it includes itself"):
        read_robot(tmp_path / "a.sdf")


def test_a_mesh_with_other_capitals_is_read(tmp_path):
    path = write_features(tmp_path)
    mesh = path.parent / "gripper" / "wedge.stl"
    mesh.rename(mesh.with_name("Wedge.STL"))
    read = read_robot(path)
    assert read.links["hand_base"].visual[0].path.name == "Wedge.STL"
    assert sum("Wedge.STL" in note for note in read.notes) == 1
