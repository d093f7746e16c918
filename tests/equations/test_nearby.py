"""What is near a ball that slides in a plane between posts: all is known by hand."""

import numpy as np
import pytest
from small_robots import make_model

from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations.kinematics import Measured, row_distances
from crar_drake.equations.nearby import (
    bounds_of_some,
    keeps_level,
    nearby_distances,
    pairs_within,
    still_clear,
    watched_nearby,
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
    return ControlLaw(model, CrarParameters(period=PERIOD)).mode


def distances(q: np.ndarray) -> np.ndarray:
    return np.linalg.norm(q - POSTS, axis=1) - 2.0 * RADIUS


def size(x: np.ndarray) -> float:
    """How much slides by x change a distance at most, each for itself."""
    return float(np.abs(x).sum())


def step_reach(mode) -> float:
    """How much farther the next braking path is, for each unit of s."""
    return PERIOD + 0.5 * PERIOD * (PERIOD + STEP) / mode.horizon


@pytest.mark.parametrize("seed", range(20))
def test_what_is_watched_are_the_pairs_that_a_step_can_come_near(mode, seed) -> None:
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-1.0, 1.0, 2), rng.normal(size=2)
    fastest = np.abs(rng.normal(size=2)) * rng.choice([0.1, 1.0, 20.0])
    d, numbers = distances(q), mode.numbers.value
    here = mode.horizon * size(v)
    beyond = numbers.admission.floor + step_reach(mode) * size(fastest)
    near = d < here + max(numbers.gains.influence_distance, beyond)
    rows, room, robot, some = watched_nearby(q, v, fastest, mode.robot, mode.numbers)
    nearest = np.arange(len(d)) == d.argmin()
    np.testing.assert_array_equal(rows, np.flatnonzero(near if near.any() else nearest))
    left = np.setdiff1d(np.arange(len(d)), rows)
    np.testing.assert_allclose(room[left], d[left] - here, atol=1e-12)
    assert np.isinf(room[rows]).all()
    # The robot and the law of these alone have a row for each, in both configurations.
    both = np.array([q, q + mode.horizon * v])
    found = row_distances(Measured(both, v, np.zeros((0, 7))), robot.value)
    expected = [distances(x)[rows] for x in both]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    members = some.value.members
    np.testing.assert_array_equal(members, np.arange(len(rows))[:, None])


@pytest.mark.parametrize("seed", range(10))
def test_a_step_leaves_clear_what_has_more_room_than_it_moves(mode, seed) -> None:
    rng = np.random.default_rng(seed)
    s, floor = rng.normal(size=2), mode.admission.floor
    least = floor + step_reach(mode) * size(s)
    room = least + np.array([np.inf, 1e-9, 0.3, 1.0])
    state = rng.normal(size=(2, 2))
    assert still_clear(*state, s, rng.permutation(room), mode.numbers)
    for less in (least - 1e-9, np.nan):
        room[1] = less
        assert not still_clear(*state, s, rng.permutation(room), mode.numbers)


@pytest.mark.parametrize("seed", range(20))
def test_a_way_keeps_a_level_if_it_is_no_nearer_to_any_post(mode, seed) -> None:
    rng = np.random.default_rng(seed)
    start, x = rng.uniform(-1.0, 1.0, 2), rng.normal(size=2)
    share = np.clip((POSTS - start) @ x / (x @ x), 0.0, 1.0)
    way = start + share[:, None] * x
    d = np.linalg.norm(way - POSTS, axis=1) - 2.0 * RADIUS
    for slack, expected in ((1e-3, True), (-1e-9, False)):
        level = d.min() - slack
        assert keeps_level(start, x, level, mode.robot, mode.reaches) == expected
    # And so for some of them.
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


def test_the_nearest_is_looked_at_where_none_is_near(mode) -> None:
    q = np.array([5.0, 1.0])
    rows, d, _, some = pairs_within(q, np.full(4, 0.1), mode.robot, mode.numbers)
    np.testing.assert_array_equal(rows, [1])
    np.testing.assert_allclose(d, distances(q), atol=1e-12)
    np.testing.assert_array_equal(some.value.reaches.value.rows, [0])
