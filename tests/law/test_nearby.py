"""What is near a ball that slides in a plane between posts: all is known by hand."""

import numpy as np
import pytest
from moving_shapes import MovingShapes
from sliding_balls import among_posts

from crar_drake.law.compilation import Held, hold
from crar_drake.law.kinematics import link_poses, place_points
from crar_drake.law.path_balls import Balls, near_on_way
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
def test_near_in_a_posture_are_those_of_which_the_distances_are_less(
    robot, enough
) -> None:
    robot = robot.value
    pairs, tree, count = robot.pairs.value, robot.tree.value, len(POSTS)
    q = np.random.default_rng(4).normal(size=(1, 2))
    points = place_points(link_poses(q, tree, tree.every), robot.selection, robot.first)
    posts = np.column_stack([POSTS, np.zeros(count)])
    centres = np.concatenate([[[*q[0], 0.0]], posts])[np.newaxis]
    # Of the links the balls are larger than the shapes: these decide.
    balls = Balls(
        *(np.zeros((count + 1, 4)), np.zeros(count + 1, dtype=int)),
        radius=np.full(count + 1, 2.0 * RADIUS),
        reach=np.zeros((count + 1, 2)),
        above=np.zeros((2, 2)),
        a=np.zeros(count, dtype=int),
        b=np.arange(1, count + 1),
        shapes=np.arange(count + 1),
        always=np.zeros(count, dtype=bool),
    )
    still = np.zeros(count + 1)
    found, _ = near_on_way(centres, points, still, enough, pairs, balls)
    np.testing.assert_array_equal(found, np.flatnonzero(distances(q[0]) < enough))
    points[:], centres[:] = np.nan, np.nan
    every, _ = near_on_way(centres, points, still, enough, pairs, balls)
    np.testing.assert_array_equal(every, np.arange(count))
