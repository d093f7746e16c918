"""(B1)-(B5): wrenches, the ground's cone, and their bounds on braking paths."""

import numpy as np
import pytest
from pydrake.multibody.tree import BodyIndex, JacobianWrtVariable
from scipy.optimize import nnls
from standing_robots import standing_robot

from crar_drake.equations.balance import (
    BalanceLaw,
    balance_excess,
    balance_level,
    balance_rows,
    examine_braking,
    examine_step,
    next_state,
    wrenches,
)
from crar_drake.equations.compilation import hold
from crar_drake.errors import ModelError
from crar_drake.robot.model import ControlModel
from crar_drake.robot.moving_pelvis import SLIDES, WholeCommand
from crar_drake.robot.soles import find_masses, ground_cone, shrunk, sole_corners
from crar_drake.robot.standing import standing_description

T, PERIOD = 0.1, 0.01


class Standing:
    """A robot of the tests that stands, and Drake's own of it."""

    def __init__(self, folder, box):
        description = standing_description(standing_robot(folder), box)
        self.pelvis = description.pelvis
        self.model = ControlModel.FromDescription(description, [], time_step=0.0)
        self.masses = find_masses(self.model)
        self.soles = sole_corners(self.model, description.soles)
        self.ground = ground_cone(self.soles, 0.5, 0.02)
        self.plant = self.model.plant
        self.context = self.plant.CreateDefaultContext()
        self.weight = self.masses.mass.sum() * self.masses.g
        names = self.model.velocity_names
        self.command = WholeCommand(self.pelvis, names)
        self.slides = [names.index(name) for name in SLIDES if name in names]

    def state(self, rng, fast=1.0):
        """Positions, velocities and accelerations, legs at rest; a base that moves may
        brake within its box."""
        q = self.model.rest_positions()
        v, a = np.zeros((2, self.plant.num_velocities()))
        at = [j for j in self.model.controlled if j not in self.slides]
        if self.slides:
            half, way = self.pelvis.half, 0.15 * min(fast, 1.0)
            q[self.slides] = self.pelvis.middle + half * rng.uniform(-0.8, 0.8, 3)
            v[self.slides] = way * half * rng.uniform(-1.0, 1.0, 3) / T
            a[self.slides] = rng.uniform(-2.0, 2.0, 3)
        q[at] += rng.normal(0.0, 0.4, len(at))
        v[at] = rng.normal(0.0, fast, len(at))
        a[at] = rng.normal(0.0, 10.0 * fast, len(at))
        return q, v, a

    def asked(self, q, v, a):
        """(6,) what Newton and Euler ask of the ground, by Drake's accelerations."""
        plant, context = self.plant, self.context
        q, v, a = self.command(q, v, a)[0]  # with legs that follow
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        W = plant.world_frame()
        found = np.zeros(6)
        for index in range(1, plant.num_bodies()):
            body = plant.get_body(BodyIndex(index))
            M = body.CalcSpatialInertiaInBodyFrame(context)
            m, c = M.get_mass(), M.get_com()
            if not m:
                continue
            J = plant.CalcJacobianSpatialVelocity(
                context, JacobianWrtVariable.kV, body.body_frame(), c, W, W
            )
            bias = plant.CalcBiasSpatialAcceleration(
                context, JacobianWrtVariable.kV, body.body_frame(), c, W, W
            ).get_coeffs()
            moved = J @ a + bias
            X = plant.EvalBodyPoseInWorld(context, body)
            R = X.rotation().matrix()
            inertia = M.Shift(c).CalcRotationalInertia().CopyToFullMatrix3()
            inertia = R @ inertia @ R.T
            w = (J @ v)[:3]
            f = m * (moved[3:] + [0.0, 0.0, self.masses.g])
            turn = inertia @ moved[:3] + np.cross(w, inertia @ w)
            found += np.append(np.cross(X.multiply(c), f) + turn, f)
        return found

    def law(self, step=0.0, finest=2e-4):
        return hold(
            BalanceLaw(
                self.masses, self.ground, self.model.controlled, T, PERIOD, step,
                finest * self.weight,
            )
        )  # fmt: skip


@pytest.fixture(scope="module", params=["still", "sways"])
def robot(request, tmp_path_factory) -> Standing:
    box = {"x": (-0.04, 0.04), "y": (-0.03, 0.03), "z": (-0.06, 0.005)}
    folder = tmp_path_factory.mktemp("robot") / "stander"
    return Standing(folder, box if request.param == "sways" else None)


def test_wrenches_are_newtons_and_eulers(robot):
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v, a = robot.state(rng)
        found = wrenches(q, v, robot.masses)
        pushed = wrenches(q, a, robot.masses).momentum
        expected = robot.asked(q, v, a)
        np.testing.assert_allclose(
            found.weight + found.turning + pushed, expected, rtol=0, atol=1e-9
        )


def test_the_cone_is_what_forces_at_the_corners_can_give(robot):
    edges = []
    for sole in robot.soles:  # parallel, so that each alone may have the margin
        for p in shrunk(sole, 0.02):
            for way in ([1, 0], [-1, 0], [0, 1], [0, -1]):
                # The pyramid's edges are along the sole's diagonals.
                turned = np.array([way[0] - way[1], way[0] + way[1]]) / np.sqrt(2.0)
                f = np.append(0.5 * turned, 1.0)
                edges.append(np.append(np.cross(p, f), f))
    edges = np.array(edges).T
    rng, inside = np.random.default_rng(1), 0
    for _ in range(300):
        w = edges @ rng.exponential(1.0, edges.shape[1]) ** 4
        w += rng.normal(0.0, 0.03, 6) * w[5]
        _, lacks = nnls(edges, w)
        value = (robot.ground.rows @ w).max()
        if abs(value) > 1e-6 * w[5]:
            assert (lacks < 1e-7 * w[5]) == (value < 0.0)
            inside += value < 0.0
    assert 50 < inside < 250


def test_feet_that_are_smaller_than_the_margin_share_what_is_asked_of_their_hull():
    pad = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    middles = [[x, y, 0.3] for x in (-0.3, 0.3) for y in (-0.1, 0.1)]
    feet = [at + 0.005 * pad for at in np.array(middles)]
    rows = ground_cone(feet, 0.5, 0.02).rows
    edges = []
    for p in np.concatenate(feet):
        # The pyramid's edges are along the hull's diagonals.
        for x, y in pad[:, :2]:
            f = np.array([0.5 * x / np.sqrt(2.0), 0.5 * y / np.sqrt(2.0), 1.0])
            edges.append(np.append(np.cross(p, f), f))
    edges, half = np.array(edges).T, np.array([0.285, 0.085])
    rng, counts = np.random.default_rng(1), [0, 0]
    for _ in range(400):
        f = np.append(rng.normal(0.0, 0.2, 2), 1.0)
        at = np.append(rng.uniform(-1.2, 1.2, 2) * half, 0.3)
        w = np.append(np.cross(at, f) + [0.0, 0.0, rng.normal(0.0, 0.03)], f)
        inside = (rows @ w).max() < -1e-9
        if inside:  # the feet can give it, and the margin is kept
            assert nnls(edges, w)[1] < 1e-9 and (np.abs(at[:2]) < half).all()
        counts[int(inside)] += 1
    assert min(counts) > 40
    # All force upwards: the hull's corners less the margin, and no more.
    for share, given in ((0.999, True), (1.001, False)):
        w = np.append(np.cross([*(share * half), 0.3], [0.0, 0, 1]), [0.0, 0, 1])
        assert ((rows @ w).max() < 0.0) == given


@pytest.mark.parametrize("fast", [0.3, 1.0, 4.0])
def test_no_wrench_of_a_braking_path_is_above_its_bound(robot, fast):
    rng, h = np.random.default_rng(2), PERIOD / T
    for _ in range(4):
        q, v, _ = robot.state(rng, fast)
        found = examine_braking(
            q, v, T, h, 2e-4 * robot.weight, robot.ground, robot.masses
        )
        most = np.full(len(found.values), -np.inf)
        for _ in range(400):
            u = rng.uniform()
            kappa = (1.0 - u) * rng.uniform() ** 0.3
            share = rng.uniform(kappa, min(1.0, kappa / (1.0 - h)))
            w = robot.asked(q + u * T * v, kappa * v, -share * v / T)
            most = np.maximum(most, robot.ground.rows @ w)
        assert (most <= found.values + 1e-9 * robot.weight).all()
        assert (found.seen <= found.values).all()
        # And the bound is no idle one: corners of (B2) come near it.
        assert (found.values - found.seen).max() < 0.02 * robot.weight * max(1, fast)


@pytest.mark.parametrize("step", [0.0, PERIOD])
def test_no_wrench_of_a_step_is_above_its_bound(robot, step):
    rng = np.random.default_rng(3)
    for _ in range(5):
        q, v, a = robot.state(rng, 2.0)
        found = examine_step(
            q, v, a, PERIOD, step, 2e-4 * robot.weight, robot.ground, robot.masses
        )
        for t in np.linspace(0.0, PERIOD, 13):
            there = q + t * v + 0.5 * t * (t + step) * a
            w = robot.asked(there, v + t * a, a)
            assert (robot.ground.rows @ w <= found.values + 1e-9 * robot.weight).all()


@pytest.mark.parametrize("step", [0.0, 0.5 * PERIOD, PERIOD])
def test_braking_from_a_balanced_state_stays_balanced(robot, step):
    rng, law, tried = np.random.default_rng(4), robot.law(step), 0
    while tried < 30:
        q, v, _ = robot.state(rng, 0.2)
        found = examine_braking(
            q, v, T, PERIOD / T, 2e-4 * robot.weight, robot.ground, robot.masses
        )
        if found.values.max() > 0.0:
            continue
        tried += 1
        for _ in range(5):
            a = -v / T
            q, v = next_state(q, v, a, law.value)
            assert not balance_level(q, v, law).any()


@pytest.mark.parametrize("at", ["in the step", "on the path"])
def test_rows_are_the_derivatives_of_the_faces(robot, at):
    finest = 2e-6  # where a bound is largest, what is seen is, too
    rng, law = np.random.default_rng(5), robot.law(finest=finest)
    F = len(robot.ground.rows)
    q, v, a = robot.state(rng, 0.5)
    level = np.zeros(F)
    excess, g, b = balance_rows(q, v, a, level, -np.inf, law)
    assert excess == balance_excess(q, v, a, level, law)

    def values(more):
        if at == "in the step":
            ground, masses = robot.ground, robot.masses
            return examine_step(
                q, v, more, PERIOD, 0.0, finest * robot.weight, ground, masses
            ).seen
        q_next, v_next = next_state(q, v, more, law.value)
        return examine_braking(
            q_next, v_next, T, PERIOD / T, finest * robot.weight, robot.ground,
            robot.masses,
        ).seen  # fmt: skip

    rows = g[:F] if at == "in the step" else g[F:]
    checked = 0
    for j, joint in enumerate(robot.model.controlled):
        e = np.zeros(len(a))
        e[joint] = 1e-3
        up, down = values(a + e), values(a - e)
        slopes = (up - down) / 2e-3
        smooth = np.abs(up + down - 2.0 * values(a)) < 1e-7 * robot.weight
        np.testing.assert_allclose(
            rows[smooth, j], slopes[smooth], rtol=0.02, atol=2e-3
        )
        checked += smooth.sum()
    assert checked > F


def test_an_excess_is_the_larger_of_step_and_path(robot):
    law, still = robot.law(), np.zeros(robot.plant.num_velocities())
    q = robot.model.rest_positions()
    level = balance_level(q, still, law)
    assert not level.any() and balance_excess(q, still, still, level, law) < 0.0
    lift = still.copy()
    lift[robot.model.controlled] = 200.0
    assert balance_excess(q, still, lift, level, law) > 0.0


def test_a_sole_is_smaller_by_the_margin_at_each_edge_and_by_no_more():
    corners = np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.1], [0.2, 0.06, 0.1]])
    corners = np.vstack([corners, [0.0, 0.06, 0.1]])
    found = shrunk(corners, 0.02)
    assert sorted(map(tuple, found.round(12).tolist())) == [
        *((0.02, 0.02, 0.1), (0.02, 0.04, 0.1)),
        *((0.18, 0.02, 0.1), (0.18, 0.04, 0.1)),
    ]


def test_points_may_be_anywhere_on_the_edge_and_inside():
    """As of a round base, or of feet most of which are on one side."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    more = [[1.0, y, 0.0] for y in np.linspace(0.0, 1.0, 40)]
    found = shrunk(np.vstack([corners, more, [[0.5, 0.5, 0.0]]]), 0.2)
    assert {tuple(p) for p in found.round(9).tolist()} == {
        *((0.2, 0.2, 0.0), (0.2, 0.8, 0.0), (0.8, 0.2, 0.0), (0.8, 0.8, 0.0))
    }


def test_soles_that_cannot_stand(robot):
    with pytest.raises(ModelError, match="of soles whose hull is 200 mm wide"):
        ground_cone(robot.soles, 0.5, 0.1)
    with pytest.raises(ModelError, match="up to 15 mm off the plane"):
        ground_cone([robot.soles[0], robot.soles[1] + [0.0, 0.0, 0.06]], 0.5, 0.02)
    line = [np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])]
    with pytest.raises(ModelError, match="in one line"):
        ground_cone(line, 0.5, 0.0)
    wall = [np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0, 0.1], [0, 0, 0.1]])]
    with pytest.raises(ModelError, match="stand on edge"):
        ground_cone(wall, 0.5, 0.0)
    with pytest.raises(ModelError, match="forearm is moved by elbow, shoulder"):
        sole_corners(robot.model, {"forearm": [[0, 0, 0], [1, 0, 0], [0, 1, 0]]})
