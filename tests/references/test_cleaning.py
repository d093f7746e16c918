"""Cleaned references, judged by the referee and by what the reference itself was."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from small_reference_robots import SPEED, reaching, write_robot

from crar_drake.errors import ModelError, ScenarioError
from crar_drake.judging.referee import Referee
from crar_drake.references.cleaning import Cleaner, CleaningParameters
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

RATE = 50.0
FLOOR = 4e-3


@pytest.fixture(scope="module")
def cleaner(tmp_path_factory) -> Cleaner:
    folder = write_robot(tmp_path_factory.mktemp("robot"))
    return Cleaner(load_robot_description(folder), RATE)


def least_distances(cleaner: Cleaner, q: np.ndarray, between: int = 8) -> np.ndarray:
    """The referee's smallest distance at points on the straight ways of a motion."""
    model = cleaner.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    share = np.arange(between)[:, None] / between
    ways = q[:-1, None] + share * np.diff(q, axis=0)[:, None]
    points = np.vstack([ways.reshape(-1, q.shape[1]), q[-1:]])
    return np.array([referee.distances(point).min() for point in points])


def test_a_clean_reference_comes_back_to_the_last_bit(cleaner):
    q = reaching(30, RATE, 0.3)
    assert least_distances(cleaner, q).min() > 0.04
    cleaned = cleaner.clean(q)
    np.testing.assert_array_equal(cleaned.q, q)
    assert not cleaned.violating.any() and cleaned.effort.linearised == 0


def test_what_is_far_from_a_collision_stays_to_the_last_bit(cleaner):
    q = np.vstack([np.zeros((40, 3)) + [0, 0, 0.1], reaching(50, RATE, 1.0)])
    q = np.vstack([q, np.zeros((60, 3)) + [0, 0, 0.1]])
    cleaned = cleaner.clean(q)
    same = (cleaned.q == q).all(axis=1)
    below = least_distances(cleaner, q, 1) < FLOOR
    first, last = np.flatnonzero(below)[[0, -1]]
    assert (
        same[: first - 26].all() and same[last + 27 :].all() and not same[below].any()
    )
    assert least_distances(cleaner, cleaned.q).min() > 0.125 * FLOOR
    assert least_distances(cleaner, cleaned.q, 1).min() > FLOOR


def test_one_frame_is_a_motion(cleaner):
    q = np.array([[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(cleaner.clean(q).q, q)
    inside = np.array([[0.9, 0.4, 0.3]])
    assert least_distances(cleaner, inside).min() < 0.0
    assert least_distances(cleaner, cleaner.clean(inside).q).min() > FLOOR


def test_a_frame_that_stays_changes_the_least(cleaner):
    """Of a motion that stands still inside the ball: what SciPy finds for one frame."""
    inside = np.array([0.9, 0.4, 0.3])
    found = cleaner.clean(np.tile(inside, (5, 1))).q
    model, kept = cleaner.model, cleaner._tasks(inside[None], None, None)
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    frame = np.zeros(1, dtype=int)

    def cost(q):
        r, *_ = kept.at(frame, q[None])
        return 0.5 * float(((q - inside) ** 2).sum() + (r**2).sum())

    asked = FLOOR + 3e-4
    best = minimize(
        cost,
        found[0],
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda q: referee.distances(q) - asked},
        options={"ftol": 1e-12, "maxiter": 200},
    )
    assert best.success and cost(found[0]) < 1.01 * best.fun
    np.testing.assert_allclose(found, np.tile(found[0], (5, 1)), atol=2e-3)


def test_the_robot_moves_while_its_reference_does(cleaner):
    """A law that goes forward in time waits before an obstacle, and is late."""
    q = reaching(100, RATE, 1.0)
    cleaned = cleaner.clean(q).q
    moved, wanted = (np.abs(np.diff(x, axis=0)).max(axis=1) for x in (cleaned, q))
    moving = wanted * RATE > 0.5
    assert moving.sum() > 40
    assert (moved[moving] > 0.2 * wanted[moving]).mean() > 0.95


@pytest.mark.parametrize("rate, scale", [(6.0, 0.8), (10.0, 0.5), (30.0, 0.2)])
@pytest.mark.parametrize("seed", [1, 3])
def test_what_jumps_to_and_fro_is_clear_on_all_ways(cleaner, rate, scale, seed):
    """Through the obstacle in one step, and faster than the joints."""
    steps = np.random.default_rng(seed).normal(scale=scale, size=(60, 3))
    q = np.clip(np.cumsum(steps, axis=0) + [0.6, 0.3, 0.1], -2.4, 2.4)
    assert least_distances(cleaner, q, 40).min() < -0.02
    found = Cleaner(cleaner.description, rate).clean(q)
    assert not found.violating.any()
    assert least_distances(cleaner, found.q, 40).min() > 0.125 * FLOOR
    assert np.abs(np.diff(found.q, axis=0)).max() * rate <= SPEED


@pytest.mark.parametrize("root", ["fixed", "prescribed"])
def test_what_carries_the_root_makes_no_difference(cleaner, root):
    q = reaching(16, RATE, 1.0)
    ours = Cleaner(replace(cleaner.description, root=root), RATE).clean(q)
    assert np.abs(ours.q - q).max() > 0.05
    np.testing.assert_array_equal(ours.q, cleaner.clean(q).q)


def test_speed_limits_hold_and_a_jump_is_spread_to_both_sides(cleaner):
    q = np.zeros((60, 3)) + [0.0, 0.0, 0.1]
    q[30:, 0] = -0.6  # a jump that would need 30 rad/s
    cleaned = cleaner.clean(q)
    assert np.abs(np.diff(cleaned.q, axis=0)).max() * RATE <= SPEED
    assert cleaned.q[29, 0] < -0.1 and cleaned.q[30, 0] > -0.5
    assert np.abs(cleaned.q - q)[[0, -1]].max() == 0.0
    half = Cleaner(cleaner.description, RATE, CleaningParameters(velocity_scale=0.5))
    assert np.abs(np.diff(half.clean(q).q, axis=0)).max() * RATE <= 0.5 * SPEED


def test_a_motion_that_starts_and_ends_in_penetration_is_clear(cleaner):
    q = reaching(61, RATE, 1.0)[25:36]
    assert least_distances(cleaner, q).max() < FLOOR
    assert least_distances(cleaner, cleaner.clean(q).q).min() > 0.125 * FLOOR


def test_a_long_motion_is_cleaned_in_parts(cleaner, monkeypatch):
    """And is as if it had been solved at once."""
    q = np.tile(reaching(50, RATE, 1.0), (4, 1))
    at_once = cleaner.clean(q)
    monkeypatch.setattr("crar_drake.trajectory.keeping._PART", 60)
    parts = cleaner.clean(q)
    assert parts.effort.linearised > at_once.effort.linearised
    assert least_distances(cleaner, parts.q).min() > 0.125 * FLOOR
    np.testing.assert_allclose(parts.q, at_once.q, atol=0.02)


def test_margins_bound_what_the_referee_finds(cleaner):
    rng = np.random.default_rng(0)
    q = np.cumsum(rng.normal(scale=0.1, size=(12, 3)), axis=0) + [0.6, 0.3, 0.1]
    found = cleaner.keeper.margins(q)
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


def test_hands_keep_their_places_where_they_carry(cleaner):
    """And the joints pay for it."""
    frames = {"left_hand": "tip"}
    description = replace(cleaner.description, task_frames=frames)
    robot = WholeBody(description)
    q = reaching(50, RATE, 1.0)
    carries = np.ones((len(q), 1))
    of_hands, of_joints = [], []
    for hands, shares in ((False, None), (False, carries), (True, None)):
        cleaner = Cleaner(description, RATE, CleaningParameters(hands=hands))
        found = cleaner.clean(q, carries=shares)
        assert least_distances(cleaner, found.q).min() > 0.125 * FLOOR
        was, now = (robot.poses_in_root(each, ("tip",))[0] for each in (q, found.q))
        of_hands.append(np.linalg.norm(now - was, axis=2).max())
        of_joints.append(np.abs(found.q - q).max())
    assert of_hands[1] < 0.7 * of_hands[0] and of_joints[1] > of_joints[0]
    assert of_hands[2] == of_hands[1]


def test_a_foots_height_is_along_the_worlds_vertical(cleaner):
    """However the root is turned: residuals are weighted there."""
    q = np.array([[0.3, 0.2, 0.1]])
    for angle in (0.0, 0.5 * np.pi):
        c, s = np.cos(angle), np.sin(angle)
        R_WR = np.array([[[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]])
        kept = cleaner._tasks(q, R_WR, None)
        moved = q + [[0.01, -0.02, 0.0]]
        r, *_ = kept.at(np.zeros(1, dtype=int), moved)
        _, p, _ = kept._find(np.vstack([q, moved]))
        expected = R_WR[0] @ (p[1, 0] - p[0, 0]) * [25.0, 25.0, 100.0]
        np.testing.assert_allclose(r[0, :3], expected, atol=1e-12)


def test_what_cannot_be_cleaned_for_is_refused(tmp_path):
    folder = write_robot(tmp_path)
    description = load_robot_description(folder)
    with pytest.raises(ModelError, match="left_hand"):
        Cleaner(description, RATE, CleaningParameters(hands=True))
    with pytest.raises(ScenarioError, match="joint_weight"):
        Cleaner(description, RATE, CleaningParameters(joint_weight=0.0))
    with pytest.raises(ScenarioError, match="velocity_scale is 5"):
        Cleaner(description, RATE, CleaningParameters(velocity_scale=5.0))
    description.pairs = []
    with pytest.raises(ModelError, match="pairs"):
        Cleaner(description, RATE)


def test_what_no_joint_can_part_is_reported(tmp_path):
    """Ball and link are welded into each other."""
    folder = write_robot(tmp_path)
    urdf = (folder / "chain.urdf").read_text()
    (folder / "chain.urdf").write_text(
        urdf.replace('lower="-2.5" upper="2.5"', 'lower="0.899" upper="0.901"')
    )
    cleaner = Cleaner(load_robot_description(folder), RATE)
    found = cleaner.clean(np.full((2, 3), 0.9))
    assert found.violating.all() and np.isfinite(found.q).all()
    assert found.q.min() >= 0.899 and found.q.max() <= 0.901
