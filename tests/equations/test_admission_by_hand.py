"""The admission of a ball that slides in a plane: its way, and what is not decided.

Its two positions are its place, and the post is where they are 0.
"""

import numpy as np
import pytest
from moving_shapes import MovingShapes, shapes_of
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from small_robots import chain_urdf, make_model

from crar_drake.equations.admission import (
    AdmissionGains,
    Checked,
    Present,
    check_step,
    examine_present,
    path_bounds,
    scale_step,
)
from crar_drake.robot.task import Task

T, PERIOD = 0.1, 0.02
BOTH = 2e-3  # the radii of ball and post [m]


def sliding_ball() -> MovingShapes:
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    parent = plant.world_body()
    for name, axis in (("x", [1.0, 0.0, 0.0]), ("y", [0.0, 1.0, 0.0])):
        inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
        body = plant.AddRigidBody(name, inertia)
        joint = PrismaticJoint(name, parent.body_frame(), body.body_frame(), axis)
        plant.AddJoint(joint)
        parent = body
    for body in (plant.world_body(), parent):
        plant.RegisterCollisionGeometry(
            body,
            RigidTransform(),
            Sphere(0.5 * BOTH),
            "ball",
            CoulombFriction(1.0, 1.0),
        )
    plant.Finalize()
    like = make_model(chain_urdf(), [Task(frame="tip")]).robot_ahead.value
    return shapes_of(plant, scene_graph, [("y", "world")], np.arange(2), like)


@pytest.fixture(scope="module")
def ball() -> MovingShapes:
    return sliding_ball()


def distance(places: np.ndarray) -> np.ndarray:
    return np.linalg.norm(places, axis=-1) - BOTH


def present(ball: MovingShapes, q, v, s, gains: AdmissionGains) -> Present:
    d = np.array([distance(q), distance(q + gains.T * v)])[:, None]
    return examine_present(q, v, s, d, ball.robot, ball.held, gains)


def check(ball: MovingShapes, q, v, s, gains: AdmissionGains) -> Checked:
    now = present(ball, q, v, s, gains)
    return check_step(q, v, s, now, ball.robot, ball.held, gains)


@pytest.mark.parametrize("d", [-1e-3, 1e-3, 3.9e-3, 4.1e-3, 0.1])
@pytest.mark.parametrize("speed", [0.0, 1e-3])
def test_at_rest_a_pair_keeps_the_floor_or_what_it_has(ball, d, speed) -> None:
    """However slow the step that is asked about."""
    gains = AdmissionGains(T, PERIOD, 0.0, 4e-3)
    q, still = np.array([0.6, 0.8]) * (d + BOTH), np.zeros(2)
    found = present(ball, q, still, np.array([0.0, speed]), gains)
    assert found.held == (d > gains.floor)
    assert found.level[0] == pytest.approx(min(d, gains.floor), abs=1e-12)
    assert found.low[0] == pytest.approx(d, abs=1e-12)


def from_way(place: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """How far a place is from a straight way."""
    along = end - start
    share = np.clip((place - start) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(start + share * along - place))


@pytest.mark.parametrize("step", [0.0, 2e-3])
@pytest.mark.parametrize("seed", range(12))
def test_a_bent_way_keeps_clear_by_its_own_distance(ball, seed, step) -> None:
    """And by that of its chord. The floor up to which it does, by bisection: the
    smallest distance of all samples; of the parabola through what a plant that moves
    in steps comes by."""
    rng = np.random.default_rng(seed)
    period, t = T, np.linspace(0.0, 1.0, 1001)[:, None]
    while True:
        v = np.array([rng.choice([1.0, 3.0, 8.0]), 0.0])
        s = np.array([rng.uniform(-2.0, 8.0), rng.uniform(1.0, 5.0)])
        qddot = (s - v) / T
        way = t * period * v + 0.5 * t * period * (t * period + step) * qddot
        start, end = way[-1], way[-1] + T * (v + period * qddot)
        post = rng.uniform(-1.0, 1.0, 2)
        others = min(from_way(post, way[0], T * v), from_way(post, start, end))
        nearest = np.linalg.norm(way - post, axis=1).min()
        nearest = min(nearest, from_way(post, way[0], start))
        if 0.02 < nearest - BOTH and nearest + 0.01 < others:
            break
    low, high = 0.0, others - BOTH  # beyond, what the pair has counts
    for _ in range(16):
        floor = 0.5 * (low + high)
        clear = check(ball, -post, v, s, AdmissionGains(T, period, step, floor)).clear
        low, high = (floor, high) if clear else (low, floor)
    assert low == pytest.approx(nearest - BOTH, abs=1e-3)
    assert low < nearest - BOTH + 1e-5


def test_a_way_that_leaves_a_surface_may_begin_on_it(ball) -> None:
    """However hard the ball is pushed off: the way is nowhere nearer than its start."""
    gains = AdmissionGains(T, PERIOD, 1e-3, 4e-3)
    q = np.array([gains.floor + BOTH + 1e-6, 0.0])
    for push in (0.1, 1.0, 8.0):
        for along in (0.0, 0.5):
            v, s = np.array([0.0, along]), np.array([push, along])
            assert check(ball, q, v, s, gains).clear


def test_what_has_no_distance_is_not_clear(ball) -> None:
    """An overflow makes a NaN of it; and the law brakes then."""
    start, x = np.array([1.0, 1.0]), np.array([np.nan, 0.0])
    level, asked = np.array([4e-3]), np.array([True])
    straight = np.zeros(2)
    bounds = path_bounds(start, x, straight, level, asked, ball.robot, ball.held, False)
    assert bounds.at[0] >= 0.0 and bounds.low[0] == bounds.d[0] == -np.inf
    q, v, s = np.array([1.0, 1.0]), np.zeros(2), np.array([0.1, 0.0])
    gains = AdmissionGains(T, PERIOD, 0.0, 4e-3)
    unknown = np.full((2, 1), np.nan)
    now = examine_present(q, v, s, unknown, ball.robot, ball.held, gains)
    assert now.held  # its path was looked at instead
    now = examine_present(q, x, s, unknown, ball.robot, ball.held, gains)
    assert not now.held and now.level[0] == gains.floor
    checked = check_step(q, x, s, now, ball.robot, ball.held, gains)
    assert not checked.clear
    assert scale_step(q, x, s, now, ball.robot, ball.held, gains)[0] == 0.0


def test_a_pair_that_is_not_decided_is_not_clear_however_far(ball) -> None:
    """Two kilometres away: a way of three is not halved often enough for 1 mm."""
    start, x = np.array([2000.0, 0.0]), np.array([0.0, 3000.0])
    d = distance(start)
    asked, straight = np.array([True]), np.zeros(2)
    for less, clear in ((100.0, True), (1e-3, False), (-1e-3, False)):
        level = np.array([d - less])
        bounds = path_bounds(
            start, x, straight, level, asked, ball.robot, ball.held, False
        )
        assert (bounds.at[0] < 0.0) == clear


@pytest.mark.parametrize("below", [4e-16, 1e-12, 9e-10])
def test_what_rounding_takes_from_the_floor_is_no_licence(ball, below) -> None:
    """The way to the next state is examined as it is from the floor itself."""
    q, v = np.array([BOTH + 4e-3, 0.0]), np.zeros(2)
    d = np.full((2, 1), distance(q))
    gains = AdmissionGains(T, PERIOD, PERIOD, float(d[0, 0]) + below)
    # Through the post and out at its other side, in a period.
    s = np.array([-4.0 * q[0] / PERIOD * T / PERIOD, 0.0])
    now = examine_present(q, v, s, d, ball.robot, ball.held, gains)
    assert now.held and now.level[0] == d[0, 0] < gains.floor
    far = check_step(q, v, s, now, ball.robot, ball.held, gains)
    path = from_way(np.zeros(2), far.start, far.start + far.x) - BOTH
    assert path > gains.floor and far.start[0] < -BOTH and not far.clear
    # And one that stays is taken.
    still = 0.0 * s
    assert check_step(q, v, still, now, ball.robot, ball.held, gains).clear
