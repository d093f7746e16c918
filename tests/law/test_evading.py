"""Links get out of the way of obstacles that move, and the filter has the last word.

Distances and speeds are those of Drake's poses (`judging.obstacle_judge`), gradients
finite differences of them.
"""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.adversary.robots import load_subject
from crar_drake import (
    ControlLaw,
    ControlModel,
    LookaheadParameters,
    Obstacles,
    SafetyFilter,
    SafetyParameters,
    Task,
    load_robot_description,
)
from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.law.moving_obstacles import evading_rows
from tests.people import Tally, hostile, run_at, witness_of

PERIOD, V_OK = 0.02, 0.05
SIZE = np.array([0.05])


def made(evade: bool, effort_limits: bool = False, **others) -> SafetyFilter:
    parameters = SafetyParameters(evade=evade, braking_time=0.06, **others)
    return SafetyFilter("obstacle_arm", PERIOD, parameters, effort_limits=effort_limits)


@pytest.fixture(scope="module")
def evading() -> SafetyFilter:
    filter = made(True)
    filter.compile(obstacles=True)
    return filter


@pytest.fixture(scope="module")
def staying() -> SafetyFilter:
    return made(False)


@pytest.fixture(scope="module")
def witness(evading) -> ObstacleJudge:
    return witness_of(evading)


@pytest.fixture(scope="module")
def hand(evading, witness) -> np.ndarray:
    """(3,) where it is at rest."""
    rest = evading.model.rest_positions()
    witness.look(rest, 0 * rest, np.zeros((1, 3)), np.zeros(1))
    return witness.places()[evading.links.index("hand")]


def swing(filter: SafetyFilter, k: int) -> np.ndarray:
    rest = filter.model.rest_positions()
    return rest + 0.3 * np.sin(1.5 * k * PERIOD + np.arange(len(rest))) * min(k / 30, 1)


def passing(filter, witness, hand, wanted, steps=200, speed=0.3, given=None):
    """Somebody comes at the hand from 0.5 m away, through it and on: the smallest
    distance, a tally, and the last command."""
    filter.reset()
    q, nearest, tally = filter.model.rest_positions(), np.inf, Tally()
    way = np.array([0.0, 0.8, 0.6])
    for k in range(steps):
        at = [hand + (0.5 - speed * PERIOD * (k + s)) * way for s in (0.0, 0.5, 1.0)]
        people = given(k, at[0]) if given else Obstacles([at[0]], SIZE, speed, ["Ann"])
        command = filter(wanted(k), obstacles=people)
        for share, centre in ((0.5, at[1]), (1.0, at[2])):
            where = q + share * (command.q - q)
            seen = witness.look(where, command.v, centre[None], SIZE)
            nearest = min(nearest, seen[0].min())
            tally.judge(*seen, V_OK)
        q = command.q
    return nearest, tally, command


def test_a_robot_that_rests_gets_out_of_the_way_and_comes_back(
    evading, staying, witness, hand
):
    rest = evading.model.rest_positions()
    stays, tally, _ = passing(staying, witness, hand, lambda k: rest)
    assert stays < 0.0 and tally.violations == 0
    nearest, tally, command = passing(evading, witness, hand, lambda k: rest)
    assert nearest > 4e-3
    # Whoever is past is not fled from: the command is the wanted one again.
    assert command.report.how == "nominal"
    np.testing.assert_array_equal(command.q, rest)


def test_what_it_runs_into_is_named(evading, witness, hand):
    rest = evading.model.rest_positions()
    evading.reset()
    told = set()
    for k in range(60):
        at = hand + (0.4 - 0.3 * PERIOD * k) * np.array([0.0, 0.8, 0.6])
        report = evading(rest, obstacles=Obstacles([at], SIZE, 0.3, ["Ann"])).report
        told.add((report.how, report.why, report.obstacle and report.obstacle[0]))
        assert report.clear
    assert ("nominal", "", None) in told
    assert ("corrected", "obstacle", "Ann") in told


def test_it_goes_on_with_what_it_does_meanwhile(evading, staying, witness, hand):
    """A robot that swings is not touched either, and is not stopped for it."""
    ways = {}
    for name, filter in (("stays", staying), ("evades", evading)):
        moved = []

        def wanted(k, filter=filter, moved=moved):
            moved.append(np.abs(filter._memory.v).max())
            return swing(filter, k)

        nearest, tally, _ = passing(filter, witness, hand, wanted)
        assert tally.violations == 0
        ways[name] = nearest, np.sum(moved)
    assert ways["evades"][0] > 4e-3 > ways["stays"][0]
    assert ways["evades"][1] > ways["stays"][1]


@pytest.mark.parametrize(
    "given",
    [
        None,
        Obstacles([], [], []),
        Obstacles([[30.0, 0.0, 0.0]], 0.3, 1.0, ["far"]),
        Obstacles([[0.4, 0.5, 0.5]], 0.2, 0.0, ["stands"]),
    ],
)
def test_without_what_moves_nearby_nothing_changes_to_the_last_bit(
    evading, staying, given
):
    commands = []
    for filter in (evading, staying):
        filter.reset()
        commands.append([filter(swing(filter, k), obstacles=given) for k in range(60)])
    for ours, theirs in zip(*commands, strict=True):
        np.testing.assert_array_equal(ours.q, theirs.q)
        np.testing.assert_array_equal(ours.a, theirs.a)
        assert ours.report.how == theirs.report.how


def test_a_command_that_gets_out_of_the_way_itself_is_taken_as_it_is(evading, hand):
    """To the last bit: a policy that evades has nothing to fear of the filter."""
    rest = evading.model.rest_positions()
    evading.reset()
    evaded = [
        evading(
            rest,
            obstacles=Obstacles(
                [hand + (0.4 - 0.2 * PERIOD * k) * np.array([0.0, 1.0, 0.0])],
                *(SIZE, 0.2, ["Ann"]),
            ),
        )
        for k in range(90)
    ]
    assert sum(c.report.how != "nominal" for c in evaded) > 20
    # The same again, by somebody who is 3 cm behind where Ann was.
    evading.reset()
    for k, before in enumerate(evaded):
        at = hand + (0.43 - 0.2 * PERIOD * k) * np.array([0.0, 1.0, 0.0])
        people = Obstacles([at], SIZE, 0.2, ["Bob"])
        command = evading(before.q, obstacles=people)
        np.testing.assert_array_equal(command.q, before.q)


def test_the_rows_are_the_rates_of_distances(evading, witness):
    """g and what the obstacle adds, against differences of Drake's distances."""
    rng = np.random.default_rng(6)
    among = evading.among
    numbers, n = among._world.value.numbers, len(evading.joint_names)
    step, seen = 1e-6, 0
    for _ in range(30):
        q = evading.model.rest_positions() + rng.uniform(-0.4, 0.4, n)
        v = rng.normal(0.0, 0.5, n)
        witness.look(q, v, np.zeros((1, 3)), np.zeros(1))
        place = witness.places()[rng.integers(len(evading.links))]
        way = rng.normal(size=3)
        begin = place + rng.uniform(0.1, 0.2) * way / np.linalg.norm(way)
        velocity = rng.uniform(-0.5, 0.5, 3)  # slower than the stated speed
        people = Obstacles([begin], SIZE, 1.0, ["one"])
        regions = among.regions(None, people, q, v)
        was = replace(
            regions.seen,
            spheres=Obstacles([begin - PERIOD * velocity], SIZE, 1.0, ["one"]),
            velocity=np.full((1, 3), np.nan),
            age=np.full(1, PERIOD),
        )
        regions = among.regions(replace(regions, seen=was), people, q, v)
        np.testing.assert_allclose(regions.seen.velocity[0], velocity, atol=1e-9)
        moving = among.evaded(regions.seen)
        g, least, who = evading_rows(q, v, *moving, among._world)

        def distance(q, t, begin=begin, velocity=velocity):
            centre = begin + t * velocity
            return witness.look(q, 0 * q, centre[None], SIZE)[0][:, 0]

        d = distance(q, 0.0)
        comes = -(distance(q, step) - distance(q, -step)) / (2 * step)
        for row, (link, _) in enumerate(who):
            slope = [
                (distance(q + e, 0.0) - distance(q - e, 0.0))[link] / (2 * step)
                for e in step * np.eye(n)
            ]
            if np.abs(g[row] - slope).max() > 1e-5:
                continue  # where two shapes of a link are equally near
            seen += 1
            h = d[link] - among.kept_at - numbers.lead * max(comes[link], 0.0)
            wanted = comes[link] + min(-h / numbers.T, 1.0)
            assert least[row] == pytest.approx(wanted, abs=1e-4)
    assert seen > 30


def test_from_between_two_it_slips_out(evading, witness, hand):
    """And comes to rest beside them, as near as it is kept, without shaking."""
    rest = evading.model.rest_positions()
    evading.reset()
    nearest, moves = np.inf, []
    for k in range(200):
        far = max(0.45 - 0.2 * PERIOD * k, 0.02)
        sides = hand + np.array([[0.0, far, 0.0], [0.0, -far, 0.0]])
        command = evading(rest, obstacles=Obstacles(sides, 0.05, 0.2))
        seen = witness.look(command.q, command.v, sides, np.full(2, 0.05))
        nearest = min(nearest, seen[0].min())
        moves.append(np.abs(command.v).max())
    assert nearest > 4e-3
    assert max(moves) > 0.3 and max(moves[-50:]) < 0.01
    assert seen[0].min() == pytest.approx(evading.among.kept_at, abs=2e-3)


def test_limits_of_joints_speeds_and_motors_hold_meanwhile(witness, hand):
    filter = made(True, effort_limits=True, velocity_scale=0.4)
    model = filter.model
    plant, limits = model.plant, model.actuator_limits
    workspace = model.MakeWorkspace()
    fastest = 0.4 * plant.GetVelocityUpperLimits()
    rest = model.rest_positions()
    q, v, tally, most, evaded = rest, 0 * rest, Tally(), 0.0, 0
    for k in range(120):
        centre = hand + (0.5 - 0.6 * k * PERIOD) * np.array([0.0, 0.0, 1.0])
        command = filter(rest, obstacles=Obstacles([centre], SIZE, 0.6))
        evaded += command.report.obstacle is not None
        model.evaluate(workspace, q, v)
        torque = model.inverse_dynamics(workspace, command.a)
        most = max(most, np.abs(torque / limits).max())
        q, v = command.q, command.v
        assert (q >= plant.GetPositionLowerLimits() - 1e-9).all()
        assert (q <= plant.GetPositionUpperLimits() + 1e-9).all()
        assert (np.abs(v) <= fastest + 1e-9).all()
        moved = witness.look(q, v, centre[None], SIZE)
        tally.judge(*moved, V_OK)
    assert evaded > 10 and most <= 1.0 + 1e-3 and tally.violations == 0


def test_a_velocity_is_seen_of_measurements_that_come_at_times(evading):
    """By the difference from the one before; a leap counts as the stated speed."""
    among, q = evading.among, evading.model.rest_positions()

    def at(x, radius=0.1):
        return Obstacles([[x, 2.0, 1.0]], radius, 1.0, ["Ann"])

    regions = among.regions(None, at(3.0), q, 0 * q)
    assert np.isnan(regions.seen.velocity).all()
    for k in range(1, 6):
        regions = among.regions(regions.later(PERIOD), at(3.0 + 0.01 * k), q, 0 * q)
    np.testing.assert_allclose(regions.seen.velocity[0, 0], 0.01 / PERIOD)
    # Nothing is measured: who tells of her says how much she may have moved.
    for k in range(1, 4):
        grown = at(3.05, 0.1 + k * PERIOD)
        regions = among.regions(regions.later(PERIOD), grown, q, 0 * q)
    np.testing.assert_allclose(regions.seen.age, 3 * PERIOD)
    assert among.evaded(regions.seen)[0].centre[0, 0] == pytest.approx(3.08)
    regions = among.regions(regions.later(PERIOD), at(3.05 + 0.04), q, 0 * q)
    np.testing.assert_allclose(regions.seen.velocity[0, 0], 0.01 / PERIOD)
    for k in range(30):
        regions = among.regions(regions.later(PERIOD), at(9.0 + k), q, 0 * q)
    np.testing.assert_allclose(regions.seen.velocity[0, 0], 1.0, rtol=1e-3)


def test_any_number_of_them_is_of_the_type_that_was_compiled(evading):
    """Else the first step among several would compile for minutes."""
    among, q = evading.among, evading.model.rest_positions()
    for n in (1, 3, 10):
        many = Obstacles(np.arange(3.0 * n).reshape(n, 3), 0.1, 1.0)
        regions = among.regions(None, many, q, 0 * q).later(PERIOD)
        spheres, velocity = among.evaded(among.regions(regions, many, q, 0 * q).seen)
        for array in (*spheres, velocity):
            assert array.flags.c_contiguous and array.dtype == float


def test_measurements_that_are_late_and_lost_evade_as_well(evading, witness, hand):
    rest = evading.model.rest_positions()

    def at_times(k, centre):
        return Obstacles([centre], SIZE, 0.3, ["Ann"]) if k % 3 == 0 else None

    nearest, tally, _ = passing(evading, witness, hand, lambda k: rest, given=at_times)
    assert nearest > 0.0 and tally.violations == 0


@pytest.mark.parametrize("robot, period", [("obstacle_arm", 0.02), ("jaw", 0.005)])
def test_whoever_runs_at_what_evades_touches_nothing_that_is_fast(robot, period):
    """Policies that jump, swing and are lost; measurements that come always or late."""
    subject = load_subject(robot)
    model, judge = subject.model(subject.task_set(0)), subject.filter(period)[1]
    filter, tally = SafetyFilter(model, period, SafetyParameters(evade=True)), Tally()
    for seed, policy in enumerate(("jumps", "sines", "lost")):
        wanted = hostile(policy, filter, judge)
        run_at(filter, wanted, round(2.0 / period), seed, tally)
    assert tally.changed > 50
    assert tally.violations == 0


def test_the_law_of_tasks_evades_as_well():
    """A wrist that is to stay is not touched, with `evade`; else it is."""
    description = load_robot_description("upper_body")
    tasks = [Task("left_wrist", "position"), Task("right_wrist", "position")]
    model = ControlModel.FromDescription(description, tasks, time_step=0.01)
    rest = model.rest_positions()
    desired, prescribed = model.tasks_at(rest), model.prescribed_at(rest)
    nearest = {}
    for evade in (False, True):
        gains = LookaheadParameters(period=0.01, evade=evade).among_obstacles()
        law = ControlLaw(model, gains)
        witness = ObstacleJudge(model.plant, model.scene_graph, law.among.links)
        q, v = rest, np.zeros(14)
        nearest[evade], evaded = np.inf, 0
        for k in range(150):
            centre = desired[:3] + [max(0.5 - 0.003 * k, 0.08), 0.0, 0.0]
            solution = law.step(
                q, v, desired, prescribed,
                obstacles=Obstacles([centre], 0.05, 0.3, ["Ann"]),
            )  # fmt: skip
            q, v = np.split(solution.position_command, [len(q)])
            evaded += solution.obstacle is not None
            d, speed = witness.look(q, v, centre[None], SIZE)
            nearest[evade] = min(nearest[evade], d.min())
            assert not ((d <= 0.0) & (speed > V_OK)).any()
    assert nearest[True] > nearest[False] and nearest[True] > 0.0 and evaded > 5
