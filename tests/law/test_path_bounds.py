"""Bounds of whole paths: each holds, by dense samples, and is of use."""

import numpy as np
import pytest
from grounded_robots import above_ground
from hypothesis import given, settings, strategies as st
from moving_shapes import MovingShapes, shapes_of_every_joint
from pydrake.geometry import SceneGraph, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
)
from pydrake.systems.framework import DiagramBuilder
from sliding_balls import BOTH, among_posts

from crar_drake.law.capsule_distances import ShapePairs
from crar_drake.law.compilation import hold
from crar_drake.law.hull_distances import no_hulls
from crar_drake.law.limits import JointLimits, velocity_bounds
from crar_drake.law.path_bounds import (
    FALLING,
    LOWEST,
    Bounds,
    gradients_at,
    next_path,
    path_bounds,
    path_curvature,
    reaching,
    shadow_gap,
    travel,
)
from crar_drake.robot.collision_pairs import WatchedPairs
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.kinematics import JointTree
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import find_reaches

T = 2.5 / 30.0  # as long a braking path as there is by default [s]


def shipped(robot: str) -> ControlModel:
    return ControlModel.FromDescription(load_robot_description(robot), [])


def bounds_of(
    shapes: MovingShapes, *path_and_level: np.ndarray, wanted: int = LOWEST
) -> Bounds:
    """Of the whole of a path.

    Args:
        path_and_level: start, x, bend, rows and level of `path_bounds`.
        wanted: see there.
    """
    whole = np.ones((1, len(path_and_level[-1])), dtype=bool)
    return path_bounds(*path_and_level, shapes.robot, shapes.held, whole, wanted)


@pytest.fixture(
    scope="module",
    params=["upper_body", "obstacle_arm", "every joint", "above ground"],
)
def shapes(request) -> MovingShapes:
    if request.param == "above ground":
        return MovingShapes.of(above_ground())
    if request.param == "every joint":
        return shapes_of_every_joint(shipped("obstacle_arm").robot.value)
    return MovingShapes.of(shipped(request.param))


# --- A1: where the next braking path lies -------------------------------------------


def stepped(q, v, a, period: float, steps: int):
    """All states of a plant on its way, by semi-implicit Euler steps."""
    states = [(q, v)]
    for _ in range(steps):
        v = v + period / steps * a
        q = q + period / steps * v
        states.append((q, v))
    return states


@pytest.mark.parametrize("steps", [1, 2, 5, 20])
def test_the_next_path_begins_where_the_plants_steps_lead(steps: int) -> None:
    """And those of a continuous one: on the parabola."""
    rng = np.random.default_rng(steps)
    q, v, s = rng.normal(size=(3, 4))
    for period in (1e-3, 0.01, T):
        a = (s - v) / T
        smooth = q + period * v + 0.5 * period**2 * a, v + period * a
        for step, state in (
            (period / steps, stepped(q, v, a, period, steps)[-1]),
            (0.0, smooth),
        ):
            found = next_path(q, v, s, T, period, step)
            np.testing.assert_allclose(found[0], state[0], atol=1e-14)
            np.testing.assert_allclose(found[1], T * state[1], atol=1e-14)


# --- A2: limits and speeds ----------------------------------------------------------


def random_joints(seed: int, beyond: bool):
    """Limits of many joints, some with none or one, some of a milliradian; and states
    whose braking paths lie within them, or anywhere."""
    rng = np.random.default_rng(seed)
    n = 40
    lower = rng.uniform(-2.0, 0.0, n)
    upper = lower + rng.choice([1e-3, 0.5, 3.0], size=n)
    q, rest = rng.uniform(lower, upper, (2, n))
    lower[rng.random(n) < 0.2], upper[rng.random(n) < 0.2] = -np.inf, np.inf
    fastest = rng.choice([0.5, 5.0, np.inf], size=n)
    v = (rest - q) / T
    v *= np.minimum(1.0, fastest / np.maximum(np.abs(v), 1e-9))
    if beyond:
        q = q + rng.normal(size=n)
        v = 5.0 * v + 3.0 * rng.normal(size=n)
    return rng, q, v, lower, upper, fastest


@given(
    st.integers(0, 2**31),
    st.sampled_from([1e-3, 5e-3, 0.02, T]),
    st.sampled_from([1, 4]),
)
@settings(max_examples=150, deadline=None)
def test_within_the_bounds_no_limit_is_passed(
    seed: int, period: float, steps: int
) -> None:
    """By q', q'_s and all steps of the plant in between; nor a speed. At the bounds
    themselves one of them is just reached."""
    rng, q, v, lower, upper, fastest = random_joints(seed, beyond=False)
    times = period, period / steps
    limits = hold(JointLimits(lower, upper, fastest, *times))
    low, high = velocity_bounds(q, v, T, limits)
    assert (low <= 0.0).all() and (high >= 0.0).all()
    bounded = [np.maximum(low, -1e6), np.minimum(high, 1e6)]
    for s in (*bounded, rng.uniform(*bounded), np.zeros(len(q))):
        states = stepped(q, v, (s - v) / T, period, steps)
        end = states[-1][0] + T * states[-1][1]
        slack = 1e-12 * (1.0 + np.abs(s))
        for x in (*(q_t for q_t, _ in states), end):
            assert (x >= lower - slack).all() and (x <= upper + slack).all()
        for _, v_t in states:
            assert (np.abs(v_t) <= fastest * (1.0 + 1e-9) + slack / T).all()
    for s, limit, sign in zip((low, high), (lower, upper), (-1.0, 1.0), strict=True):
        finite = np.where(np.isfinite(s), s, 0.0)
        q_next, v_next = stepped(q, v, (finite - v) / T, period, steps)[-1]
        some = np.isfinite(s) & (np.abs(s) > 0.0)
        off = np.minimum(
            np.abs((q_next + T * v_next)[some] - limit[some]),
            np.abs(v_next[some] - sign * fastest[some]),
        )
        assert (off < 1e-9 * (1.0 + np.abs(s[some]))).all()
        # Without a limit and a speed limit there is no bound.
        assert (np.isinf(s) == (np.isinf(limit) & np.isinf(fastest))).all()


@given(st.integers(0, 2**31), st.sampled_from([1e-3, 5e-3, 0.02, T]))
@settings(max_examples=150, deadline=None)
def test_beyond_a_limit_or_a_speed_it_does_not_get_worse(
    seed: int, period: float
) -> None:
    """Braking is always within the bounds; and what is within the bounds is no worse
    than the present path and what braking leaves of the speed."""
    rng, q, v, lower, upper, fastest = random_joints(seed, beyond=True)
    limits = hold(JointLimits(lower, upper, fastest, period, period))
    low, high = velocity_bounds(q, v, T, limits)
    assert (low <= 0.0).all() and (high >= 0.0).all()
    bounded = [np.maximum(low, -1e6), np.minimum(high, 1e6)]
    for s in (*bounded, rng.uniform(*bounded), np.zeros(len(q))):
        q_next, v_next = stepped(q, v, (s - v) / T, period, 1)[-1]
        slack = 1e-12 * (1.0 + np.abs(s))
        for x in (q_next, q_next + T * v_next):
            assert (x >= np.minimum(lower, np.minimum(q, q + T * v)) - slack).all()
            assert (x <= np.maximum(upper, np.maximum(q, q + T * v)) + slack).all()
        most = np.maximum(fastest, np.abs(v) * (1.0 - period / T))
        assert (np.abs(v_next) <= most * (1.0 + 1e-9) + slack / T).all()


# --- A3, A6: how far and how bent shapes move ---------------------------------------


def random_path(shapes: MovingShapes, rng: np.random.Generator):
    """A start within the limits, and a way of one of several lengths."""
    x = rng.normal(size=len(shapes.order)) * rng.choice([0.01, 0.1, 0.5])
    x[rng.random(len(x)) < 0.3] = 0.0
    return shapes.random_configuration(rng), x


def test_no_point_of_a_shape_accelerates_more_than_the_curvature(
    shapes: MovingShapes,
) -> None:
    """Second differences of the axes' ends along random ways, seen from what carries
    both shapes: that is, without the joints that carry both."""
    rng = np.random.default_rng(5)
    both = np.array([shapes.carries(r[0]) & shapes.carries(r[3]) for r in shapes.rows])
    step, ratios = 1e-3, []
    for _ in range(12):
        start, x = random_path(shapes, rng)
        reaches, moves = shapes.reaches, shapes.robot.pairs.value.moves
        bound = path_curvature(x, moves, reaches.reach, reaches.above)
        for row in range(len(shapes.rows)):
            way = np.where(both[row], 0.0, x)
            largest = 0.0
            for t in (0.0, 0.5, 1.0):
                ends = [
                    np.array(shapes.ends(start + (t + k * step) * way))[:, row]
                    for k in (-1, 0, 1)
                ]
                bent = (ends[0] - 2.0 * ends[1] + ends[2]) / step**2
                of_a, of_b = np.linalg.norm(bent, axis=2).max(axis=1)
                largest = max(largest, of_a + of_b)
            assert largest <= bound[row] * (1.0 + 1e-4) + 1e-8
            if largest > 1e-6:
                ratios.append(bound[row] / largest)
    assert np.median(ratios) < 30.0


def test_no_distance_changes_more_than_the_travel(shapes: MovingShapes) -> None:
    """From anywhere within the limits to anywhere; and for a single joint the axes'
    ends never move faster than its reach."""
    rng = np.random.default_rng(6)
    ratios = []
    for _ in range(60):
        start, end = (shapes.random_configuration(rng) for _ in range(2))
        end = np.where(rng.random(len(start)) < 0.7, start, end)
        d = shapes.distances(np.array([start, end]))
        bound = travel(end - start, shapes.reaches.reach)
        assert (np.abs(d[1] - d[0]) <= bound + 1e-12).all()
        moved = bound > 1e-9
        ratios.extend(np.abs(d[1] - d[0])[moved] / bound[moved])
    assert max(ratios) > 0.5


def test_no_end_is_farther_from_a_joint_than_its_reach(shapes: MovingShapes) -> None:
    rng = np.random.default_rng(7)
    reach, moves = shapes.reaches.reach, shapes.robot.pairs.value.moves
    largest = np.zeros((2, *reach.shape))
    for _ in range(100):
        shapes.set(shapes.random_configuration(rng))
        for row, (a, ends_a, _, b, ends_b, _) in enumerate(shapes.rows):
            for k, (body, ends) in enumerate(((a, ends_a), (b, ends_b))):
                for end in ends:
                    speed = np.linalg.norm(shapes.end_jacobian(body, end), axis=0)
                    largest[k, row] = np.maximum(largest[k, row], speed)
    alone = np.array([moves > 0.0, moves < 0.0])
    assert (largest * alone <= reach + 1e-12).all()
    # A joint moves a shape alone where Drake says so, and has no reach elsewhere.
    carried = np.array(
        [[shapes.carries(row[k]) for row in shapes.rows] for k in (0, 3)]
    )
    np.testing.assert_array_equal(alone[0], carried[0] & ~carried[1])
    np.testing.assert_array_equal(alone[1], carried[1] & ~carried[0])
    assert not reach[moves == 0.0].any()
    # and the reach is of use: stretched out, but not much more.
    assert np.median((reach / np.maximum(largest, 1e-9))[alone]) < 3.0


def sliding_plant(kinds: str, limits: tuple[float, float]):
    """A ball at the end of joints that turn ("t") or slide ("s"), and a post."""
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    parent = plant.world_frame()
    for i, kind in enumerate(kinds):
        body = plant.AddRigidBody(f"l{i}", inertia)
        mount = plant.AddFrame(
            FixedOffsetFrame(f"f{i}", parent, RigidTransform([0.2, 0.0, 0.0]))
        )
        made, axis, bounds = RevoluteJoint, [0.0, 0.0, 1.0], (-1.0, 1.0)
        if kind == "s":
            made, axis, bounds = PrismaticJoint, [1.0, 0.0, 0.0], limits
        plant.AddJoint(made(f"j{i}", mount, body.body_frame(), axis, *bounds))
        parent = body.body_frame()
    for link in (body, plant.world_body()):
        plant.RegisterCollisionGeometry(
            link, RigidTransform(), Sphere(0.1), "ball", CoulombFriction(1.0, 1.0)
        )
    plant.Finalize()
    return plant, scene_graph, [(body, plant.world_body())]


def reaches_of(plant: MultibodyPlant, scene_graph: SceneGraph, pairs):
    watched = WatchedPairs(plant, scene_graph.model_inspector(), pairs)
    return find_reaches(
        JointTree(plant),
        watched,
        np.arange(plant.num_velocities()),
        plant.GetPositionLowerLimits(),
        plant.GetPositionUpperLimits(),
    )


def test_a_slide_adds_to_the_reach_of_what_carries_it() -> None:
    reaches = reaches_of(*sliding_plant("tst", (-0.3, 0.1)))
    # 0.2 m from joint to joint, and 0.3 m of slide; the ball is on its own joint.
    np.testing.assert_allclose(reaches.reach, [[0.2 + 0.2 + 0.3, 1.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize("limits", [(-np.inf, np.inf), (-0.1, np.inf), (-0.1, 0.2)])
def test_a_slide_beyond_its_limits_reaches_as_far_as_it_is(limits) -> None:
    """Joints t, s, t: where the path leads is what counts, at either end."""
    plant, scene_graph, pairs = sliding_plant("tst", limits)
    reaches, every = reaches_of(plant, scene_graph, pairs), np.arange(1)

    def reach(q: float, x: float, bend: float = 0.0) -> float:
        slide = np.array([0.0, 1.0, 0.0])
        found = reaching(q * slide, x * slide, bend * slide, every, reaches)
        return found[0, 0] - 0.4

    farthest = 0.2 if np.isfinite(limits).all() else 0.0
    for q, x in ((0.5, 0.0), (-0.5, 0.0), (0.1, 0.4), (0.1, -0.6), (-0.5, 0.3)):
        assert reach(q, x) == pytest.approx(0.5)
    assert reach(0.05, 0.1) == pytest.approx(max(farthest, 0.15))
    # A parabola may turn round between its ends: 0.3 + 0.4 t - 0.8 t^2 is 0.35 at 1/4.
    along = np.linspace(0.0, 1.0, 1001)
    for x, bend in ((0.4, -0.8), (2.0, -2.0), (-1.5, 1.0)):
        most = np.abs(0.3 + x * along + bend * along**2).max()
        assert reach(0.3, x, bend) >= most


# --- A4, A5: the whole path ---------------------------------------------------------


def shape_pairs(start_a, start_b, to_vector: int) -> ShapePairs:
    """Of points, where the rest does not matter."""
    none = np.zeros(len(start_a))
    rest = none, none, none > 0.0, none.reshape(-1, 1)
    return ShapePairs(start_a, start_b, to_vector, *rest, **no_hulls(len(start_a)))


@given(st.integers(0, 2**31))
@settings(max_examples=100, deadline=None)
def test_the_shadow_gap_is_the_smallest_of_linear_motion(seed: int) -> None:
    """By many instants, its ends among them."""
    rng = np.random.default_rng(seed)
    k, half = 3, 0.5
    n = rng.normal(size=(k, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    p_a, u, p_b, v = rng.normal(size=(4, k, 3))
    a, b = rng.normal(size=(2, k, 6)) * rng.choice([0.1, 3.0])
    at, some = np.concatenate((p_a, p_b, u, v)), np.arange(k)
    of = n, at, shape_pairs(some, some + k, 2 * k), some, a, b, half
    found = np.minimum(*shadow_gap(*of))
    gaps = []
    for t in np.linspace(-half, half, 41):

        def shadows(start, along, spatial, t=t):
            ends = np.array([start, start + along])
            moved = ends + t * (np.cross(spatial[:, :3], ends) + spatial[:, 3:])
            return np.einsum("ekc,kc->ek", moved, n)

        of_a, of_b = shadows(p_a, u, a), shadows(p_b, v, b)
        gaps.append(of_a.min(axis=0) - of_b.max(axis=0))
    np.testing.assert_allclose(found, np.min(gaps, axis=0), atol=1e-12)


def test_no_distance_on_a_path_is_below_its_bound(shapes: MovingShapes) -> None:
    """Against 2000 samples: what is called clear is, and its bound is one; what has a
    millimetre to spare is called clear but for less than one in a hundred."""
    rng = np.random.default_rng(8)
    missed = clear_with_slack = clear = failed = 0
    for _ in range(10):
        start, x = random_path(shapes, rng)
        d = shapes.on_path(start, start + x, 2000)
        true = d.min(axis=0)
        slack = rng.choice([-0.02, -1e-6, 1e-6, 1e-3, 0.01, 0.1], size=len(true))
        rows = np.flatnonzero(rng.random(len(true)) < 0.8)
        true, slack = true[rows], slack[rows]
        level = true - slack
        bounds = bounds_of(shapes, start, x, 0.0 * x, rows, level)
        shown = bounds.at < 0.0
        # Where distances fall no pair is missed, and the place is below its level.
        of = start, x, 0.0 * x, rows, level
        falling = bounds_of(shapes, *of, wanted=FALLING)
        np.testing.assert_array_equal(falling.at < 0.0, shown)
        sure = bounds.d < level
        assert (falling.d[sure] < level[sure]).all()
        assert (falling.d[sure] >= bounds.d[sure] - 1e-12).all()
        assert (true[shown] >= level[shown] - 1e-12).all()
        assert (bounds.low[shown] <= true[shown] + 1e-12).all()
        assert (bounds.low[shown] >= level[shown]).all()
        spare = slack >= 1e-3
        clear_with_slack += spare.sum()
        missed += (spare & ~shown).sum()
        clear, failed = clear + shown.sum(), failed + (~shown).sum()
        # Where one fails, the distance is that, and is about the smallest.
        for k in np.flatnonzero(~shown):
            there = shapes.distances((start + bounds.at[k] * x)[None])[0, rows[k]]
            assert there == pytest.approx(bounds.d[k], abs=1e-12)
            if slack[k] < -0.01:
                assert there < level[k]
    assert clear > 20 and failed > 10
    assert missed <= 0.01 * clear_with_slack


def test_no_distance_on_a_bent_path_is_below_its_bound(shapes: MovingShapes) -> None:
    """Against 2000 samples of ways that turn round, speed up or change direction."""
    rng = np.random.default_rng(18)
    shown_of = clear_with_slack = missed = 0
    shares = np.linspace(0.0, 1.0, 2001)[:, None]
    for _ in range(10):
        start, x = random_path(shapes, rng)
        bend = rng.choice([-1.0, 0.1, 1.0]) * x + rng.normal(size=len(x)) * 0.1
        d = shapes.distances(start + shares * x + shares**2 * bend)
        true = d.min(axis=0)
        slack = rng.choice([-0.02, -1e-6, 1e-6, 1e-3, 0.01], size=len(true))
        rows, level = np.arange(len(true)), true - slack
        bounds = bounds_of(shapes, start, x, bend, rows, level)
        shown = bounds.at < 0.0
        assert (true[shown] >= level[shown] - 1e-6).all()  # the samples' spacing
        assert (bounds.low[shown] <= true[shown] + 1e-12).all()
        shown_of += shown.sum()
        clear_with_slack += (slack >= 1e-3).sum()
        missed += ((slack >= 1e-3) & ~shown).sum()
        for pair in np.flatnonzero(~shown):
            t = bounds.at[pair]
            there = shapes.distances((start + t * x + t * t * bend)[None])[0, pair]
            assert there == pytest.approx(bounds.d[pair], abs=1e-12)
    assert shown_of > 20
    assert missed <= 0.02 * clear_with_slack


def test_gradients_are_those_of_the_distances_where_they_fail(
    shapes: MovingShapes,
) -> None:
    """By differences, of every joint at the place that `path_bounds` tells."""
    rng = np.random.default_rng(12)
    step, compared = 1e-6, 0
    start, x = random_path(shapes, rng)
    d = shapes.on_path(start, start + x, 50)
    level = d.min(axis=0) + rng.choice([-0.1, 0.01], size=d.shape[1])
    rows = np.arange(len(level))
    bounds = bounds_of(shapes, start, x, 0.0 * x, rows, level)
    failed, g = gradients_at(start, x, rows, bounds, shapes.robot)
    np.testing.assert_array_equal(failed, np.flatnonzero(bounds.at >= 0.0))
    for pair, gradient in zip(failed, g, strict=True):
        at = start + bounds.at[pair] * x
        moves = step * np.eye(len(at))
        sides = [shapes.distances(at + k * moves)[:, pair] for k in (-1.0, 1.0)]
        np.testing.assert_allclose(
            gradient, (sides[1] - sides[0]) / (2.0 * step), atol=1e-5
        )
        compared += 1
    assert compared > 2


def test_a_path_without_way_is_its_start(shapes: MovingShapes) -> None:
    rng = np.random.default_rng(9)
    start = shapes.random_configuration(rng)
    d = shapes.distances(start[None])[0]
    rows = np.arange(len(d))
    for level, expected in ((d - 1e-9, True), (d + 1e-9, False)):
        still = np.zeros(len(start))
        bounds = bounds_of(shapes, start, still, still, rows, level)
        assert ((bounds.at < 0.0) == expected).all()


@pytest.fixture(scope="module")
def ball() -> MovingShapes:
    """It slides in a plane, and a post is where its two positions are 0."""
    return MovingShapes.of(among_posts([[0.0, 0.0]]))


def test_what_has_no_distance_is_not_clear(ball) -> None:
    """An overflow makes a NaN of it; and the law brakes then."""
    start, x = np.array([1.0, 1.0]), np.array([np.nan, 0.0])
    rows, level, straight = np.array([0]), np.array([4e-3]), np.zeros(2)
    bounds = bounds_of(ball, start, x, straight, rows, level)
    assert bounds.at[0] >= 0.0 and bounds.low[0] == bounds.d[0] == -np.inf


def test_a_pair_that_is_not_decided_is_not_clear_however_far(ball) -> None:
    """Two kilometres away: a way of three is not halved often enough for 1 mm."""
    start, x = np.array([2000.0, 0.0]), np.array([0.0, 3000.0])
    rows, straight = np.array([0]), np.zeros(2)
    for less, clear in ((100.0, True), (1e-3, False), (-1e-3, False)):
        level = np.array([2000.0 - BOTH - less])
        bounds = bounds_of(ball, start, x, straight, rows, level)
        assert (bounds.at[0] < 0.0) == clear
