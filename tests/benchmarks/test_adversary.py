"""The adversary: its judge is right, its attacks are sound, a bad law is caught."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from benchmarks.adversary import __main__ as command, run as running
from benchmarks.adversary.attacks import ATTACKS, make_episode
from benchmarks.adversary.cases import (
    Case,
    make_cases,
)
from benchmarks.adversary.judge import (
    segments_to_boxes,
    segments_to_hull,
)
from benchmarks.adversary.policies import POLICIES
from benchmarks.adversary.random_robots import KINDS
from benchmarks.adversary.robots import load_subject
from benchmarks.adversary.run import play_and_judge, run_case
from benchmarks.adversary.starts import (
    random_poses,
)
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.pairs import Pairs
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.step import SafetyCheck
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


def shapes(model, name):
    body = find_body(model.plant, name)
    return model.plant.GetCollisionGeometriesForBody(body)


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


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_attacks_start_clear_and_have_targets_of_the_right_size(robot, attack):
    subject = load_subject(robot)
    for seed in range(3):
        model = subject.model(subject.task_set(seed))
        if attack == "moving" and not model.n_p:
            continue
        parameters = LookaheadParameters(period=0.01)
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
        horizon = episode.parameters.T
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


@pytest.mark.parametrize(
    "robot, attack", [("jaw", "moving"), ("slides", "gains"), ("upper_body", "sine")]
)
def test_a_law_that_takes_every_step_for_safe_is_caught(robot, attack, monkeypatch):
    """It has the rows that keep its nominal off pairs, and looks no further."""
    safe = SafetyCheck(True, 0.0)
    monkeypatch.setattr(Pairs, "examine", lambda *_: safe)
    result = run_case(Case(robot, attack, 0.02, steps=400))
    assert result.violated > 0 and result.blocked > 0


@pytest.mark.parametrize("attack", ["sine", "several", "squeeze"])
def test_a_law_without_constraints_is_caught(attack):
    result = run_case(Case("upper_body", attack, 0.01, constraints="none", steps=600))
    assert result.violated > 0
    assert result.penetrating > 0 and result.clearance < -1e-3
    assert result.worst["step"] is not None and result.failed


def test_a_law_that_stands_still_is_not_accused(monkeypatch):
    """Braking from a start at rest cannot violate anything."""
    step = ControlLaw.step

    def braking(self, q, v, *targets):
        solution = step(self, q, v, *targets)
        period = self.parameters.period
        v_next = v * (1.0 - period / self.parameters.T)
        there, T = np.concatenate([q + period * v_next, v_next]), self.parameters.T
        return replace(solution, position_command=there, T=np.array([T]))

    monkeypatch.setattr(ControlLaw, "step", braking)
    for attack in ("teleport", "fast_start", "singular"):
        result = run_case(Case("jaw", attack, 0.01, steps=300))
        assert not result.failed
        assert result.steps >= 300 and result.paths > 0


@pytest.mark.parametrize("attack", ["moving", "fast_start", "wild"])
def test_a_law_that_keeps_the_invariant_passes(attack, monkeypatch):
    """The law's wish, scaled towards braking until the judge finds the path clear."""
    judge, step = load_subject("jaw").judge, ControlLaw.step
    held_back = []

    def shielded(self, q, v, *targets):
        solution = step(self, q, v, *targets)
        T, period = self.parameters.T, self.parameters.period
        wish = np.nan_to_num(solution.acceleration)
        for share in (1.0, 0.7, 0.4, 0.2, 0.1, 0.05, 0.0):
            v_next = v + period * (share * wish - (1.0 - share) * v / T)
            q_next = q + period * v_next
            there = judge.path_is_clear(q_next, v_next, T, 4.2e-3)
            if there and judge.path_is_clear(q, v_next, period, 4.2e-3):
                break
        held_back.append(share < 1.0 or solution.admission[0] > 0.0)
        there = np.concatenate([q_next, v_next])
        return replace(solution, position_command=there, T=np.array([T]))

    monkeypatch.setattr(ControlLaw, "step", shielded)
    result = run_case(Case("jaw", attack, 0.02, steps=150))
    assert not result.failed, result
    assert result.steps >= 150 and result.paths > 10
    assert any(held_back) or attack == "wild"  # the attack was one


def run(tmp_path, *more):
    return command.main(
        ["--robots", "jaw", "--attacks", "several", "--periods", "0.02,0.01"]
        + ["--steps", "60", "--processes", "1", "--out", str(tmp_path), *more]
    )


def test_command_writes_resumes_and_replays(tmp_path, monkeypatch, capsys):
    code = run(tmp_path, "--constraints", "none")
    assert code == 1
    assert "| several |" in capsys.readouterr().out
    whole = json.loads((tmp_path / "adversary.json").read_text())
    assert [r["case"]["period"] for r in whole["results"]] == [0.02, 0.01]

    monkeypatch.setattr(command, "run_case", None)  # all cases are there already
    assert run(tmp_path, "--constraints", "none") == 1
    assert json.loads((tmp_path / "adversary.json").read_text()) == whole

    found = next((tmp_path / "found").glob("*.json"))
    saved = json.loads(found.read_text())
    capsys.readouterr()
    assert command.main(["--replay", str(found)]) == 1
    told = " ".join(capsys.readouterr().out.split())
    if saved["step"] is not None:
        assert f"at state {saved['step']}" in told


def test_what_was_found_stays_where_a_later_episode_fails(monkeypatch):
    played = []

    def once(*given):
        if played:
            raise RuntimeError("no\nmore")
        played.append(given)
        return play_and_judge(*given)

    monkeypatch.setattr(running, "play_and_judge", once)
    case = Case("upper_body", "squeeze", 0.01, constraints="none", steps=600)
    result = run_case(case)
    assert result.violated == 1 and result.worst is not None
    assert result.error == "RuntimeError: no more"


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
        for (a, b), d in zip(model.pairs.names, model.signed_distances(x), strict=True):
            mine = found[k][(first == a) & (second == b)].min()
            if d > 0.0:  # SceneGraph searches, and stops a little early
                assert -1e-9 < d - mine < 1e-4
                apart += 1
    assert apart > 1000


@pytest.mark.parametrize("robot", ["boxes", "shelf_arm"])
def test_boxes_and_convex_pieces_stay_clear_under_attack(robot):
    """A few episodes of what the whole search does."""
    cases = make_cases([robot], ["posture", "sine"], [0.01], steps=200)
    for case in cases:
        result = run_case(case)
        assert result.steps >= 200
        assert not result.below and not result.blocked and not result.penetrating


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
        assert result.worst is None
        assert result.steps >= 100 and not result.failed


def test_a_filter_that_lets_everything_through_is_caught(monkeypatch):
    """The judge counts all joints, and what policies want is no good by itself."""
    subject = load_subject("upper_body")
    filter, judge = subject.filter(0.01, 0.0)
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
