"""The admission of a ball that slides in a plane, where all is known in closed form.

Its two positions are its place, and the post is where they are 0.
"""

import numpy as np
import pytest
from moving_shapes import MovingShapes, shapes_of
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from small_robots import chain_urdf, make_model

from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations.admission import (
    AS_NOMINAL,
    CORRECTED,
    SCALED,
    AdmissionGains,
    Checked,
    Present,
    Reaches,
    check_step,
    examine_present,
    next_path,
    path_bounds,
    path_curvature,
    scale_step,
)
from crar_drake.equations.compilation import hold
from crar_drake.equations.lookahead_guard import SPARE, admit, correction
from crar_drake.equations.lookahead_rows import (
    Constraints,
    LookaheadGains,
    find_limits,
    row_weights,
)
from crar_drake.robot.task import Task

T, PERIOD = 0.1, 0.02
BOTH = 2e-3  # the radii of ball and post [m]
GAINS = LookaheadGains(
    T=T,
    Gv=30.0,
    damping=0.1,
    rho=1e-4,
    alpha=50.0,
    beta=2.0,
    rho_limits=0.01,
    distance_margin=5e-3,
    limit_margin=1e-3,
    retreat_rate=20.0,
    retreat_speed=0.5,
    joint_retreat_speed=2.0,
    influence_distance=0.3,
    period=PERIOD,
    slip_share=0.1,
)


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


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("step", [0.0, 5e-3, PERIOD])
def test_what_is_left_of_a_step_towards_a_post(ball, step, share) -> None:
    """The largest of 64 shares with which the next path ends before the floor."""
    gains = AdmissionGains(T, PERIOD, step, 4e-3)
    d = 0.2 + gains.floor
    reach = PERIOD + 0.5 * PERIOD * (PERIOD + step) / T
    s = np.array([-0.2 / (max(share, 0.01) * reach), 0.0])
    q, v = np.array([d + BOTH, 0.0]), np.zeros(2)
    now = present(ball, q, v, s, gains)
    found, clearance = scale_step(q, v, s, now, ball.robot, ball.held, gains)
    expected = np.floor(64.0 * max(share, 0.01) + 1e-9) / 64.0
    # All of it is not asked about, but for the last of the shares.
    assert found == min(expected, 63.0 / 64.0)
    left = d + found * s[0] * reach
    assert clearance == pytest.approx(left, abs=1e-9)


@pytest.mark.parametrize("step", [0.0, 5e-3, T])
def test_a_way_through_a_post_is_not_clear(ball, step) -> None:
    """From rest, in a period as long as the horizon: the next path begins behind it."""
    gains = AdmissionGains(T, T, step, 4e-3)
    way = 0.5 * T * (T + step) / T  # for each unit of s
    q, still = np.array([-0.5, 0.0]), np.zeros(2)
    for behind, clear in ((-7e-3, True), (7e-3, False)):
        s = np.array([(0.5 + behind) / way, 0.0])
        if behind < 0.0:  # the next path goes on, so it turns round first
            s = np.array([-s[0], 0.0])
        assert check(ball, q, still, s, gains).clear == clear


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_short_way_through_a_post_is_not_clear_either(ball, side) -> None:
    """With a velocity of the size of what it is multiplied with, T."""
    gains = AdmissionGains(T, T, T, 1e-3)
    q, s = np.full(2, side * 3.5e-3), np.full(2, -side * T)
    found = check(ball, q, np.zeros(2), s, gains)
    np.testing.assert_allclose(found.start, -side * 6.5e-3)
    assert (found.bounds.at < 0.0).all() and not found.clear


def test_a_turn_is_bounded_by_its_middle_less_half_the_curvature() -> None:
    """Of a ball on an arm that is nearest to the post there, and of a low level, for
    which the whole way is one part: d - rho x^2 / 8."""
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    arm = plant.AddRigidBody("arm", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    W, up = plant.world_frame(), [0.0, 0.0, 1.0]
    plant.AddJoint(RevoluteJoint("turn", W, arm.body_frame(), up, -3.0, 3.0))
    rho, friction = 0.5, CoulombFriction(1.0, 1.0)
    for body, x in ((plant.world_body(), 1.0), (arm, rho)):
        X = RigidTransform([x, 0.0, 0.0])
        plant.RegisterCollisionGeometry(body, X, Sphere(0.5 * BOTH), "ball", friction)
    plant.Finalize()
    like = make_model(chain_urdf(), [Task(frame="tip")]).robot_ahead.value
    arms = shapes_of(plant, scene_graph, [("arm", "world")], np.arange(1), like)
    for turn in (0.1, 0.4, 1.0):
        x, level, asked = np.array([turn]), np.array([-9.0]), np.ones(1, dtype=bool)
        found = path_bounds(-0.5 * x, x, 0.0 * x, level, asked, arms.robot, arms.held)
        expected = 1.0 - rho - BOTH - rho * turn**2 / 8.0
        np.testing.assert_allclose(found.low, [expected], rtol=1e-12)
        # Twice as fast at the end as at the beginning, or as fast at the end and still
        # at the beginning; in the middle at the same place.
        for rate, bend in ((turn, 0.5 * turn), (0.0, turn), (-2.0 * turn, turn)):
            start = -(0.5 * rate + 0.25 * bend)
            found = path_bounds(
                np.array([start]),
                np.array([rate]),
                np.array([bend]),
                level,
                asked,
                arms.robot,
                arms.held,
            )
            most = max(abs(rate), abs(rate + 2.0 * bend))
            curvature = rho * (most**2 + 2.0 * abs(bend))
            expected = 1.0 - rho - BOTH - curvature / 8.0
            np.testing.assert_allclose(found.low, [expected], rtol=1e-12)


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


@pytest.mark.parametrize("seed", range(20))
def test_the_place_that_is_told_is_the_worst_of_32(ball, seed) -> None:
    """On a way by the post, wherever on it the ball is nearest: to half a part."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=2)
    aside = np.array([-x[1], x[0]]) * rng.uniform(0.05, 0.3)
    nearest = rng.uniform(0.02, 0.98)
    start = aside - nearest * x
    level = np.linalg.norm(aside) - BOTH + 10.0 ** rng.uniform(-5.0, 1.0)
    asked = np.ones(1, dtype=bool)
    levels, straight = np.array([level]), np.zeros(2)
    bounds = path_bounds(start, x, straight, levels, asked, ball.robot, ball.held)
    assert abs(bounds.at[0] - nearest) <= 1.0 / 32.0 + 1e-9
    there = distance(start + bounds.at[0] * x)
    assert bounds.d[0] == bounds.low[0] == pytest.approx(there, abs=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_clear_is_shown_to_keep_the_floor(ball, seed) -> None:
    """On the present path by the post, and on the next; and no more than is true."""
    rng = np.random.default_rng(seed)
    v, s = rng.normal(size=2), 5.0 * rng.normal(size=2)
    aside = np.array([-v[1], v[0]]) / np.linalg.norm(v) * rng.uniform(0.1, 0.2)
    gains = AdmissionGains(T, PERIOD, 0.0, 4e-3)
    q = aside - rng.uniform(0.0, T) * v
    nearest = from_way(np.zeros(2), q, q + T * v) - BOTH
    gains = gains._replace(floor=nearest - 10.0 ** rng.uniform(-4.0, -1.0))
    now = present(ball, q, v, s, gains)
    assert now.held and gains.floor <= now.low[0] <= nearest + 1e-12
    found = check_step(q, v, s, now, ball.robot, ball.held, gains)
    after = from_way(np.zeros(2), found.start, found.start + found.x) - BOTH
    if after >= gains.floor + 1e-4:
        assert found.clear
    if found.clear:
        assert gains.floor <= found.clearance <= after + 1e-12


def test_what_has_no_distance_is_not_clear(ball) -> None:
    """An overflow makes a NaN of it; and the law brakes then."""
    start, x = np.array([1.0, 1.0]), np.array([np.nan, 0.0])
    level, asked = np.array([4e-3]), np.array([True])
    straight = np.zeros(2)
    bounds = path_bounds(start, x, straight, level, asked, ball.robot, ball.held)
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
        bounds = path_bounds(start, x, straight, level, asked, ball.robot, ball.held)
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


@pytest.mark.parametrize("step", [0.0, 5e-3, PERIOD])
@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("seed", range(6))
def test_a_correction_leads_to_the_level_and_some(ball, step, n, seed) -> None:
    """Where the next path came too near: to the first order, of which the change of the
    distance there by the step's velocity is found by differences."""
    rng = np.random.default_rng(seed)
    gains = AdmissionGains(T, PERIOD, step, 4e-3)
    q = np.array([0.1, 0.02]) * rng.choice([-1.0, 1.0], 2)
    v, s = -0.1 * q / T, -rng.uniform(1.0, 1.3) * q / PERIOD
    now = present(ball, q, v, s, gains)
    checked = check_step(q, v, s, now, ball.robot, ball.held, gains)
    assert now.held and not checked.clear
    at, change = checked.bounds.at[0], 1e-7 * np.eye(2)

    def there(s) -> np.ndarray:
        start, x = next_path(q, v, s, T, PERIOD, step)
        return distance(start + at * x)

    slope = np.array([(there(s + x) - there(s - x)) / 2e-7 for x in change])
    asked = [ball.robot, ball.held, GAINS, gains]
    found = correction(checked, s, n, now, *asked)
    assert len(found.h) == 1 and found.g.shape == (1, n)
    # The shortest change of the controlled velocities that the row asks for.
    g = found.g[0]
    missing = found.retreat[0] - found.drift[0] - g @ s[:n]
    by_row = slope[:n] @ (missing * g / (g @ g))
    assert by_row == pytest.approx(gains.floor + SPARE - there(s), rel=1e-5)
    # It weighs as a pair that is in collision.
    harder = GAINS.rho, GAINS.alpha, GAINS.beta
    weight = row_weights(np.full(1, -1.0), GAINS.distance_margin, *harder)
    np.testing.assert_array_equal(found.weight, weight)


def admitted(ball: MovingShapes, q, v, s, n: int, gains: AdmissionGains):
    """`admit` of a wish without limits and rows; the first n are controlled."""
    free, nothing = np.full(n, np.inf), np.zeros(0)
    none = Constraints(nothing, np.zeros((0, n)), nothing, nothing, nothing)
    law = ControlLaw(make_model(chain_urdf(), [Task(frame="tip")]), CrarParameters())
    numbers = law.mode.numbers.value._replace(
        limits=hold(find_limits(-free, free, free)),
        gains=GAINS,
        admission=gains,
        reaches=ball.held,
    )
    d = np.array([distance(q), distance(q + gains.T * v)])[:, None]
    found, s_p, told = admit(
        s[:n], s[n:], s[:n], q, v, d, none, np.eye(n), ball.robot, numbers
    )
    assert found.shape == (n,) and s_p.shape == (2 - n,)
    return np.concatenate((found, s_p)), told


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("within", [0.45, 0.3, 0.26, 0.2, 0.03, 0.001])
def test_what_is_admitted_of_a_jump_through_a_post(ball, n, within) -> None:
    """Nothing can be corrected, for the next path is behind it. Of 64 shares the
    largest that is clear is left; if that is less than a quarter, the guard is asked
    anew with 1/16, 1/64 and nothing of the wish, and has nothing to say here."""
    gains = AdmissionGains(T, T, T, 4e-3)
    d, towards = 0.2 + gains.floor, np.array([-0.6, -0.8])
    # For each unit of s the way is T long, and so is the next path.
    s = 0.2 / (2.0 * T) / within * towards
    q, still = -(d + BOTH) * towards, np.zeros(2)
    found, told = admitted(ball, q, still, s, n, gains)
    share = np.floor(64.0 * within) / 64.0
    if share < 0.25:
        share = max(x for x in (1.0 / 16.0, 1.0 / 64.0, 0.0) if x <= within)
    np.testing.assert_allclose(found, share * s, atol=1e-12)
    left = d - 2.0 * T * share * np.linalg.norm(s)
    # The rows of a step's distances are bounded by what each slide moves.
    least = d - 2.0 * T * share * np.abs(s).sum()
    assert told[:2].tolist() == [SCALED, share] and told[3] == 1.0
    assert max(gains.floor, least) - 1e-9 <= told[2] <= left + 1e-9


@pytest.mark.parametrize("n", [1, 2])
def test_a_step_towards_a_post_is_corrected_to_the_floor_and_some(ball, n) -> None:
    gains = AdmissionGains(T, PERIOD, PERIOD, 4e-3)
    q, still = np.array([0.02, 0.0]), np.zeros(2)
    reach = PERIOD + PERIOD**2 / T
    s = np.array([-0.0176 / reach, 0.0])
    found, told = admitted(ball, q, still, s, n, gains)
    assert told.tolist() == [CORRECTED, 1.0, told[2], 1.0] and found[1] == 0.0
    left = 0.02 - BOTH + reach * found[0]
    assert gains.floor <= left <= gains.floor + 2.0 * SPARE
    assert gains.floor <= told[2] <= left + 1e-12
    # As wished if that is clear, and told with what it keeps.
    found, told = admitted(ball, q, still, 0.5 * s, n, gains)
    np.testing.assert_array_equal(found, 0.5 * s)
    assert told.tolist() == [AS_NOMINAL, 1.0, pytest.approx(0.0112 - BOTH), 1.0]


def test_what_begins_below_the_floor_is_told(ball) -> None:
    """And a step away from there is admitted as it is wished."""
    gains = AdmissionGains(T, PERIOD, PERIOD, 4e-3)
    q, s = np.array([0.0, 2e-3 + BOTH]), np.array([0.1, 1.0])
    found, told = admitted(ball, q, np.zeros(2), s, 2, gains)
    np.testing.assert_array_equal(found, s)
    assert told[:2].tolist() == [AS_NOMINAL, 1.0] and told[3] == 0.0
    assert told[2] == pytest.approx(2e-3)


def test_how_a_step_was_admitted_is_told_by_what_logs_say() -> None:
    assert (AS_NOMINAL, CORRECTED, SCALED) == (0.0, 1.0, 2.0)


def stretched_chains(rng: np.random.Generator, lengths: np.ndarray) -> Reaches:
    """Two chains of planar joints, each stretched and with a shape at its end, on one
    joint that carries both."""
    n = len(lengths)
    joints = np.arange(2 * n + 1)
    a_alone, b_alone = (joints >= 1) & (joints <= n), joints > n
    reach = np.cumsum(lengths[::-1])[::-1]
    a, b = np.zeros((2, 2 * n + 1))
    a[1 : n + 1], b[n + 1 :] = reach, 2.0 * reach
    above = np.zeros((2 * n + 1, 2 * n + 1))
    for chain in (a_alone, b_alone):
        above[np.ix_(chain, chain)] = np.tri(n, k=-1)
        above[chain, 0] = 1.0
    rows = np.arange(1)
    return Reaches(
        *(x[None].astype(float) for x in (a_alone, b_alone, a, b)),
        (a + b)[:, None],
        above,
        rows,
        rows,
        np.arange(0),
        np.zeros(0),
        *np.zeros((2, 0, *a[None].shape)),
    )


@pytest.mark.parametrize(
    "curvature",
    [path_curvature, getattr(path_curvature, "py_func", path_curvature)],
    ids=["called", "plain"],
)
def test_a_stretched_arm_bends_its_way_as_much_as_the_curvature(curvature) -> None:
    """Joints that turn one way: each link's own turn, squared, times its length."""
    rng = np.random.default_rng(2)
    for n in (1, 2, 4):
        lengths = rng.uniform(0.1, 0.5, n)
        x = rng.uniform(0.1, 0.9, 2 * n + 1) * rng.choice([-1.0, 1.0], 2 * n + 1)
        turns = np.abs(x)
        expected = sum(
            scale * (lengths * np.cumsum(chain) ** 2).sum()
            for scale, chain in ((1.0, turns[1 : n + 1]), (2.0, turns[n + 1 :]))
        )
        found = curvature(x, np.zeros(1, dtype=int), stretched_chains(rng, lengths))
        np.testing.assert_allclose(found, [expected], rtol=1e-12)
