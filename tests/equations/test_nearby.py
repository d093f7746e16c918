"""What is near a ball that slides in a plane between posts: all is known by hand."""

import numpy as np
import pytest
from small_robots import make_model

from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import LookaheadParameters
from crar_drake.equations.kinematics import link_poses, place_points
from crar_drake.equations.nearby import (
    ball_distances,
    bounds_of_some,
    near_balls,
    nearby_distances,
)
from crar_drake.robot.task import Task

PERIOD, STEP, RADIUS = 0.02, 5e-3, 0.01
POSTS = np.array([[0.0, 0.0], [1.0, 0.2], [-0.5, 1.0], [0.3, -2.0]])


def sliding_ball() -> str:
    """A URDF: `slider` along y on `x` along x, among posts welded to `base`."""
    shape = f'<collision><geometry><sphere radius="{RADIUS}"/></geometry></collision>'
    inertia = (
        '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" '
        'ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    text = '<robot name="ball"><link name="base"/>'
    text += f'<link name="x">{inertia}</link><link name="slider">{inertia}{shape}'
    text += "</link>"
    for name, parent, child, axis in (
        ("along_x", "base", "x", "1 0 0"),
        ("along_y", "x", "slider", "0 1 0"),
    ):
        text += (
            f'<joint name="{name}" type="prismatic"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="{axis}"/>'
            '<limit lower="-9" upper="9"/></joint>'
            "<transmission><type>transmission_interface/SimpleTransmission</type>"
            f'<joint name="{name}"><hardwareInterface>EffortJointInterface'
            f'</hardwareInterface></joint><actuator name="{name}"/></transmission>'
        )
    for k, (x, y) in enumerate(POSTS):
        text += (
            f'<link name="post{k}">{shape}</link><joint name="weld{k}" type="fixed">'
            f'<parent link="base"/><child link="post{k}"/>'
            f'<origin xyz="{x} {y} 0"/></joint>'
        )
    return text + "</robot>"


@pytest.fixture(scope="module")
def mode():
    model = make_model(
        sliding_ball(),
        [Task(frame="slider")],
        time_step=STEP,
        pairs=[["slider", f"post{k}"] for k in range(len(POSTS))],
    )
    return ControlLaw(model, LookaheadParameters(period=PERIOD)).mode


def distances(q: np.ndarray) -> np.ndarray:
    return np.linalg.norm(q - POSTS, axis=1) - 2.0 * RADIUS


@pytest.mark.parametrize("seed", range(20))
def test_bounds_of_a_way_are_below_how_near_it_comes_to_the_posts(mode, seed) -> None:
    rng = np.random.default_rng(seed)
    start, x = rng.uniform(-1.0, 1.0, 2), rng.normal(size=2)
    share = np.clip((POSTS - start) @ x / (x @ x), 0.0, 1.0)
    way = start + share[:, None] * x
    d = np.linalg.norm(way - POSTS, axis=1) - 2.0 * RADIUS
    rows = rng.permutation(len(POSTS))[:2]
    bounds = bounds_of_some(start, x, 0.3, rows, mode.robot, mode.reaches)
    shown = bounds.at < 0.0
    assert (d[rows][shown] >= 0.3).all() and (d[rows][~shown] < 0.3 + 2e-3).all()
    assert (bounds.low[shown] <= d[rows][shown] + 1e-12).all()


def test_distances_are_those_of_each_configuration(mode) -> None:
    rng = np.random.default_rng(1)
    q = rng.normal(size=(5, 2))
    found = nearby_distances(q, np.full((5, len(POSTS)), np.inf), mode.robot)
    np.testing.assert_allclose(found, [distances(x) for x in q], atol=1e-12)


def test_balls_are_as_far_apart_as_the_shapes_if_these_are_balls(mode) -> None:
    robot = mode.robot.value
    pairs = robot.pairs.value
    q = np.random.default_rng(3).normal(size=(1, 2))
    tree = robot.tree.value
    points = place_points(link_poses(q, tree, tree.every), robot.selection, robot.first)
    some = np.array([2, 0])
    found = ball_distances(points[0], pairs, pairs.shapes[some])
    np.testing.assert_allclose(found, distances(q[0])[some], atol=1e-12)


@pytest.mark.parametrize("enough", [-0.1, 0.0, 0.4, np.inf])
def test_near_balls_are_those_of_which_the_distances_are_less(mode, enough) -> None:
    robot = mode.robot.value
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
