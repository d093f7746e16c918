"""The steps of a follower are the law's own on all pairs, however few are looked at."""

import numpy as np
import pytest
from small_reference_robots import reaching, write_robot

from crar_drake.equations.admission import travel
from crar_drake.equations.compilation import hold
from crar_drake.equations.following import (
    Followed,
    FollowerNumbers,
    OnTheWay,
    far_for_a_while,
    follow_steps,
    is_on,
    near_for_a_while,
)
from crar_drake.equations.free_joints import PLAIN
from crar_drake.equations.lookahead import (
    LookaheadLaw,
    LookaheadMemory,
    lookahead_or_scaled,
)
from crar_drake.equations.nearby import nearby_distances
from crar_drake.equations.prediction import next_state
from crar_drake.references.following import Follower
from crar_drake.references.frame_targets import configurations
from crar_drake.robot.description import load_robot_description

RATE = 50.0
NOTHING = np.zeros(0)


@pytest.fixture(scope="module")
def follower(tmp_path_factory) -> Follower:
    folder = write_robot(tmp_path_factory.mktemp("robot"))
    return Follower(load_robot_description(folder), RATE)


def numbers_of(follower: Follower, expected: float = 1.3) -> FollowerNumbers:
    return follower._numbers.value._replace(expected=expected)


def from_state(q: np.ndarray, v: np.ndarray) -> OnTheWay:
    still = np.zeros(len(v))
    return OnTheWay(q, v, LookaheadMemory(v, still, still, NOTHING, NOTHING))


def on_all_pairs(numbers: FollowerNumbers, begin: OnTheWay, targets) -> Followed:
    """The law's steps, one after the other, with all pairs in each."""
    law, r, n = numbers.law.value, numbers.robot.value, numbers.robot.value.n
    whole, still = hold(LookaheadLaw(numbers.robot, numbers.law)), np.zeros(n)
    rows = len(r.pairs.value.members) + len(law.limits.value.joints)
    sizes = [len(begin.v), len(law.tasks.weights), n, n, n, rows, 2, 4]
    ends = np.cumsum(sizes)
    q, v, h = begin.q, begin.v, law.gains.period
    v_before, vdot, slip = v, np.zeros(len(v)), still
    how, share, clear = 0.0, 1.0, True
    for target in targets:
        wanted = target, numbers.prescribed, NOTHING, *numbers.start, 1.0, 0.0, 0.0
        found = lookahead_or_scaled(
            q, v, np.zeros((0, 7)), *wanted, v_before, vdot, slip, NOTHING, whole
        )
        parts = np.split(found, ends)
        v_before, vdot, slip = v, parts[0], parts[4]
        told = parts[7]
        q, v = next_state(q, v, vdot, h, h, PLAIN)
        how, share = max(how, told[0]), min(share, told[1])
        clear = clear and told[3] == 1.0
    memory = LookaheadMemory(v_before[r.order], vdot[r.order], slip, NOTHING, NOTHING)
    steps = len(targets)
    return Followed(OnTheWay(q, v, memory), steps, steps, how, share, clear)


@pytest.mark.parametrize("expected", [0.0, 1.3, 1e3])
def test_steps_are_those_on_all_pairs(follower, expected) -> None:
    """From states beside the ball, at rest and fast, with targets in it and elsewhere;
    also where the reference that tells how far it may go stays behind."""
    numbers = numbers_of(follower, expected)
    held, rng = hold(numbers), np.random.default_rng(5)
    hows, again = set(), 0
    for k in range(30):
        q = np.array([0.5, 0.2, 0.2]) + 0.3 * rng.normal(size=3)
        v = rng.choice([0.0, 1.0, 4.0]) * rng.normal(size=3)
        to = q + rng.choice([0.02, 0.3]) * rng.normal(size=(2, 3))
        targets = follower._targets(np.vstack([q[None], to]), 2)
        asked = targets.at(1, 5)
        reference = targets.q[1:5] if k % 2 else np.tile(q, (4, 1))
        watched = np.zeros(len(follower.model.pairs.pair_of_shapes), dtype=bool)
        begin = from_state(q, v)
        found = follow_steps(
            begin, asked, reference, 0.0 * reference, False, watched, held
        )
        wanted = on_all_pairs(numbers, begin, asked)
        np.testing.assert_allclose(found.end.q, wanted.end.q, rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(found.end.v, wanted.end.v, rtol=0.0, atol=1e-9)
        assert (found.how, found.clear) == (wanted.how, wanted.clear)
        assert found.share == pytest.approx(wanted.share, abs=1e-9)
        assert found.steps == 4 and found.asked >= 4
        again += found.asked - 4
        hows.add(found.how)
        assert watched.any()
    assert hows == {0.0, 1.0, 2.0}
    assert again > 0 or expected > 2.0


@pytest.mark.parametrize("speed", [0.0, 4.0])
@pytest.mark.parametrize("far", [0.03, 0.04])
def test_a_step_that_goes_farther_than_expected_is_asked_anew(follower, far, speed):
    """At some distance, towards where it is 0 as fast as can be, from rest and at two
    thirds of that; with a reference that would stay, and no step expected."""
    numbers = numbers_of(follower, 0.0)
    held, rng = hold(numbers), np.random.default_rng(9)
    every = np.full((1, len(follower.model.pairs.pair_of_shapes)), np.inf)

    def least(q: np.ndarray) -> float:
        whole = configurations(follower.model, follower.model.rest_positions(), q[None])
        return float(nearby_distances(whole, every, follower.model.robot_ahead).min())

    not_as_wished = 0
    for _ in range(12):
        q = rng.uniform(-1.0, 1.5, 3)
        while not far - 0.01 < least(q) < far:
            q = rng.uniform(-1.0, 1.5, 3)
        moves = 1e-5 * np.eye(3)
        slope = np.array([least(q + x) - least(q - x) for x in moves]) / 2e-5
        to = q - 0.08 * np.sign(slope)
        targets = follower._targets(np.vstack([q, to, 2.0 * to - q]), 2)
        asked, stays = targets.at(1, 3), np.tile(q, (2, 1))
        watched = np.zeros(every.shape[1], dtype=bool)
        begin = from_state(q, -speed * np.sign(slope))
        found = follow_steps(begin, asked, stays, 0.0 * stays, False, watched, held)
        wanted = on_all_pairs(numbers, begin, asked)
        np.testing.assert_allclose(found.end.q, wanted.end.q, rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(found.end.v, wanted.end.v, rtol=0.0, atol=1e-9)
        assert found.how == wanted.how and found.asked > 2
        not_as_wished += found.how > 0.0
    assert not_as_wished > 1


def test_few_pairs_are_looked_at_where_few_are_near(follower) -> None:
    """At rest on a reference that stays, and far from all, the nearest alone."""
    numbers, q = hold(numbers_of(follower)), np.array([-1.0, 0.1, 0.1])
    targets = follower._targets(q[None], 1)
    watched = np.zeros(len(follower.model.pairs.pair_of_shapes), dtype=bool)
    found = follow_steps(
        from_state(q, np.zeros(3)),
        targets.at(0, 1),
        targets.q,
        targets.v,
        False,
        watched,
        numbers,
    )
    assert (found.steps, found.asked) == (1, 1) and watched.sum() == 1
    np.testing.assert_allclose(found.end.q, q, atol=1e-12)


def test_steps_end_where_the_robot_is_on_the_reference(follower) -> None:
    """Before the first step where it is, if that is asked for."""
    q = reaching(30, RATE, 0.3)
    targets = follower._targets(q, follower.steps)
    some = slice(40, 44)
    numbers = hold(numbers_of(follower))
    watched = np.zeros(len(follower.model.pairs.pair_of_shapes), dtype=bool)
    begin = from_state(targets.q[40], targets.v[40])
    asked = targets.at(40, 44), targets.q[some], targets.v[some]
    assert follow_steps(begin, *asked, True, watched, numbers).steps == 0
    assert follow_steps(begin, *asked, False, watched, numbers).steps == 4
    beside = from_state(targets.q[40] + 0.01, targets.v[40])
    assert follow_steps(beside, *asked, True, watched, numbers).steps == 4


@pytest.mark.parametrize("joint", range(3))
def test_on_a_reference_is_near_it_and_as_fast(follower, joint) -> None:
    """In every joint, on either side, by what counts as near."""
    numbers = numbers_of(follower)
    held = hold(numbers)
    q, v = np.array([0.3, -0.2, 0.7]), np.array([1.0, -2.0, 0.5])
    for sign in (-1.0, 1.0):
        for of_q, of_v, on in (
            (0.0, 0.0, True),
            (0.99, 0.99, True),
            (1.01, 0.0, False),
            (0.0, 1.01, False),
            (np.nan, 0.0, False),
        ):
            near = q.copy(), v.copy()
            near[0][joint] += sign * of_q * numbers.on_it
            near[1][joint] += sign * of_v * numbers.along_it
            assert is_on(from_state(*near), q, v, held) == on


def test_pairs_for_a_while_are_those_within_what_joints_go(follower) -> None:
    """And the influence distance, which is more than the floor."""
    numbers, rng = numbers_of(follower), np.random.default_rng(2)
    law = numbers.law.value
    every = np.full((1, len(law.reaches.value.own)), np.inf)
    some = 0
    for _ in range(30):
        q, far = rng.uniform(-1.5, 1.5, 3), np.abs(rng.normal(size=3)) * 0.1
        d = nearby_distances(q[None], every, numbers.robot)[0]
        near = d < law.gains.influence_distance + travel(far, law.reaches)
        rows, _, its_law = near_for_a_while(q, far, numbers)
        if near.any():
            np.testing.assert_array_equal(rows, np.flatnonzero(near))
        assert len(its_law.value.reaches.value.rows) == len(rows)
        some += 0 < near.sum() < len(d)
    assert some > 3


def test_how_far_joints_are_expected_to_go(follower) -> None:
    """Braking, the next step and the way to the reference's end, and half as much, and
    a hundredth besides."""
    numbers = numbers_of(follower)
    law = numbers.law.value
    h, T = law.gains.period, law.gains.T
    q, v, to = np.random.default_rng(1).normal(size=(3, 3))
    step = numbers.expected * (h + h * h / T) * np.abs(v)
    expected = 1.5 * (T * np.abs(v) + step + np.abs(to - q)) + 0.01
    np.testing.assert_allclose(far_for_a_while(q, v, to, numbers), expected)
