"""The mean wrench between frames, against its instants and against centres of mass."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_walker import walker

from crar_drake.references.ground_demand import ground_wrench, mean_wrench
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import find_root, load_robot_description

AXIS = np.array([0.36, -0.48, 0.8])
FIRST = np.array([0.4, 0.9, -0.5])  # how the root is turned first [rad]
W = 7.0  # [rad/s] of all that swings


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walker")
    walker(folder)
    robot = WholeBody(load_robot_description(folder))
    return robot, find_root(robot.plant, robot.description)


def swinging(robot, root, t):
    """A motion at times t (T,), and q, v, vdot of the plant: root and joints swing."""
    phase = W * t[:, None] + np.arange(4 + robot.n)
    size = np.concatenate([[0.1, -0.06, 0.05], [0.3], np.linspace(-0.3, 0.4, robot.n)])
    x, v, a = (
        size * wave
        for wave in (np.sin(phase), W * np.cos(phase), -(W**2) * np.sin(phase))
    )
    # About a fixed axis of the world, which is not one of the root's.
    turned = Rotation.from_rotvec(x[:, 3:4] * AXIS) * Rotation.from_rotvec(FIRST)
    quaternions = turned.as_quat()[:, [3, 0, 1, 2]]
    rate = 1.0 / (t[1] - t[0])
    motion = RobotMotion(robot.joint_names, x[:, :3], quaternions, x[:, 4:], rate)
    q = robot.configurations(x[:, 4:])
    at = root.position_start()
    q[:, at : at + 7] = np.column_stack([quaternions, x[:, :3]])
    at, states = root.velocity_start(), []
    for rates in (v, a):
        whole = robot.velocities(rates[:, 4:])
        whole[:, at : at + 6] = np.column_stack([rates[:, 3:4] * AXIS, rates[:, :3]])
        states.append(whole)
    return motion, q, *states


def centres_of_mass(robot, root, motion):
    """(T, 3) at the frames."""
    plant, found = robot.plant, []
    context, at = plant.CreateDefaultContext(), root.position_start()
    q = robot.configurations(motion.joint_positions)
    q[:, at : at + 7] = np.column_stack(
        [motion.root_quaternions, motion.root_positions]
    )
    for each in q:
        plant.SetPositions(context, each)
        found.append(plant.CalcCenterOfMassPositionInWorld(context))
    return np.array(found)


def test_it_is_the_mean_of_the_instants(made):
    robot, root = made
    rate, fine = 60.0, 24
    motion, *_ = swinging(robot, root, np.arange(12) / rate)
    found = mean_wrench(robot, root, motion)
    assert (
        np.isnan(found.force[[0, -1]]).all() and np.isnan(found.moment[[0, -1]]).all()
    )
    t = np.arange(-fine, fine + 1) / (fine * rate)
    share = (1.0 - np.abs(t) * rate) / fine  # of each instant; they sum to 1
    for frame in range(1, 11):
        _, *state = swinging(robot, root, frame / rate + t)
        each = ground_wrench(robot.plant, *state)
        # The trapezoidal rule is right to some 1e-4 of what changes.
        np.testing.assert_allclose(found.force[frame], share @ each.force, rtol=2e-3)
        # Ways between frames are straight, by (W h)^2 of the moment's parts.
        size = np.abs(each.moment).max()
        np.testing.assert_allclose(
            found.moment[frame], share @ each.moment, atol=4e-3 * size
        )


def test_it_is_right_of_joints_that_turn_far(made):
    """Of straight ways on which joints turn by two radians and the root by one."""
    robot, root = made
    rng, T, rate, fine = np.random.default_rng(3), 4, 30.0, 400
    joints = np.cumsum(rng.uniform(-2.0, 2.0, (T, robot.n)), axis=0)
    places = np.cumsum(rng.uniform(-0.1, 0.1, (T, 3)), axis=0)
    turns = Rotation.from_rotvec(np.arange(T)[:, None] * AXIS)
    quaternions = turns.as_quat()[:, [3, 0, 1, 2]]
    motion = RobotMotion(robot.joint_names, places, quaternions, joints, rate)
    found = mean_wrench(robot, root, motion)
    plant, at = robot.plant, root.velocity_start()
    context, start = plant.CreateDefaultContext(), root.position_start()
    moment = np.zeros((T, 3))
    for way in range(T - 1):
        step, moves = np.diff(joints, axis=0)[way], np.diff(places, axis=0)[way]
        v = rate * robot.velocities(step[None])[0]
        v[at : at + 6] = rate * np.concatenate([AXIS, moves])
        plant.SetVelocities(context, v)
        for share in (np.arange(fine) + 0.5) / fine:
            q = robot.configurations((joints[way] + share * step)[None])[0]
            turned = Rotation.from_rotvec((way + share) * AXIS).as_quat()[[3, 0, 1, 2]]
            q[start : start + 4], q[start + 4 : start + 7] = (
                turned,
                places[way] + share * moves,
            )
            plant.SetPositions(context, q)
            h = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3))
            p_WC = plant.CalcCenterOfMassPositionInWorld(context)
            held = np.cross(p_WC, [0.0, 0.0, found.weight])
            change = rate * h.rotational()
            moment[way] += (change + (1.0 - share) * held) / fine
            moment[way + 1] += (share * held - change) / fine
    size = np.abs(moment).max()
    assert size > 10.0 * found.weight
    np.testing.assert_allclose(found.moment[1:-1], moment[1:-1], atol=1e-3 * size)


def test_joints_that_jump(made):
    """To and fro by half a radian: the force is that of centres of mass at frames."""
    robot, root = made
    T, rate = 9, 30.0
    jump = np.where(np.arange(T) % 2, 0.5, 0.0)[:, None]
    joints = jump * np.linspace(-1.0, 1.0, robot.n)
    places = np.column_stack([0.1 * jump, 0.02 * jump, 0.9 - 0.04 * jump])
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (T, 1))
    motion = RobotMotion(robot.joint_names, places, turns, joints, rate)
    found = mean_wrench(robot, root, motion)
    centres = centres_of_mass(robot, root, motion)
    mass = found.weight / np.linalg.norm(robot.plant.gravity_field().gravity_vector())
    expected = mass * rate**2 * np.diff(centres, 2, axis=0) + [0, 0, found.weight]
    np.testing.assert_allclose(found.force[1:-1], expected, atol=1e-9 * found.weight)
    assert np.abs(expected).max() > 3.0 * found.weight


def test_at_rest_it_is_the_weight(made):
    robot, root = made
    T = 4
    places = np.tile([0.2, -0.1, 0.9], (T, 1))
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (T, 1))
    motion = RobotMotion(robot.joint_names, places, turns, np.zeros((T, robot.n)), 30.0)
    found = mean_wrench(robot, root, motion)
    np.testing.assert_allclose(
        found.centres()[1:-1], centres_of_mass(robot, root, motion)[1:-1, :2]
    )
    np.testing.assert_allclose(found.force[1], [0, 0, found.weight], atol=1e-9)


def test_two_frames_say_nothing(made):
    robot, root = made
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    motion = RobotMotion(
        robot.joint_names, np.zeros((2, 3)), turns, np.zeros((2, robot.n)), 30.0
    )
    assert np.isnan(mean_wrench(robot, root, motion).force).all()
