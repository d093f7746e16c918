"""The centre of pressure from positions, against Drake's inverse dynamics."""

from dataclasses import replace

import numpy as np
import pytest
from floating_robots import write_floater
from pydrake.multibody.tree import JointIndex
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from crar_drake.references.ground_demand import ground_wrench, mean_wrench
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import find_body, find_root, load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.robot_import.link_outlines import links_outward
from crar_drake.trajectory.balance import (
    OF_SPLINE,
    Balance,
    demand,
    half_planes,
    mean_demand,
    point_masses,
)
from crar_drake.trajectory.body_points import ROOT, Placed

AXIS = np.array([0.36, -0.48, 0.8])
FLOOR = -0.4  # [m]
OF_THREE = np.array([0.0, 1.0, -2.0, 1.0, 0.0])  # as OF_SPLINE, second differences
TRIANGLE = np.array([[-0.1, -0.1], [0.2, 0.0], [0.0, 0.15]])


class Floater:
    """The robot whose inertias are skew, moving smoothly: unknowns of some frames, and
    what Drake says of the same states by their derivatives in closed form."""

    def __init__(self, folder):
        write_floater(folder, "prescribed", "[0.3, -0.5, 0.8]")
        self.robot = WholeBody(load_robot_description(folder / "robot.yaml"))
        fixed = replace(self.robot.description, root="fixed", pairs=[])
        plant = self.robot.plant
        body = find_body(plant, "body")
        self.links = list(links_outward(plant, body.body_frame()))
        tasks = [Task(frame=link, kind="pose") for link in self.links]
        self.model = ControlModel.FromDescription(fixed, tasks)
        self.masses = point_masses(plant, self.links)
        self.rest = self.model.rest_positions()
        X_WB = fixed.rest_pose()
        self.base = X_WB.translation(), X_WB.rotation().matrix()
        self.R_0 = Rotation.from_rotvec([0.2, 0.1, -0.3]).as_matrix()

    def motion(self, t):
        """Root's place, turn about AXIS, and joints, with two derivatives each."""
        of_place, of_turn, of_joints = (
            [0.3, -0.2, 0.1],
            0.4,
            np.linspace(-0.5, 0.6, 6),
        )
        w = 3.0
        phase = w * t[:, None] + np.arange(10)
        size = np.concatenate([of_place, [of_turn], of_joints])
        x, v = size * np.sin(phase), w * size * np.cos(phase)
        return x, v, -(w**2) * x

    def unknowns(self, t):
        x, _, _ = self.motion(t)
        y = np.zeros((len(t), ROOT + 6))
        y[:, :3], y[:, ROOT:] = x[:, :3], x[:, 4:]
        y[:, 3:ROOT] = x[:, 3:4] * AXIS
        return y

    def placed(self, frames, y):
        K = len(y)
        p_0, R_0 = np.tile([0.1, 0.2, 0.5], (K, 1)), np.tile(self.R_0, (K, 1, 1))
        return Placed(self.model, self.rest, self.base, p_0, R_0, y)

    def wrench(self, t):
        plant = self.robot.plant
        x, v, a = self.motion(t)
        names = self.model.joint_names
        columns = [names.index(name) for name in self.robot.joint_names]
        q = self.robot.configurations(x[:, 4:][:, columns])
        qd, qdd = (self.robot.velocities(z[:, 4:][:, columns]) for z in (v, a))
        joints = [plant.get_joint(JointIndex(k)) for k in range(plant.num_joints())]
        (root,) = (j for j in joints if j.num_velocities() == 6)
        at, first = root.position_start(), root.velocity_start()
        turned = Rotation.from_rotvec(x[:, 3:4] * AXIS) * Rotation.from_matrix(self.R_0)
        q[:, at : at + 4] = turned.as_quat()[:, [3, 0, 1, 2]]
        q[:, at + 4 : at + 7] = x[:, :3] + [0.1, 0.2, 0.5]
        for z, of in ((qd, v), (qdd, a)):
            z[:, first : first + 3] = of[:, 3:4] * AXIS
            z[:, first + 3 : first + 6] = of[:, :3]
        return ground_wrench(plant, q, qd, qdd)


@pytest.fixture(scope="module")
def floater(tmp_path_factory):
    return Floater(tmp_path_factory.mktemp("floater"))


def test_it_is_what_inverse_dynamics_says(floater):
    """With differences over 1 ms, whose error goes with their square."""
    errors = []
    for rate in (500.0, 1000.0):
        times = np.concatenate(
            [t + np.array([-1, 0, 1]) / rate for t in (0.1, 0.7, 1.9)]
        )
        rows = np.arange(9).reshape(3, 3)
        middle = rows[:, 1]
        p, J = floater.placed(np.arange(9), floater.unknowns(times)).points(
            floater.masses.links, floater.masses.offsets
        )
        found, _ = demand(
            p,
            J,
            floater.masses.masses,
            rows,
            rate**2 * OF_THREE[1:-1],
            np.full(3, FLOOR),
            floater.masses.gravity,
        )
        wrench = floater.wrench(times[middle])
        np.testing.assert_allclose(
            found[:, 0], wrench.force[:, 2] / wrench.weight, atol=1e-4
        )
        centres = wrench.centres(FLOOR)
        assert np.ptp(centres, axis=0).min() > 0.1  # they do move
        errors.append(np.abs(found[:, 1:] / found[:, :1] - centres).max())
    assert errors[1] < 1e-5 and errors[1] < 0.3 * errors[0]


@pytest.mark.parametrize("second", [OF_THREE, OF_SPLINE])
def test_a_mass_at_constant_acceleration_presses_behind_itself(second):
    """At x - z a_x / (a_z + g) of its place, by hand; parabolas are exact."""
    rate, g, a = 25.0, 9.81, np.array([1.5, -0.4, 2.0])
    t = np.arange(-2, 3) / rate
    p = ([0.2, -0.1, 0.8] + 0.5 * t[:, None] ** 2 * a)[:, None]
    found, _ = demand(
        p,
        np.zeros((5, 1, 3, 1)),
        np.array([3.0]),
        np.arange(5)[None],
        rate**2 * second,
        np.array([FLOOR]),
        g,
    )
    arm = (0.8 - FLOOR) / (a[2] + g)
    expected = 0.2 - arm * a[0], -0.1 - arm * a[1]
    np.testing.assert_allclose(found[0, 0], 1.0 + a[2] / g, rtol=1e-9)
    np.testing.assert_allclose(found[0, 1:] / found[0, 0], expected, rtol=1e-9)


def test_the_mean_of_a_mass_at_constant_acceleration():
    """The weight's arm is the mean place, the rest as at the instant; by hand."""
    rate, g, a = 25.0, 9.81, np.array([1.5, -0.4, 2.0])
    t = np.arange(-2, 3) / (2.0 * rate)
    p = ([0.2, -0.1, 0.8] + 0.5 * t[:, None] ** 2 * a)[:, None]
    found, _ = mean_demand(
        p,
        np.zeros((5, 1, 3, 1)),
        np.array([3.0]),
        np.array([0, 2, 4]),
        np.array([1]),
        rate,
        np.array([FLOOR]),
        g,
    )
    place = np.array([0.2, -0.1]) + a[:2] / (12.0 * rate**2)
    moment = np.array([0.2, -0.1]) * a[2] - (0.8 - FLOOR) * a[:2]
    np.testing.assert_allclose(found[0, 0], 1.0 + a[2] / g, rtol=1e-9)
    np.testing.assert_allclose(found[0, 1:], place + moment / g, rtol=1e-9)


@pytest.mark.parametrize("rate", [2.2, 10.0])
def test_the_mean_is_what_the_change_of_momentum_says(floater, rate):
    """By Drake's momentum on the same straight ways; at 2.2 Hz joints turn by up to 0.7
    rad on one, and three add up."""
    frames, every = np.arange(9), np.ones(9, dtype=bool)
    y = floater.unknowns(0.3 + frames / rate)
    most = np.abs(np.diff(y[:, ROOT:], axis=0)).max()
    assert (most > 0.6) == (rate < 3.0)
    turned = Rotation.from_rotvec(y[:, 3:ROOT]) * Rotation.from_matrix(floater.R_0)
    names = floater.model.joint_names
    motion = RobotMotion(
        tuple(names),
        y[:, :3] + [0.1, 0.2, 0.5],
        turned.as_quat()[:, [3, 0, 1, 2]],
        y[:, ROOT:],
        rate,
    )
    robot = floater.robot
    columns = [names.index(name) for name in robot.joint_names]
    motion = replace(
        motion,
        joint_names=robot.joint_names,
        joint_positions=motion.joint_positions[:, columns],
    )
    wrench = mean_wrench(robot, find_root(robot.plant, robot.description), motion)
    support = half_planes([TRIANGLE] * 9, np.full(9, FLOOR), 0.01)
    rows = Balance(floater.placed, floater.masses, support, ~every, rate)(frames, y)
    t, side = rows.places
    n, b = support.normals[t, side], support.bounds[t, side]
    force, moment = wrench.force[t] / wrench.weight, wrench.moment[t] / wrench.weight
    H = np.column_stack([-moment[:, 1], moment[:, 0]]) + FLOOR * force[:, :2]
    expected = b * force[:, 2] - (n * H).sum(axis=1) - support.margins[t]
    size = np.abs(expected).max()
    np.testing.assert_allclose(rows.d, expected, atol=2e-3 * size)


def test_five_samples_say_how_a_spline_through_many_bends():
    """What is left of its second derivative is a fraction of what three leave."""
    x = np.random.default_rng(4).normal(size=400)
    bends = CubicSpline(np.arange(400), x)(np.arange(400), 2)[20:-20]
    lack = {}
    for name, second in (("three", OF_THREE), ("five", OF_SPLINE)):
        found = np.convolve(x, second, mode="same")[20:-20]
        lack[name] = np.sqrt(np.mean((found - bends) ** 2))
    assert lack["five"] < 0.25 * lack["three"]
    assert lack["five"] < 0.15 * np.sqrt(np.mean(bends**2))


@pytest.mark.parametrize("rate", [2.2, 50.0])  # with four parts of a way, and with two
def test_its_gradient_is_that_of_finite_differences(floater, rate):
    """Of all sides of a triangle, by the unknowns of all frames."""
    support = half_planes([TRIANGLE] * 7, np.full(7, FLOOR), 0.01)
    every = np.ones(7, dtype=bool)
    rows = Balance(floater.placed, floater.masses, support, every, rate)
    frames = np.arange(7)
    y = floater.unknowns(0.3 + frames / rate)
    at = rows(frames, y)
    # Three sides in each inner frame, and three more where five frames are there.
    assert len(at.d) == 3 * 5 + 3 * 3 and (at.d < 0.0).any()
    assert len(set(zip(at.frames[:, 2], at.row, strict=True))) == len(at.d)
    step, number = 1e-5, np.arange(len(at.d))
    for k in range(7):
        for j in range(y.shape[1]):
            ahead, behind = y.copy(), y.copy()
            ahead[k, j] += step
            behind[k, j] -= step
            slope = (rows(frames, ahead).d - rows(frames, behind).d) / (2.0 * step)
            gradient = np.zeros(len(slope))
            for a in range(5):
                of = number[at.frames[:, a] == k]
                gradient[of] += at.gradient[of, a, j]
            np.testing.assert_allclose(gradient, slope, rtol=1e-6, atol=2e-5)


def test_frames_that_are_no_neighbours_or_do_not_stand_have_no_rows(floater):
    nothing, every = np.zeros((0, 2)), np.ones(9, dtype=bool)
    points = [TRIANGLE, TRIANGLE, nothing, *[TRIANGLE] * 6]
    support = half_planes(points, np.full(9, FLOOR), 0.01)
    rows = Balance(floater.placed, floater.masses, support, every, 50.0)
    y = floater.unknowns(0.3 + np.arange(9) / 50.0)
    every = rows(np.arange(9), y)
    assert set(every.frames[:, 2]) == {1, 3, 4, 5, 6, 7}
    some = np.array([0, 1, 3, 4, 5, 6, 7])
    found = rows(some, y[some])
    assert set(found.frames[:, 2]) == {4}  # which of `some` frame 5 is
    mine = every.frames[:, 2] == 5
    np.testing.assert_array_equal(found.d, every.d[mine])
    assert not len(rows(some[:3], y[:3]).d)
    # No spline is asked of frame 5.
    rows = Balance(floater.placed, floater.masses, support, np.arange(9) != 5, 50.0)
    less = rows(np.arange(9), y)
    gone = mine & (every.row >= len(TRIANGLE))
    assert gone.sum() == len(TRIANGLE)
    np.testing.assert_array_equal(less.d, every.d[~gone])


def test_half_planes_are_the_hull():
    square = np.array([[0, 0], [1, 0], [1, 2], [0, 2], [0.5, 1.0]], dtype=float)
    narrow, line = square * [0.01, 1.0], square * [0.0, 1.0]
    found = half_planes([square, narrow, line, square[:2]], np.zeros(4), 0.1)
    np.testing.assert_array_equal(found.supported, [True, True, False, False])
    sides = {
        (*n.round(6), round(b, 6))
        for n, b in zip(found.normals[0], found.bounds[0], strict=True)
    }
    assert sides == {(1, 0, 1), (-1, 0, 0), (0, 1, 2), (0, -1, 0)}
    assert found.margins[0] == 0.1 and 0.0 < found.margins[1] < 0.005


def test_of_a_round_sole_few_sides_are_left_and_all_are_inside():
    turn = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    circle = 0.1 * np.column_stack([np.cos(turn), np.sin(turn)])
    found = half_planes([circle], np.zeros(1), 0.0)
    sides = np.isfinite(found.bounds[0])
    assert 8 <= sides.sum() <= 16
    assert (found.bounds[0, sides] <= 0.1).all()
    assert (found.bounds[0, sides] > 0.097).all()
