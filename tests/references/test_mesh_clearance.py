"""What meshes keep on a motion: closed forms, another library, and what hides.

The robot: a base with a post, an arm that turns about z, and a hand that slides along
the arm's x; hand and base are two joints apart.
"""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from small_urdfs import joint, link, robot, write

from crar_drake.errors import MotionError
from crar_drake.references.mesh_clearance import ClearanceOfMeshes, MeshClearance
from crar_drake.references.mesh_pairs import ROUNDING
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

# A bound is so close to the distance: a share of it, or so much [m].
SHARE, ENOUGH = 0.1, 2e-4
WIDE = 'lower="-9" upper="9" effort="9" velocity="9"'


def robot_of(
    folder: Path, post, hand, *, arm: str = "", axis: str = "1 0 0"
) -> WholeBody:
    """The robot with two meshes; `arm` is the shape of the link between."""
    for name, mesh in (("post", post), ("hand", hand)):
        if mesh is not None:
            mesh.export(folder / f"{name}.obj", digits=12)
    shapes = {
        name: "" if mesh is None else f'<mesh filename="{name}.obj"/>'
        for name, mesh in (("post", post), ("hand", hand))
    }
    parts = [
        link("post", shapes["post"]),
        link("arm", arm),
        joint("turn", "post", "arm", "0 0 1", limits=WIDE),
        link("hand", shapes["hand"]),
        joint("slide", "arm", "hand", axis, kind="prismatic", limits=WIDE),
    ]
    write(folder, robot(parts, "clock"), "clock.urdf")
    (folder / "robot.yaml").write_text(
        "name: clock\nmodel: clock.urdf\nbase: post\ntask_frames: {t: hand}\n"
        "rest_posture: {turn: 1.5}\n"
    )
    return WholeBody(load_robot_description(folder))


@pytest.fixture(autouse=True)
def all_pairs_are_near(monkeypatch):
    """Of each the frames and ways are told."""
    monkeypatch.setattr("crar_drake.references.mesh_clearance._NEAR", np.inf)


def box(lower, upper) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[lower, upper])


def found_for(body: WholeBody, q) -> tuple[ClearanceOfMeshes, MeshClearance]:
    meshes = ClearanceOfMeshes(body)
    return meshes, meshes.find(np.asarray(q, dtype=float))


def assert_close(bound, distance, slack: float = 0.0) -> None:
    """Bounds hold, and are a share of the distance at least, or enough."""
    assert np.all(bound <= distance + slack + 1e-12)
    least = np.minimum(ENOUGH, SHARE * distance) - 2.0 * ROUNDING
    assert np.all(bound >= least), (bound - least).min()


def test_balls_on_a_turning_arm(tmp_path):
    """Two balls at the same distance from the axis are 2 a sin(q / 2) - 2 r apart."""
    a, r = 1.0, 0.1
    ball = trimesh.creation.icosphere(4, radius=r)
    body = robot_of(
        tmp_path,
        ball.copy().apply_translation([a, 0, 0]),
        ball.copy().apply_translation([a, 0, 0]),
    )
    touching = 2.0 * np.arcsin(r / a)
    angles = touching + np.array([1e-3, 5e-3, 0.02, 0.3, 2.5, 0.9, 0.04, 2e-3])
    meshes, found = found_for(body, np.column_stack([angles, 0.0 * angles]))
    assert found.pairs == [("post", "hand")] and meshes.meshes.not_of.as_built == []
    # Faces are within the ball by so much at most.
    sagitta = r - np.linalg.norm(ball.triangles_center, axis=1).min()
    d = 2.0 * a * np.sin(angles / 2.0) - 2.0 * r
    assert_close(found.at_frames[0], d, 2.0 * sagitta)
    assert_close(found.on_ways[0], np.minimum(d[:-1], d[1:]), 2.0 * sagitta)
    assert not found.touch_at.any() and not found.touch_on.any()
    assert not found.not_shown.any()


def test_boxes_that_slide_apart_and_meet(tmp_path):
    """Their faces are 0.2 - q apart; at q = 0.2 they touch, and in no other frame."""
    body = robot_of(
        tmp_path, box((0.3, -0.1, -0.1), (0.4, 0.1, 0.1)), box((0, 0, 0), (0.1,) * 3)
    )
    slide = np.array([-0.5, 0.0, 0.19, 0.199, 0.2 - 1e-5, 0.1, 0.2, 0.15, 0.0])
    _, found = found_for(body, np.column_stack([0.0 * slide, slide]))
    assert np.flatnonzero(found.touch_at[0]).tolist() == [6]
    assert np.flatnonzero(found.touch_on[0]).tolist() == [5, 6]
    assert found.num_touching == 1 and found.num_unclear == 2
    d = 0.2 - slide
    apart = np.arange(len(d)) != 6
    assert found.at_frames[0, 6] == 0.0
    assert_close(found.at_frames[0, apart], d[apart])
    assert found.on_ways[0, 5] == found.on_ways[0, 6] == 0.0
    least = np.minimum(d[:-1], d[1:])
    assert_close(found.on_ways[0, [0, 1, 2, 3, 4, 7]], least[[0, 1, 2, 3, 4, 7]])


@pytest.mark.parametrize("thick", [1e-3, 1e-4])
def test_a_blade_between_two_frames(tmp_path, thick):
    """It goes through a post of its own thickness, far from both in all frames."""
    half = thick / 2.0
    body = robot_of(
        tmp_path,
        box((0.5, -half, -0.1), (0.6, half, 0.1)),
        box((0.4, -half, -0.1), (0.7, half, 0.1)),
    )
    q = np.column_stack([[-0.9, -0.31, 0.2, 0.6], np.zeros(4)])
    _, found = found_for(body, q)
    assert not found.touch_at.any() and found.at_frames.min() >= ENOUGH
    assert found.touch_on.tolist() == [[False, True, False]]
    assert found.on_ways[0, 1] == 0.0 and found.on_ways[0, [0, 2]].min() > ENOUGH


def test_blades_without_thickness_are_never_said_to_be_clear(tmp_path):
    """Flat meshes meet at an instant that no part of the way may hit."""
    square = trimesh.Trimesh(
        [(0.5, 0, -0.1), (0.6, 0, -0.1), (0.6, 0, 0.1), (0.5, 0, 0.1)],
        [(0, 1, 2), (0, 2, 3)],
    )
    body = robot_of(tmp_path, square, square.copy())
    q = np.column_stack([[-0.9, -np.pi / 10.0, 0.2, 0.6], np.zeros(4)])
    _, found = found_for(body, q)
    assert found.not_shown.tolist() == [[False, True, False]]
    assert found.on_ways[0, 1] == 0.0 and found.on_ways[0, [0, 2]].min() > 0.0


def test_one_link_inside_the_other(tmp_path):
    """No surfaces meet there; nor are the links clear until it has come out."""
    shell = box((0.5, -0.5, -0.5), (1.5, 0.5, 0.5))
    body = robot_of(tmp_path, shell, box((-0.05,) * 3, (0.05,) * 3))
    slide = np.array([1.0, 1.01, 0.99, 0.52, 0.2, 0.0])
    _, found = found_for(body, np.column_stack([0.0 * slide, slide]))
    assert found.touch_at[0].tolist() == [True] * 4 + [False] * 2
    assert found.touch_on[0].tolist() == [True] * 4 + [False]
    assert_close(found.at_frames[0, 4:], np.array([0.25, 0.45]))


def test_hulls_that_overlap_where_meshes_do_not(tmp_path):
    """A peg in the gap of a fork: 20 mm free on both sides, and hulls say nothing."""
    fork = trimesh.util.concatenate(
        [
            box((0.5, -0.3, -0.1), (0.6, 0.3, 0.1)),
            box((0.5, 0.1, -0.1), (1.0, 0.3, 0.1)),
            box((0.5, -0.3, -0.1), (1.0, -0.1, 0.1)),
        ]
    )
    peg = box((0.7, -0.08, -0.05), (0.9, 0.08, 0.05))
    body = robot_of(tmp_path, fork, peg, axis="0 1 0")
    slide = np.array([0.0, 0.01, -0.015, 0.019, 0.021])
    _, found = found_for(body, np.column_stack([0.0 * slide, slide]))
    d = 0.02 - np.abs(slide)
    assert found.touch_at[0].tolist() == [False] * 4 + [True]
    assert_close(found.at_frames[0, :4], d[:4])
    assert_close(found.on_ways[0, :3], np.minimum(d[:3], d[1:4]))
    assert found.touch_on[0].tolist() == [False] * 3 + [True]


def test_a_single_frame(tmp_path):
    body = robot_of(
        tmp_path, box((0.3, -0.1, -0.1), (0.4, 0.1, 0.1)), box((0, 0, 0), (0.1,) * 3)
    )
    for slide, d in ((0.17, 0.03), (0.2, 0.0), (-3.0, 3.2)):
        _, found = found_for(body, [[0.0, slide]])
        assert found.on_ways.shape == (1, 0)
        assert_close(found.at_frames[0], np.array([d]))
        assert found.touch_at[0, 0] == (d == 0.0)


def test_many_frames_are_searched_in_parts(tmp_path, monkeypatch):
    body = robot_of(
        tmp_path, box((0.3, -0.1, -0.1), (0.4, 0.1, 0.1)), box((0, 0, 0), (0.1,) * 3)
    )
    slide = 0.1 + 0.1 * np.sin(np.linspace(0.0, 2.5 * np.pi, 14))
    q = np.column_stack([0.0 * slide, slide])
    _, whole = found_for(body, q)
    monkeypatch.setattr("crar_drake.references.mesh_clearance._BLOCK", 4)
    _, parts = found_for(body, q)
    assert parts.at_frames.shape == (1, 14) and parts.on_ways.shape == (1, 13)
    np.testing.assert_array_equal(parts.touch_at, whole.touch_at)
    np.testing.assert_array_equal(parts.touch_on, whole.touch_on)
    assert_close(parts.at_frames[0], 0.2 - slide)


def test_of_pairs_that_are_far_the_smallest_bounds_are_told(tmp_path, monkeypatch):
    """Also where some frames are changed: then none that was larger is."""
    body = robot_of(
        tmp_path, box((0.3, -0.1, -0.1), (0.4, 0.1, 0.1)), box((0, 0, 0), (0.1,) * 3)
    )
    slide = np.array([0.0, 0.05, 0.1, 0.05])
    q = np.column_stack([0.0 * slide, slide])
    _, every = found_for(body, q)
    monkeypatch.setattr("crar_drake.references.mesh_clearance._NEAR", 0.02)
    meshes, found = found_for(body, q)
    assert found.at_frames.shape == (0, 4) and found.num_unclear == 0
    assert found.least_at == every.at_frames.min() and found.least_at > 0.04
    assert found.least_on == every.on_ways.min()
    q[2, 1] = 0.19  # now it is near
    found = meshes.find(q)
    assert found.near.tolist() == [0] and 0.0 < found.at_frames[0, 2] <= 0.01
    assert found.least_at == found.at_frames.min()


def test_what_is_no_number_is_told(tmp_path):
    body = robot_of(tmp_path, box((1,) * 3, (2,) * 3), box((-1,) * 3, (0,) * 3))
    q = np.zeros((3, 2))
    for bad in (np.nan, np.inf, -2e5):
        q[1, 1] = bad
        with pytest.raises(MotionError, match=f"frame 2: joint 'slide' is {bad}"):
            found_for(body, q)
    with pytest.raises(MotionError, match="without frames"):
        found_for(body, np.zeros((0, 2)))


def test_it_lists_what_it_is_not_of(tmp_path):
    small = box((-0.01,) * 3, (0.01,) * 3)
    # Hand and post meet as they are built; the arm has a shape, then none.
    body = robot_of(tmp_path, small, small.copy(), arm='<sphere radius="0.001"/>')
    not_of = ClearanceOfMeshes(body).meshes.not_of
    assert not_of.as_built == [("post", "hand")]
    assert not_of.one_joint == [("post", "arm"), ("arm", "hand")]
    assert not_of.without_mesh == [] and not_of.beyond_root == []
    assert found_for(body, np.zeros((2, 2)))[1].pairs == []
    far = robot_of(tmp_path, small, small.copy().apply_translation([1, 0, 0]))
    meshes, found = found_for(far, np.zeros((2, 2)))
    assert meshes.meshes.not_of.without_mesh == ["arm"]
    assert found.pairs == [("post", "hand")]
    none = robot_of(tmp_path, small, None)
    meshes, found = found_for(none, np.zeros((2, 2)))
    assert found.pairs == [] and found.at_frames.shape == (0, 2)
    assert meshes.meshes.not_of.without_mesh == ["arm", "hand"]


def test_links_that_the_root_does_not_carry(tmp_path):
    """Where a joint moves the root, its motion is not in the joints' positions."""
    body = robot_of(tmp_path, box((1,) * 3, (2,) * 3), box((-1,) * 3, (0,) * 3))
    urdf = (tmp_path / "clock.urdf").read_text()
    stands = '<link name="world"/>' + joint("stands", "world", "post", kind="fixed")
    urdf = urdf.replace('<parent link="post"/>', '<parent link="world"/>')
    write(tmp_path, urdf.replace("</robot>", stands + "</robot>"), "clock.urdf")
    yaml = (tmp_path / "robot.yaml").read_text().replace("base: post", "base: ''")
    driven = "prescribed_joints: {turn: waist.heading}\n"
    (tmp_path / "robot.yaml").write_text(yaml + driven)
    body = WholeBody(load_robot_description(tmp_path))
    assert body.root == "arm" and body.joint_names == ("slide",)
    meshes, found = found_for(body, np.zeros((2, 1)))
    assert found.pairs == [] and meshes.meshes.not_of.beyond_root == [("post", "hand")]


@dataclass
class Chains:
    """Two chains of random boxes on one base, for this project and for MuJoCo."""

    body: WholeBody
    model: mujoco.MjModel
    boxes: list[str]

    def distances(self, q: np.ndarray) -> dict[tuple[str, str], float]:
        """Of all pairs of boxes, by MuJoCo."""
        data = mujoco.MjData(self.model)
        for name, value in zip(self.body.joint_names, q, strict=True):
            data.joint(name).qpos = value
        mujoco.mj_kinematics(self.model, data)
        ids = {name: self.model.geom(name).id for name in self.boxes}
        return {
            (a, b): mujoco.mj_geomDistance(self.model, data, ids[a], ids[b], 9.0, None)
            for a in self.boxes
            for b in self.boxes
            if a != b
        }


def chains(folder: Path, seed: int) -> Chains:
    """A trunk that turns, and on it two arms: turn, slide, turn, turn."""
    rng = np.random.default_rng(seed)
    parts = []
    mjcf: dict[str, str] = {}
    below: dict[str, list[str]] = {}

    def add(name, parent, kind, xyz):
        size = rng.uniform(0.03, 0.12, 3)
        centre = rng.uniform(-0.05, 0.05, 3)
        axis = Rotation.random(random_state=rng).as_matrix()[0]
        turned = Rotation.random(random_state=rng)
        mesh = trimesh.creation.box(extents=2.0 * size)
        mesh.apply_transform(
            np.block([[turned.as_matrix(), centre[:, None]], [0, 0, 0, 1]])
        )
        mesh.export(folder / f"{name}.obj", digits=12)
        parts.append(link(name, f'<mesh filename="{name}.obj"/>'))
        text = " ".join(map(repr, map(float, axis)))
        at = " ".join(map(repr, map(float, xyz)))
        moves = ""
        if parent:
            parts.append(joint(f"to_{name}", parent, name, text, at, kind, limits=WIDE))
            of = "hinge" if kind == "revolute" else "slide"
            moves = f'<joint name="to_{name}" type="{of}" axis="{text}"/>'
        quaternion = turned.as_quat()[[3, 0, 1, 2]]
        mjcf[name] = (
            f'<body name="{name}" pos="{at}">{moves}<geom name="{name}" type="box" '
            f'mass="1" size="{" ".join(map(str, size))}" '
            f'pos="{" ".join(map(str, centre))}" '
            f'quat="{" ".join(map(str, quaternion))}"/>'
        )
        below.setdefault(parent, []).append(name)

    add("base", "", "", (0, 0, 0))
    add("trunk", "base", "revolute", (0, 0, 0.3))
    for side in (-1.0, 1.0):
        parent = "trunk"
        for k, kind in enumerate(("revolute", "prismatic", "revolute", "revolute")):
            name = f"{'left' if side > 0 else 'right'}{k}"
            add(name, parent, kind, (0.05, 0.08 * side, 0.03 * k))
            parent = name

    def nested(name: str) -> str:
        return mjcf[name] + "".join(map(nested, below.get(name, []))) + "</body>"

    write(folder, robot(parts, "chains"), "chains.urdf")
    (folder / "robot.yaml").write_text(
        "name: chains\nmodel: chains.urdf\nbase: base\ntask_frames: {t: left3}\n"
    )
    text = f"<mujoco><worldbody>{nested('base')}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    body = WholeBody(load_robot_description(folder))
    return Chains(body, model, list(mjcf))


@pytest.mark.parametrize("seed", range(4))
def test_dense_samples_by_another_library(tmp_path, seed):
    """MuJoCo's boxes come nowhere nearer than the bounds, and touch where these say."""
    both = chains(tmp_path, seed)
    rng = np.random.default_rng(seed + 100)
    # Frames that are near each other, and jumps over half a turn.
    steps = rng.normal(size=(10, 9)) * rng.choice([0.02, 0.2, 1.0], size=(10, 1))
    q = np.cumsum(steps, axis=0)
    q[:, [n in ("to_left1", "to_right1") for n in both.body.joint_names]] *= 0.1
    meshes, found = found_for(both.body, q)
    assert len(found.pairs) + len(meshes.meshes.not_of.as_built) == 36
    nearest = np.full(found.on_ways.shape, np.inf)
    for k in range(len(q)):
        at_frame = both.distances(q[k])
        d = np.array([at_frame[pair] for pair in found.pairs])
        apart = d > 2.0 * ROUNDING
        assert np.all(found.at_frames[:, k] <= np.maximum(d, 0.0) + 1e-7)
        assert not found.touch_at[apart, k].any()
        assert found.touch_at[d < -1e-6, k].all()
        assert_close(found.at_frames[apart, k], d[apart], 1e-7)
        if k + 1 < len(q):
            for u in np.linspace(0.0, 1.0, 25):
                there = both.distances((1.0 - u) * q[k] + u * q[k + 1])
                d = np.array([there[pair] for pair in found.pairs])
                nearest[:, k] = np.minimum(nearest[:, k], d)
    assert np.all(found.on_ways <= np.maximum(nearest, 0.0) + 1e-7)
    assert np.all(found.on_ways[nearest < 0.0] == 0.0)
    assert np.all((found.on_ways > 0.0) | found.touch_on | (nearest < 1e-4))
    assert found.touch_on.any() and (found.on_ways > 0.0).any()


@pytest.mark.parametrize("seed", range(4))
def test_no_point_goes_farther_than_the_bound(tmp_path, seed):
    """(M1): corners' paths, from poses by Drake, where neither link's joints are."""
    both = chains(tmp_path, seed)
    rng = np.random.default_rng(seed)
    q = both.body.configurations(np.cumsum(rng.normal(size=(4, 9)), axis=0))
    meshes = ClearanceOfMeshes(both.body)
    bound = meshes.advance(q)
    plant = both.body.plant
    context = plant.CreateDefaultContext()
    trunk = plant.GetBodyByName("trunk")
    a, b = (plant.GetBodyByName(name) for name in ("left3", "right2"))
    pairs = [frozenset(pair) for pair in meshes.meshes.pairs]
    row = pairs.index(frozenset(("left3", "right2")))
    corners = {
        body: trimesh.load(tmp_path / f"{body.name()}.obj").vertices.T
        for body in (a, b)
    }
    for k in range(3):
        went = {body: np.zeros(8) for body in corners}
        last: dict = {}
        for u in np.linspace(0.0, 1.0, 400):
            plant.SetPositions(context, (1.0 - u) * q[k] + u * q[k + 1])
            for body, p_B in corners.items():
                X = plant.CalcRelativeTransform(
                    context, trunk.body_frame(), body.body_frame()
                )
                p = X.multiply(p_B)
                if body in last:
                    went[body] += np.linalg.norm(p - last[body], axis=0)
                last[body] = p
        together = sum(each.max() for each in went.values())
        assert together <= bound[row, k] <= 4.0 * together


def elbow(folder: Path) -> WholeBody:
    """A post at the axis of a shoulder, 1 m to an elbow, and a needle 1 m long."""
    half = 1e-6
    box((-half,) * 3, (half,) * 3).export(folder / "post.obj", digits=12)
    box((0.0, -half, -half), (1.0, half, half)).export(folder / "needle.obj", digits=12)
    parts = [
        link("post", '<mesh filename="post.obj"/>'),
        link("upper"),
        joint("shoulder", "post", "upper", limits=WIDE),
        link("needle", '<mesh filename="needle.obj"/>'),
        joint("bend", "upper", "needle", xyz="1 0 0", limits=WIDE),
    ]
    write(folder, robot(parts, "elbow"), "elbow.urdf")
    (folder / "robot.yaml").write_text(
        "name: elbow\nmodel: elbow.urdf\nbase: post\ntask_frames: {t: needle}\n"
    )
    return WholeBody(load_robot_description(folder))


def test_one_joint_moves_a_point_as_far_as_its_arc(tmp_path):
    body = elbow(tmp_path)
    meshes = ClearanceOfMeshes(body)
    q = np.array([[0.2, 1.0], [0.9, 1.0], [0.9, -0.5]])
    arm = np.sqrt(2.0 + 2.0 * np.cos(1.0))  # from the shoulder to the needle's end
    bound = meshes.advance(q)
    np.testing.assert_allclose(bound[0], [0.7 * arm, 1.5], rtol=1e-5)


def test_a_motion_that_was_changed_in_place_is_asked_anew(tmp_path):
    meshes, q = ClearanceOfMeshes(elbow(tmp_path)), np.array([[0.2, 1.0], [0.9, 1.0]])
    first = meshes.find(q)
    assert meshes.find(q) is first
    q[1, 1] = np.pi  # onto the post
    assert meshes.find(q).touch_at.tolist() == [[False, True]]
    assert not first.touch_at.any()


def test_an_arm_that_stretches_on_the_way(tmp_path):
    """It is bent at both ends, and its end goes farther than if it were on the way."""
    body = elbow(tmp_path)
    meshes = ClearanceOfMeshes(body)
    q = np.array([[0.0, -2.0], [3.0, 2.0]])
    u = np.linspace(0.0, 1.0, 10001)
    shoulder, bend = 3.0 * u, -2.0 + 4.0 * u
    end = np.exp(1j * shoulder) + np.exp(1j * (shoulder + bend))
    path = np.abs(np.diff(end)).sum()
    bent = 3.0 * np.sqrt(2.0 + 2.0 * np.cos(2.0)) + 4.0
    bound = meshes.advance(q)[0, 0]
    assert bent < path <= bound < 2.0 * path
