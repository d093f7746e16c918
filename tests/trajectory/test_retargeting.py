"""What a person asks of a robot: residuals and rows against finite differences, and the
side on which limbs bend."""

import re
from dataclasses import replace

import numpy as np
import pytest
from short_motions import short_amc
from small_walker import HEIGHT, HIP, leg_points, walker

from crar_drake.errors import ModelError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.planted_feet import runs
from crar_drake.motion.smooth_steps import smooth_step
from crar_drake.robot.description import load_robot_description
from crar_drake.trajectory import retargeting
from crar_drake.trajectory.body_points import ROOT, Placed
from crar_drake.trajectory.distance_rows import no_rows
from crar_drake.trajectory.keeping import Keeper
from crar_drake.trajectory.optimiser import AtFrames, Samples
from crar_drake.trajectory.performer_targets import FootTarget, performer_targets
from crar_drake.trajectory.retargeting import (
    MOST_SLIP,
    NearRowsAndFloor,
    PersonTasks,
    Retargeter,
)

STEP, RATE = 1e-6, 15.0


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


def slopes(of, y):
    found = []
    for k in range(y.shape[1]):
        step = STEP * np.eye(y.shape[1])[k]
        found.append((of(y + step) - of(y - step)) / (2.0 * STEP))
    return np.stack(found, axis=-1)


def test_jacobians_of_all_that_a_person_asks_for(robot, targets):
    frames, y = np.array([3, 40, 41, 90]), unknowns(robot, 4)
    tasks = PersonTasks(robot, targets)
    found = tasks.at(frames, y)
    assert found.r.shape == (4, 3 * 11 + 6 + 8 + 8 + 18)
    np.testing.assert_allclose(
        found.J, slopes(lambda y: tasks.at(frames, y).r, y), atol=3e-6
    )
    np.testing.assert_allclose(
        found.G, slopes(lambda y: tasks.at(frames, y).f, y), atol=1e-7
    )


def test_nothing_is_asked_for_where_the_robot_does_it(robot, targets):
    """Of soles that are where they are wanted, and of a root that is where it is."""
    frames, y = np.array([10]), unknowns(robot, 1)
    y[:, :ROOT] = 0.0
    points, _ = robot.placed(targets, frames, y).points(*robot.sole_points())
    for k, side in enumerate(("left", "right")):
        foot, corners = targets.feet[side], points[0, 4 + 4 * k : 8 + 4 * k]
        foot.heel[10], foot.ball[10] = points[0, 2 * k : 2 * k + 2]
        foot.heights[10] = corners[:, 2] - 4e-4  # they are wanted so much higher
    r = PersonTasks(robot, targets).at(frames, y).r[0]
    limbs = 3 * len(targets.directions)
    np.testing.assert_allclose(r[limbs : limbs + 6 + 16], 0.0, atol=1e-10)
    assert np.abs(r[:limbs]).max() > 0.01


def test_what_stands_is_to_stand(robot, targets):
    """Steps of a heel or ball that stands at both ends are the person's, and others do
    not count; what stands counts more at its place than what is high in the air."""
    tasks = PersonTasks(robot, targets)
    foot, p = targets.feet["left"], robot.parameters
    stands = foot.on_heel[1:] & foot.on_heel[:-1]
    assert 0.3 < stands.mean() < 1.0
    weights, steps = tasks.step_weights[:, :2], tasks.steps[:, :2]
    assert (weights[stands] == p.standing).all() and not weights[~stands].any()
    np.testing.assert_allclose(steps, np.diff(foot.heel[:, :2], axis=0))
    assert np.median(np.abs(steps[stands])) < 1e-3
    of_place = tasks._end_weights[:, 0]
    assert (of_place[foot.on_heel] == p.planted).all() and not foot.on_heel.all()
    share = np.clip(1.0 - foot.heel[:, 2] / 0.08, 0.0, 1.0)
    expected = p.foot + share * (p.planted - p.foot)
    air = ~foot.on_heel
    np.testing.assert_allclose(of_place[air], expected[air])
    assert of_place[air].min() < 0.95 * p.planted


def test_legs_are_parted_further_only_while_one_is_in_the_air(robot, targets):
    """By all that is asked for, and by nothing while both feet stand."""
    keeper = Keeper(robot.model, RATE, 4e-3, 5e-4)
    keeper.room[:] = 0.5
    left, right = (targets.feet[side] for side in ("left", "right"))
    for foot in (left, right):
        foot.on_heel[:], foot.on_ball[:] = False, False
    left.on_heel[:], right.on_ball[30:60] = True, True
    frames = np.arange(0, 90)
    at = Samples(frames, np.zeros(90), np.zeros(90))
    y = np.repeat(unknowns(robot, 1), 90, axis=0)
    rows = NearRowsAndFloor(robot, targets, keeper)(at, y, 0.2)
    pair = rows.row[rows.row < keeper.num_rows][0]
    d = rows.d[rows.row == pair]
    assert len(d) == 90
    np.testing.assert_allclose(d[30:60], d[45], atol=1e-12)
    for far in (d[:25], d[65:]):
        np.testing.assert_allclose(far, d[45] - 0.5, atol=1e-12)
    assert (np.diff(d[25:31]) >= 0.0).all() and (np.diff(d[59:65]) <= 0.0).all()


def test_rows_of_the_floor_are_the_lowest_points_of_links(robot, targets):
    keeper = Keeper(robot.model, RATE, 4e-3, 5e-4)
    rows = NearRowsAndFloor(robot, targets, keeper)
    frames, y = np.array([5, 60]), unknowns(robot, 2)
    y[:, :ROOT] = 0.0
    y[:, 2] = -0.02
    at = Samples(frames, np.zeros(2), np.zeros(2))
    found = rows(at, y, 0.05)
    assert (np.diff(found.sample) >= 0).all()
    of_floor = found.row >= keeper.num_rows
    assert {0, 1} == set(found.sample[of_floor])
    for k, frame in enumerate(frames):
        q = dict(zip(robot.model.joint_names, y[k, ROOT:], strict=True))
        R, p = targets.root_rotations[frame], targets.root_positions[frame] + y[k, :3]
        here = of_floor & (found.sample == k)
        lowest = [
            (p + leg_points(side, q)["sole"] @ R.T)[:, 2].min() - 0.01
            for side in ("left", "right")
        ]
        expected = sorted(z for z in lowest if z < 0.05)
        np.testing.assert_allclose(sorted(found.d[here]), expected, atol=1e-9)
    for k in range(y.shape[1]):
        step = STEP * np.eye(y.shape[1])[k]
        ahead, behind = (rows(at, y + s * step, 0.05).d for s in (1, -1))
        change = (ahead - behind) / (2.0 * STEP)
        np.testing.assert_allclose(found.gradient[:, k], change, atol=1e-6)
    # Between frames nobody looks at the floor.
    between = rows(Samples(frames, np.full(2, 0.5), np.zeros(2)), y, 0.05)
    assert (between.row < keeper.num_rows).all()


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


def test_from_heel_on_ball_a_foot_goes_as_it_is_wanted_to(robot, targets):
    """In that step neither stands at both ends, and the foot is on the floor."""
    foot, p = targets.feet["left"], robot.parameters
    foot.on_heel[:], foot.on_ball[:] = False, False
    foot.on_heel[3:8], foot.on_ball[8:12] = True, True
    weights = PersonTasks(robot, targets).step_weights[:, :4]
    expected = np.zeros_like(weights)
    expected[3:8, :2], expected[7:11, 2:] = p.standing, p.standing
    np.testing.assert_array_equal(weights, expected)


def test_a_contact_that_slips_is_let_go(robot, targets):
    """That one alone: its place counts less, and steps about which it turns more."""
    left, right = targets.feet["left"], targets.feet["right"]
    for foot in (left, right):
        foot.on_heel[:], foot.on_ball[:] = False, False
        foot.on_heel[3:12], foot.on_ball[6:12] = True, True
        foot.on_ball[20:30] = True
    tasks, y = PersonTasks(robot, targets), np.zeros((len(targets.root_positions), 0))
    at = np.zeros((len(y), 8))
    at[1:] = np.cumsum(tasks.steps, axis=0)
    at[9:, 6:8] += [3e-3, 0.0]  # a ball whose heel stands has turned about that
    at[25:, 2:4] += [0.0, 2.1e-3]
    tasks.at = lambda frames, y: AtFrames(None, None, at[frames], None)
    places, steps = tasks._end_weights.copy(), tasks.step_weights.copy()
    assert tasks.slip(y) == pytest.approx(1e-4)  # [m]
    slips = tasks.let_slipping_go(y)
    np.testing.assert_array_equal(np.flatnonzero(slips), np.arange(20, 30))
    places[20:30, :4] = robot.parameters.foot
    np.testing.assert_array_equal(tasks._end_weights, places)
    steps[20:29, 2:4] *= 5.0
    np.testing.assert_array_equal(tasks.step_weights, steps)
    # Flat, the ball is held more, and the heel as before.
    at[9:, 4:6] += [3e-3, 0.0]
    steps[3:6, 4:6] *= 5.0
    steps[6:11, 6:8] *= 5.0
    tasks.let_slipping_go(y)
    np.testing.assert_array_equal(tasks.step_weights[:19], steps[:19])


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


def kept_twice(targets, monkeypatch, second):
    """What `Keeper.keep` finds at first and again; the latter is changed by `second`,
    which is given the first."""
    monkeypatch.setattr(retargeting, "performer_targets", lambda *_: targets)
    keep, kept = Keeper.keep, []

    def keeps(self, *arguments, **named):
        y, violating, effort = keep(self, *arguments, **named)
        if kept:
            y, violating = second(kept[0], y, violating)
        kept.append(y)
        return y, violating, effort

    monkeypatch.setattr(Keeper, "keep", keeps)
    return kept


def test_but_not_where_that_violates_more(robot, targets, monkeypatch):
    def worse(first, again, violating):
        violating[40] = True
        return again, violating

    targets = standing_beside(robot, targets, 150, 120, 0.01)
    kept = kept_twice(targets, monkeypatch, worse)
    shown = []
    found = robot.retarget(None, RATE, shown.append)
    assert len(kept) == 2 and not found.violating.any()
    np.testing.assert_array_equal(found.q, kept[0][:, ROOT:])
    assert shown.count(150) == 2  # each comes to the end


def test_nor_where_feet_slip_as_much(robot, targets, monkeypatch):
    def no_better(first, again, violating):
        again = first.copy()
        again[:, ROOT + robot.model.joint_names.index("left_fore_arm_j")] += 1e-6
        return again, violating

    targets = standing_beside(robot, targets, 150, 120, 0.01)
    kept = kept_twice(targets, monkeypatch, no_better)
    found = robot.retarget(None, RATE)
    assert len(kept) == 2
    np.testing.assert_array_equal(found.q, kept[0][:, ROOT:])
