"""What is near a ball that slides in a plane between posts: all is known by hand."""

import numpy as np
import pytest
from moving_shapes import MovingShapes
from sliding_balls import among_posts

from crar_drake.law.compilation import Held, hold
from crar_drake.law.kinematics import link_poses, place_points
from crar_drake.law.nearby import (
    ball_distances,
    bounds_of_some,
    near_balls,
    nearby_distances,
)

RADIUS = 0.01
POSTS = np.array([[0.0, 0.0], [1.0, 0.2], [-0.5, 1.0], [0.3, -2.0]])


@pytest.fixture(scope="module")
def ball() -> MovingShapes:
    return MovingShapes.of(among_posts(POSTS, radius=RADIUS))


@pytest.fixture(scope="module")
def robot(ball) -> Held:
    return hold(ball.robot)


def distances(q: np.ndarray) -> np.ndarray:
    return np.linalg.norm(q - POSTS, axis=1) - 2.0 * RADIUS


@pytest.mark.parametrize("seed", range(20))
def test_bounds_of_a_way_are_below_how_near_it_comes_to_the_posts(ball, seed) -> None:
    rng = np.random.default_rng(seed)
    start, x = rng.uniform(-1.0, 1.0, 2), rng.normal(size=2)
    share = np.clip((POSTS - start) @ x / (x @ x), 0.0, 1.0)
    way = start + share[:, None] * x
    d = np.linalg.norm(way - POSTS, axis=1) - 2.0 * RADIUS
    rows = rng.permutation(len(POSTS))[:2]
    bounds = bounds_of_some(start, x, 0.3, rows, hold(ball.robot), ball.held)
    shown = bounds.at < 0.0
    assert (d[rows][shown] >= 0.3).all() and (d[rows][~shown] < 0.3 + 2e-3).all()
    assert (bounds.low[shown] <= d[rows][shown] + 1e-12).all()


def test_distances_are_those_of_each_configuration(robot) -> None:
    rng = np.random.default_rng(1)
    q = rng.normal(size=(5, 2))
    found = nearby_distances(q, np.full((5, len(POSTS)), np.inf), robot)
    np.testing.assert_allclose(found, [distances(x) for x in q], atol=1e-12)


def test_balls_are_as_far_apart_as_the_shapes_if_these_are_balls(robot) -> None:
    robot = robot.value
    pairs = robot.pairs.value
    q = np.random.default_rng(3).normal(size=(1, 2))
    tree = robot.tree.value
    points = place_points(link_poses(q, tree, tree.every), robot.selection, robot.first)
    some = np.array([2, 0])
    found = ball_distances(points[0], pairs, pairs.shapes[some])
    np.testing.assert_allclose(found, distances(q[0])[some], atol=1e-12)


@pytest.mark.parametrize("enough", [-0.1, 0.0, 0.4, np.inf])
def test_near_balls_are_those_of_which_the_distances_are_less(robot, enough) -> None:
    robot = robot.value
    pairs, tree = robot.pairs.value, robot.tree.value
    q = np.random.default_rng(4).normal(size=(1, 2))
    points = place_points(link_poses(q, tree, tree.every), robot.selection, robot.first)
    some = pairs.shapes[: len(POSTS)]
    starts = np.stack([pairs.start_a[some], pairs.start_b[some]])
    to_vector = pairs.vector_a[0] - pairs.start_a[0]
    balls = pairs.sizes.balls[some]
    found = near_balls(points[0], starts, to_vector, balls, enough)
    apart = ball_distances(points[0], pairs, some)
    np.testing.assert_array_equal(found, np.flatnonzero(apart < enough))
    points[:] = np.nan
    every = near_balls(points[0], starts, to_vector, balls, enough)
    np.testing.assert_array_equal(every, np.arange(len(POSTS)))
