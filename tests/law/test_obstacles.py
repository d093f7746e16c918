"""Obstacles that move, before the filter: nothing is touched while it is fast.

Distances, speeds and times here are this file's own: Drake's poses, and the formulas of
the theory page written again.
"""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from benchmarks.adversary.robots import load_subject
from crar_drake import (
    InputError,
    Obstacles,
    SafetyFilter,
    SafetyFilterSystem,
    SafetyParameters,
    ScenarioError,
)
from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.law.moving_obstacles import (
    Spheres,
    braking_time,
    line_bounds,
    nearest_to,
    passing,
)
from crar_drake.law.path_bounds import LOWEST
from tests.people import Person, Tally, hostile, run_at, witness_of

PERIOD, FLOOR, V_OK = 0.02, 4e-3, 0.05


@pytest.fixture(scope="module")
def arm() -> SafetyFilter:
    """The arm beside a post; tests begin it anew."""
    made = SafetyFilter("obstacle_arm", PERIOD)
    made.compile(obstacles=True)
    return made


@pytest.fixture(scope="module")
def witness(arm) -> ObstacleJudge:
    return witness_of(arm)


def swing(filter: SafetyFilter, k: int) -> np.ndarray:
    """A wanted position: all joints swing."""
    share = min(1.0, k * filter.period / 0.4)
    rest = filter.model.rest_positions()
    return rest + share * 0.4 * np.sin(2.5 * k * filter.period + np.arange(len(rest)))


# --- the theorem's formulas --------------------------------------------------------


@pytest.mark.parametrize("T, period", [(0.0833, 0.02), (0.0833, 0.001), (0.05, 0.04)])
def test_braking_is_never_later_than_its_time_says(T, period):
    """Steps of braking, on straight lines: where the robot is at tau seconds has a time
    of (M1) of at least tau, and of hardly more."""
    numbers = passing(T, period, FLOOR, V_OK)
    q, v, slack = 0.0, 1.0, []
    for step in range(40):
        after = v * (1.0 - period / T)
        for share in np.linspace(0.0, 1.0, 41):
            u = (q + share * period * after) / T  # of the first braking path
            slack.append(braking_time(u * T, 0.0, numbers) - (step + share) * period)
        q, v = q + period * after, after
        if v < 1e-6:
            break
    assert min(slack) > -1e-9
    assert min(slack) < 1e-3 * period
    assert max(slack) <= numbers.eta + 1e-9
    # (M1) in closed form, with eta as the largest of many, and after a while before.
    tau = np.linspace(0.0, period, 100_001)
    kappa = 1.0 - period / T
    T_star = -period / math.log(kappa)
    eta = float((tau + T_star * np.log1p(-tau / T)).max())
    for before in (0.0, period):
        for t in np.linspace(0.0, before + 0.999 * kappa * T, 50):
            time = eta + min(t, before)
            time -= T_star * math.log1p(-max(t - before, 0.0) / (T * kappa))
            found = braking_time(t, before, numbers)
            assert found == pytest.approx(time, abs=1e-9 * T)


def required(numbers, t: float) -> float:
    """V's factor at t seconds along the line of a command at the speed it has there."""
    if t <= numbers.period:
        return t
    u = (t - numbers.period) / numbers.T
    t_hat = numbers.eta - numbers.T_star * math.log(1.0 - u / numbers.kappa)
    return numbers.period + t_hat


@pytest.mark.parametrize("robot", ["obstacle_arm", "upper_body"])
def test_what_is_found_clear_is_so_at_every_place(robot):
    """Of random lines and spheres, sampled finely; and little more is refused."""
    filter = SafetyFilter(robot, PERIOD)
    witness, rng = witness_of(filter), np.random.default_rng(5)
    world = filter.among._world
    links, numbers = world.value.links, world.value.numbers
    n, found, refused = len(filter.joint_names), 0, 0
    for _ in range(70):
        q = filter.model.rest_positions() + rng.uniform(-0.5, 0.5, n)
        v = rng.normal(0.0, rng.choice([0.02, 0.3, 1.0]), n)
        witness.look(q, v, np.zeros((1, 3)), np.zeros(1))
        place = witness.places()[rng.integers(len(filter.links))]
        way = rng.normal(size=3)
        centre = place + rng.uniform(0.1, 0.7) * way / np.linalg.norm(way)
        radius, V = rng.uniform(0.01, 0.15), rng.choice([0.0, 0.5, 2.0])
        shape = centre[None], np.array([radius])
        one = Spheres(*shape, np.array([V]))
        floor = np.full((2, len(filter.links), 1), FLOOR)
        of = floor, LOWEST, one, world
        lacking, clearance = line_bounds(q, v, PERIOD, *of)
        sigma = (links.reaches.reach + links.turned) @ np.abs(v)
        u_end = numbers.kappa * (1.0 - numbers.kappa * V_OK / np.maximum(sigma, 1e-12))
        fast = sigma > numbers.kappa * V_OK
        until = np.where(fast, PERIOD + numbers.T * u_end, -np.inf)
        lacks, low = -np.inf, np.inf
        for t in np.linspace(0.0, PERIOD + numbers.T, 120):
            d, _ = witness.look(q + t * v, v, *shape)
            still_fast = t <= until
            grown = still_fast * V * (required(numbers, t) if still_fast.any() else 0.0)
            lacks = max(lacks, (FLOOR + grown - d[:, 0]).max())
            low = min(low, (d[:, 0] - grown).min())
        if not lacking.any():
            found += 1
            assert lacks < 1e-8
            assert clearance <= low + 1e-8
        else:
            refused += 1
            # eta on the way is more than the theorem needs there.
            assert lacks > -(1e-3 + V * numbers.eta)
    assert found > 15 and refused > 15


def test_where_a_segment_is_nearest_to_a_point():
    """Against a fine grid; segments of no length among them."""
    rng, shares = np.random.default_rng(4), np.linspace(0.0, 1.0, 801)[:, None]
    for k in range(60):
        p, u, c = rng.normal(size=(3, 3))
        u = u * (k % 3 != 0)
        *n, far = nearest_to(p, u, c)
        n = np.array(n)
        least = np.linalg.norm(p + shares * u - c, axis=1).min()
        assert least - 1e-4 < far < least + 1e-9
        assert np.linalg.norm(n) == pytest.approx(1.0)
        # The plane through the nearest point leaves the segment behind it.
        assert min(n @ (p - c), n @ (p + u - c)) > far - 1e-6


def test_the_reach_bounds_the_speed_of_surfaces(arm, witness):
    """sigma of each link, against Drake's velocities of points all over it."""
    rng = np.random.default_rng(8)
    links = arm.among._world.value.links
    n = len(arm.joint_names)
    largest = 0.0
    for _ in range(200):
        q, v = rng.uniform(-2.0, 2.0, n), rng.normal(size=n)
        around = rng.normal(size=(40, 3))
        _, speed = witness.look(q, v, around, np.zeros(40))
        sigma = (links.reaches.reach + links.turned) @ np.abs(v)
        assert (speed <= sigma[:, None] + 1e-12).all()
        largest = max(largest, (speed.max(axis=1) / np.maximum(sigma, 1e-12)).max())
    assert largest > 0.5


# --- the filter --------------------------------------------------------------------


def test_how_far_obstacles_are_is_told(arm):
    far = Obstacles([[30.0, 0.0, 0.0], [0.0, -20.0, 1.0]], 0.3, 2.0)
    rest, told = arm.model.rest_positions(), []
    for given in (None, far, Obstacles([], 1, 1)):
        arm.reset()
        told.append(arm(rest, obstacles=given).report.obstacle_clearance)
    assert math.isnan(told[0]) and told[1] > 10.0 and math.isnan(told[2])


def test_a_person_who_comes_slows_it_and_is_named(arm, witness):
    """And it goes on as wanted when the person has left."""
    arm.reset()
    rest = arm.model.rest_positions()
    witness.look(rest, 0 * rest, np.zeros((1, 3)), np.zeros(1))
    hand = witness.places()[arm.links.index("hand")]
    V, tally, whys = 1.6, Tally(), []
    for k in range(260):
        far = 1.5 - min(k, 60) * PERIOD * V * 0.75 + max(k - 120, 0) * PERIOD * V
        centre = hand + max(far, 0.0) * np.array([0.8, 0.6, 0.0])
        given = Obstacles([centre], 0.1, V, ["person"])
        command = arm(swing(arm, k), obstacles=given)
        whys.append((command.report.why, command.report.obstacle))
        moved = witness.look(command.q, command.v, centre[None], np.array([0.1]))
        tally.judge(*moved, V_OK)
        if command.report.why == "obstacle":
            name, link = command.report.obstacle
            assert name == "person" and link in arm.links
            assert command.report.how in ("corrected", "scaled")
            assert command.report.share <= 1.0
    assert tally.contacts > 0 and tally.violations == 0
    assert ("", None) in whys[:5]
    assert sum(why == "obstacle" for why, _ in whys) > 40
    assert command.report.how == "nominal"


@pytest.mark.parametrize("robot, period", [("obstacle_arm", 0.02), ("jaw", 0.005)])
def test_whoever_runs_at_it_touches_nothing_that_is_fast(robot, period):
    """Policies that jump, swing and are lost; measurements that come always or late."""
    subject = load_subject(robot)
    model, judge = subject.model(subject.task_set(0)), subject.filter(period)[1]
    filter, tally = SafetyFilter(model, period), Tally()
    for seed, policy in enumerate(("jumps", "sines", "on_and_on", "lost", "between")):
        wanted = hostile(policy, filter, judge)
        run_at(filter, wanted, round(2.0 / period), seed, tally)
    assert tally.changed > 50 and tally.contacts > 0
    assert tally.violations == 0


def test_it_creeps_towards_one_that_stands_and_stops_at_the_floor(arm, witness):
    """Slower than is harmless, and by itself it touches nothing."""
    arm.reset()
    rest = arm.model.rest_positions()
    witness.look(rest, 0 * rest, np.zeros((1, 3)), np.zeros(1))
    hand = witness.places()[arm.links.index("hand")]
    wanted = rest.copy()
    wanted[0] += 0.6
    witness.look(wanted, 0 * rest, np.zeros((1, 3)), np.zeros(1))
    there = witness.places()[arm.links.index("hand")]
    centre = hand + 0.6 * (there - hand)
    nearest = np.inf
    for _ in range(1500):
        command = arm(wanted, obstacles=Obstacles([centre], 0.03, 0.5))
        d, v = witness.look(command.q, command.v, centre[None], np.array([0.03]))
        nearest = min(nearest, d.min())
        assert d.min() > 0.1 or v.max() < 0.5
    assert FLOOR - 1e-6 < nearest < 0.03
    assert command.report.why == "obstacle"


def test_one_that_appears_too_near_is_told_and_nothing_gets_worse(arm, witness):
    """Not clear: the robot brakes, though it cannot in time."""
    arm.reset()
    for k in range(40):
        command = arm(swing(arm, k))
    witness.look(command.q, command.v, np.zeros((1, 3)), np.zeros(1))
    hand = witness.places()[arm.links.index("hand")]
    given = Obstacles([hand + [0.0, 0.0, 0.12]], 0.02, 1.0, ["tool"])
    fast = np.abs(command.v).max()
    for k in range(40, 60):
        command = arm(swing(arm, k), obstacles=given)
        if k == 40:
            assert not command.report.clear and fast > 0.3
        assert command.report.why == "obstacle"
    assert command.report.clear
    moved = witness.look(command.q, command.v, np.zeros((1, 3)), np.zeros(1))
    assert moved[1].max() < 0.1


def test_no_number_brakes_and_obstacles_go_on_growing(arm):
    arm.reset()
    rest = arm.model.rest_positions()
    arm(rest, obstacles=Obstacles([[2.0, 0.0, 0.5]], 0.2, 1.0))
    for _ in range(5):
        command = arm(np.full(len(rest), np.nan))
    assert command.report.how == "braking" and command.report.clear
    regions = arm._memory.braking.regions
    assert regions.spheres.radii[0] == pytest.approx(0.2 + 6 * PERIOD)


def test_motors_limits_hold_among_obstacles(witness):
    """Torques by Drake's inverse dynamics; and nothing is touched that is fast."""
    filter = SafetyFilter("obstacle_arm", PERIOD, effort_limits=True)
    model, tally = filter.model, Tally()
    plant, limits = model.plant, model.actuator_limits
    context = plant.CreateDefaultContext()
    rest = model.rest_positions()
    witness.look(rest, 0 * rest, np.zeros((1, 3)), np.zeros(1))
    hand = witness.places()[filter.links.index("hand")]
    q, v, most = rest, 0 * rest, 0.0
    for k in range(100):
        centre = hand + max(1.3 - 1.2 * k * PERIOD, 0.1) * np.array([0.0, 1.0, 0.0])
        given = Obstacles([centre], 0.05, 1.2)
        command = filter(swing(filter, 3 * k), obstacles=given)
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        workspace = model.MakeWorkspace()
        model.evaluate(workspace, q, v)
        torque = model.inverse_dynamics(workspace, command.a)
        most = max(most, np.abs(torque / limits).max())
        q, v = command.q, command.v
        moved = witness.look(q, v, centre[None], np.array([0.05]))
        tally.judge(*moved, V_OK)
    assert most <= 1.0 + 1e-3
    assert tally.violations == 0


def test_a_tracking_error_makes_links_thicker():
    """By what it can move them at most."""
    plain = SafetyFilter("obstacle_arm", PERIOD)
    errs = SafetyFilter(
        "obstacle_arm",
        PERIOD,
        SafetyParameters(braking_time=plain.parameters.T, tracking_error=0.002),
    )
    thin, thick = (f.among._world.value.links for f in (plain, errs))
    more = 0.002 * thin.reaches.reach.sum(axis=1)
    more = np.repeat(more, np.diff(thin.shapes))
    np.testing.assert_allclose(thick.radii - thin.radii, more, rtol=1e-12)
    np.testing.assert_allclose(thick.balls - thin.balls, more, rtol=1e-12)


# --- the system --------------------------------------------------------------------


def test_the_system_has_a_port_for_them(arm):
    """The same commands as the filter's; without speeds there is no port."""
    builder = DiagramBuilder()
    system = builder.AddSystem(SafetyFilterSystem(arm, obstacle_speeds=[1.0]))
    wanted = swing(arm, 30)
    rest = arm.model.rest_positions()
    sphere = [0.9, 0.0, 0.5, 0.2]
    for port, value in (
        (system.get_input_port_desired_position(), wanted),
        (system.get_input_port_obstacles(), sphere),
    ):
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.Connect(source.get_output_port(), port)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.31)
    context = system.GetMyContextFromRoot(simulator.get_context())
    arm.reset(rest)
    for _ in range(16):
        command = arm(wanted, obstacles=Obstacles([sphere[:3]], sphere[3], 1.0))
    np.testing.assert_array_equal(
        system.get_output_port_position_command().Eval(context), command.q
    )
    assert system.report(context).obstacle_clearance == (
        command.report.obstacle_clearance
    )
    with pytest.raises(InputError, match="obstacle_speeds"):
        SafetyFilterSystem(arm).get_input_port_obstacles()


# --- what is refused ---------------------------------------------------------------


@pytest.mark.parametrize(
    "given, match",
    [
        (([[0.0, 1.0, 2.0]], [0.1, 0.2], 1.0), "radii"),
        (([[0.0, 1.0, 2.0]] * 2, 0.1, 1.0, ["a", "a"]), "2 different names"),
        (("nonsense", 0.1, 1.0), "centres"),
    ],
)
def test_obstacles_that_are_none_are_refused(given, match):
    with pytest.raises(InputError, match=match):
        Obstacles(*given)


def test_parameters_that_do_not_go_with_them_are_refused():
    for speed in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ScenarioError, match="contact_speed"):
            SafetyFilter("obstacle_arm", PERIOD, SafetyParameters(contact_speed=speed))


def test_a_person_keeps_to_its_speed(witness):
    """The adversary's own people."""
    rng = np.random.default_rng(3)
    one = Person(np.array([1.0, 0.0, 0.0]), 0.1, 1.5)
    rest = np.zeros(7)
    for _ in range(500):
        seen = witness.look(rest, rest, one.where[None], np.array([0.1]))
        before = one.where
        one.step(PERIOD, witness, seen, 0, rng)
        assert np.linalg.norm(one.where - before) <= 1.5 * PERIOD * (1 + 1e-12)
