"""What is near a ball that slides in a plane between posts: all is known by hand."""

import numpy as np
import pytest
from moving_shapes import MovingShapes
from sliding_balls import among_posts

from crar_drake.law.compilation import Held, hold
from crar_drake.law.kinematics import link_poses, place_points
from crar_drake.law.path_balls import near_balls
from crar_drake.law.placed_shapes import shape_distances

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


def test_distances_are_those_of_each_configuration(robot) -> None:
    rng = np.random.default_rng(1)
    q = rng.normal(size=(5, 2))
    found = shape_distances(q, robot)
    np.testing.assert_allclose(found, [distances(x) for x in q], atol=1e-12)


@pytest.mark.parametrize("enough", [-0.1, 0.0, 0.4, np.inf])
def test_near_balls_are_those_of_which_the_distances_are_less(robot, enough) -> None:
    robot = robot.value
    pairs, tree = robot.pairs.value, robot.tree.value
    q = np.random.default_rng(4).normal(size=(1, 2))
    points = place_points(link_poses(q, tree, tree.every), robot.selection, robot.first)
    starts = np.stack([pairs.start_a, pairs.start_b])
    of = pairs.to_vector, pairs.balls, enough
    found = near_balls(points[0], starts, *of)
    np.testing.assert_array_equal(found, np.flatnonzero(distances(q[0]) < enough))
    points[:] = np.nan
    every = near_balls(points[0], starts, *of)
    np.testing.assert_array_equal(every, np.arange(len(POSTS)))
