"""The filter of joint commands: what is safe comes back as it was, the rest safe."""

import numpy as np
import pytest
from floating_robots import make_floater, write_floater
from grounded_robots import add_ground
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from small_robots import CAPSULE, chain_urdf, make_model

from crar_drake import (
    ControlModel,
    CrarError,
    LookaheadParameters,
    SafetyFilter,
    SafetyParameters,
)
from crar_drake.errors import InputError, ModelError, ScenarioError
from crar_drake.judging.referee import Referee
from crar_drake.law.path_balls import near_segment
from crar_drake.robot.description import (
    GROUND,
    RobotDescription,
    load_robot_description,
)

PERIOD = 0.02
FLOOR = 4e-3


@pytest.fixture(scope="module")
def arm() -> SafetyFilter:
    """The arm beside a post; tests begin it anew."""
    return SafetyFilter("obstacle_arm", PERIOD)


def smooth(filter: SafetyFilter, steps: int, amplitude: float) -> np.ndarray:
    """(K, n) positions that begin and end at rest in the rest posture."""
    t = np.linspace(0.0, 1.0, steps)
    share = np.sin(np.pi * t) ** 2 * np.sin(5.0 * t)
    along = np.random.default_rng(3).uniform(-1.0, 1.0, len(filter.joint_names))
    return filter.model.rest_positions() + amplitude * share[:, None] * along


def judge(filter: SafetyFilter, q: np.ndarray, v: np.ndarray) -> None:
    """By the referee's distances and limits: commands, ways between, braking paths."""
    model, T = filter.model, filter.parameters.T
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    ways = [q]
    for share in (0.25, 0.5, 0.75, 1.0):
        ways += [q + share * T * v, q[:-1] + share * np.diff(q, axis=0)]
    ways = np.concatenate(ways)
    assert referee.violations(np.array(ways)).smallest_distance > FLOOR - 1e-8
    assert referee.violations(ways).num_violated == 0
    assert (np.abs(v) <= model.velocity_limits + 1e-9).all()


def jumps(
    filter: SafetyFilter, seed: int, steps: int, hold: int, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """(K, n) positions and velocities of commands; what is wanted jumps at times."""
    rng, commands = np.random.default_rng(seed), []
    for k in range(steps):
        if k % hold == 0:
            wanted = rng.uniform(-size, size, len(filter.joint_names))
        commands.append(filter(wanted))
    return np.array([c.q for c in commands]), np.array([c.v for c in commands])


# --- what does nothing wrong ------------------------------------------------------


def test_a_safe_command_comes_back_to_the_last_bit(arm):
    arm.reset()
    wanted = smooth(arm, 200, 0.4)
    for q, before in zip(wanted[1:], wanted[:-1], strict=True):
        command = arm(q)
        np.testing.assert_array_equal(command.q, q)
        np.testing.assert_array_equal(command.v, (q - before) / PERIOD)
        assert command.report.how == "nominal" and command.report.why == ""
        assert command.report.clear and command.report.clearance >= FLOOR
        assert not command.report.braking


def test_safe_velocities_and_accelerations_come_back(arm):
    v = np.gradient(smooth(arm, 200, 0.3), PERIOD, axis=0)
    v[0] = 0.0
    arm.reset()
    for wanted in v:
        command = arm(v=wanted)
        np.testing.assert_array_equal(command.v, wanted)
    arm.reset()
    q = arm.model.rest_positions()
    for k, wanted in enumerate(np.diff(v, axis=0) / PERIOD):
        command = arm(a=wanted)
        np.testing.assert_allclose(command.a, wanted, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(command.v, v[k + 1], rtol=0.0, atol=1e-10)
        q = q + PERIOD * v[k + 1]
        np.testing.assert_allclose(command.q, q, rtol=0.0, atol=1e-10)


def test_joints_exactly_at_a_limit_are_left_there(arm):
    q = arm.model.rest_positions()
    i = int(np.argmin(np.where(np.isfinite(arm.model.upper), arm.model.upper, np.inf)))
    q[i] = arm.model.upper[i]
    arm.reset(q)
    for _ in range(5):
        command = arm(q)
        assert command.report.how == "nominal"
        np.testing.assert_array_equal(command.q, q)


# --- what does ---------------------------------------------------------------------


@pytest.mark.parametrize("period", [0.001, 0.005, 0.02])
@pytest.mark.parametrize("robot", ["obstacle_arm", "upper_body"])
def test_whatever_is_wanted_nothing_is_violated(robot, period):
    """Jumps, noise, sines, NaN; positions, velocities and accelerations."""
    filter = SafetyFilter(robot, period)
    rng = np.random.default_rng(int(1e3 * period))
    n, rest = len(filter.joint_names), filter.model.rest_positions()
    wanted, q, v, how = rest, [], [], set()
    for k in range(300):
        kind = k // 60 % 5
        if kind == 0 and k % 15 == 0:
            wanted = rest + rng.uniform(-2.0, 2.0, n)
        elif kind == 1:
            wanted = wanted + rng.normal(0.0, 0.05, n)
        elif kind == 2:
            wanted = rest + 1.5 * np.sin(k * period * rng.uniform(1.0, 20.0, n))
        given = {"q": wanted}
        if kind == 3:
            given = {"v": rng.normal(0.0, 5.0, n)}
        elif kind == 4:
            given = {"a": rng.normal(0.0, 300.0, n)}
        if k % 37 == 5:
            given = {"q": np.where(rng.random(n) < 0.3, np.nan, wanted)}
        command = filter(**given)
        assert command.report.clear
        how.add(command.report.how)
        if command.report.how == "nominal" and "q" in given:
            np.testing.assert_array_equal(command.q, wanted)
        q.append(command.q)
        v.append(command.v)
    assert {"corrected", "braking"} <= how
    judge(filter, np.array(q), np.array(v))
    steps = np.diff(np.array(q), axis=0)
    np.testing.assert_allclose(steps, period * np.array(v)[1:], atol=1e-12)


def test_an_arm_that_is_sent_into_the_post_stops_before_it_and_says_so(arm):
    """And goes on when it may; the other joints are not held back meanwhile."""
    arm.reset()
    model = arm.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    rest = model.rest_positions()
    way = np.array([1.5, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    shares = np.linspace(0.0, 1.0, 101)
    depths = [referee.distances(rest + share * way).min() for share in shares]
    into = rest + shares[np.argmin(depths)] * way
    assert min(depths) < -0.01  # where it is sent, the arm is within the post
    pairs = set()
    for k in range(150):
        wanted = rest + min(1.0, k / 75) * (into - rest)
        wanted[6] = rest[6] + 0.3 * np.sin(0.1 * k)
        command = arm(wanted)
        # What the pair does not need is as wanted, but for rounding.
        assert abs(command.q[6] - wanted[6]) < 1e-9
        if command.report.why == "pair":
            pairs.add(command.report.pair)
    assert pairs and all(pair in model.pairs.names for pair in pairs)
    assert 4e-3 < referee.distances(command.q).min() < 8e-3
    for k in range(150):
        command = arm(rest + max(0.0, 1.0 - k / 75) * (into - rest))
    assert command.report.how == "nominal"
    np.testing.assert_array_equal(command.q, rest)


def test_it_says_which_joints_limit_or_speed_a_command_passes(arm):
    model, rest = arm.model, arm.model.rest_positions()
    i = 6
    beyond = rest.copy()
    for name, limit in (("upper", model.upper[i]), ("lower", model.lower[i])):
        arm.reset()
        for k in range(400):
            beyond[i] = rest[i] + min(1.0, k / 300) * 1.2 * (limit - rest[i])
            command = arm(beyond)
            if command.report.how != "nominal":
                break
        assert (command.report.why, command.report.joint) == (
            "joint limit",
            arm.joint_names[i],
        ), name
        beyond[i] = 1.1 * limit
        for _ in range(200):
            command = arm(beyond)
        assert abs(command.q[i] - limit) < 1e-6
    limits = SafetyParameters(velocity_limits={"joint7": 0.5})
    slow = SafetyFilter("obstacle_arm", PERIOD, limits)
    for k in range(1, 60):
        wanted = rest.copy()
        wanted[6] += 0.01 * min(k, 20) ** 2 / 20
        command = slow(wanted)
        assert abs(command.v[6]) <= 0.5 + 1e-12
        if command.report.why == "joint speed":
            assert command.report.joint == "joint7"
            break
    else:
        pytest.fail("0.95 rad/s were never too fast")


def test_after_it_was_held_back_it_returns_without_a_leap():
    """The acceleration is the nominal speed limit's at most; then all is exact."""
    period, limit = 0.005, 1.0
    limits = SafetyParameters(velocity_limits={"joint1": limit})
    filter = SafetyFilter("obstacle_arm", period, limits)
    rest, T = filter.model.rest_positions(), filter.parameters.T
    wanted, fastest = rest.copy(), 16.0
    for k in range(600):
        # Twice as fast as it may for 0.2 s, and then slowly.
        speed = 2.0 * np.sin(np.pi * k / 80) if k < 80 else 0.1 * np.sin(k / 50)
        wanted[0] += period * speed
        command = filter(wanted)
        if command.report.how != "nominal":
            assert np.abs(command.a).max() <= (fastest + limit) / T + 1e-9
        assert abs(command.v[0]) <= limit + 1e-12
    assert command.report.how == "nominal"
    np.testing.assert_array_equal(command.q, wanted)


def test_no_number_brakes_and_is_told(arm):
    arm.reset()
    wanted = smooth(arm, 100, 0.5)
    for q in wanted[:30]:
        command = arm(q)
    T = arm.parameters.T
    for k in range(40):
        before = command
        bad = wanted[30].copy()
        bad[k % 7] = (np.nan, np.inf, -np.inf)[k % 3]
        command = arm(bad)
        assert command.report.how == "braking" and command.report.why == "no number"
        assert command.report.braking and command.report.clear
        np.testing.assert_allclose(command.v, (1.0 - PERIOD / T) * before.v, rtol=1e-12)
        np.testing.assert_allclose(command.q, before.q + PERIOD * command.v, rtol=1e-12)
    for _ in range(100):
        command = arm(wanted[30])
    np.testing.assert_array_equal(command.q, wanted[30])


@pytest.mark.parametrize("huge", [1e6, 1e200, 1e308])
def test_numbers_beyond_all_sense_do_no_harm(arm, huge):
    arm.reset()
    commands = []
    for k in range(30):
        value = np.full(7, huge * (-1.0) ** k)
        commands.append(arm(**{("q", "v", "a")[k % 3]: value}))
    judge(arm, *(np.array([getattr(c, x) for c in commands]) for x in "qv"))


# --- where it begins, and what is measured ----------------------------------------


def test_it_begins_where_the_robot_is(arm):
    q = arm.model.rest_positions() + 0.05
    v = np.full(7, 0.2)
    arm.reset()
    command = arm(q + PERIOD * v, measured=(q, v))
    np.testing.assert_array_equal(command.q, q + PERIOD * v)
    assert command.report.tracking_error == 0.0
    # From then on on its own command: a robot that lags changes nothing but the report.
    lagging = q.copy()
    lagging[2] -= 0.03
    again = arm(command.q + PERIOD * v, measured=(lagging, v))
    np.testing.assert_array_equal(again.q, command.q + PERIOD * v)
    assert again.report.tracking_error == pytest.approx(
        abs(lagging[2] - command.q[2]), abs=1e-12
    )
    assert again.report.tracking_joint == "joint3"
    assert np.isnan(arm(again.q).report.tracking_error)


def test_a_start_that_is_not_clear_gets_no_worse_and_comes_free():
    """Two links of a chain in one another, and a joint beyond its limit."""
    model = make_model(chain_urdf("zzz", extra=""), pairs=[["l0", "l2"]])
    filter = SafetyFilter(model, 0.005)
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    folds = (np.array([2.6, x, x]) for x in np.linspace(1.0, 2.4, 400))
    q = next(q for q in folds if referee.distances(q).min() < -0.005)
    filter.reset(q)
    deepest, away = referee.distances(q).min(), np.array([2.0, 1.2, 0.5])
    command = filter(q)
    assert not command.report.clear
    for k in range(600):
        command = filter(away if k > 100 else q)
        d = referee.distances(command.q).min()
        assert d > deepest - 1e-9 and command.q[0] <= 2.6 + 1e-9
        deepest = min(d, FLOOR)
    assert command.report.clear
    np.testing.assert_allclose(command.q, away, atol=1e-6)


def test_a_command_that_its_user_changes_changes_nothing_else(arm):
    arm.reset()
    wanted = smooth(arm, 50, 0.3)
    for q in wanted[1:]:
        given = q.copy()
        command = arm(given)
        np.testing.assert_array_equal(command.q, q)
        for mine in (command.q, command.v, command.a, given):
            mine[:] = 7.0


def test_steps_leave_nothing_behind_but_their_memory(arm):
    memory = arm.start()
    wanted = smooth(arm, 50, 2.0)
    memories = [memory]
    for q in wanted:
        memories.append(arm.solve(memories[-1], q))
    k = 25
    again = arm.solve(memories[k], wanted[k])
    for name in "qva":
        np.testing.assert_array_equal(
            getattr(again.command, name), getattr(memories[k + 1].command, name)
        )
    assert again.command.report == memories[k + 1].command.report or np.isnan(
        again.command.report.tracking_error
    )


# --- by name, and mistakes ----------------------------------------------------------


def test_joints_by_name(arm):
    arm.reset()
    rest = arm.model.rest_positions()
    command = arm({"joint2": rest[1] + 0.01})
    expected = rest.copy()
    expected[1] += 0.01
    np.testing.assert_array_equal(command.q, expected)
    assert command.by_name == dict(zip(arm.joint_names, expected, strict=True))
    # Those that are not named stay where they were wanted last.
    command = arm({"joint1": rest[0] + 0.01})
    expected[0] += 0.01
    np.testing.assert_array_equal(command.q, expected)
    assert arm(v={"joint1": 0.1}).v[1] == 0.0


@pytest.mark.parametrize(
    "given, words",
    [
        ({}, ["wanted positions q"]),
        ({"q": np.zeros(7), "a": np.zeros(7)}, ["accelerations a"]),
        ({"q": np.zeros(6)}, ["q has shape (6,)", "(7,)"]),
        ({"v": np.zeros((7, 1))}, ["v has shape (7, 1)"]),
        ({"q": "up"}, ["q is not a vector of numbers"]),
        ({"q": {"joint8": 0.0}}, ["'joint8'", "did you mean 'joint"]),
        ({"q": {"joint1": None}}, ["q", "joint1"]),
        ({"q": np.zeros(7), "measured": (np.zeros(7),)}, ["measured", "(q, v)"]),
        ({"q": np.zeros(7), "measured": (np.zeros(7), np.zeros(3))}, ["measured v"]),
    ],
)
def test_what_is_asked_for_wrongly_is_refused(arm, given, words):
    arm.reset()
    before = arm._memory
    with pytest.raises(InputError) as caught:
        arm(**given)
    for word in words:
        assert word in str(caught.value)
    assert arm._memory is before


def test_the_period_stays(arm):
    """All of the law is of it."""
    with pytest.raises(AttributeError, match="period"):
        arm.period = 0.05


def test_a_start_without_numbers_is_refused(arm):
    with pytest.raises(InputError, match="start's q has a NaN.*joint2"):
        arm.reset([0.0, np.nan, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    "arguments, error, word",
    [
        ({"robot": "obstacle_amr"}, ModelError, "obstacle_arm"),
        ({"period": 0.0}, ScenarioError, "period"),
        ({"period": float("nan")}, ScenarioError, "period"),
        ({"period": 0.2, "braking_time": 0.1}, ScenarioError, "filter.period: 0.2 s"),
        ({"margin": 1e-3}, ScenarioError, "filter.margin"),
        ({"tracking_error": 3.0}, ScenarioError, "filter.tracking_error: 3 of joint"),
        ({"velocity_limits": {"joint9": 1.0}}, ScenarioError, "joint9"),
        ({"velocity_scale": -1.0}, ScenarioError, "velocity_scale"),
        ({"robot": 7}, ModelError, "not as int"),
        ({"robot": RobotDescription()}, ModelError, "no model.*FromPlant"),
        ({"period": "0.02"}, ScenarioError, "filter.period: '0.02' is no number"),
        ({"period": np.float32(-1.0)}, ScenarioError, "filter.period"),
        ({"parameters": {}}, ScenarioError, "SafetyParameters, not dict"),
        ({"parameters": LookaheadParameters()}, ScenarioError, "SafetyParameters"),
        ({"velocity_scale": "1"}, ScenarioError, "filter.velocity_scale: '1'"),
        ({"velocity_limits": [1.0]}, ScenarioError, "filter.velocity_limits"),
        ({"velocity_limits": {"joint1": "1"}}, ScenarioError, "joint1: '1'"),
    ],
)
def test_a_filter_that_cannot_be_made_says_why(arguments, error, word):
    given = {"robot": "obstacle_arm"}
    for name, value in arguments.items():
        if name not in ("robot", "period", "parameters"):
            value, name = SafetyParameters(**{name: value}), "parameters"
        given[name] = value
    with pytest.raises(error, match=word) as caught:
        SafetyFilter(**given)
    assert isinstance(caught.value, CrarError)


# --- robots -------------------------------------------------------------------------


def test_a_base_that_floats_counts_as_fixed(tmp_path):
    """Its links are kept off one another wherever it is, and nothing off the ground."""
    write_floater(tmp_path, "prescribed", "[2.3, -1.5, 0.8]")
    filter = SafetyFilter(tmp_path, 0.005)
    assert filter.joint_names == tuple(filter.model.joint_names)
    assert len(filter.joint_names) == filter.model.plant.num_positions() == 6
    judge(filter, *jumps(filter, 0, 200, 20, 2.0))
    with pytest.raises(ScenarioError, match="effort_limits.*base.*floats"):
        SafetyFilter(tmp_path, 0.005, effort_limits=True)
    with pytest.raises(ModelError, match="floats"):
        SafetyFilter(make_floater())


def test_the_ground_is_kept_off():
    """Of a base that is fixed: a half space is near always."""
    description = RobotDescription(pairs=[["l1", GROUND], ["l2", GROUND]])
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    Parser(plant).AddModelsFromString(chain_urdf("yyz", extra=""), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    add_ground(plant, RigidTransform([0.0, 0.0, -0.3]))
    plant.Finalize()
    model = ControlModel.FromPlant(plant, scene_graph, description, [])
    filter = SafetyFilter(model, 0.01)
    q, v = jumps(filter, 2, 300, 30, 2.5)
    judge(filter, q, v)
    assert min(_distances(filter, x) for x in q) < 0.02  # it was near


def _distances(filter: SafetyFilter, q: np.ndarray) -> float:
    model = filter.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    return referee.distances(q).min()


def test_cylinders_and_ellipsoids_are_kept_apart_by_hulls_about_them():
    for shape in (
        '<cylinder radius="0.05" length="0.1"/>',
        '<drake:ellipsoid a="0.05" b="0.04" c="0.06"/>',
    ):
        urdf = chain_urdf("zzzz", shapes=(CAPSULE,), extra="").replace(
            f"<geometry>{CAPSULE}</geometry>", f"<geometry>{shape}</geometry>"
        )
        model = make_model(urdf, [], pairs=[["l0", "l2"], ["l1", "l3"]])
        filter = SafetyFilter(model, 0.01)
        nearest, seen = np.inf, set()
        folded = 2.4 * np.array([0.0, 1.0, 1.0, 1.0])
        for k in range(400):
            command = filter(folded * np.sin(0.01 * k))
            nearest = min(nearest, model.signed_distances(command.q).min())
            seen.add(command.report.pair)
        assert FLOOR - 1e-6 < nearest < 0.02 and len(seen) > 1


def test_prescribed_joints_are_joints_of_the_filter():
    description = load_robot_description("upper_body")
    assert description.prescribed_joints
    filter = SafetyFilter(description)
    assert set(description.prescribed_joints) <= set(filter.joint_names)
    of_model = SafetyFilter(ControlModel.FromDescription(description, []))
    assert of_model.joint_names == filter.joint_names


def test_efforts_stay_within_the_motors_by_drakes_own_dynamics():
    """Whatever the policy; and what they allow comes back as it was."""
    description = load_robot_description("obstacle_arm")
    model = ControlModel.FromDescription(description, [])
    wide = SafetyFilter(model, 0.005, effort_limits=True)
    limits = model.actuator_limits
    assert np.isfinite(limits).all()
    plant: MultibodyPlant = model.plant
    context = plant.CreateDefaultContext()
    B = np.linalg.inv(plant.MakeActuationMatrix())

    def torque(q, v, a):
        plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
        M = plant.CalcMassMatrix(context)
        bias = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        return B @ (M @ a + bias)

    rng = np.random.default_rng(0)
    rest = model.rest_positions()
    wanted, why, largest = rest, set(), 0.0
    q, v = rest, np.zeros(7)
    for k in range(400):
        if k % 80 == 40:
            wanted = rest + rng.uniform(-1.0, 1.0, 7)
        command = wide(wanted)
        share = np.abs(torque(q, v, command.a)) / limits
        largest = max(largest, share.max())
        use = command.report.motor_use  # of a command that does not just brake
        assert np.isnan(use) or share.max() - 1e-9 <= use <= 1.0
        why.add((command.report.why, command.report.joint is not None))
        q, v = command.q, command.v
    assert ("motor", True) in why and 0.8 < largest <= 1.0 + 1e-3
    slow = smooth(wide, 400, 0.2)
    wide.reset()
    for row in slow:
        np.testing.assert_array_equal(wide(row).q, row)
        assert wide._memory.command.report.how == "nominal"


# --- the equations -------------------------------------------------------------------


def test_the_pairs_left_out_of_a_way_keep_what_is_claimed(arm):
    """By the referee's distances at samples of the way."""
    filter = SafetyFilter("upper_body")
    model = filter.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    shapes = filter._robot.pairs.shapes.value
    rng = np.random.default_rng(5)
    lower, upper = np.maximum(model.lower, -3.0), np.minimum(model.upper, 3.0)
    left_out = in_parts = 0
    for _ in range(60):
        q = rng.uniform(lower, upper)
        x = rng.normal(size=len(q)) * rng.choice([0.02, 0.2, 1.0])
        rows, parts, low, _ = near_segment(q, x, 0.03, 20, shapes)
        assert low >= 0.03 and parts.any(axis=0).all()
        in_parts += len(parts) > 1
        for k, some in enumerate(parts):
            near = set(model.pairs.pair_of_shapes[rows[some]].tolist())
            others = [pair for pair in range(len(model.pairs)) if pair not in near]
            left_out += len(others) / len(parts)
            if others:
                ways = (q + u * x for u in np.linspace(k, k + 1, 21) / len(parts))
                least = min(referee.distances(at)[others].min() for at in ways)
                assert least >= low - 1e-9
    assert 60 * len(model.pairs) / 10 < left_out < 60 * len(model.pairs)
    assert in_parts > 5


# --- a robot that follows within a bound ------------------------------------------


@pytest.mark.parametrize("error", [0.0, 0.004])
def test_a_robot_that_errs_by_the_stated_bound_keeps_the_floor(error):
    """It errs in every joint by the same, against the gradient of the nearest pair; a
    filter that is not told of it lets it come nearer."""
    filter = SafetyFilter("upper_body", PERIOD, SafetyParameters(tracking_error=error))
    model, rng, worst = filter.model, np.random.default_rng(4), np.inf
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    lower, upper, n = model.lower, model.upper, len(filter.joint_names)
    for step in range(400):
        while step % 50 == 0:
            aim = rng.uniform(np.maximum(lower, -1.5), np.minimum(upper, 1.5))
            if referee.distances(aim).min() < -0.02:  # it cannot be had
                break
        q = filter(aim).q
        assert (q >= lower + error - 1e-9).all() and (q <= upper - error + 1e-9).all()
        if (distance := referee.distances(q).min()) < 0.05:
            moved = q + 1e-6 * np.eye(n)
            slopes = [referee.distances(x).min() - distance for x in moved]
            off = q - 0.004 * np.sign(slopes)
            worst = min(worst, referee.distances(off).min())
    if error:
        assert FLOOR - 1e-6 <= worst < 0.05
    else:
        assert worst < FLOOR


def test_a_robot_that_errs_by_more_is_braked_for():
    """What is said of commands then is not said of the robot, which may be anywhere."""
    bounds = SafetyParameters(tracking_error=0.01, tracking_errors={"joint3": 0.05})
    filter = SafetyFilter("obstacle_arm", PERIOD, bounds)
    rest = filter.model.rest_positions()
    still, wanted = np.zeros(len(rest)), rest + 0.5
    filter.reset(rest, np.full(len(rest), 0.1))
    command = filter(wanted, measured=(rest, still))
    for joint, off, why in (
        (0, 0.009, ""),
        (2, 0.049, ""),
        (0, 0.011, "tracking error"),
        (2, -0.051, "tracking error"),
        (5, np.nan, "tracking error"),
        (0, 0.0, ""),
    ):
        before, q = command, command.q.copy()
        q[joint] += off
        command = filter(wanted, measured=(q, still))
        report, name = command.report, filter.joint_names[joint]
        assert report.clear == (not why)
        assert (report.why, report.joint) == (why, name) or not why
        assert (report.how == "braking") == bool(why) == np.isnan(report.clearance)
        if why:
            slower = 1.0 - PERIOD / report.T
            np.testing.assert_allclose(command.v, slower * before.v)
            assert report.tracking_joint == name
    # Where no error is stated nothing is said of the robot, but it has to be somewhere.
    filter = SafetyFilter(filter.model, PERIOD)
    assert filter(rest, measured=(rest, still)).report.clear
    assert filter(rest, measured=(rest + 0.5, still)).report.clear
    report = filter(rest, measured=(rest * np.nan, still)).report
    assert (report.why, report.clear) == ("tracking error", False)
