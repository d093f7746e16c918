"""What is left out of a step can change nothing in it, and what is taken is clear."""

import numpy as np
import pytest
from small_reference_robots import reaching, write_robot

from crar_drake.equations.compilation import IS_COMPILED
from crar_drake.equations.nearby import ball_distances, nearby_distances
from crar_drake.judging.referee import Referee
from crar_drake.references import following
from crar_drake.references.clear_ways import ClearWays
from crar_drake.references.following import CleaningParameters, Follower
from crar_drake.references.frame_targets import configurations
from crar_drake.robot.description import load_robot_description

RATE = 50.0


@pytest.fixture(scope="module")
def follower(tmp_path_factory) -> Follower:
    folder = write_robot(tmp_path_factory.mktemp("robot"))
    return Follower(load_robot_description(folder), RATE)


def whole(follower: Follower, q: np.ndarray) -> np.ndarray:
    return configurations(follower.model, follower.model.rest_positions(), q)


def far_and_near(follower: Follower) -> np.ndarray:
    rng = np.random.default_rng(4)
    q = rng.uniform(-2.0, 2.0, (40, 3))
    return whole(follower, q)


def test_bounds_are_the_referees_distances_where_these_matter(follower):
    model = follower.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    q = far_and_near(follower)
    rows = len(model.pairs.pair_of_shapes)
    enough = np.full((len(q), rows), 0.3)
    found = nearby_distances(q, enough, model.robot_ahead)
    by_pair = found[:, model.pairs.shape_pairs].min(axis=2)
    wanted = np.array([referee.distances(each) for each in q])
    near = wanted < 0.3
    assert near.any() and not near.all()
    np.testing.assert_allclose(by_pair[near], wanted[near], atol=1e-9)
    assert (by_pair[~near] >= 0.3).all()
    assert (by_pair <= wanted + 1e-9).all()


def test_balls_are_as_far_apart_as_their_middles_less_radii(follower):
    r = follower.model.robot_ahead.value
    pairs, rng = r.pairs.value, np.random.default_rng(6)
    points = rng.normal(size=(2 * len(r.first), 3))  # in both configurations
    a, u = points[pairs.start_a], points[pairs.vector_a]
    b, v = points[pairs.start_b], points[pairs.vector_b]
    between = np.linalg.norm((a + 0.5 * u) - (b + 0.5 * v), axis=1)
    every = np.arange(len(between))
    expected = between - pairs.sizes.balls
    np.testing.assert_allclose(
        ball_distances(points, pairs, every), expected, atol=1e-12
    )
    np.testing.assert_allclose(ball_distances(points, pairs, every[1:2]), expected[1:2])


def test_the_law_on_some_pairs_is_the_law_on_all(follower, monkeypatch):
    """To the last bit, in a motion that comes near one link after the other."""
    q = reaching(60, RATE, 1.0)
    some = follower.follow(q)
    assert 0 < some.num_watched < len(follower.model.pairs)
    with monkeypatch.context() as patched:
        patched.setattr(following, "_EXPECTED", 1e4)
        every = Follower(follower.description, RATE).follow(q)
    assert every.num_watched == len(follower.model.pairs)
    # NumPy's products of matrices round by how many rows they have.
    atol = 0.0 if IS_COMPILED else 1e-13
    np.testing.assert_allclose(some.q, every.q, rtol=0.0, atol=atol)
    assert np.abs(some.q - q).max() > 0.05


def test_a_pair_that_a_step_could_reach_is_looked_at_in_the_end(follower, monkeypatch):
    """However few are looked at first, the floor is shown for all of them."""
    parameters = CleaningParameters(influence_distance=0.006)
    q = reaching(60, RATE, 1.0)
    at_once = Follower(follower.description, RATE, parameters).follow(q)
    monkeypatch.setattr(following, "_EXPECTED", 0.0)
    found = Follower(follower.description, RATE, parameters).follow(q)
    assert found.asked > at_once.asked
    model = follower.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    least = min(referee.distances(each).min() for each in found.q)
    assert least > CleaningParameters().floor - 1e-6


def test_a_way_is_clear_if_all_of_it_and_of_braking_is(follower):
    """Against distances and limits sampled finely, of both kinds."""
    model = follower.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    rng = np.random.default_rng(1)
    q = np.cumsum(rng.normal(scale=0.06, size=(150, 3)), axis=0)
    q = np.clip(q + [0.6, 0.3, 0.1], -2.49, 2.49)
    ways = ClearWays(follower.law, whole(follower, q), RATE)
    overshoot = follower.law.parameters.braking_horizon * RATE
    told = np.array([ways.clear(k) for k in range(len(q) - 1)])
    margin = CleaningParameters().distance_margin
    for k in range(len(q) - 1):
        share = np.linspace(0.0, 1.0 + overshoot, 40)[:, None]
        way = q[k] + share * (q[k + 1] - q[k])
        least = min(referee.distances(each).min() for each in whole(follower, way))
        within = (np.abs(way) <= 2.5).all()
        fast = np.abs(q[k + 1] - q[k]).max() * RATE > 6.0
        if told[k]:
            assert least >= margin - 1e-9 and within and not fast
        else:  # and is not told of much that is clear
            assert least < margin + 2e-3 or not within or fast
    assert told.any() and not told.all()
