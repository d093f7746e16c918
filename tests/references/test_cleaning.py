"""Cleaned references, judged by the referee and by what the reference itself was."""

from dataclasses import replace

import numpy as np
import pytest
from small_reference_robots import SPEED, reaching, write_robot

from crar_drake.errors import ModelError, MotionError, ScenarioError
from crar_drake.judging.referee import Referee
from crar_drake.references.clear_ways import ClearWays
from crar_drake.references.following import CleaningParameters, Follower
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

RATE = 50.0
FLOOR = 4e-3


@pytest.fixture(scope="module")
def cleaner(tmp_path_factory) -> Follower:
    folder = write_robot(tmp_path_factory.mktemp("robot"))
    return Follower(load_robot_description(folder), RATE)


def least_distances(cleaner: Follower, q: np.ndarray, between: int = 8) -> np.ndarray:
    """The referee's smallest distance at points on the straight ways of a motion."""
    model = cleaner.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    share = np.arange(between)[:, None] / between
    ways = q[:-1, None] + share * np.diff(q, axis=0)[:, None]
    points = np.vstack([ways.reshape(-1, q.shape[1]), q[-1:]])
    return np.array([referee.distances(point).min() for point in points])


def test_a_clean_reference_comes_back_as_it_was(cleaner):
    q = reaching(30, RATE, 0.3)
    assert least_distances(cleaner, q).min() > 0.04
    cleaned = cleaner.follow(q)
    np.testing.assert_allclose(cleaned.q, q, rtol=0.0, atol=1e-9)
    assert (cleaned.admitted == 0.0).all() and cleaned.moved_start == 0.0


def test_the_law_itself_leaves_a_clean_reference_as_it_was(cleaner, monkeypatch):
    """Where it is asked in every step, not only where the reference cannot be taken."""
    monkeypatch.setattr(ClearWays, "clear", lambda *arguments: False)
    q = reaching(30, RATE, 0.3)
    cleaned = cleaner.follow(q)
    np.testing.assert_allclose(cleaned.q, q, rtol=0.0, atol=1e-9)
    assert not np.array_equal(cleaned.q, q)
    assert cleaned.asked >= 29 * CleaningParameters().steps_per_frame(RATE)


def test_what_is_clear_is_taken_to_the_last_bit_before_and_after_a_collision(cleaner):
    still = np.zeros((80, 3))
    q = np.vstack([reaching(50, RATE, 1.0), still])
    cleaned = cleaner.follow(q)
    same = (cleaned.q == q).all(axis=1)
    assert same[:10].all() and same[-10:].all() and not same[20:30].any()
    assert least_distances(cleaner, cleaned.q).min() > FLOOR - 1e-6
    # Back on it, it is off by less than it may be, and never again.
    change = np.abs(cleaned.q - q).max(axis=1)
    back = int(np.flatnonzero(~same)[-1]) + 1
    assert change[back - 1] < 5e-3 and back < 110
    assert 0 < cleaned.asked < CleaningParameters().steps_per_frame(RATE) * len(q)


def test_one_frame_is_a_motion(cleaner):
    q = np.array([[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(cleaner.follow(q).q, q)


def test_a_collision_is_taken_out_and_the_rest_stays(cleaner):
    q = reaching(50, RATE, 1.0)
    assert least_distances(cleaner, q).min() < -0.02
    cleaned = cleaner.follow(q)
    assert least_distances(cleaner, cleaned.q).min() > FLOOR - 1e-6
    assert cleaned.clear.all()
    change = np.abs(cleaned.q - q).max(axis=1)
    assert change.max() > 0.05
    assert change[:10].max() < 1e-6  # before, and after it has caught up
    assert change[-1] < 2e-2


def test_straight_ways_between_frames_are_clear_where_the_laws_are_not_straight(
    cleaner, monkeypatch
):
    """Of a few frames a second, to and fro: there the robot brakes for a frame."""
    follower = Follower(cleaner.description, 6.0)
    q = np.random.default_rng(28).uniform([0.2, -1.0, -1.0], [1.4, 1.2, 1.2], (20, 3))
    q[0] = 0.0
    found = follower.follow(q)
    assert least_distances(cleaner, found.q, 40).min() > 0.125 * FLOOR
    assert follower.margins(found.q).between.min() > 0.125 * FLOOR - 2e-4
    monkeypatch.setattr(Follower, "_goes_clear", lambda *arguments: True)
    assert least_distances(cleaner, follower.follow(q).q, 40).min() < -0.02


def test_a_root_that_floats_makes_no_difference(cleaner):
    floating = replace(cleaner.description, root="prescribed")
    q = reaching(16, RATE, 1.0)
    ours, theirs = Follower(floating, RATE).follow(q), cleaner.follow(q)
    assert np.abs(theirs.q - q).max() > 0.05
    np.testing.assert_array_equal(ours.q, theirs.q)


def test_speed_limits_hold_and_are_caught_up_with(cleaner):
    q = np.zeros((60, 3))
    q[10:, 0] = -0.6  # a jump that would need 30 rad/s
    cleaned = cleaner.follow(q)
    assert np.abs(np.diff(cleaned.q, axis=0)).max() * RATE <= SPEED + 1e-9
    np.testing.assert_allclose(cleaned.q[:10], q[:10], atol=1e-9)
    assert np.abs(cleaned.q - q)[-20:].max() < 1e-3


def test_limits_hold_where_a_reference_passes_them(cleaner):
    q = np.zeros((40, 3))
    q[:, 2] = -2.45 + np.linspace(0.0, 1.0, 40) * (-0.3)
    q[:, 0] = -1.0
    cleaned = cleaner.follow(q)
    assert cleaned.q.min() >= -2.5
    assert np.abs(cleaned.q[-1, 2] + 2.5) < 1e-3  # and it goes as far as it may


def test_a_start_in_penetration_is_told_and_left(cleaner):
    q = reaching(61, RATE, 1.0)[30:]
    assert least_distances(cleaner, q[:2]).min() < 0.0
    cleaned = cleaner.follow(q)
    assert cleaned.moved_start > 0.01
    assert least_distances(cleaner, cleaned.q).min() > FLOOR - 1e-6


def test_margins_bound_what_the_referee_finds(cleaner):
    rng = np.random.default_rng(0)
    q = np.cumsum(rng.normal(scale=0.1, size=(12, 3)), axis=0) + [0.6, 0.3, 0.1]
    found = cleaner.margins(q)
    fine = least_distances(cleaner, q, 50)
    frames = fine[::50]
    np.testing.assert_allclose(found.distance, frames, atol=1e-9)
    for k in range(len(q) - 1):
        least = fine[50 * k : 50 * k + 51].min()
        assert found.between[k] <= least + 1e-9
        assert found.between[k] > least - 2e-3  # and is not far below
    np.testing.assert_allclose(
        found.speed[:-1], np.abs(np.diff(q, axis=0)).max(axis=1) * RATE / SPEED
    )
    np.testing.assert_allclose(found.limit, (2.5 - np.abs(q)).min(axis=1))


def test_speeds_are_shares_of_the_robots_limits_whatever_the_law_may_use(cleaner):
    q = reaching(6, RATE, 0.3)
    half = Follower(cleaner.description, RATE, CleaningParameters(velocity_scale=0.5))
    fastest = np.abs(np.diff(q, axis=0)).max(axis=1) * RATE / SPEED
    np.testing.assert_allclose(half.margins(q).speed[:-1], fastest)
    with pytest.raises(ScenarioError, match="velocity_scale is 5"):
        CleaningParameters(velocity_scale=5.0).validate()


def test_hands_keep_their_places_if_asked(cleaner):
    """And the joints pay for it."""
    frames = {"left_hand": "tip"}
    description = replace(cleaner.description, task_frames=frames)
    robot = WholeBody(description)
    q = reaching(50, RATE, 1.0)
    of_hands, of_joints = [], []
    for hands in (False, True):
        found = Follower(description, RATE, CleaningParameters(hands=hands)).follow(q)
        assert least_distances(cleaner, found.q).min() > FLOOR - 1e-6
        was, now = (robot.poses_in_root(each, ("tip",))[0] for each in (q, found.q))
        of_hands.append(np.linalg.norm(now - was, axis=2).max())
        of_joints.append(np.abs(found.q - q).max())
    assert of_hands[1] < 0.5 * of_hands[0]
    assert of_joints[1] > of_joints[0]


def test_a_foots_height_has_a_weight_of_its_own(cleaner):
    """And nothing else has it, nor the law that a follower was made of."""
    layout = cleaner.model.layout
    weights = cleaner._numbers.value.law.value.tasks.weights
    height = layout.linear_rows[0, 2]
    np.testing.assert_array_equal(weights[layout.linear_rows[0]], [25.0, 25.0, 100.0])
    others = np.delete(np.arange(layout.m), height)
    own = cleaner.law.mode.numbers.value.tasks.weights
    np.testing.assert_array_equal(weights[others], own[others])
    assert own[height] == 25.0


def test_what_cannot_be_cleaned_is_refused(tmp_path):
    folder = write_robot(tmp_path)
    description = load_robot_description(folder)
    with pytest.raises(ModelError, match="left_hand"):
        Follower(description, RATE, CleaningParameters(hands=True))
    with pytest.raises(ScenarioError, match="catch_up"):
        Follower(description, RATE, CleaningParameters(catch_up=0.0))
    description.pairs = []
    with pytest.raises(ModelError, match="pairs"):
        Follower(description, RATE)


def test_a_start_without_a_way_out_is_an_error(tmp_path):
    """Ball and link are welded into each other: no joint parts them."""
    folder = write_robot(tmp_path)
    urdf = (folder / "chain.urdf").read_text()
    (folder / "chain.urdf").write_text(
        urdf.replace('lower="-2.5" upper="2.5"', 'lower="0.899" upper="0.901"')
    )
    cleaner = Follower(load_robot_description(folder), RATE)
    with pytest.raises(MotionError, match="clear of collisions"):
        cleaner.follow(np.full((2, 3), 0.9))
