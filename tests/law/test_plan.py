"""The plan's equations (L10)-(L13), against sums of squares written out, differences
of distances, and Drake's solver."""

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from scipy.linalg import lstsq

from crar_drake import ControlModel, load_robot_description, position_tasks
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.plan import (
    effort_rows,
    expected_motion,
    limit_rows_ahead,
    make_preview,
    pair_rows_ahead,
    plan_accelerations,
    possible_motion,
    shifted_plan,
    speed_rows,
    task_shares,
)
from crar_drake.law.references import References

PERIOD, DURATION, RHO, D, K = 5e-3, 0.16, 2e-4, 12.0, 9.0
MARGIN, LIMIT_MARGIN, FAR = 5e-3, 0.02, 0.04
AHEAD = LookaheadParameters(preview=DURATION, smoothness=RHO, posture_gain=K).resolved()
AHEAD = AHEAD._replace(damping=D, farthest_pull=FAR, null_space_damping=0.02)
PREVIEW = make_preview(AHEAD, PERIOD)
N = len(PREVIEW.times)


def positions(plan: np.ndarray, fine: int = 4000) -> np.ndarray:
    """Where a joint is at the instants that starts at rest at 0, by small steps."""
    time = np.linspace(0.0, PREVIEW.times[-1], fine * 16 + 1)
    part = np.minimum(
        np.searchsorted(PREVIEW.times, 0.5 * (time[1:] + time[:-1])), N - 1
    )
    h = time[1]
    v = np.concatenate([[0.0], np.cumsum(plan[part]) * h])
    q = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * h])
    return np.interp(PREVIEW.times, time, q)


def references(rng: np.random.Generator, m: int, n: int, size: float) -> References:
    none = np.zeros(0)
    return References(
        rng.normal(size=(m, n)),
        none,
        none,
        none,
        none,
        none,
        none,
        none,
        size * rng.normal(size=m),
        rng.normal(size=m),
        10.0 * rng.normal(size=m),
    )


def squares(found, shares, damping, posture_error, qdot, plan) -> np.ndarray:
    """The residuals whose squares (L12) sums, one by one, at a plan (N n,)."""
    n = found.J.shape[1]
    plan = plan.reshape(N, n)
    J = shares[:, np.newaxis] * found.J
    u, sigma, vt = np.linalg.svd(J.T @ J + damping**2 * np.eye(n))
    free = vt.T @ np.diag(damping**2 / sigma) @ u.T
    lengths = np.diff(PREVIEW.times, prepend=0.0)
    weights = np.append(0.5 * (lengths[1:] + lengths[:-1]), 0.5 * lengths[-1])
    moved = np.column_stack([positions(plan[:, c]) for c in range(n)])
    residuals = []
    for i, tau in enumerate(PREVIEW.times):
        e = found.e + tau * found.e_dot + 0.5 * tau**2 * found.a_ff
        residuals.append(np.sqrt(weights[i]) * (shares * e - J @ moved[i]))
        speed = qdot + lengths[: i + 1] @ plan[: i + 1]
        z = D * speed + K * (posture_error + tau * qdot + moved[i])
        residuals.append(RHO * np.sqrt(lengths[i]) * (plan[i] + free @ z))
    return np.concatenate(residuals)


def test_the_instants_are_apart_by_a_period_at_least():
    np.testing.assert_allclose(PREVIEW.times, [0.01, 0.03, 0.06, 0.1, 0.16])
    late = make_preview(AHEAD._replace(preview=0.1), 0.02)
    np.testing.assert_allclose(late.times, [0.02, 0.04, 0.06, 0.08, 0.1])


def test_a_plan_is_shifted_by_a_period():
    plan = np.arange(1.0, 2.0 * N + 1.0)
    shifted = shifted_plan(plan, PREVIEW, 2)
    before = plan.reshape(N, 2)
    # The middles of the parts, 5, 20, 45, 80 and 130 ms, and a period of 5 ms later.
    np.testing.assert_array_equal(shifted, before[[0, 1, 2, 3, 4]])
    late = make_preview(AHEAD, 0.04)
    # Parts of 40 ms: what was next is now, and of what comes last nothing is known.
    np.testing.assert_array_equal(
        shifted_plan(plan, late, 2), [*before[1:5], [0.0, 0.0]]
    )
    assert not shifted_plan(np.zeros(0), PREVIEW, 2).any()


def test_expected_motion_is_that_of_the_accelerations():
    rng = np.random.default_rng(1)
    plan, v, qddot_p = rng.normal(size=(N, 3)), rng.normal(size=5), rng.normal(size=2)
    x = expected_motion(v, qddot_p, plan, PREVIEW)
    at, lengths = PREVIEW.times, np.diff(PREVIEW.times, prepend=0.0)
    for c in range(3):
        speed = v[c] + np.cumsum(lengths * plan[:, c])
        expected = at * v[c] + positions(plan[:, c]) + PERIOD * speed
        np.testing.assert_allclose(x[:, c], expected, atol=1e-6)
    for c in range(2):
        speed = v[3 + c] + at * qddot_p[c]
        expected = at * v[3 + c] + at**2 / 2 * qddot_p[c] + PERIOD * speed
        np.testing.assert_allclose(x[:, 3 + c], expected)


@pytest.mark.parametrize(("m", "n"), [(6, 4), (3, 5)])
def test_a_plan_without_rows_is_the_least_sum_of_squares(m, n):
    """Of residuals written out, with every motion by small steps: m > n and m < n."""
    rng = np.random.default_rng(m)
    found = references(rng, m, n, 0.02)
    of_rows, damping = np.arange(m) // 3, 0.3
    shares = task_shares(found.e, of_rows, FAR)
    qdot, posture_error = rng.normal(size=n), rng.normal(size=n)

    def residuals(plan):
        return squares(found, shares, damping, posture_error, qdot, plan)

    at_zero = residuals(np.zeros(N * n))
    A = np.column_stack([residuals(unit) - at_zero for unit in np.eye(N * n)])
    expected = lstsq(A, -at_zero)[0]
    plan = plan_accelerations(
        found,
        of_rows,
        damping,
        posture_error,
        qdot,
        np.zeros((0, N * n)),
        np.zeros(0),
        PREVIEW,
    )
    assert np.abs(plan).max() > 1.0
    np.testing.assert_allclose(plan, expected, rtol=1e-3, atol=1e-3)


def test_a_task_that_is_far_pulls_no_more_than_from_afar():
    """The pull of Huber's function: e up to `farthest`, and from then on its length."""
    of_rows = np.array([0, 0, 0, 1, 1, 1])
    e = np.array([0.01, 0.0, 0.02, 0.3, 0.0, -0.4])
    shares = task_shares(e, of_rows, FAR)
    np.testing.assert_array_equal(shares[:3], 1.0)
    pull = shares**2 * e
    np.testing.assert_allclose(pull[3:], FAR * np.array([0.6, 0.0, -0.8]))
    # Continuous, where it begins.
    for length in (FAR * (1 - 1e-9), FAR * (1 + 1e-9)):
        shares = task_shares(np.array([length]), np.array([0]), FAR)
        assert shares == pytest.approx(1.0)


def problem_with_rows(rng):
    found = references(rng, 6, 4, 0.02)
    rows, least = rng.normal(size=(5, N * 4)), rng.normal(size=5)
    arguments = (np.arange(6) // 3, 0.3, rng.normal(size=4), rng.normal(size=4))
    return found, 1e-3 * rows, 1e-3 * least, arguments


def test_rows_are_kept_with_the_least_sum_of_squares():
    """Against Drake's Clarabel with the rows hard: they give way by next to nothing."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        found, rows, least, (of_rows, damping, error, qdot) = problem_with_rows(rng)
        shares = task_shares(found.e, of_rows, FAR)
        at_zero = squares(found, shares, damping, error, qdot, np.zeros(N * 4))
        A = np.column_stack(
            [
                squares(found, shares, damping, error, qdot, unit) - at_zero
                for unit in np.eye(N * 4)
            ]
        )
        program = MathematicalProgram()
        x = program.NewContinuousVariables(N * 4)
        scale = 1e4
        program.AddQuadraticCost(
            2.0 * scale * A.T @ A, 2.0 * scale * A.T @ at_zero, x, is_convex=True
        )
        program.AddLinearConstraint(rows, least, np.full(5, np.inf), x)
        result = ClarabelSolver().Solve(program)
        assert result.is_success()
        given = (found, of_rows, damping, error, qdot)
        plans = [
            plan_accelerations(*given, rows[order], least[order], PREVIEW)
            for order in (np.arange(5), np.arange(5)[::-1])
        ]
        # Whichever row comes first.
        np.testing.assert_allclose(plans[0], plans[1], rtol=1e-6, atol=1e-6)
        assert (rows @ plans[0] - least).min() > -1e-4
        np.testing.assert_allclose(plans[0], result.GetSolution(x), rtol=0.1, atol=1.0)


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return ControlModel.FromDescription(
        load_robot_description("upper_body"), position_tasks(["left_wrist"])
    )


def crossed(model: ControlModel, rng: np.random.Generator):
    """A state with the hands near each other, that moves."""
    q = model.rest_positions()
    at = dict(
        zip(model.joint_names, np.flatnonzero(model.controlled_positions), strict=True)
    )
    for name, angle in (
        ("left_shoulder_pitch", -0.35),
        ("right_shoulder_pitch", -0.35),
        ("left_shoulder_yaw", -0.5),
        ("right_shoulder_yaw", 0.5),
        ("left_elbow", -1.6),
        ("right_elbow", -1.6),
    ):
        q[at[name]] = angle + 0.1 * rng.normal()
    v = np.zeros(model.plant.num_velocities())
    v[model.controlled] = rng.normal(size=model.n)
    return q, v


def test_rows_are_how_distances_and_limits_change(model):
    """By central differences of distances at the instants, and exactly of limits."""
    rng, n = np.random.default_rng(2), model.n
    law = ControlLaw(model, LookaheadParameters())
    shapes = law._constraints.pairs.shapes.value
    approach = LookaheadParameters().resolved().approach
    q, v = crossed(model, rng)
    at_q, at_v = model.in_order(q, v)
    last = 5.0 * rng.normal(size=(N, n))

    def places(plan):
        x = expected_motion(at_v, np.zeros(model.n_p), plan, PREVIEW)
        ahead = np.repeat(q[np.newaxis], N, axis=0)
        ahead[:, model.positions] += x
        return ahead

    def distances(plan):
        return np.array([model.signed_distances(at) for at in places(plan)])

    x = expected_motion(at_v, np.zeros(model.n_p), last, PREVIEW)
    margins = approach.distance_margin, approach.limit_margin
    assert margins == (MARGIN, LIMIT_MARGIN)
    of_pairs = pair_rows_ahead(at_q, at_v, x, approach, shapes, PREVIEW)
    limits = model.lower, model.upper, approach
    of_limits = limit_rows_ahead(at_q, at_v, x, *limits, PREVIEW)
    rows, least = map(np.concatenate, zip(of_pairs, of_limits, strict=True))
    way = rng.normal(size=(N, n))
    step = 1e-4
    there, change = distances(last), distances(last + step * way)
    change = (change - distances(last - step * way)) / (2.0 * step)
    expected = {}
    # What is in violation leaves at its retreat speed.
    until = PREVIEW.times + PERIOD
    here = model.signed_distances(q)
    asked = np.minimum(MARGIN, here + np.outer(until, np.full(len(here), 0.5)))
    for d, wanted, rate in zip(
        there.ravel(), asked.ravel(), change.ravel(), strict=True
    ):
        if d < 0.1:
            expected[round(float(wanted - d), 9)] = rate
    now = q[model.controlled_positions]
    at = places(last)[:, model.controlled_positions]
    moves = (places(last + way) - places(last))[:, model.controlled_positions]
    for i in range(N):
        for c in range(n):
            low, high = at[i, c] - model.lower[c], model.upper[c] - at[i, c]
            if low < 0.3:
                wanted = min(LIMIT_MARGIN, now[c] - model.lower[c] + 2.0 * until[i])
                expected[round(float(wanted - low), 9)] = moves[i, c]
            if high < 0.3:
                wanted = min(LIMIT_MARGIN, model.upper[c] - now[c] + 2.0 * until[i])
                expected[round(float(wanted - high), 9)] = -moves[i, c]
    assert len(rows) == len(expected) > 10
    missing = least - rows @ last.ravel()
    for row, lack in zip(rows, missing, strict=True):
        rate = expected[min(expected, key=lambda known: abs(known - lack))]
        assert row @ way.ravel() == pytest.approx(rate, abs=1e-6)
    for lack in expected:
        assert np.abs(missing - lack).min() < 1e-8


def test_a_motion_that_no_robot_makes_is_not_believed(model):
    """Of any plan: within the limits, or where the joint is now, and no faster."""
    limits = model.lower, model.upper
    rng = np.random.default_rng(3)
    for size in (1.0, 1e8):
        q = model.rest_positions()[model.controlled_positions]
        q[3] = model.upper[3] + 0.1  # beyond its limit
        x = size * rng.normal(size=(N, model.n + 2))
        possible = possible_motion(x, q, *limits, 10.0, PREVIEW)
        at = q + possible[:, : model.n]
        assert (at <= np.maximum(model.upper, q) + 1e-12).all()
        assert (at >= np.minimum(model.lower, q) - 1e-12).all()
        speed = np.diff(possible[:, : model.n], axis=0, prepend=0.0)
        since = PREVIEW.lengths + PERIOD * (np.arange(N) == 0)
        assert (np.abs(speed) <= 10.0 * since[:, np.newaxis] + 1e-12).all()
        np.testing.assert_array_equal(possible[:, model.n :], x[:, model.n :])
    slow = 0.01 * rng.normal(size=(N, model.n))
    bounded = np.isfinite(model.lower)
    middle = np.zeros(model.n)
    middle[bounded] = 0.5 * (model.lower[bounded] + model.upper[bounded])
    np.testing.assert_array_equal(
        possible_motion(slow, middle, *limits, 10.0, PREVIEW), slow
    )
    # A joint that is beyond a limit may stay there.
    still = np.zeros((N, model.n))
    for beyond in (model.lower - 0.3, model.upper + 0.3):
        q = np.where(bounded, beyond, 0.0)
        np.testing.assert_array_equal(
            possible_motion(still, q, *limits, 10.0, PREVIEW), still
        )


def test_a_joint_that_would_be_too_fast_slows_no_other_down():
    """Two joints with a task each: the plan of the slow one stays as it was."""
    zeros = np.zeros((0, 2 * N))
    found = references(np.random.default_rng(0), 2, 2, 1.0)._replace(
        J=np.eye(2), e=np.array([2.0, 0.03]), e_dot=np.zeros(2), a_ff=np.zeros(2)
    )
    qdot, fastest = np.array([1.0, 0.1]), 5.0
    lengths = np.diff(PREVIEW.times, prepend=0.0)

    def planned(rows, least):
        of_rows, posture = np.arange(2), np.zeros(2)
        return plan_accelerations(
            found, of_rows, 1e-6, posture, qdot, rows, least, PREVIEW
        ).reshape(N, 2)

    def speeds(plan):
        return qdot + np.cumsum(lengths[:, np.newaxis] * plan, axis=0)

    free = plan = planned(zeros, np.zeros(0))
    assert np.abs(speeds(free)[:, 0]).max() > 1.5 * fastest
    for _ in range(5):  # the rows are of the last plan
        plan = planned(*speed_rows(qdot, plan, fastest, PREVIEW))
    assert np.abs(speeds(plan)[:, 0]).max() == pytest.approx(fastest, rel=0.02)
    np.testing.assert_allclose(plan[:, 1], free[:, 1], atol=1e-6)
    still = speed_rows(np.zeros(2), np.zeros((N, 2)), fastest, PREVIEW)
    assert len(still[0]) == len(still[1]) == 0


def test_a_plan_asks_no_more_of_a_motor_than_it_has():
    """Two motors that each move both joints, a prescribed joint that loads them: the
    one that is too weak gives all that it has, at each part of the plan."""
    found = references(np.random.default_rng(0), 2, 2, 1.0)._replace(
        J=np.eye(2), e=np.array([0.5, -0.2]), e_dot=np.zeros(2), a_ff=np.zeros(2)
    )
    A = np.array([[2.0, 0.3, 0.5], [0.3, 1.0, 0.0]])  # the last column: prescribed
    bias, limits, given = (
        np.array([3.0, -1.0]),
        np.array([20.0, 400.0]),
        np.array([2.0]),
    )
    motors = np.column_stack([A, bias, limits]).copy()

    def planned(rows, least):
        of_rows, posture = np.arange(2), np.zeros(2)
        return plan_accelerations(
            found, of_rows, 1e-6, posture, np.zeros(2), rows, least, PREVIEW
        ).reshape(N, 2)

    def efforts(plan):
        return np.column_stack([plan, np.tile(given, (N, 1))]) @ A.T + bias

    free = plan = planned(np.zeros((0, 2 * N)), np.zeros(0))
    assert np.abs(efforts(free)[:, 0]).max() > 3.0 * limits[0]
    for _ in range(8):  # the rows are of the last plan
        plan = planned(*effort_rows(motors, given, plan))
    asked = np.abs(efforts(plan)) / limits
    assert 0.95 < asked[:, 0].max() < 1.0 and asked[:, 1].max() < 1.0
    weak = effort_rows(motors, given, np.zeros((N, 2)))
    assert len(weak[0]) == len(weak[1]) == 0
