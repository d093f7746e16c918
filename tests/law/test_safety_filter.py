"""The filter of joint commands; most is in `tests/acceptance/test_joint_filter.py`."""

import numpy as np
import pytest
from floating_robots import make_floater, write_floater
from grounded_robots import add_ground
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from small_robots import CAPSULE, chain_urdf, make_model

from crar_drake import (
    ControlModel,
    CrarError,
    LookaheadParameters,
    SafetyFilter,
    SafetyParameters,
)
from crar_drake.errors import ModelError, ScenarioError
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


def test_a_speed_limit_of_the_user_is_kept_and_named(arm):
    rest = arm.model.rest_positions()
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


def test_the_period_stays(arm):
    """All of the law is of it."""
    with pytest.raises(AttributeError, match="period"):
        arm.period = 0.05


@pytest.mark.parametrize(
    "arguments, error, word",
    [
        ({"period": 0.2, "braking_time": 0.1}, ScenarioError, "filter.period: 0.2 s"),
        ({"margin": 1e-3}, ScenarioError, "filter.margin"),
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


def test_the_use_of_motors_is_told_by_drakes_own_dynamics():
    """It is no less than that of the command, of one that does not just brake."""
    filter = SafetyFilter("obstacle_arm", 0.005, effort_limits=True)
    model, rng, why = filter.model, np.random.default_rng(0), set()
    workspace, wanted = model.MakeWorkspace(), model.rest_positions()
    q, v = wanted, np.zeros(7)
    for k in range(400):
        if k % 80 == 40:
            wanted = model.rest_positions() + rng.uniform(-1.0, 1.0, 7)
        command = filter(wanted)
        model.evaluate(workspace, q, v)
        torque = model.inverse_dynamics(workspace, command.a)
        use = command.report.motor_use
        share = np.abs(torque / model.actuator_limits).max()
        assert np.isnan(use) or share - 1e-9 <= use <= 1.0
        why.add((command.report.why, command.report.joint is not None))
        q, v = command.q, command.v
    assert ("motor", True) in why


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
