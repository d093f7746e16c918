"""Reading a robot's MJCF: as Drake and MuJoCo read it, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Capsule, Cylinder, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from small_mjcfs import FEATURES, body, mjcf, write_features
from small_urdfs import write
from source_robots import random_positions, spatial_inertia

from crar_drake.errors import ModelError
from crar_drake.robot_import import import_robot
from crar_drake.robot_import.link_bodies import read_inertia
from crar_drake.robot_import.meshes import link_parts
from crar_drake.robot_import.rest_posture import guess_rest
from crar_drake.robot_import.robot_files import default_name
from crar_drake.robot_import.source_file import read_robot

mujoco = pytest.importorskip("mujoco")

BODIES = ["base", "turned", "angled", "forearm", "axes", "zaxis"]
JOINTS = ["turn", "slide", "twist", "bend", "wrist", "side"]


def read(tmp_path, text: str):
    """The text, read as a file small.xml."""
    return read_robot(write(tmp_path, text, "small.xml"))


@pytest.fixture(scope="module")
def features(tmp_path_factory):
    """The path of the file with all features, and the robot that is read."""
    path = write_features(tmp_path_factory.mktemp("features"))
    return path, read_robot(path)


def mujoco_poses(path, positions) -> dict[str, RigidTransform]:
    """Pose of each body in the world, by MuJoCo's own kinematics."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for name, position in positions.items():
        data.joint(name).qpos = position
    mujoco.mj_kinematics(model, data)
    return {
        model.body(i).name: RigidTransform(
            RotationMatrix(data.xmat[i].reshape(3, 3)), np.array(data.xpos[i])
        )
        for i in range(model.nbody)
    }


def assert_same_poses(mine, theirs, bodies) -> None:
    """The same, seen from the first of the bodies."""
    root = bodies[0]
    for name in bodies:
        expected = theirs[root].inverse() @ theirs[name]
        assert (mine[root].inverse() @ mine[name]).IsNearlyEqualTo(expected, 1e-9)


def drake_plant(path) -> MultibodyPlant:
    """The MJCF as Drake reads it itself."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    return plant


def test_it_moves_as_mujoco_says(features):
    path, robot = features
    positions = random_positions(robot)
    assert set(positions) == set(JOINTS)
    assert_same_poses(robot.poses(positions), mujoco_poses(path, positions), BODIES)


def test_it_weighs_what_drake_says(features):
    path, robot = features
    plant = drake_plant(path)
    context = plant.CreateDefaultContext()
    for name in BODIES:
        there = plant.GetBodyByName(name).CalcSpatialInertiaInBodyFrame(context)
        inertia, complaint = read_inertia(robot.links[name])
        assert not complaint
        np.testing.assert_allclose(
            spatial_inertia(inertia).CopyToFullMatrix6(),
            there.CopyToFullMatrix6(),
            rtol=1e-6,
            atol=1e-9,
        )


def test_limits_damping_and_efforts(features):
    joints = features[1].joints
    assert [joints[name].kind for name in ("turn", "slide", "twist")] == [
        "revolute",
        "prismatic",
        "continuous",
    ]
    assert (joints["turn"].lower, joints["turn"].upper) == (-1.0, 2.0)
    assert (joints["slide"].lower, joints["slide"].upper) == (-0.1, 0.2)
    assert joints["twist"].upper == np.inf
    assert (joints["turn"].damping, joints["bend"].damping) == (0.5, 2.0)
    # The nearer bound, times the gear; a servo without a force range has none.
    assert joints["turn"].effort == 20.0
    assert joints["bend"].effort == 14.0
    assert joints["side"].effort is None
    assert all(joint.velocity is None for joint in joints.values())
    assert any("no speed limits" in note for note in features[1].notes)


def test_what_a_joint_admits_bounds_its_actuators(tmp_path):
    joint = '<joint name="a" actuatorfrcrange="-5 5"/>'
    motors = '<actuator><motor joint="a"/><motor joint="a" gear="2"/></actuator>'
    robot = read(tmp_path, mjcf(body("link", joint=joint), motors))
    assert robot.joints["a"].effort == 5.0


def test_looks(features):
    path, robot = features
    assert [type(s.geometry) for s in robot.links["turned"].visual] == [Capsule]
    assert not robot.links["turned"].collision
    # Only what collides, in a hidden group: nothing else shows the link.
    assert not robot.links["angled"].visual
    assert [type(s.geometry) for s in robot.links["angled"].collision] == [
        Cylinder,
        Sphere,
    ]
    assert robot.links["base"].visual[0].rgba == (0.0, 1.0, 0.0, 1.0)
    assert robot.links["turned"].visual[0].rgba == (0.2, 0.4, 0.8, 1.0)
    size = np.ptp(link_parts(robot.links["zaxis"])[0].vertices, axis=0)
    np.testing.assert_allclose(size, [0.04, 0.06, 0.08], rtol=0.02)
    # The capsule is from the body's origin to its other end.
    vertices = link_parts(robot.links["turned"])[0].vertices
    np.testing.assert_allclose(vertices.mean(axis=0), [0.05, 0.1, 0.15], atol=1e-6)


def test_a_colour_brighter_than_can_be(tmp_path):
    """MuJoCo takes it, Drake refuses it."""
    shining = body("link").replace("<geom ", '<geom rgba="3 0.5 -1 1" ')
    robot = read(tmp_path, mjcf(shining))
    assert robot.links["link"].visual[0].rgba == (1.0, 0.5, 0.0, 1.0)


def test_a_mesh_is_where_its_file_says(features):
    """MuJoCo keeps meshes in frames of their own; scale and place must survive."""
    (part,) = link_parts(features[1].links["forearm"])
    expected = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0.02, 0.06, 0.3]])
    expected += [0.01, 0.02, 0.03]
    near = np.linalg.norm(part.vertices[:, None] - expected, axis=2)
    assert (near.min(axis=0) < 1e-6).all() and (near.min(axis=1) < 1e-6).all()


def test_a_mesh_with_a_reference(tmp_path):
    """It is taken off before the mesh is scaled."""
    text = FEATURES.replace('0.3"/>', '0.3" refpos="0.5 0 0"/>', 1)
    (part,) = link_parts(read_robot(write_features(tmp_path, text)).links["forearm"])
    np.testing.assert_allclose(part.vertices[:, 0].min(), 0.01 - 0.05, atol=1e-6)


def test_the_same_mesh_twice_is_one(tmp_path):
    twice = 'mesh="wedge" pos="0.01 0.02 0.03"/>'
    path = write_features(tmp_path)
    forearm = tmp_path / "forearm.xml"
    forearm.write_text(
        forearm.read_text().replace(
            twice, f'{twice}<geom class="arm" type="mesh" {twice}'
        )
    )
    link = read_robot(path).links["forearm"]
    assert len(link.visual) == len(link.collision) == 1


def test_references_of_joints(tmp_path):
    """A joint's coordinate is the file's, although the body is drawn elsewhere."""
    text = mjcf(
        body(
            "a",
            body("b", joint='<joint name="s" type="slide" axis="1 0 0" ref="0.3"/>'),
            joint='<joint name="h" axis="0 1 0" pos="0 0 0.1" ref="40" range="0 90"/>',
        )
    )
    path = write(tmp_path, text, "small.xml")
    robot = read_robot(path)
    for positions in ({"h": np.deg2rad(40.0), "s": 0.3}, {"h": 0.2, "s": -0.1}):
        poses = mujoco_poses(path, positions)
        assert_same_poses(robot.poses(positions), poses, ["world", "a", "b"])
    assert robot.joints["h"].upper == pytest.approx(np.pi / 2)


def test_free_bodies_are_roots_and_mounted_ones_stand_in_the_world(tmp_path):
    free = body("a", body("b"), joint="<freejoint/>")
    assert read(tmp_path, mjcf(free)).root == "a"
    mounted = read(tmp_path, mjcf(body("a", body("b"), joint="")))
    assert mounted.root == "world"
    assert mounted.poses()["a"].translation()[2] == pytest.approx(0.2)


def test_a_root_that_lies_is_carried_upright(tmp_path):
    lying = body("a", body("b"), joint="<freejoint/>").replace(
        "<body", '<body euler="90 0 0"', 1
    )
    path = write(tmp_path, mjcf(lying), "small.xml")
    robot = read_robot(path)
    assert robot.root == "a_upright"
    np.testing.assert_allclose(
        robot.poses()["b"].translation(), [0, -0.2, 0], atol=1e-12
    )


def test_of_a_scene_only_the_robot_is_read(tmp_path):
    robot = read(
        tmp_path,
        mjcf(
            body("box", joint='<freejoint name="loose"/>')
            + body("a", body("b"), joint="<freejoint/>")
            + '<geom name="table" type="box" size="1 1 1"/>'
        ),
    )
    assert set(robot.links) == {"a", "b"}
    (note,) = [note for note in robot.notes if "not the robot's" in note]
    assert "box" in note and "table" in note


def test_names_that_are_missing_are_given(tmp_path):
    inside = '<body><joint/><joint axis="1 0 0"/><geom size="0.1"/></body>'
    robot = read(tmp_path, mjcf(body("a", inside, joint="")))
    assert set(robot.joints) >= {"body_2_joint_1", "body_2_joint_2"}
    assert "body_2" in robot.links


def test_sites_can_be_tools(tmp_path):
    chain = body("hand", '<site name="tcp"/>')
    for name in "dcba":
        chain = body(name, chain)
    report = import_small(tmp_path, mjcf(chain))
    assert report.choices.frames["tool"].link == "tcp"


def test_a_keyframe_is_the_rest_posture_of_an_arm(tmp_path):
    """That called home, if there is one; its quaternion of a ball joint is left out."""
    chain = body("e", joint='<joint name="{}_joint" type="ball"/>')
    for name in "dcba":
        chain = body(name, chain)
    keys = '<key name="busy" qpos="1 1 1 1 1 0 0 0"/>'
    home = '<key name="Home" qpos="0.1 -0.2 0.3 0 0.6 0.8 0 0"/>'
    for more, posture in ((keys + home, (0.1, -0.2, 0.3, 0.0)), (keys, (1.0,) * 4)):
        robot = read(tmp_path, mjcf(chain, f"<keyframe>{more}</keyframe>"))
        expected = {f"{n}_joint": q for n, q in zip("abcd", posture, strict=True)}
        assert robot.posture == expected
        rest = guess_rest(replace(robot, locked={"a_joint": 0.0}), None)
        assert rest == {n: q for n, q in expected.items() if n != "a_joint" and q}
    assert read(tmp_path, mjcf(chain)).posture == {}


def test_a_joint_that_follows_another_mimics_it(tmp_path):
    equality = (
        '<equality><joint joint1="b_joint" joint2="a_joint" polycoef="0.1 -2 0 0 0"/>'
        "</equality>"
    )
    robot = read(tmp_path, mjcf(body("a", body("b")), equality))
    joint = robot.joints["b_joint"]
    assert (joint.mimic, joint.multiplier, joint.offset) == ("a_joint", -2.0, 0.1)


def import_small(tmp_path, text: str, name: str = "out", **choices):
    """Imports the text with one capsule a link."""
    path = write(tmp_path, text, "small.xml")
    return import_robot(path, tmp_path / name, most_capsules=1, **choices)


LOOP = '<equality><connect name="rod" body1="b" body2="c" anchor="0 0 0"/></equality>'


@pytest.mark.parametrize(
    "text, words",
    [
        ("<mujoco><worldbody><thing/></worldbody></mujoco>", ["MuJoCo cannot read it"]),
        ("<mujocoinclude/>", ["import the file that includes it"]),
        ("<scene/>", ["neither", "<scene>"]),
        ("<mujoco", ["neither"]),
        ('<mujoco><include file="away.xml"/></mujoco>', ["away.xml"]),
        (
            mjcf(body("a"), '<asset><mesh file="away.obj"/></asset>'),
            ["small.xml", "away.obj"],
        ),
        (mjcf(body("a", joint="")), ["no joint that turns or slides"]),
        (mjcf(body("a", joint="<freejoint/>")), ["no joint that turns or slides"]),
    ],
)
def test_refused(tmp_path, text, words):
    path = write(tmp_path, text, "small.xml")
    with pytest.raises(ModelError) as caught:
        import_robot(path, tmp_path / "out")
    for word in words:
        assert word in str(caught.value)
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_a_file_that_lacks_what_its_scene_has_names_the_scene(tmp_path):
    """As of a robot that excludes contacts with a floor."""
    path = tmp_path / "small.xml"
    path.write_text(
        '<mujoco><worldbody><body name="a"><joint/><geom name="ball" size="0.1"/>'
        '</body></worldbody><contact><pair geom1="ball" geom2="floor"/></contact>'
        "</mujoco>"
    )
    with pytest.raises(ModelError, match="'floor' not found") as caught:
        read_robot(path)
    assert "what it lacks" not in str(caught.value)
    (tmp_path / "other.xml").write_text(
        '<mujoco><include file="smaller.xml"/></mujoco>'
    )
    (tmp_path / "scene.xml").write_text(
        '<mujoco><include file="small.xml"/><worldbody><geom name="floor" type="plane" '
        'size="1 1 1"/></worldbody></mujoco>'
    )
    with pytest.raises(ModelError, match=r"what it lacks may be in scene\.xml$"):
        read_robot(path)
    assert "a" in read_robot(tmp_path / "scene.xml").links


def test_a_closed_chain_has_to_be_locked(tmp_path):
    text = mjcf(body("a", body("b") + body("c")), LOOP)
    with pytest.raises(ModelError, match="'rod' closes a chain.*b_joint, c_joint"):
        import_small(tmp_path, text, locked={})
    locked = {"b_joint": 0.0, "c_joint": 0.0}
    report = import_small(tmp_path, text, "locked", locked=locked)
    assert report.choices.base == "fixed"


def test_what_is_left_out_is_said(tmp_path):
    ball = body("c", joint='<joint name="ball" type="ball"/>')
    bodies = body("a", body("b", ball) + '<site name="p"/>')
    more = (
        '<tendon><fixed name="cord"><joint joint="a_joint" coef="1"/></fixed></tendon>'
        '<equality><weld name="pin" body1="c"/></equality>'
    )
    report = import_small(tmp_path, mjcf(bodies, more))
    notes = "\n".join(report.notes)
    for said in ("ball joints are not supported: ball", "cord", "pin (weld)"):
        assert said in notes
    assert set(report.choices.locked) == {"ball"}
    with pytest.raises(ModelError, match="'ball' is ball.*add it to locked"):
        import_small(tmp_path, mjcf(bodies, more), "none", locked={})


def test_its_name(tmp_path):
    named = write(tmp_path, mjcf(body("a")), "robots/scene.xml")
    assert default_name(named) == tmp_path.name
    assert read_robot(named).name == "small"
    nameless = mjcf(body("a")).replace(' model="small"', "")
    assert read_robot(write(tmp_path, nameless, "arm.xml")).name == "arm"
