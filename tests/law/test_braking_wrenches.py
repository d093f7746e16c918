"""(B1)-(B6): wrenches, the ground's cone, and their bounds on braking paths."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.tree import BodyIndex, JacobianWrtVariable
from scipy.optimize import minimize, nnls
from standing_robots import standing_robot

from crar_drake.errors import ModelError
from crar_drake.law.balance import (
    BalanceLaw,
    Examined,
    balance_level,
    examine,
    examine_balance,
)
from crar_drake.law.compilation import hold
from crar_drake.law.dynamics import wrench_slopes, wrenches
from crar_drake.law.ground import Ground
from crar_drake.law.parameters import BalanceParameters
from crar_drake.law.prediction import state_within
from crar_drake.law.projection import project
from crar_drake.law.step import State
from crar_drake.robot.model import ControlModel
from crar_drake.robot.soles import ground_cone, masses_on_soles, shrunk, sole_corners
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import position_tasks

T, PERIOD = 0.1, 0.01


class Standing:
    """A robot of the tests that stands, and Drake's own of it."""

    def __init__(self, description):
        description = standing_description(description)
        self.model = ControlModel.FromDescription(description, [], time_step=0.0)
        self.masses = masses_on_soles(self.model)
        self.soles = sole_corners(self.model)
        self.cone = ground_cone(self.soles, 0.5, 0.02)
        self.plant = self.model.plant
        self.context = self.plant.CreateDefaultContext()
        self.weight = self.masses.inertia[:, 3, 3].sum() * self.masses.g

    def state(self, rng, fast=1.0):
        """Positions, velocities and accelerations, legs at rest."""
        q = self.model.rest_positions()
        v, a = np.zeros((2, self.plant.num_velocities()))
        at = self.model.controlled
        q[at] += rng.normal(0.0, 0.4, len(at))
        v[at] = rng.normal(0.0, fast, len(at))
        a[at] = rng.normal(0.0, 10.0 * fast, len(at))
        return q, v, a

    def asked(self, q, v, a):
        """(6,) what Newton and Euler ask of the ground, by Drake's accelerations."""
        plant, context = self.plant, self.context
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

    def law(self, step=0.0, near=None):
        return hold(
            BalanceLaw(
                self.masses, self.cone, self.model.controlled, T, PERIOD, step,
                2e-4 * self.weight, 0.1 * self.weight if near is None else near,
            )
        )  # fmt: skip


def examine_braking(q, v, level, close, law) -> Examined:
    return examine(q, v, -v / T, True, level, close, law)


def examine_step(q, v, a, level, close, law) -> Examined:
    return examine(q, v, a, False, level, close, law)


def excess_of(q, v, a, level, law) -> float:
    return examine_balance(q, v, a, level, np.inf, law)[0]


@pytest.fixture(scope="module", params=["revolute", "prismatic"])
def robot(request, tmp_path_factory) -> Standing:
    """With an elbow that turns, or slides."""
    description = standing_robot(tmp_path_factory.mktemp("robot") / "stander")
    model = Path(description.folder) / description.model
    elbow = '<joint name="elbow" type='
    text = model.read_text().replace(f'{elbow}"revolute"', f'{elbow}"{request.param}"')
    model.write_text(text)
    return Standing(description)


def test_wrenches_are_newtons_and_eulers(robot):
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v, a = robot.state(rng)
        for turns, pushes in ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0)):
            w = wrenches(q, turns * v, pushes * a, robot.masses)
            expected = robot.asked(q, turns * v, pushes * a)
            np.testing.assert_allclose(w.sum(axis=0), expected, rtol=0, atol=1e-9)


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
        value = (robot.cone.rows @ w).max()
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


@pytest.mark.parametrize("close", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("fast", [0.3, 1.0, 4.0])
def test_no_wrench_of_a_braking_path_is_above_its_bound(robot, fast, close):
    rng, h, law = np.random.default_rng(2), PERIOD / T, robot.law().value
    level = np.zeros(len(robot.cone.rows))
    for _ in range(4):
        q, v, _ = robot.state(rng, fast)
        found = examine_braking(q, v, level, close, law)
        most = np.full(len(found.values), -np.inf)
        for _ in range(400):
            u = rng.uniform()
            kappa = (1.0 - u) * rng.uniform() ** 0.3
            share = rng.uniform(kappa, min(1.0, kappa / (1.0 - h)))
            w = robot.asked(q + u * T * v, kappa * v, -share * v / T)
            most = np.maximum(most, robot.cone.rows @ w)
        assert (most <= found.values + 1e-9 * robot.weight).all()
        assert (found.seen <= found.values).all()
        # And the bound is no idle one: corners of (B2) come near it.
        idle = 0.02 * robot.weight * max(1, fast) + close * np.abs(found.values)
        assert (found.values - found.seen <= idle).all()


@pytest.mark.parametrize("fast", [2.0, 12.0])
@pytest.mark.parametrize("step", [0.0, PERIOD])
def test_no_wrench_of_a_step_is_above_its_bound(robot, step, fast):
    rng, law = np.random.default_rng(3), robot.law(step).value
    level, inside = np.zeros(len(robot.cone.rows)), 0
    for close in (0.0, 0.1, 1.0):
        for _ in range(4):
            q, v, a = robot.state(rng, fast)
            found = examine_step(q, v, a, level, close, law)
            inside += ((found.at[:, 0] > 0.0) & (found.at[:, 0] < 1.0)).sum()
            for t in np.linspace(0.0, PERIOD, 13):
                there = q + t * v + 0.5 * t * (t + step) * a
                w = robot.asked(there, v + t * a, a)
                most = found.values + 1e-9 * np.abs(w).max()
                assert (robot.cone.rows @ w <= most).all()
            if not close:  # fast or not, pieces add little to what may be the worst
                assert (found.values - found.seen).max() <= 2.1 * law.finest
    assert inside or fast < 3.0


@pytest.mark.parametrize("step", [0.0, 0.5 * PERIOD, PERIOD])
def test_braking_from_a_balanced_state_stays_balanced(robot, step):
    rng, law, tried = np.random.default_rng(4), robot.law(step), 0
    while tried < 30:
        q, v, _ = robot.state(rng, 0.2)
        found = examine_braking(q, v, np.zeros(len(robot.cone.rows)), 0.0, law.value)
        if found.values.max() > 0.0:
            continue
        tried += 1
        for _ in range(5):
            a = -v / T
            q, v = state_within(q, v, a, PERIOD, step)
            assert not balance_level(q, v, law).any()


def test_slopes_are_those_of_the_wrenches(robot):
    rng, masses = np.random.default_rng(6), robot.masses
    joints, e = robot.model.controlled, 1e-6
    for _ in range(3):
        at = robot.state(rng, 2.0)
        slopes = wrench_slopes(*at, joints, masses)
        for j, joint in enumerate(joints):
            for k in range(3):
                ends = []
                for sign in (1.0, -1.0):
                    moved = [x.copy() for x in at]
                    moved[k][joint] += sign * e
                    ends.append(wrenches(*moved, masses).sum(axis=0))
                expected = (ends[0] - ends[1]) / (2.0 * e)
                np.testing.assert_allclose(slopes[j, k], expected, rtol=1e-5, atol=1e-5)


def test_faces_far_below_their_level_have_no_rows(robot):
    rng = np.random.default_rng(5)
    q, v, a = robot.state(rng, 0.1)
    level = np.zeros(len(robot.cone.rows))
    _, g, b = examine_balance(q, v, a, level, -np.inf, robot.law(near=np.inf))
    _, near, c = examine_balance(q, v, a, level, -np.inf, robot.law())
    kept = np.isfinite(c)
    assert np.isfinite(b).all() and 0 < kept.sum() < len(b)
    np.testing.assert_array_equal(near[kept], g[kept])
    np.testing.assert_array_equal(c[kept], b[kept])
    left = b - g @ a[robot.model.controlled]
    assert left[~kept].min() >= 0.1 * robot.weight > left[kept].max()


def test_the_nearest_accelerations_are_those_of_a_quadratic_program(robot):
    rng, tasks = np.random.default_rng(7), position_tasks(["hand"])
    description = robot.model.description
    model = ControlModel.FromDescription(description, tasks, time_step=0.0)
    n, nv = len(model.controlled), robot.plant.num_velocities()
    q, v = model.in_order(model.rest_positions(), np.zeros(nv))
    state = State(q, v, n, T, PERIOD, 0.0, lambda T: np.zeros(n))
    Ground(model, T, PERIOD, BalanceParameters(0.02, 0.5)).begin(state)
    root = state.root
    norm = root @ root.T
    assert np.trace(norm) == pytest.approx(n)
    assert np.abs(norm - np.eye(n)).max() > 0.1
    changed = 0
    for _ in range(20):
        wanted, g = rng.normal(0.0, 5.0, n), rng.normal(0.0, 1.0, (4, n))
        inside = rng.normal(0.0, 1.0, n)
        b = g @ inside + rng.exponential(1.0, 4)
        lower, upper = inside - 3.0, inside + 3.0
        rows = np.concatenate((-g, np.eye(n), -np.eye(n)))
        least = np.concatenate((-b, lower, -upper))
        hard = np.full(len(least), 1e12)
        found = project(wanted, rows, least, hard, lower, upper, root)
        assert (g @ found <= b + 1e-5).all()
        assert (found >= lower - 1e-5).all() and (found <= upper + 1e-5).all()
        expected = minimize(
            lambda a, w=wanted: (a - w) @ norm @ (a - w),
            inside,
            method="SLSQP",
            bounds=list(zip(lower, upper, strict=True)),
            constraints={"type": "ineq", "fun": lambda a, g=g, b=b: b - g @ a},
            options={"ftol": 1e-14},
        ).x
        np.testing.assert_allclose(found, expected, atol=1e-4)
        changed += np.abs(found - wanted).max() > 1e-3
    assert changed > 10


@pytest.mark.parametrize("at", ["in the step", "on the path"])
def test_rows_are_the_derivatives_of_the_faces(robot, at):
    """By Drake, where each face is found to be largest."""
    rng, law = np.random.default_rng(5), robot.law(near=np.inf)
    F = len(robot.cone.rows)
    q, v, a = robot.state(rng, 0.5)
    level = np.zeros(F)
    excess, g, b = examine_balance(q, v, a, level, -np.inf, law)
    assert (excess > 0.0) == (excess_of(q, v, a, level, law) > 0.0)
    if at == "in the step":
        rows, bounds = g[:F], b[:F]
        found = examine_step(q, v, a, level, 0.1, law.value)
    else:
        rows, bounds = g[F:], b[F:]
        found = examine_braking(
            *state_within(q, v, a, PERIOD, 0.0), level, 0.1, law.value
        )

    def value(face, more):
        u, share, brake = found.at[face]
        if at == "in the step":
            t = u * PERIOD
            there = q + t * v + 0.5 * t * t * more
            w = robot.asked(there, v + t * more, more)
        else:
            end, x = state_within(q, v, more, PERIOD, 0.0)
            w = robot.asked(end + u * T * x, share * x, -brake * x / T)
        return robot.cone.rows[face] @ w

    for face in range(F):
        assert value(face, a) <= found.values[face] + 1e-9 * robot.weight
        for j, joint in enumerate(robot.model.controlled):
            e = np.zeros(len(a))
            e[joint] = 1e-3
            slope = (value(face, a + e) - value(face, a - e)) / 2e-3
            assert rows[face, j] == pytest.approx(slope, rel=1e-4, abs=1e-6)
    at_a = rows @ a[robot.model.controlled]
    np.testing.assert_allclose(at_a - bounds, found.values, atol=1e-9 * robot.weight)


def test_an_excess_is_the_larger_of_step_and_path(robot):
    law, still = robot.law(), np.zeros(robot.plant.num_velocities())
    q = robot.model.rest_positions()
    level = balance_level(q, still, law)
    assert not level.any() and excess_of(q, still, still, level, law) < 0.0
    lift = still.copy()
    lift[robot.model.controlled] = 200.0
    assert excess_of(q, still, lift, level, law) > 0.0


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
        soles = {"forearm": [[0, 0, 0], [1, 0, 0], [0, 1, 0]]}
        description = replace(robot.model.description, soles=soles)
        sole_corners(ControlModel.FromDescription(description, [], time_step=0.0))
