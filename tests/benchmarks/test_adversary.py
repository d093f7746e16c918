"""The adversary: its judge is right, its attacks are sound, a bad law is caught."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.tree import PrismaticJoint
from scipy.spatial import ConvexHull

from benchmarks.adversary import __main__ as command
from benchmarks.adversary import drive
from benchmarks.adversary.attacks import ATTACKS, GAINS, make_episode
from benchmarks.adversary.cases import (
    Case,
    Result,
    law_digest,
    make_cases,
    read_results,
    write_results,
)
from benchmarks.adversary.drive import drive_exact, drive_torque
from benchmarks.adversary.judge import (
    box_distances,
    segment_distances,
    segments_to_boxes,
    segments_to_hull,
)
from benchmarks.adversary.policies import POLICIES
from benchmarks.adversary.random_robots import KINDS, draw_robot
from benchmarks.adversary.robots import load_subject
from benchmarks.adversary.run import play, play_and_judge, run_case
from benchmarks.adversary.starts import (
    FARTHEST,
    POSE_CLEARANCE,
    fast,
    random_poses,
    singular,
)
from benchmarks.adversary.targets import approach, chirp, waves
from benchmarks.page import Benchmark
from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters
from crar_drake.errors import CrarError, ScenarioError
from crar_drake.judging.referee import Referee
from crar_drake.robot.description import find_body

ROBOTS = ("upper_body", "obstacle_arm", "jaw")  # those that need no import


def anywhere(model, rng, count):
    """Poses within and beyond limits, prescribed joints moved, too."""
    q = rng.uniform(-2.9, 2.9, (count, model.plant.num_positions()))
    q[:, model.prescribed] *= 0.1
    return q


def scene_graph_distances(model, q):
    """(T, N) of all watched shape pairs, by Drake."""
    workspace = model.MakeWorkspace()
    port = model.scene_graph.get_query_output_port()
    ids = [
        (a, b)
        for first, second in model.description.pairs
        for a in shapes(model, first)
        for b in shapes(model, second)
    ]
    found = np.empty((len(q), len(ids)))
    for k, q_k in enumerate(q):
        model.plant.SetPositions(workspace.plant_context, q_k)
        query = port.Eval(workspace.scene_graph_context)
        found[k] = [
            query.ComputeSignedDistancePairClosestPoints(*pair).distance for pair in ids
        ]
    return found


@pytest.mark.parametrize("robot", ROBOTS)
def test_judge_agrees_with_scene_graph(robot):
    """Distances by Drake's geometry engine and kinematics, shape by shape."""
    subject = load_subject(robot)
    model = subject.model(subject.task_set(0))
    q = anywhere(model, np.random.default_rng(3), 80)
    ours, theirs = subject.judge.distances(q), scene_graph_distances(model, q)
    # The engine's nearest points are points of the shapes, so that its distance is
    # never too small; where its iterations end early it is somewhat too large.
    beyond = theirs - ours
    assert beyond.min() > -1e-9
    assert np.quantile(beyond, 0.9) < 1e-5
    assert beyond[theirs < 2e-3].max() < 3e-5
    assert (theirs < 0.0).sum() > 3 and (theirs > 0.0).sum() > 200


@pytest.mark.parametrize("kind", KINDS)
def test_judge_agrees_with_scene_graph_on_robots_that_are_drawn(kind):
    """Capsules, whips and boxes, and slides anywhere."""
    rng = np.random.default_rng(7)
    found, boxes = [], 0
    for seed in range(15):
        subject = load_subject(kind, seed)
        model = subject.model("drawn")
        q = rng.uniform(-2.0, 2.0, (20, model.plant.num_positions()))
        ours, theirs = subject.judge.distances(q), scene_graph_distances(model, q)
        together = (ours < 0.0) & (theirs < 0.0)  # how deep is not claimed
        found.append(np.stack([ours, theirs])[:, ~together])
        boxes += int(subject.judge._is_box.sum())
        nearest, pair = subject.judge.nearest(q)
        np.testing.assert_allclose(nearest, ours.min(axis=1), atol=1e-12)
        np.testing.assert_allclose(ours[np.arange(20), pair], nearest, atol=1e-12)
    ours, theirs = np.concatenate(found, axis=1)
    assert (theirs - ours).min() > -1e-9
    # The engine's iterations end early at times.
    assert np.quantile(theirs - ours, 0.99) < 1e-5 and (theirs - ours).max() < 5e-3
    assert len(ours) > 3000 and (boxes > 30) == (kind == "boxes")


def test_distances_of_boxes_that_meet_or_touch():
    """By hand, and of segments by brute force."""
    unit = np.eye(3)[None], np.full((1, 3), 0.5)
    for middle, expected in (
        ((1.5, 0.0, 0.0), 0.5),
        ((1.5, 1.5, 0.0), np.sqrt(0.5)),
        ((0.9, 0.2, 0.1), -0.1),
        ((0.0, 0.0, 0.0), -1.0),
    ):
        d = box_distances((np.zeros((1, 3)), *unit), (np.array([middle]), *unit))
        np.testing.assert_allclose(d, expected, atol=1e-12)
    rng = np.random.default_rng(8)
    p0, p1 = rng.normal(size=(2, 300, 3))
    half = rng.uniform(0.05, 0.8, (300, 3))
    s = np.linspace(0.0, 1.0, 2001)[:, None]
    x = p0[:, None] + s * (p1 - p0)[:, None]
    out = np.abs(x) - half[:, None]
    brute = np.linalg.norm(np.maximum(out, 0.0), axis=2).min(axis=1)
    d = segments_to_boxes(p0, p1, half)
    assert (d <= brute + 1e-12).all() and (brute - d).max() < 5e-3
    assert (d == 0.0).any() and (d > 0.1).any()


def test_robots_that_are_drawn_have_what_is_claimed():
    """Slides and turns, ranges of nothing, whips, no speed limit, moved posts; each
    the same again."""
    slides = zero = free = prescribed = whips = 0
    joints = set()
    for seed in range(40):
        _, judge, model = draw_robot("random", seed)
        plant = model.plant
        arm = [
            plant.get_joint(j)
            for j in plant.GetJointIndices()
            if plant.get_joint(j).name().startswith("joint")
            and "post" not in plant.get_joint(j).name()
        ]
        joints.add(len(arm))
        slides += sum(isinstance(joint, PrismaticJoint) for joint in arm)
        zero += int((model.lower == model.upper).sum())
        free += int(np.isinf(model.velocity_limits).sum())
        prescribed += model.n_p
        whips += int((judge._radius == 1e-3).sum())
        _, again, _ = draw_robot("random", seed)
        q = model.rest_positions()
        np.testing.assert_array_equal(
            again.distances(q[None]), judge.distances(q[None])
        )
    assert joints == {1, 2, 3, 4, 5, 6}
    assert min(slides, free, prescribed, whips) > 10 and zero > 3


def shapes(model, name):
    body = find_body(model.plant, name)
    return model.plant.GetCollisionGeometriesForBody(body)


@pytest.mark.parametrize("robot", ROBOTS)
def test_judge_agrees_with_the_referee_inside_as_well(robot):
    subject = load_subject(robot)
    model = subject.model(subject.task_set(0))
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    q = anywhere(model, np.random.default_rng(4), 60)
    d, pair = subject.judge.nearest(q)
    expected = np.array([referee.distances(q_k).min() for q_k in q])
    np.testing.assert_allclose(d, expected, atol=1e-9)
    assert (expected < 0.0).any() and (expected > 0.0).any()
    all_of_them = subject.judge.distances(q)
    np.testing.assert_allclose(all_of_them[np.arange(60), pair], d, atol=1e-12)
    excess = subject.judge.excess(q)
    both = np.array([referee.limit_excess(q_k) for q_k in q])[:, model.controlled]
    np.testing.assert_array_equal(excess, both)
    assert excess.max() > 0.0


def test_distances_of_segments_in_their_special_cases():
    """Crossing, parallel, in line, a point, and nearly parallel, by hand."""
    cases = [
        # a0, a1, b0, b1, distance
        ((-1, 0, 0), (1, 0, 0), (0, -1, 0.3), (0, 1, 0.3), 0.3),
        ((0, 0, 0), (1, 0, 0), (0.5, 0.2, 0), (2, 0.2, 0), 0.2),
        ((0, 0, 0), (1, 0, 0), (1.5, 0, 0), (2, 0, 0), 0.5),
        ((0, 0, 0), (0, 0, 0), (3, 4, 0), (3, 4, 0), 5.0),
        ((0.5, 1, 0), (0.5, 1, 0), (0, 0, 0), (1, 0, 0), 1.0),
        ((0, 0, 0), (1, 0, 0), (0, 0.1, 0), (1, 0.1 + 1e-8, 0), 0.1),
        ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), 0.0),
    ]
    ends = [np.array([case[i] for case in cases], dtype=float) for i in range(4)]
    expected = np.array([case[4] for case in cases])
    np.testing.assert_allclose(segment_distances(*ends), expected, atol=1e-7)


def test_distances_of_segments_are_the_smallest_there_is():
    rng = np.random.default_rng(5)
    a0, a1, b0, b1 = rng.normal(size=(4, 300, 3))
    s = np.linspace(0.0, 1.0, 101)
    a = a0[:, None] + s[:, None] * (a1 - a0)[:, None]
    b = b0[:, None] + s[:, None] * (b1 - b0)[:, None]
    brute = np.linalg.norm(a[:, :, None] - b[:, None], axis=3).min(axis=(1, 2))
    d = segment_distances(a0, a1, b0, b1)
    assert (d <= brute + 1e-12).all()
    assert (brute - d).max() < 0.05  # the grid's width


def test_judge_counts_states_limits_speeds_and_paths():
    subject = load_subject("jaw")
    judge, model = subject.judge, subject.model("position")
    rest = model.rest_positions()
    q, v = np.tile(rest, (5, 1)), np.zeros((5, len(rest)))
    c = list(judge.joint_names).index("elbow")
    column = judge.controlled[c]
    q[1, column] = judge.upper[c] + 0.01  # a position limit
    v[2, column] = -1.5 * judge.fastest[c]  # a speed limit
    left = model.position_names.index("left_slide")
    q[3, left] -= 0.3  # the post is in the hand's place, or beyond
    q[3, :] = posts_on_hand(model, judge, rest)
    verdict = judge.judge(q, v, 0.03, np.random.default_rng(0), share=1.0)
    assert verdict.states == 5 and verdict.paths == 5
    assert verdict.penetrating == 1 and verdict.clearance < 0.0
    assert verdict.beyond_limit == 1 and verdict.joint == "elbow"
    assert verdict.excess == pytest.approx(0.01)
    assert verdict.too_fast == 1 and verdict.overspeed == pytest.approx(1.5)
    assert verdict.first == 1 and verdict.unsafe
    # Braking alone: at rest all is well, a fast slide goes through the hand.
    v = np.zeros((1, len(rest)))
    still = judge.judge(rest[None], v, 0.03, np.random.default_rng(0))
    assert not still.violated and still.path_clearance > 0.0
    v[0, column] = (judge.upper[c] - rest[column] + 0.1) / 0.5
    both = np.tile(rest, (2, 1)), np.concatenate([0.0 * v, v])
    ahead = judge.judge(*both, 0.5, np.random.default_rng(0))
    assert ahead.ahead == 1 and ahead.beyond_limit == 0 and ahead.unsafe
    # Braking paths are claimed to be clear at control steps, not between them.
    q, v = np.tile(rest, (4, 1)), np.concatenate([0.0 * v, v, 0.0 * v, 0.0 * v])
    counted = judge.judge(q, v, 0.5, np.random.default_rng(0), share=1.0)
    assert (counted.ahead, counted.first, counted.paths) == (1, 1, 4)
    claimed = judge.judge(q, v, 0.5, np.random.default_rng(0), share=1.0, per_step=2)
    assert (claimed.ahead, claimed.first, claimed.paths) == (0, None, 2)
    assert claimed.states == 4 and not claimed.violated


def posts_on_hand(model, judge, rest):
    """The jaw with a post through its hand: found by sliding it along."""
    poses = random_poses(model, judge, np.random.default_rng(0), 40)
    left = model.position_names.index("left_slide")
    for q in poses:
        slid = np.tile(q, (200, 1))
        slid[:, left] = np.linspace(-0.5, 0.5, 200)
        d, _ = judge.nearest(slid)
        if d.min() < -0.02:
            return slid[d.argmin()]
    raise AssertionError("no pose was found")


@pytest.mark.parametrize("motion", ["waves", "chirp", "approach"])
def test_targets_have_the_derivatives_of_their_formula(motion):
    time = np.linspace(0.0, 1.0, 20001)
    rng = np.random.default_rng(1)
    amplitude = rng.uniform(0.1, 0.3, (2, 3))
    if motion == "waves":
        path = waves(time, amplitude[..., None], rng.uniform(1, 4, (2, 3, 1)), 0.3)
    elif motion == "chirp":
        path = chirp(time, amplitude, 0.5, 6.0, 0.3)
    else:
        path = approach(time, amplitude, -amplitude, 0.7)
    for k in (0, 1):
        slope = np.gradient(path[k], time, axis=0, edge_order=2)
        np.testing.assert_allclose(
            slope, path[k + 1], atol=2e-3 * abs(path[k + 1]).max()
        )


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_attacks_start_clear_and_have_targets_of_the_right_size(robot, attack):
    subject = load_subject(robot)
    for seed in range(3):
        model = subject.model(subject.task_set(seed))
        if attack == "moving" and not model.n_p:
            continue
        parameters = CrarParameters(period=0.01)
        episode = make_episode(attack, model, subject.judge, parameters, 50, [seed])
        parameters = replace(parameters, period=episode.parameters.period)
        assert (attack == "slow") == (parameters.period > 0.01)
        assert episode.tasks.shape == (50, model.layout.size)
        assert episode.prescribed.shape == (50, 3 * model.n_p)
        assert np.isfinite(episode.prescribed).all()
        assert episode.posture.shape == (50, model.n if attack == "posture" else 0)
        lost = np.isnan(episode.tasks).all(axis=1)
        assert np.isfinite(episode.tasks[~lost]).all()
        assert lost.any() == (attack == "lost") and not lost.all()
        quaternions = episode.tasks[~lost][:, model.layout.quaternion_entries.ravel()]
        lengths = np.linalg.norm(quaternions.reshape(-1, 4), axis=1)
        np.testing.assert_allclose(lengths, 1.0, atol=1e-9)
        horizon = episode.parameters.braking_horizon
        path = episode.q + np.linspace(0.0, horizon, 80)[:, None] * episode.v
        assert subject.judge.nearest(path)[0].min() >= 1.5e-3
        if attack != "beyond":
            assert subject.judge.path_is_clear(episode.q, episode.v, horizon, 1.5e-3)
        parameters = replace(parameters, period=0.01)
        again = make_episode(attack, model, subject.judge, parameters, 50, [seed])
        np.testing.assert_array_equal(again.tasks, episode.tasks)
        np.testing.assert_array_equal(again.q, episode.q)
        other = make_episode(attack, model, subject.judge, parameters, 50, [seed + 9])
        assert not np.array_equal(other.tasks, episode.tasks, equal_nan=True)


def test_pose_targets_turn_as_their_velocities_say():
    """The quaternions' differences are the angular velocities."""
    subject = load_subject("jaw")
    model = subject.model("pose")
    parameters = CrarParameters(period=1e-4)
    episode = make_episode("sine", model, subject.judge, parameters, 2000, [3])
    unpacked = [model.layout.unpack(row) for row in episode.tasks]
    R = np.array([x.R[0] for x in unpacked])
    omega = np.array([x.v[:3] for x in unpacked])
    skew = np.einsum("kij,klj->kil", np.diff(R, axis=0), R[:-1]) / 1e-4
    found = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    middle = 0.5 * (omega[1:] + omega[:-1])
    np.testing.assert_allclose(found, middle, atol=0.02 * np.abs(omega).max())


def test_fast_starts_are_fast_and_clear():
    subject = load_subject("upper_body")
    model, judge = subject.model("wrists"), subject.judge
    rng = np.random.default_rng(2)
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    speeds = []
    for _ in range(6):
        q, v = fast(model, judge, rng, 1 / 30)
        speeds.append(np.abs(v).max())
        path = q + np.linspace(0.0, 1 / 30, 50)[:, None] * v
        assert referee.violations(path).num_violated == 0
    assert max(speeds) > 3.0


def test_singular_poses_are_singular():
    subject = load_subject("obstacle_arm")
    model, judge = subject.model("position"), subject.judge
    rng = np.random.default_rng(2)
    workspace = model.MakeWorkspace()

    def smallest(q):
        J = model.evaluate(workspace, q, np.zeros(len(q))).J
        return np.linalg.svd(J, compute_uv=False)[-1]

    usual = np.median([smallest(q) for q in random_poses(model, judge, rng, 40)])
    q, v = singular(model, judge, rng)
    assert smallest(q) < 0.2 * usual and not v.any()
    assert judge.nearest(q[None])[0][0] >= POSE_CLEARANCE


def test_search_mutates_a_lineage_a_little():
    subject = load_subject("obstacle_arm")
    model, parameters = subject.model("position"), CrarParameters(period=0.005)
    first, second, third = (
        make_episode("search", model, subject.judge, parameters, 100, lineage).tasks
        for lineage in ([8], [8, 5], [8, 5, 6])
    )
    assert not np.array_equal(first, second) and not np.array_equal(second, third)
    unlike = make_episode("search", model, subject.judge, parameters, 100, [9]).tasks
    position = slice(0, model.layout.size_x)
    assert np.abs(second - first)[:, position].max() < 1.0
    # Even seeds are at most 1 m/s, odd ones 8 m/s.
    v = slice(model.layout.size_x, model.layout.size_x + 3)
    speed = [np.linalg.norm(x[:, v], axis=1).max() for x in (first, second, unlike)]
    assert max(speed[:2]) <= 1.0 + 1e-9 and speed[2] <= 8.0 + 1e-9


def test_gains_stay_in_their_range():
    subject = load_subject("jaw")
    model, base = subject.model("position"), CrarParameters(period=0.005)
    factors = []
    for seed in range(20):
        p = make_episode("gains", model, subject.judge, base, 5, [seed]).parameters
        factors.append([p.K / base.K, p.Kp / base.Kp, p.Gv / base.Gv])
        factors[-1].append(p.velocity_gain / base.velocity_gain)
    assert np.min(factors) >= GAINS[0] - 1e-9 and np.max(factors) <= GAINS[1] + 1e-9
    assert np.max(factors) > 5.0 and np.min(factors) < 0.5


def test_starts_beyond_limits_are_there_and_prescribed_joints_are_driven():
    farthest, driven = 0.0, 0.0
    for seed in range(12):
        subject = load_subject("slides", seed)
        model, base = subject.model("drawn"), CrarParameters(period=0.01)
        episode = make_episode("beyond", model, subject.judge, base, 60, [seed])
        assert not episode.v.any()
        farthest = max(farthest, subject.judge.excess(episode.q[None]).max())
        swing = episode.prescribed[:, : model.n_p]
        np.testing.assert_allclose(swing[0], episode.q[model.prescribed], atol=1e-12)
        limits = model.plant.GetPositionUpperLimits()[model.prescribed]
        driven = max(driven, (swing - limits).max(initial=0.0))
    assert 0.2 < farthest <= FARTHEST and driven > 1.5


def test_touching_starts_are_at_the_floor_on_either_side():
    subject = load_subject("upper_body")
    judge, model = subject.judge, subject.model("wrists")
    base = CrarParameters(period=0.01)
    off = []
    for seed in range(8):
        made = make_episode("touching", model, judge, base, 5, [seed])
        assert not made.v.any() and judge.excess(made.q[None]).max() == 0.0
        off.append(judge.nearest(made.q[None])[0][0] - 4e-3)
    there = np.array(off)[np.abs(off) < 1e-14]  # others found no way to a contact
    assert len(there) >= 5 and there.min() < 0.0 < there.max()


def test_laws_are_switched_in_mid_motion_and_their_horizons_do_not_grow():
    subject = load_subject("jaw")
    model, base = subject.model("position"), CrarParameters(period=0.005)
    previews, counted = set(), 0
    for seed in range(20):
        made = make_episode("switched", model, subject.judge, base, 200, [seed])
        laws = made.laws(201)
        T = np.array([law.braking_horizon for law in laws])
        assert (np.diff(T) <= 1e-12).all() and T.min() >= base.period
        assert laws[0] is made.parameters
        for step, law in made.switches.items():
            law.validate()
            assert 0 < step < 200 and law.period == base.period
            assert laws[step] is law and laws[step - 1] is not law
            previews.add(law.plans)
        counted += len(made.switches)
    assert previews == {True, False} and counted > 40
    used = []

    class Told(ControlLaw):
        def __init__(self, model, parameters):
            used.append(parameters)
            super().__init__(model, parameters)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(drive, "ControlLaw", Told)
        drive_exact(model, made)
    assert used == [made.parameters, *(made.switches[k] for k in sorted(made.switches))]


def test_slow_control_has_periods_up_to_the_horizon():
    subject = load_subject("jaw")
    model, base = subject.model("position"), CrarParameters(period=0.01)
    shares, horizons = [], set()
    for seed in range(20):
        p = make_episode("slow", model, subject.judge, base, 5, [seed]).parameters
        p.validate()
        horizons.add(round(p.braking_horizon, 6))
        shares.append(p.period / p.braking_horizon)
    assert horizons == {0.016, round(2.5 / 30.0, 6)}  # with a preview and without
    assert max(shares) > 0.98 and min(shares) < 0.4


def test_judge_lets_joints_come_back_to_their_limits_and_go_no_farther():
    subject = load_subject("jaw")
    judge, model = subject.judge, subject.model("position")
    c = list(judge.joint_names).index("elbow")
    q = np.tile(model.rest_positions(), (5, 1))
    beyond = np.array([0.5, 0.4, 0.2, 0.1, -0.1])
    q[:, judge.controlled[c]] = judge.upper[c] + beyond
    v, dice = np.zeros_like(q), np.random.default_rng(0)
    assert not judge.judge(q, v, 0.03, dice).unsafe
    q[3, judge.controlled[c]] = judge.upper[c] + 0.25  # out again
    found = judge.judge(q, v, 0.03, dice)
    assert (found.beyond_limit, found.ahead, found.first) == (1, 1, 3)
    assert found.excess == pytest.approx(0.05) and found.joint == "elbow"


def test_judge_holds_the_law_to_its_floor_but_where_the_start_is_nearer():
    subject = load_subject("jaw")
    judge, model = subject.judge, subject.model("position")
    q = np.tile(model.rest_positions(), (3, 1))
    v, dice = np.zeros_like(q), np.random.default_rng(0)
    d = judge.nearest(q)[0][0]
    floor = d + 1e-3
    assert judge.judge(q, v, 0.03, dice, floor=floor).below == 0  # starts there
    left = model.position_names.index("left_slide")
    slid = q[0] + np.linspace(-0.1, 0.1, 21)[:, None] * np.eye(q.shape[1])[left]
    far = slid[judge.nearest(slid)[0].argmax()]
    q[0] = far
    if judge.nearest(far[None])[0][0] > floor:
        found = judge.judge(q, v, 0.03, dice, floor=floor)
        assert found.below == 2 and found.penetrating == 0 and found.unsafe


def test_a_law_that_takes_slides_for_short_is_caught(monkeypatch):
    """A tenth of the reach, as if a slide that is far out were within its limits."""
    from crar_drake.control.modes import lookahead

    def shorter(*given):
        found = find_reaches(*given)
        parts = {name: 0.1 * getattr(found, name) for name in ("a", "b", "farthest")}
        return found._replace(**parts)

    find_reaches = lookahead.find_reaches
    monkeypatch.setattr(lookahead, "find_reaches", shorter)
    result = run_case(Case("slides", "beyond", 0.02, steps=2500))
    assert not result.error and result.violated > 0 and result.blocked > 0


@pytest.mark.parametrize("attack", ["sine", "several", "squeeze"])
def test_a_law_without_constraints_is_caught(attack):
    result = run_case(Case("upper_body", attack, 0.01, constraints="none", steps=600))
    assert not result.error and result.violated > 0
    assert result.penetrating > 0 and result.clearance < -1e-3
    assert result.worst["step"] is not None and result.unsafe


def test_a_law_that_stands_still_is_not_accused(monkeypatch):
    """Braking from a start at rest cannot violate anything."""
    step = ControlLaw.step

    def braking(self, q, v, *targets):
        solution = step(self, q, v, *targets)
        period = self.parameters.period
        v_next = v * (1.0 - period / self.parameters.braking_horizon)
        return replace(
            solution, position_command=np.concatenate([q + period * v_next, v_next])
        )

    monkeypatch.setattr(ControlLaw, "step", braking)
    for attack in ("teleport", "fast_start", "singular"):
        result = run_case(Case("jaw", attack, 0.01, steps=300))
        assert not result.error and not result.unsafe
        assert result.steps >= 300 and result.paths > 0


@pytest.mark.parametrize("attack", ["moving", "fast_start", "wild"])
def test_a_law_that_keeps_the_invariant_passes(attack, monkeypatch):
    """The law's wish, scaled towards braking until the judge finds the path clear."""
    judge, step = load_subject("jaw").judge, ControlLaw.step
    held_back = []

    def shielded(self, q, v, *targets):
        solution = step(self, q, v, *targets)
        T, period = self.parameters.braking_horizon, self.parameters.period
        wish = np.nan_to_num(solution.acceleration)
        for share in (1.0, 0.7, 0.4, 0.2, 0.1, 0.05, 0.0):
            v_next = v + period * (share * wish - (1.0 - share) * v / T)
            q_next = q + period * v_next
            there = judge.path_is_clear(q_next, v_next, T, 4.2e-3)
            if there and judge.path_is_clear(q, v_next, period, 4.2e-3):
                break
        held_back.append(share < 1.0 or solution.admission[0] > 0.0)
        return replace(solution, position_command=np.concatenate([q_next, v_next]))

    monkeypatch.setattr(ControlLaw, "step", shielded)
    result = run_case(Case("jaw", attack, 0.02, steps=150))
    assert not result.error and not result.unsafe, result
    assert result.steps >= 150 and result.paths > 10
    assert any(held_back) or attack == "wild"  # the attack was one


def test_what_the_law_tells_of_its_admission_is_counted(monkeypatch):
    step = ControlLaw.step
    told, counts = iter(np.tile([0.0, 1.0, 1.0, 2.0], 1000)), [0, 0, 0]

    def telling(self, *given):
        solution = step(self, *given)
        how = next(told)
        counts[int(how)] += 1
        of_mode = {"admission": np.array([how, 1.0, 0.01, float(how != 2.0)])}
        return replace(solution, of_mode=of_mode)

    monkeypatch.setattr(ControlLaw, "step", telling)
    result = run_case(Case("jaw", "several", 0.02, steps=80))
    assert not result.error
    assert result.admitted == counts and min(counts) > 0
    assert result.unheld == counts[2]


def test_gains_that_the_law_refuses_are_counted(monkeypatch):
    def refuse(model, parameters):
        raise ScenarioError("controller.Gv: too high for this period")

    monkeypatch.setattr(drive, "ControlLaw", refuse)
    result = run_case(Case("jaw", "gains", 0.02, steps=200))
    assert not result.error and result.episodes == 0 and result.refused > 1


@pytest.mark.parametrize("robot, attack", [("jaw", "lost"), ("upper_body", "search")])
def test_the_same_seed_gives_the_same_bits(robot, attack):
    subject = load_subject(robot)
    case = Case(robot, attack, 0.01)
    finals = []
    for _ in range(2):
        _, done = play(case, subject, subject.task_set(0), [4, 2], 60)
        finals.append(np.concatenate([done.q[-1], done.v[-1]]).tobytes())
    assert finals[0] == finals[1]
    _, other = play(case, subject, subject.task_set(0), [5], 60)
    assert np.concatenate([other.q[-1], other.v[-1]]).tobytes() != finals[0]


def test_a_case_gives_the_same_figures_alone_and_again():
    case = Case("jaw", "search", 0.02, steps=60)
    first, second = run_case(case), run_case(case)
    assert first.episodes == 4
    first.wall = second.wall = 0.0
    assert first == second


def test_the_whole_diagram_starts_and_moves_as_the_episode_says():
    subject = load_subject("jaw")
    model = subject.model("position")
    parameters = CrarParameters(period=0.005)
    episode = make_episode("fast_start", model, subject.judge, parameters, 10, [1])
    done = drive_torque(model, episode)
    ideal = drive_exact(model, episode)
    assert not done.diverged and done.steps == 50 and ideal.steps == 10
    np.testing.assert_allclose(done.q[0], episode.q)
    np.testing.assert_allclose(done.v[0], episode.v)
    moved = np.abs(ideal.q[-1] - ideal.q[0]).max()
    assert np.abs(done.q[-1] - ideal.q[-1]).max() < 0.3 * moved
    assert done.slip > 0.0


def run(tmp_path, *more):
    return command.main(
        ["--robots", "jaw", "--attacks", "several", "--periods", "0.02,0.01"]
        + ["--steps", "60", "--processes", "1", "--out", str(tmp_path), *more]
    )


def test_the_law_without_a_preview_is_attacked_too(tmp_path):
    found = [
        run_case(Case("jaw", "teleport", 0.01, steps=120, preview=preview))
        for preview in (False, True)
    ]
    assert not any(result.error or result.violated for result in found)
    assert found[0].clearance != found[1].clearance
    assert run(tmp_path, "--no-preview") == 0
    whole = json.loads((tmp_path / "adversary.json").read_text())
    assert not any(result["case"]["preview"] for result in whole["results"])


def test_gains_are_of_laws_with_and_without_a_plan():
    subject = load_subject("jaw")
    model = subject.model("position")
    laws = [
        make_episode(
            "gains", model, subject.judge, CrarParameters(period=period), 5, [seed]
        ).parameters
        for seed in range(6)
        for period in (0.005, 0.02)
    ]
    assert {law.plans for law in laws} == {True, False}
    assert len({law.lookahead.preview for law in laws if law.plans}) > 1


def test_command_writes_resumes_and_replays(tmp_path, monkeypatch, capsys):
    code = run(tmp_path, "--constraints", "none")
    assert code == 1
    assert "| several |" in capsys.readouterr().out
    whole = json.loads((tmp_path / "adversary.json").read_text())
    assert [r["case"]["period"] for r in whole["results"]] == [0.02, 0.01]

    # The second case is lost: it alone is run again.
    kept = tmp_path / "adversary.json"
    kept.write_text(json.dumps({"results": whole["results"][:1]}))
    ran = []

    def counted(case):
        ran.append(case.period)
        return run_case(case)

    monkeypatch.setattr(command, "run_case", counted)
    assert run(tmp_path, "--constraints", "none") == 1
    assert ran == [0.01]
    again = json.loads((tmp_path / "adversary.json").read_text())
    for a, b in zip(whole["results"], again["results"], strict=True):
        assert a | {"wall": 0} == b | {"wall": 0}
    assert run(tmp_path, "--constraints", "none") == 1 and ran == [0.01]

    # Another law is another matter.
    monkeypatch.setattr(command, "law_digest", lambda: "another")
    run(tmp_path, "--constraints", "none")
    assert ran == [0.01, 0.02, 0.01]

    found = next((tmp_path / "found").glob("*.json"))
    saved = json.loads(found.read_text())
    capsys.readouterr()
    assert command.main(["--replay", str(found)]) == 1
    told = " ".join(capsys.readouterr().out.split())
    if saved["step"] is not None:
        assert f"at state {saved['step']}" in told


@pytest.mark.slow
def test_a_stopped_command_ends_at_once(tmp_path):
    """Cases of minutes are under way in two processes when Ctrl-C comes."""
    command_line = [sys.executable, "-m", "benchmarks.adversary", "--robots", "jaw"]
    options = ["--steps", "100000", "--processes", "2", "--out", str(tmp_path)]
    process = subprocess.Popen(
        [*command_line, *options],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        process_group=0,
        cwd=Path(__file__).parents[2],
        # A background job may ignore SIGINT, and so would its child.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    while not (tmp_path / ".adversary.json.lock").exists():
        assert process.poll() is None
        time.sleep(0.1)
    time.sleep(5.0)  # the processes are there and at work, or about to be
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=600)  # of a computer that does much else
    assert process.returncode == 130 and "the same command goes on" in told


def test_exit_code_without_a_violation(tmp_path, monkeypatch):
    def fine(case):
        return Result(case, law=law_digest(), steps=60, episodes=1, states=61)

    monkeypatch.setattr(command, "run_case", fine)
    assert run(tmp_path) == 0

    def broken(case):
        return Result(case, law=law_digest(), error="ModelError: no")

    monkeypatch.setattr(command, "run_case", broken)
    assert run(tmp_path, "--seed", "1") == 2


@pytest.mark.parametrize(
    "argv, message",
    [
        (["--robots", "jar"], "no robot 'jar'"),
        (["--attacks", "sines"], "no attack 'sines'"),
        (["--periods", "0"], "seconds from"),
        (["--steps", "many"], "whole number"),
        (["--seed", "-1"], "--seed: '-1' is not a whole number from 0 on"),
        (["--plants", "real"], "no plant 'real'"),
    ],
)
def test_wrong_options_are_named(argv, message, capsys):
    with pytest.raises(SystemExit) as stopped:
        command.main(argv)
    assert stopped.value.code == 2 and message in capsys.readouterr().err


def test_a_file_that_is_no_counterexample_is_refused(tmp_path):
    wrong = tmp_path / "wrong.json"
    wrong.write_text("{}")
    with pytest.raises(CrarError, match=r"wrong\.json: not a counterexample"):
        command.main(["--replay", str(wrong)])
    with pytest.raises(CrarError, match="cannot be read"):
        command.main(["--replay", str(tmp_path / "absent.json")])


def test_boxes_are_attacked_when_asked_for():
    """And examined by the law."""
    asked = [[], ["--robots", "boxes"]]
    usual, given = (command.parse(Benchmark("", "attacks", ""), argv) for argv in asked)
    assert "boxes" not in usual.robots and given.robots == ["boxes"]
    model = load_subject("boxes", 1).model("drawn")
    assert not model.pairs.not_examined


def test_distances_of_a_convex_piece_are_those_of_a_box_and_of_the_law():
    corners = np.indices((2, 2, 2)).reshape(3, -1).T - 0.5
    half = np.array([0.2, 0.5, 0.8])
    box = 2.0 * half * corners
    triangles = box[ConvexHull(box).simplices]
    p0, p1 = np.random.default_rng(9).normal(size=(2, 300, 3))
    d = segments_to_hull(p0, p1, triangles)
    boxes = segments_to_boxes(p0, p1, np.broadcast_to(half, p0.shape))
    np.testing.assert_allclose(d, boxes, atol=1e-12)
    assert (d == 0.0).any() and (d > 0.1).any()
    subject = load_subject("shelf_arm")
    model = subject.model("pose")
    q = np.random.default_rng(10).uniform(-1.5, 1.5, (200, model.n))
    found = subject.judge.distances(q)
    first = np.array([name.split(" - ")[0] for name in subject.judge.pair_names])
    second = np.array([name.split(" - ")[1] for name in subject.judge.pair_names])
    apart = 0
    for k, x in enumerate(q):
        state = model.evaluate(model.MakeWorkspace(), x, 0.0 * x)
        for (a, b), d in zip(model.pairs.names, state.d, strict=True):
            mine = found[k][(first == a) & (second == b)].min()
            if d > 0.0:
                assert mine == pytest.approx(d, abs=1e-9)
                apart += 1
    assert apart > 1000


@pytest.mark.parametrize("robot", ["boxes", "shelf_arm"])
def test_boxes_and_convex_pieces_stay_clear_under_attack(robot):
    """A few episodes of what the whole search does."""
    cases = make_cases([robot], ["posture", "sine"], [0.01], steps=200)
    for case in cases:
        result = run_case(case)
        assert result.steps >= 200 and not result.error
        assert not result.below and not result.blocked and not result.penetrating


def test_cases_are_all_combinations_that_there_are():
    cases = make_cases(["jaw", "obstacle_arm"], ["moving", "posture"], [0.01])
    assert {(c.robot, c.attack) for c in cases} == {
        ("jaw", "moving"),
        ("jaw", "posture"),
        ("obstacle_arm", "posture"),
    }
    torque = make_cases(["jaw"], ["posture", "sine"], [0.01], ["torque"])
    assert [c.attack for c in torque] == ["sine"]


def test_tables_are_written_into_a_page(tmp_path, monkeypatch):
    """Between the marks of what was run, and nothing else is touched."""
    page = tmp_path / "page.md"
    text = "Before.\n\n<!-- exact -->\nold\n<!-- end -->\n\nAfter.\n"
    page.write_text(text + text.replace("exact", "torque"))
    assert run(tmp_path, "--page", str(page)) == 0
    written = page.read_text()
    assert written.count("Before.") == written.count("After.") == 2
    assert "| several |" in written and "no violation in 160 control steps" in written
    assert written.count("old") == 1 and written.endswith(
        text.replace("exact", "torque")
    )
    assert "python -m benchmarks.adversary --robots jaw" in written
    assert str(tmp_path) not in written
    page.write_text("without marks\n")
    with pytest.raises(CrarError, match="needs the line <!-- exact -->"):
        run(tmp_path, "--page", str(page))
    assert page.read_text() == "without marks\n"


def test_results_are_kept(tmp_path):
    case, path = Case("jaw", "sine", 0.01), tmp_path / "kept.json"
    result = Result(case, law="x", clearance=0.003, worst={"lineage": [1, 2]})
    write_results(path, [result, Result(Case("jaw", "wild", 0.01), "x", error="no")])
    assert read_results(path, "x") == {case: result}  # infinite path_clearance, too
    assert read_results(path, "another") == {}
    path.write_text('{"results": [{}]}')
    assert read_results(path, "x") == {}


# --- the filter of joint commands ---------------------------------------------------


@pytest.mark.parametrize("policy", list(POLICIES))
def test_no_policy_makes_the_filter_violate_anything(policy):
    """At 1 to 20 ms, on a robot of a file and on ones that are drawn, slides among
    them; also that a command which is said to be the wanted one is it."""
    for robot, period in (
        ("upper_body", 0.001),
        ("jaw", 0.01),
        ("slides", 0.02),
        ("random", 0.005),
    ):
        case = Case(robot, policy, period, "filter", steps=100)
        result = run_case(case)
        assert not result.error and result.worst is None
        assert result.steps >= 100 and not result.unsafe


def test_a_filter_that_lets_everything_through_is_caught(monkeypatch):
    """The judge counts all joints, and what policies want is no good by itself."""
    subject = load_subject("upper_body")
    filter, judge = subject.filter(0.01)
    assert len(judge.controlled) == len(filter.joint_names)
    solve = filter.solve

    def blind(memory, q=None, v=None, a=None, measured=None, obstacles=None):
        made = solve(memory, q, v, a, measured, obstacles)
        wanted = replace(made.command, q=q, v=(q - memory.q) / 0.01)
        return replace(made, q=wanted.q, v=wanted.v, command=wanted)

    monkeypatch.setattr(filter, "solve", blind)
    monkeypatch.setattr("benchmarks.adversary.policies.NOMINAL", "never")
    for policy in ("jumps", "noise", "sines", "between"):
        done, verdict = play_and_judge(
            Case("upper_body", policy, 0.01, "filter"), subject, "", [5], 60
        )
        assert done.steps == 60 and verdict.unsafe, policy
