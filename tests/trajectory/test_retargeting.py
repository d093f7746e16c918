"""A person's motion on small robots: on which side limbs bend, and where feet stand."""

import re
from dataclasses import replace

import numpy as np
import pytest
from short_motions import short_amc
from small_walker import HEIGHT, HIP, walker

from crar_drake.errors import ModelError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.planted_feet import runs
from crar_drake.motion.smooth_steps import smooth_step
from crar_drake.robot.description import load_robot_description
from crar_drake.trajectory import retargeting
from crar_drake.trajectory.body_points import ROOT, Placed
from crar_drake.trajectory.distance_rows import no_rows
from crar_drake.trajectory.optimiser import spread
from crar_drake.trajectory.performer_targets import (
    LIMBS,
    FootTarget,
    performer_targets,
)
from crar_drake.trajectory.retargeting import (
    MOST_SLIP,
    PersonTasks,
    Retargeter,
    bridged,
)

RATE = 15.0


def with_hands(folder):
    """The walker, with its hands at its wrists."""
    walker(folder, knee=0.06)
    text = (folder / "robot.yaml").read_text()
    hands = "left_hand: left_wrist, right_hand: right_wrist, "
    text = text.replace("task_frames: {", f"task_frames: {{{hands}")
    (folder / "robot.yaml").write_text(text)
    return load_robot_description(folder)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return Retargeter(with_hands(tmp_path_factory.mktemp("walker")))


@pytest.fixture
def targets(robot):
    """New ones for each test, which changes them."""
    performer = load_performer("boxing")
    turned = robot._base[1]
    return performer_targets(performer, robot.legs, robot.soles, turned, RATE, 6.0)


def unknowns(robot, frames, seed=0):
    rng = np.random.default_rng(seed)
    y = 0.1 * rng.normal(size=(frames, ROOT + robot.model.n))
    rest = robot.rest[robot.model.controlled_positions]
    y[:, ROOT:] = np.clip(rest + y[:, ROOT:], robot.model.lower, robot.model.upper)
    return y


def limits(robot, joint):
    k = list(robot.model.joint_names).index(joint)
    return robot._lower[k], robot._upper[k]


def test_elbows_and_knees_bend_on_a_persons_side(robot):
    """A forearm that hangs goes ahead where its joint about y turns to the negative."""
    for side in ("left", "right"):
        lower, upper = limits(robot, f"{side}_fore_arm_j")
        assert lower == -2.0 and 0.0 < upper < 0.1
        lower, upper = limits(robot, f"{side}_shank_j")
        assert -0.05 <= lower < 0.0 and upper == 2.5
    others = [
        k
        for k, name in enumerate(robot.model.joint_names)
        if not name.endswith(("fore_arm_j", "shank_j"))
    ]
    np.testing.assert_array_equal(robot._lower[others], robot.model.lower[others])
    np.testing.assert_array_equal(robot._upper[others], robot.model.upper[others])


def test_however_their_axes_point(tmp_path):
    """Axes the other way around, and a forearm that is straight at another angle."""
    walker(tmp_path)
    text = (tmp_path / "walker.urdf").read_text()
    for joint, lower, upper in (("fore_arm", -2, 2), ("shank", -2.5, 0.4)):
        text, count = re.subn(
            rf'(<joint name="\w+_{joint}_j" type.*?<axis xyz=")0 1 0'
            r'("/><limit lower=")[^"]*(" upper=")[^"]*',
            rf"\g<1>0 -1 0\g<2>{lower}\g<3>{upper}",
            text,
        )
        assert count == 2
    # Forearms begin bent: they are straight at +0.4, and end ahead beyond it.
    text = re.sub(
        r'(<child link="\w+_fore_arm"/><origin xyz="[^"]*")', r'\1 rpy="0 0.4 0"', text
    )
    (tmp_path / "walker.urdf").write_text(text)
    rest = re.sub(
        r"(_shank_j|_fore_arm_j): (-?)",
        lambda m: f"{m[1]}: {'' if m[2] else '-'}",
        (tmp_path / "robot.yaml").read_text(),
    )
    (tmp_path / "robot.yaml").write_text(rest)
    robot = Retargeter(load_robot_description(tmp_path))
    for side in ("left", "right"):
        lower, upper = limits(robot, f"{side}_fore_arm_j")
        assert 0.3 < lower < 0.45 and upper == 2.0
        lower, upper = limits(robot, f"{side}_shank_j")
        assert lower == -2.5 and 0.0 < upper < 0.1


def test_hinges_without_limits(tmp_path):
    """As URDF has them that call every joint continuous."""
    walker(tmp_path)
    text, count = re.subn(
        r'(<joint name="\w+_(?:fore_arm|shank)_j" type=")revolute(".*?<limit )'
        r'lower="[^"]*" upper="[^"]*"',
        r"\1continuous\2",
        (tmp_path / "walker.urdf").read_text(),
    )
    assert count == 4
    (tmp_path / "walker.urdf").write_text(text)
    robot = Retargeter(load_robot_description(tmp_path))
    for side in ("left", "right"):
        lower, upper = limits(robot, f"{side}_fore_arm_j")
        assert lower == -np.inf and 0.0 <= upper < 0.2
        lower, upper = limits(robot, f"{side}_shank_j")
        assert -0.2 < lower <= 0.0 and upper == np.inf


def test_a_leg_is_measured_as_it_is_built(robot):
    for leg in robot.legs.values():
        assert leg.thigh == pytest.approx(0.35) and leg.shank == pytest.approx(0.33)
        assert leg.heel[0] == pytest.approx(-0.06, abs=0.01)
        assert leg.ball[0] == pytest.approx(0.12, abs=0.01)
        assert leg.heel[2] == leg.ball[2] == pytest.approx(-0.06, abs=0.01)
    assert HEIGHT == pytest.approx(0.35 + 0.33 + 0.06 + 0.05)


def test_a_robot_without_a_head_follows_all_the_same(tmp_path):
    walker(tmp_path)
    text = (tmp_path / "robot.yaml").read_text()
    assert "head: head, " in text or ", head: head" in text
    text = text.replace(", head: head", "").replace("head: head, ", "")
    (tmp_path / "robot.yaml").write_text(text)
    robot = Retargeter(load_robot_description(tmp_path))
    performer = load_performer(short_amc(tmp_path / "motion", "short"))
    found = robot.retarget(performer, RATE)
    assert "trunk" in found.targets.directions
    assert "head" not in found.targets.directions


class NoMeshes:
    """Meshes without a pair, and how often they were asked."""

    num_pairs = asked = 0

    def touching(self, q):
        self.asked += 1
        return np.zeros((0, len(q)), dtype=bool)

    def near_rows(self, where, parts):
        return lambda at, q, look: no_rows(q.shape[1])


def test_what_was_solved_before_changes_nothing(tmp_path, robot):
    """Another motion, another rate, meshes."""
    short, other = (
        load_performer(short_amc(tmp_path, of, of=of)) for of in ("dance", "boxing")
    )
    first, meshes = robot.retarget(short, RATE), NoMeshes()
    robot.retarget(short, 2.0 * RATE)
    robot.retarget(other, RATE, meshes=meshes)
    asked = meshes.asked
    again = robot.retarget(short, RATE)
    assert meshes.asked == asked > 0
    np.testing.assert_array_equal(again.q, first.q)
    np.testing.assert_array_equal(again.root_positions, first.root_positions)


def test_the_root_accelerates_as_the_persons(tmp_path, robot):
    """Root mean squares of second differences, of the scaled path and the robot's."""
    performer = load_performer(short_amc(tmp_path, "some", 121, of="exercise"))
    found = robot.retarget(performer, 30.0)
    rms, persons = (
        np.sqrt(np.mean(np.sum((900.0 * np.diff(p, 2, axis=0)) ** 2, axis=1)))
        for p in (found.root_positions, found.targets.root_positions)
    )
    assert persons > 0.2 and rms < 1.3 * persons


def test_limbs_may_be_elsewhere_in_all_frames(tmp_path, robot):
    """Of a robot whose joints may hardly move: there is no frame to begin from."""
    stiff = Retargeter(replace(robot.description, range_share=0.02))
    performer = load_performer(short_amc(tmp_path, "short"))
    found = stiff.retarget(performer, RATE)
    root = found.root_positions, found.root_rotations
    limb = "left_shoulder-elbow"
    (way,) = stiff.ways(*root, found.q, [LIMBS[limb][1]])
    along = np.sum(way * found.targets.directions[limb], axis=1)
    assert (along < np.cos(np.radians(45.0)) * np.linalg.norm(way, axis=1)).all()
    assert not found.violating.any()


def test_what_lasts_went_astray(robot, targets):
    """Limbs where they are wanted, but an arm that jumps elsewhere for some frames, and
    by less for one."""
    frames = 30
    y = np.tile(unknowns(robot, 1), (frames, 1))
    y[:, :ROOT] = 0.0
    root = np.zeros((frames, 3)), np.tile(robot._base[1], (frames, 1, 1))
    ends = [LIMBS[limb][1] for limb in targets.directions]
    ways = robot.ways(*root, y[:, ROOT:], ends)
    directions = {
        limb: way / np.linalg.norm(way, axis=1)[:, None]
        for limb, way in zip(targets.directions, ways, strict=True)
    }
    there = {
        "root_positions": root[0],
        "root_rotations": root[1],
        "directions": directions,
        "feet": {
            side: FootTarget(
                *(x[:frames] for x in (foot.heel, foot.ball)),
                *(x[:frames] for x in (foot.on_heel, foot.on_ball, foot.heights)),
            )
            for side, foot in targets.feet.items()
        },
        "hands": {},
    }
    tasks = PersonTasks(robot, replace(targets, **there))
    assert not tasks.astray(y).any()
    k = list(robot.model.joint_names).index("left_fore_arm_j")
    y[10:20, ROOT + k] -= 1.2
    y[25, ROOT + k] -= 0.8
    # The first frame back is one to which it jumps.
    assert np.flatnonzero(tasks.astray(y)).tolist() == list(range(10, 21))
    straight = bridged(y, spread(tasks.astray(y), 1))
    np.testing.assert_allclose(straight[:25], np.tile(y[:1], (25, 1)))
    np.testing.assert_array_equal(straight[25:], y[25:])


def test_a_link_that_is_called_like_another_ones_point(tmp_path, robot):
    """As a thigh is that is called after the joint at its end."""
    with_hands(tmp_path)
    for file in ("walker.urdf", "robot.yaml"):
        text = (tmp_path / file).read_text()
        for side in ("left", "right"):
            thigh = f"{side}_thigh(?!_)"
            text = re.sub(thigh, f"{side}_knee", text)
        (tmp_path / file).write_text(text)
    named = Retargeter(load_robot_description(tmp_path))
    assert "left_knee" in named._links
    y = unknowns(robot, 3)
    root = np.tile(robot._base[0], (3, 1)), np.tile(robot._base[1], (3, 1, 1))
    ends = [("left_hip", "left_knee"), ("right_knee", "right_foot")]
    expected, found = (each.ways(*root, y[:, ROOT:], ends) for each in (robot, named))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_robot_that_lacks_a_frame_is_told_which(tmp_path):
    walker(tmp_path)
    text = (tmp_path / "robot.yaml").read_text()
    text = text.replace("left_knee: left_shank, ", "")
    (tmp_path / "robot.yaml").write_text(text)
    with pytest.raises(ModelError, match="needs the task_frames left_knee; add"):
        Retargeter(load_robot_description(tmp_path))


def standing_beside(robot, targets, frames, last, beside):
    """Who stands, and from a frame on with the right foot so far from the left [m]."""
    share = smooth_step((np.arange(frames) - last) / 8.0 + 1.0)[:, None]
    feet = {}
    for side, y in (("left", HIP[1]), ("right", -HIP[1])):
        on, way = np.ones(frames, dtype=bool), np.zeros(3)
        if side == "right":
            on[last - 8 : last], way = False, np.array([0.0, HIP[1] - beside - y, 0.0])
        height = np.where(on, 0.0, 0.03)
        heel, ball = (
            np.array([end[0], y, 0.0]) + share * way + height[:, None] * [0.0, 0.0, 1.0]
            for end in (robot.legs[side].heel, robot.legs[side].ball)
        )
        heights = np.repeat(height[:, None], 4, axis=1)
        feet[side] = FootTarget(heel, ball, on, on.copy(), heights)
    return replace(
        targets,
        root_positions=np.tile([0.0, 0.0, HEIGHT - 0.02], (frames, 1)),
        root_rotations=np.tile(robot._base[1], (frames, 1, 1)),
        directions={
            limb: np.repeat(way[:1], frames, axis=0)
            for limb, way in targets.directions.items()
        },
        feet=feet,
        hands={},
    )


def slip(robot, targets, found):
    """The longest way of a heel or ball in one contact [m]."""
    y = np.hstack([np.zeros((len(found.q), ROOT)), found.q])
    there = robot._poses, robot.rest, robot._base, found.root_positions
    placed = Placed(*there, found.root_rotations, y)
    ends = placed.points(*robot.sole_points())[0][:, :4, :2]
    ways = np.linalg.norm(np.diff(ends, axis=0), axis=2)
    stands = targets.feet["right"].on_ball
    stands = np.stack([np.ones_like(stands), stands])[[0, 0, 1, 1]].T
    stands = stands[1:] & stands[:-1]
    return max(
        ways[a:b, end].sum() for end in range(4) for a, b in runs(stands[:, end])
    )


def test_a_foot_that_has_no_room_where_it_is_wanted_stands_elsewhere(
    robot, targets, monkeypatch
):
    """One steps to where the other has stood for long: knees do not let it."""
    targets = standing_beside(robot, targets, 150, 120, 0.01)
    monkeypatch.setattr(retargeting, "performer_targets", lambda *_: targets)
    found = robot.retarget(None, RATE)
    assert not found.violating.any()
    assert slip(robot, targets, found) < MOST_SLIP
    monkeypatch.setattr(retargeting, "MOST_SLIP", np.inf)
    assert slip(robot, targets, robot.retarget(None, RATE)) > MOST_SLIP
