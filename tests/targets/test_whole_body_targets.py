"""A performer's whole body on a small robot: feet, root, limits, derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from floating_robots import make_floater
from pydrake.multibody.tree import JacobianWrtVariable
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from small_walker import ANKLE_HEIGHT, HIP, SHANK, THIGH, walker

from crar_drake.errors import MotionError, ScenarioError
from crar_drake.motion import load_clip
from crar_drake.motion.conditioning import low_pass
from crar_drake.motion.held_feet import FootMotion
from crar_drake.motion.joint_centres import JOINT_CENTRES
from crar_drake.motion.leg_shape import TrunkShape
from crar_drake.motion.performers.asf_amc import as_performer
from crar_drake.motion.planted_feet import ContactThresholds, runs
from crar_drake.motion.report import inspect
from crar_drake.motion.retarget_legs import retarget_legs
from crar_drake.motion.travel import pinned_pelvis
from crar_drake.motion.turns import hip_turns
from crar_drake.references.ground_contact import foot_slip
from crar_drake.robot.description import find_frame
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task, experiment_tasks, position_tasks
from crar_drake.targets.ankle_limits import LegSolver, joints_between
from crar_drake.targets.leg_room import LegClearance
from crar_drake.targets.leg_shapes import body_shapes
from crar_drake.targets.motion import load_motion_targets, segment_lengths
from crar_drake.targets.start_pose import solve_start_pose
from crar_drake.targets.whole_body import retarget_whole_body

RATE = 100.0  # [Hz]
TASKS = [*experiment_tasks("whole-body"), Task(frame="head")]


@pytest.fixture(scope="module")
def description(tmp_path_factory):
    return walker(tmp_path_factory.mktemp("walker"))


def test_a_way_to_another_branch_ends_where_both_meet():
    """As from a wrist to a neck that is on a link beside the shoulders."""
    robot = make_floater()
    hand = robot.plant.GetBodyByName("left_hand")
    for end in ("body", "right_l0", "right_hand"):
        chain = joints_between(robot, hand, robot.plant.GetBodyByName(end))
        assert [joint.name() for joint in chain] == ["left_j2", "left_j1", "left_j0"]
    (joint,) = joints_between(robot, hand, robot.plant.GetBodyByName("left_l1"))
    assert joint.name() == "left_j2"


@pytest.fixture(scope="module")
def model(description) -> ControlModel:
    return ControlModel.FromDescription(description, TASKS)


@pytest.fixture(scope="module")
def performer():
    return as_performer(load_clip("dance"))


@pytest.fixture(scope="module")
def motion(model):
    return load_motion_targets("dance", model)


@pytest.fixture(scope="module")
def whole(model, performer):
    return retarget_whole_body(model, performer, segment_lengths(model), 6.0)


def test_shapes_are_read_off_the_robot(model):
    legs, trunk = body_shapes(model)
    left = legs["left"]
    np.testing.assert_allclose(left.hip, HIP, atol=1e-9)
    assert (left.thigh, left.shank) == (pytest.approx(THIGH), pytest.approx(SHANK))
    assert left.reach == pytest.approx(THIGH + SHANK, abs=2e-3)
    assert left.points[:, 2].min() == pytest.approx(-ANKLE_HEIGHT)
    np.testing.assert_allclose(left.heel, [-0.06, 0.0, -ANKLE_HEIGHT], atol=1e-9)
    np.testing.assert_allclose(left.ball, [0.12, 0.0, -ANKLE_HEIGHT], atol=1e-9)
    np.testing.assert_allclose(legs["right"].hip, HIP * np.array([1, -1, 1]), atol=1e-9)
    assert trunk.pelvis[:, 2].min() == pytest.approx(-0.08)
    assert len(trunk.upper) and trunk.neck[2] > 0.99


def test_feet_stand_on_the_floor_and_are_in_reach(model, whole):
    for side, foot in whole.legs.feet.items():
        leg = whole.shapes[side]
        R = Rotation.from_quat(foot.turns).as_matrix()
        p = foot.positions[:, None] + np.einsum("tij,vj->tvi", R, leg.points)
        assert p[..., 2].min() > -1e-9
        contacts = runs(foot.planted)
        assert contacts
        np.testing.assert_allclose(p[foot.planted][..., 2].min(axis=1), 0.0, atol=1e-9)
        turns = Rotation.from_quat(whole.legs.root_turns)
        hip = whole.legs.root_positions + turns.apply(leg.hip)
        distance = np.linalg.norm(foot.positions - hip, axis=1)
        assert distance.max() < THIGH + SHANK
        # Two lengths and both ends: the knee is where they meet.
        knee = whole.legs.knees[side]
        np.testing.assert_allclose(np.linalg.norm(knee - hip, axis=1), THIGH, atol=1e-6)
        np.testing.assert_allclose(
            np.linalg.norm(knee - foot.positions, axis=1), SHANK, atol=2e-3
        )


def test_a_pelvis_that_is_pinned_is_refused(model, performer, whole):
    """As of a pose estimator: all points relative to it."""
    p = performer.positions
    still = {joint: q - p["pelvis"] + p["pelvis"][0] for joint, q in p.items()}
    pinned = replace(performer, positions=still)
    with pytest.raises(MotionError, match="the pelvis never moves, although a foot"):
        retarget_whole_body(model, pinned, segment_lengths(model), 6.0)
    (doubt,) = inspect(pinned).doubts
    assert "relative to it, as pose estimators give them" in doubt
    assert not any("pelvis never" in doubt for doubt in inspect(performer).doubts)
    # Somebody who stands does not move it either.
    standing = {joint: np.repeat(q[:1], len(q), axis=0) for joint, q in p.items()}
    assert not pinned_pelvis(replace(performer, positions=standing))


def test_the_hips_path_is_scaled_by_the_legs(performer, whole):
    p = performer.positions
    ratio = (THIGH + SHANK) / np.mean(
        [
            np.linalg.norm(p[f"{s}_hip"] - p[f"{s}_knee"], axis=1)
            + np.linalg.norm(p[f"{s}_knee"] - p[f"{s}_ankle"], axis=1)
            for s in ("left", "right")
        ]
    )
    turns = Rotation.from_quat(whole.legs.root_turns)
    found = whole.legs.root_positions + turns.apply([HIP[0], 0.0, HIP[2]])
    middle = 0.5 * (p["left_hip"] + p["right_hip"])
    expected = ratio * (middle - middle[0])[:, :2]
    # A low-pass of 6 Hz lies between.
    np.testing.assert_allclose((found - found[0])[:, :2], expected, atol=0.02)


def test_the_root_leans_where_the_trunk_cannot(model, performer, whole):
    """The waist of this robot pitches, but does not roll."""
    _, trunk = body_shapes(model)
    # The waist is 5 cm below the joint, the neck 40 cm above, which it pitches by 2.
    most = np.arctan2(0.4 * np.sin(1.5), 0.05 + 0.4 * np.cos(1.5))
    np.testing.assert_allclose(trunk.pitch, [-most, most], atol=1e-9)
    np.testing.assert_allclose(trunk.roll, 0.0, atol=1e-9)
    way = performer.positions["neck"] - performer.positions["pelvis"]
    way = low_pass(way / np.linalg.norm(way, axis=1, keepdims=True), 120.0, 6.0)
    aside = []
    for turns in (whole.legs.root_turns, hip_turns(performer, 6.0)):
        aside.append(np.abs(Rotation.from_quat(turns).inv().apply(way)[:, 1]).max())
    assert aside[0] < 0.01 < 0.1 < aside[1]
    # It leans no farther than that: the trunk can pitch, so it is not pitched.
    lean = (
        Rotation.from_quat(hip_turns(performer, 6.0)).inv()
        * Rotation.from_quat(whole.legs.root_turns)
    ).as_rotvec()
    assert np.abs(lean[:, 1]).max() < 0.1 * np.abs(lean[:, 0]).max()
    free = replace(trunk, pitch=(-np.inf, np.inf), roll=(-np.inf, np.inf))
    as_hips = hip_turns(performer, 6.0, free)
    np.testing.assert_allclose(as_hips, hip_turns(performer, 6.0), atol=1e-12)


def test_ways_have_their_derivatives(model, motion):
    source = motion.MakeTaskSource()
    context = source.CreateDefaultContext()

    def at(time):
        context.SetTime(time)
        return model.layout.unpack(source.get_output_port().Eval(context))

    h = 1e-4
    for time in np.linspace(0.3, motion.duration - 0.3, 12):
        before, here, after = at(time - h), at(time), at(time + h)
        linear = np.concatenate(model.layout.linear_rows).ravel()
        v = ((after.p - before.p) / (2 * h)).ravel()
        np.testing.assert_allclose(here.v[linear], v, atol=2e-3)
        a = (after.v - before.v) / (2 * h)
        np.testing.assert_allclose(here.a, a, atol=0.3)
        turn = Rotation.from_matrix(after.R) * Rotation.from_matrix(before.R).inv()
        angular = np.concatenate(model.layout.angular_rows).ravel()
        omega = turn.as_rotvec().ravel() / (2 * h)
        np.testing.assert_allclose(here.v[angular], omega, atol=2e-3)


def test_held_accelerations_lead_to_the_velocities_of_the_way(description, motion):
    h = 0.005
    model = ControlModel.FromDescription(description, TASKS, time_step=0.0)
    held = load_motion_targets("dance", model, hold=h)
    layout = model.layout
    points = [
        layout.rows_of(task)
        for task, name in enumerate(layout.names)
        if name in JOINT_CENTRES
    ]
    assert points
    for time in np.linspace(0.3, motion.duration - 0.3, 8):
        now, then = motion.tasks_at(time), motion.tasks_at(time + h)
        of_held = layout.unpack(held.tasks_at(time))
        now, then = layout.unpack(now), layout.unpack(then)
        np.testing.assert_allclose(of_held.p, now.p, rtol=0.0, atol=1e-15)  # rounding
        for rows in points:
            np.testing.assert_array_equal(of_held.v[rows], now.v[rows])
            reached = now.v[rows] + h * of_held.a[rows]
            np.testing.assert_allclose(reached, then.v[rows], atol=1e-12)


@pytest.mark.parametrize("step", [0.0, 1e-3])
def test_legs_that_do_as_they_are_told_have_their_feet_where_they_should_be(
    description, performer, step
):
    """A period at a time from where legs should be, accelerations held: by a discrete
    plant, which moves by the velocity at a step's end, and by a continuous one."""
    h = 0.005
    model = ControlModel.FromDescription(description, TASKS, time_step=step)
    held = load_motion_targets("dance", model, hold=h)
    source, plant = held.MakePrescribedSource(), model.plant
    port, clock = source.get_output_port(), source.CreateDefaultContext()
    whole = retarget_whole_body(model, performer, segment_lengths(model), 6.0)
    places = [joint.position_start() for joint in whole.joints]
    legs = [joint.velocity_start() for joint in whole.joints]
    way = CubicSpline(whole.upper.time, whole.positions)
    context = model.MakeWorkspace().plant_context
    names = ["left_foot", "right_foot"]
    linear = list(model.layout.linear_tasks)
    tasks_of_feet = [model.layout.names.index(name) for name in names]
    rows = [model.layout.rows_of(task) for task in tasks_of_feet]
    frames = [find_frame(plant, description.task_frames[name]) for name in names]

    def told(time):
        tasks = model.layout.unpack(held.tasks_at(time))
        return *(np.concatenate([x[r] for r in rows]) for x in (tasks.v, tasks.a)), [
            tasks.p[linear.index(task)] for task in tasks_of_feet
        ]

    q, v, v_dot = model.rest_positions(), *np.zeros((2, plant.num_velocities()))
    steps = round(h / step) if step else 20
    moved_by = 1.0 if step else 0.5  # of what a velocity changes by in a step
    slow, away = [], []
    for time in np.linspace(0.3, held.duration - 0.3, 40):
        clock.SetTime(time)
        root = port.Eval(clock)[-19:]
        q[model.root_positions], v[model.unactuated] = root[:7], root[7:13]
        v_dot[model.unactuated] = root[13:]
        q[places], v[legs] = way(time), way(time - 0.5 * step, 1)
        v_dot[legs] = 0.0
        plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
        world = plant.world_frame()
        of = [(JacobianWrtVariable.kV, f, np.zeros(3), world, world) for f in frames]
        J = np.vstack([plant.CalcJacobianSpatialVelocity(context, *f) for f in of])
        bias = [plant.CalcBiasSpatialAcceleration(context, *f).get_coeffs() for f in of]
        left = told(time)[1] - np.concatenate(bias) - J @ v_dot
        v_dot[legs] = np.linalg.solve(J[:, legs], left)
        for _ in range(steps):
            by = v + moved_by * h / steps * v_dot
            v += h / steps * v_dot
            plant.SetPositions(context, q)
            q += h / steps * plant.MapVelocityToQDot(context, by)
        plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
        V = [frame.CalcSpatialVelocityInWorld(context).get_coeffs() for frame in frames]
        p = [frame.CalcPoseInWorld(context).translation() for frame in frames]
        v_told, _, p_told = told(time + h)
        slow.append(np.concatenate(V) - v_told)
        away.append(np.ravel(p) - np.ravel(p_told))
    slow, away = (np.linalg.norm(x, axis=1) for x in (slow, away))
    # Most of the time feet stand; where they do not, samples of ways are interpolated.
    # Told the means alone they are 7 times as fast, or 35 where the plant is discrete.
    assert np.median(slow) < 2e-5
    assert np.quantile(slow, 0.8) < 1.2e-3
    assert np.quantile(away, 0.8) < 2e-5


def test_the_robot_can_start_so(model, motion):
    q = solve_start_pose(model, motion.tasks_at(0.0), motion.prescribed_at(0.0))
    state = model.evaluate(
        model.MakeWorkspace(), q, np.zeros(model.plant.num_velocities())
    )
    wanted = model.layout.unpack(motion.tasks_at(0.0))
    feet = [model.layout.names.index(f"{side}_foot") for side in ("left", "right")]
    rows = [list(model.layout.linear_tasks).index(task) for task in feet]
    np.testing.assert_allclose(state.p[rows], wanted.p[rows], atol=5e-3)


def test_an_ankle_that_cannot_roll_turns_the_foot_as_far_as_it_can(description, model):
    """The foot is flat, 0.25 m to the side of a hip that is upright: the leg leans."""
    legs, _ = body_shapes(model)
    solver = LegSolver(model, "left", legs["left"], RATE)
    p_hip = np.array([0.0, 0.0, 0.6])
    root = p_hip - legs["left"].hip
    foot = FootMotion(
        np.tile([0.0, 0.28, ANKLE_HEIGHT], (3, 1)),
        np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)),
        *np.ones((2, 3), dtype=bool),
    )
    turns, knees = solver.turns(np.tile(root, (3, 1)), Rotation.identity(3), foot)
    lean = np.arctan2(0.28, 0.6 - ANKLE_HEIGHT)
    limit = 0.3 - 0.03
    np.testing.assert_allclose(
        turns[-1].as_rotvec(), [lean - limit, 0.0, 0.0], atol=6e-3
    )
    # Within the limits the foot is as it should be.
    near = replace(foot, positions=foot.positions - [0.0, 0.2, 0.0])
    turns, _ = solver.turns(np.tile(root, (3, 1)), Rotation.identity(3), near)
    assert np.abs(turns[-1].magnitude()) < 1e-4


def turning_foot(leg, axis: str, angles: np.ndarray) -> FootMotion:
    """In the air, under the hip, turned about an axis by so much [rad]."""
    count = len(angles)
    return FootMotion(
        np.tile(leg.hip - [0.0, 0.0, 0.9 * (THIGH + SHANK)], (count, 1)),
        Rotation.from_euler(axis, angles[:, None]).as_quat(),
        *np.zeros((2, count), dtype=bool),
    )


def test_ankles_come_to_their_limits_as_slowly_as_a_lookahead_lets_them(model):
    """A foot that is pitched at 4 rad/s to beyond what its ankle can."""
    legs, _ = body_shapes(model)
    solver = LegSolver(model, "left", legs["left"], RATE)
    pitch = np.clip(np.arange(60) * 4.0 / RATE, 0.0, 1.6)
    foot = turning_foot(legs["left"], "y", pitch)
    solver.turns(np.zeros((60, 3)), Rotation.identity(60), foot)
    ankle = solver.joints[:2]
    q = np.array(solver.positions)[:, : len(ankle)]
    moves = [joint.position_start() for joint in ankle]
    lower = model.plant.GetPositionLowerLimits()[moves]
    upper = model.plant.GetPositionUpperLimits()[moves]
    # Where braking over 40 ms, the scenarios' horizon, would end.
    rest = q[1:] + 0.04 * np.diff(q, axis=0) * RATE
    assert (rest > lower + 0.02).all()
    assert (rest < upper - 0.02).all()
    nearest = np.minimum(q - lower, upper - q).min(axis=0)
    assert nearest.min() < 0.031  # a joint was led to its limit
    assert np.abs(np.diff(q, axis=0)).max() * RATE > 3.0  # and fast


def test_a_foot_is_led_from_one_way_of_its_leg_to_another(model):
    """A foot that is asked to be pitched by 1.2 rad from one sample to the next."""
    legs, _ = body_shapes(model)
    solver = LegSolver(model, "left", legs["left"], RATE)
    pitch = np.where(np.arange(60) < 30, 0.6, -0.6)
    foot = turning_foot(legs["left"], "y", pitch)
    turns, knees = solver.turns(np.zeros((60, 3)), Rotation.identity(60), foot)
    away = (turns * Rotation.from_quat(foot.turns).inv()).magnitude()
    assert away[:20].max() < 1e-3 and away[45:].max() < 1e-3
    speeds = RATE * (turns[1:] * turns[:-1].inv()).as_rotvec()
    # A step of 1.2 rad in 0.1 s, with no curvature at its ends, would have 690 rad/s^2.
    assert RATE * np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() < 700.0
    ankles = np.array(solver.positions)[:, :2]
    assert np.abs(np.diff(ankles, axis=0)).max() * RATE < 0.9 * 20.0
    # What it says of the knee and of the joints is of the same leg.
    plant, context = model.plant, model.MakeWorkspace().plant_context
    shank = find_frame(plant, model.description.task_frames["left_knee"])
    q = model.rest_positions()
    q[model.root_positions] = [1.0, *np.zeros(6)]
    for found, knee in zip(solver.positions, knees, strict=True):
        q[[joint.position_start() for joint in solver.joints]] = found
        plant.SetPositions(context, q)
        p = shank.CalcPoseInWorld(context).translation()
        np.testing.assert_allclose(p, knee, atol=1e-9)


def test_a_hip_comes_to_its_limit_as_a_lookahead_lets_it(model):
    """A foot that is turned about the vertical at 5 rad/s beyond what its hip can."""
    legs, _ = body_shapes(model)
    solver = LegSolver(model, "left", legs["left"], RATE)
    yaw = np.clip(np.arange(80) * 5.0 / RATE, 0.0, 2.5)
    foot = turning_foot(legs["left"], "z", yaw)
    given = foot
    for _ in range(6):  # as rounds in `retarget_legs`
        turns, _ = solver.turns(np.zeros((80, 3)), Rotation.identity(80), given)
        given = replace(given, turns=turns.as_quat())
    (thigh,) = (k for k, j in enumerate(solver.joints) if j.name() == "left_thigh_j")
    q = np.array(solver.positions)[:, thigh]
    # Where braking over 40 ms, the scenarios' horizon, would end.
    rest = q + 0.04 * np.gradient(q) * RATE
    # Within a degree: led to its limit and stopped there, it would end 0.1 beyond.
    assert rest.max() < 2.0 + np.deg2rad(1.0)
    assert q.max() > 1.96  # it was led to its limit
    assert np.diff(q).max() * RATE > 4.9  # and fast
    away = (turns * Rotation.from_quat(foot.turns).inv()).magnitude()
    assert away[:25].max() < 1e-3


def test_a_joint_that_carries_both_legs_is_of_neither(tmp_path, performer):
    """Else it would have two positions at once, and no foot be where it is said."""
    low = ControlModel.FromDescription(walker(tmp_path, hips=True), TASKS)
    beginning = {joint: p[:120] for joint, p in performer.positions.items()}
    turns = {joint: R[:120] for joint, R in performer.orientations.items()}
    performer = replace(performer, positions=beginning, orientations=turns, hands={})
    found = retarget_whole_body(low, performer, segment_lengths(low), 6.0)
    assert "hips_j" not in {joint.name() for joint in found.joints}
    plant, context = low.plant, low.MakeWorkspace().plant_context
    q = low.rest_positions()
    joints = [joint.position_start() for joint in found.joints]
    for t in range(0, 120, 10):
        q[low.root_positions[:4]] = found.legs.root_turns[t, [3, 0, 1, 2]]
        q[low.root_positions[4:]] = found.legs.root_positions[t]
        q[joints] = found.positions[t]
        plant.SetPositions(context, q)
        for side, foot in found.legs.feet.items():
            frame = find_frame(plant, low.description.task_frames[f"{side}_foot"])
            p = frame.CalcPoseInWorld(context).translation()
            np.testing.assert_allclose(p, foot.positions[t], atol=1e-3)


def test_joints_at_their_limits_from_the_knee_up_part_no_legs(model):
    legs, _ = body_shapes(model)
    solver = LegSolver(model, "left", legs["left"], RATE)
    moves = [joint.position_start() for joint in solver.joints]
    at = model.plant.GetPositionUpperLimits()[moves]
    names = [joint.name() for joint in solver.joints]
    stopped = dict(zip(names, solver.stopped(at), strict=True))
    assert stopped == {
        name: "ankle" not in name and "foot" not in name for name in names
    }
    assert not solver.stopped(model.rest_positions()[moves]).any()


def test_a_hip_stays_on_one_side_of_its_singular_poses(model):
    """A foot that swings up beside the hip and around: the thigh goes along the first
    axis of the hip, where another solver comes out with two joints turned by pi."""
    legs, _ = body_shapes(model)
    solver = LegSolver(model, "left", legs["left"], RATE)
    a = np.linspace(0.0, 0.75 * np.pi, 60)
    way = np.column_stack([0.3 * np.sin(2.0 * a), np.sin(a), -np.cos(a)])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    foot = FootMotion(
        legs["left"].hip + 0.8 * (THIGH + SHANK) * way,
        np.tile([0.0, 0.0, 0.0, 1.0], (60, 1)),
        *np.zeros((2, 60), dtype=bool),
    )
    solver.turns(np.zeros((60, 3)), Rotation.identity(60), foot)
    plant, context = model.plant, model.MakeWorkspace().plant_context
    names = ("left_hip_pitch_j", "left_hip_roll_j", "left_thigh_j")
    hip = [plant.GetJointByName(name) for name in names]
    q = model.rest_positions()
    signs = []
    for found in solver.positions:
        q[[joint.position_start() for joint in solver.joints]] = found
        plant.SetPositions(context, q)
        first, middle, last = (
            joint.frame_on_parent().CalcPoseInWorld(context).rotation()
            @ joint.revolute_axis()
            for joint in hip
        )
        signs.append(middle @ np.cross(first, last))
    assert np.abs(signs).min() > np.sin(0.19)
    assert len(set(np.sign(signs))) == 1
    assert np.abs(signs).min() < np.sin(0.21)  # it was led there


def test_knees_are_lifted_off_the_floor(model, performer):
    """Knees half as high as the root, and 3 cm lower than they should be at worst."""
    legs, _ = body_shapes(model)
    legs = {side: replace(leg, knee=0.05) for side, leg in legs.items()}
    plain = retarget_legs(performer, legs, 6.0)
    down = 0.5 * plain.root_positions[:, 2].min() - 0.02

    def attainable(side, root_positions, root_turns, foot):
        knees = root_positions * [1.0, 1.0, 0.5] - [0.0, 0.0, down]
        return Rotation.from_quat(foot.turns), knees

    lifted = retarget_legs(performer, legs, 6.0, attainable)
    before = 0.5 * plain.root_positions[:, 2] - down
    assert before.min() == pytest.approx(0.02)
    # Half of what the root rises by arrives: four rounds leave a sixteenth.
    for knee in lifted.knees.values():
        assert 0.05 < knee[:, 2].min() < 0.06
    assert (lifted.root_positions[:, 2] >= plain.root_positions[:, 2] - 1e-9).all()


def test_a_trunk_is_lifted_off_the_floor(model, performer):
    legs, _ = body_shapes(model)
    plain = retarget_legs(performer, legs, 6.0)
    ball = np.array([[0.0, 0.0, -0.7]])
    trunk = TrunkShape(ball, np.zeros(3), np.zeros((0, 3)), np.array([0.0, 0.0, 1.0]))
    lifted = retarget_legs(performer, legs, 6.0, trunk=trunk)

    def lowest(motion):
        turns = Rotation.from_quat(motion.root_turns)
        return (motion.root_positions + turns.apply(ball[0]))[:, 2].min()

    assert lowest(plain) < 0.0 < lowest(lifted) < 0.02


def test_how_near_a_knee_brings_a_foot_to_its_hip(description, tmp_path):
    """By the law of cosines, a tenth of a radian before the knee's limit, 2.5 rad."""
    nearest = np.sqrt(THIGH**2 + SHANK**2 + 2.0 * THIGH * SHANK * np.cos(2.4))
    shapes, _ = body_shapes(ControlModel.FromDescription(description, TASKS))
    for leg in shapes.values():
        assert leg.shortest == pytest.approx(nearest, abs=1e-6)
    # A watched pair: a ball at the knee, which is as far from the foot at any bend, and
    # from the pelvis, to which the foot comes as it would without.
    thick = walker(tmp_path, knee=0.06)
    thick = replace(thick, pairs=[*thick.pairs, ["left_shank", "left_foot"]])
    shapes, _ = body_shapes(ControlModel.FromDescription(thick, TASKS))
    assert shapes["left"].shortest == pytest.approx(nearest, abs=1e-6)


def test_a_root_is_lifted_off_legs_that_cannot_be_bent_so(model, performer):
    legs, _ = body_shapes(model)

    def distances(motion):
        R = Rotation.from_quat(motion.root_turns)
        for side, foot in motion.feet.items():
            hip = motion.root_positions + R.apply(legs[side].hip)
            yield np.linalg.norm(hip - foot.positions, axis=1), foot.planted

    plain = retarget_legs(performer, legs, 6.0)
    nearest = min(d[planted].min() for d, planted in distances(plain))
    shortest = nearest + 0.02
    stiff = {side: replace(leg, shortest=shortest) for side, leg in legs.items()}
    lifted = retarget_legs(performer, stiff, 6.0)
    for d, planted in distances(lifted):
        assert d[planted].min() > shortest - 1e-6
        assert d.max() < legs["left"].reach
    rise = lifted.root_positions - plain.root_positions
    assert (rise[:, 2] > -1e-9).all() and rise[:, 2].max() < 0.04
    assert np.abs(rise[:, :2]).max() < 1e-9
    # Legs that can be bent so are left as they are.
    loose = {side: replace(leg, shortest=nearest - 0.01) for side, leg in legs.items()}
    same = retarget_legs(performer, loose, 6.0)
    np.testing.assert_array_equal(same.root_positions, plain.root_positions)


def test_what_is_refused(model, performer, description):
    no_toes = {k: v for k, v in performer.positions.items() if "toe" not in k}
    with pytest.raises(MotionError, match="no left_toe, right_toe, and so no feet"):
        toeless = replace(performer, positions=no_toes, orientations={})
        retarget_legs(toeless, body_shapes(model)[0], 6.0)
    frames = {k: v for k, v in description.task_frames.items() if k != "left_hip"}
    lacking = replace(description, task_frames=frames)
    tasks = position_tasks(["left_knee"])
    with pytest.raises(ScenarioError, match="needs the task_frames left_hip"):
        load_motion_targets("dance", ControlModel.FromDescription(lacking, tasks))
    fixed = replace(description, root="fixed")
    with pytest.raises(ScenarioError, match="import it with --whole-body"):
        load_motion_targets("dance", ControlModel.FromDescription(fixed, tasks))
    tasks = [Task(frame="left_knee", kind="orientation")]
    with pytest.raises(ScenarioError, match="no orientation of left_knee"):
        load_motion_targets("dance", ControlModel.FromDescription(description, tasks))
    frames = {k: v for k, v in description.task_frames.items() if k != "head"}
    headless = replace(description, task_frames=frames)
    headless = replace(headless, task_frames=frames | {"crown": "head"})
    tasks = position_tasks(["head"])
    with pytest.raises(ScenarioError, match="no task_frame head"):
        load_motion_targets("dance", ControlModel.FromDescription(headless, tasks))


def test_the_foot_of_the_robot_is_turned_from_its_rest(model, whole):
    """At rest the foot's axes are those of the world: the way has them so."""
    plant = model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, model.rest_positions())
    foot = find_frame(plant, model.description.task_frames["left_foot"])
    R = foot.CalcPoseInWorld(context).rotation().matrix()
    np.testing.assert_allclose(R, whole.shapes["left"].foot, atol=1e-9)
    way = whole.way("left_foot")
    time = 40 / whole.upper.frame_rate
    turned = Rotation.from_quat(whole.legs.feet["left"].turns[40]).as_matrix() @ R
    np.testing.assert_allclose(way.orientation(time)[0], turned, atol=1e-9)


def knees_apart(whole) -> np.ndarray:
    """(T,) distance of the knees' middles [m]."""
    left, right = (whole.legs.knees[side] for side in ("left", "right"))
    return np.linalg.norm(left - right, axis=1)


def worst_slip(whole, side: str) -> float:
    """Of a foot in one of its contacts [m]."""
    foot = whole.legs.feet[side]
    R = Rotation.from_quat(foot.turns).as_matrix()
    points = whole.shapes[side].points
    p = foot.positions[:, None] + np.einsum("tij,vj->tvi", R, points)
    touching = ContactThresholds(1e-3, 2e-3, np.inf, np.inf)
    return foot_slip(side, p, 0.0, whole.upper.frame_rate, touching).worst


def test_knees_that_would_meet_are_apart(tmp_path, performer, whole):
    """Of balls so thick that those of the dancer would be 1 cm in each other."""
    before = knees_apart(whole)
    radius = 0.5 * before.min() + 0.005
    thick = ControlModel.FromDescription(walker(tmp_path, knee=radius), TASKS)
    parted = retarget_whole_body(thick, performer, segment_lengths(thick), 6.0)
    assert (knees_apart(parted) - 2.0 * radius).min() > 0.005
    for side, foot in parted.legs.feet.items():
        # Feet stand as firmly as they did, as whoever judges motions finds.
        assert worst_slip(parted, side) < max(worst_slip(whole, side), 5e-4)
        # And they are where legs can have them: the shank is as long as it is.
        shank = np.linalg.norm(parted.legs.knees[side] - foot.positions, axis=1)
        np.testing.assert_allclose(shank, SHANK, atol=2e-3)
    # Where legs are far from each other nothing has changed.
    moved = np.linalg.norm(
        parted.legs.feet["left"].positions - whole.legs.feet["left"].positions, axis=1
    )
    assert moved.max() < 0.1


def test_what_parts_legs_is_how_their_distance_changes(tmp_path):
    """Of the knees' balls, against solutions for feet that are moved a little."""
    thick = ControlModel.FromDescription(walker(tmp_path, knee=0.088), TASKS)
    legs, _ = body_shapes(thick)
    solvers = {s: LegSolver(thick, s, leg, RATE) for s, leg in legs.items()}
    turns = Rotation.from_euler("z", np.full((2, 1), 0.6))

    def apart(moved: str, move: np.ndarray) -> float:
        knees = {}
        for side, leg in legs.items():
            down = leg.hip - [-0.05, 0.0, 0.8 * (THIGH + SHANK)]
            by = move if side == moved else np.zeros(3)
            foot = FootMotion(
                turns.apply(down) + [*by[:2], 0.0],
                (Rotation.from_euler("z", by[2]) * turns).as_quat(),
                *np.ones((2, 2), dtype=bool),
            )
            _, knees[side] = solvers[side].turns(np.zeros((2, 3)), turns, foot)
        return np.linalg.norm(knees["left"] - knees["right"], axis=1)[0] - 2 * 0.088

    still = apart("none", np.zeros(3))
    room = LegClearance(thick, solvers, RATE).room(turns)
    np.testing.assert_allclose(room.lacking, 0.012 - still, atol=1e-6)
    assert 0.0 < room.lacking[0] < 0.012
    for side in legs:
        found = []
        for step in 1e-3 * np.eye(3):
            found.append((apart(side, step) - apart(side, -step)) / 2e-3)
        np.testing.assert_allclose(room.effects[side][0], found, atol=0.03)
        assert np.abs(found).max() > 0.2


def test_a_foot_that_is_turned_by_its_leg_stands_where_its_leg_can_have_it(
    tmp_path, performer
):
    """Ankles that hardly roll: what turns a foot moves it, and that turns it again."""
    stiff = ControlModel.FromDescription(walker(tmp_path, ankle_roll=0.05), TASKS)
    beginning = {joint: p[:120] for joint, p in performer.positions.items()}
    turns = {joint: R[:120] for joint, R in performer.orientations.items()}
    performer = replace(performer, positions=beginning, orientations=turns, hands={})
    found = retarget_whole_body(stiff, performer, segment_lengths(stiff), 6.0)
    for side, foot in found.legs.feet.items():
        solver = LegSolver(stiff, side, found.shapes[side], performer.frame_rate)
        root_turns = Rotation.from_quat(found.legs.root_turns)
        turns, knees = solver.turns(found.legs.root_positions, root_turns, foot)
        away = turns * Rotation.from_quat(foot.turns).inv()
        assert away.magnitude().max() < 1e-3  # else it would be turned by 0.009
