"""The lookahead's two stages: what they promise, for random problems."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from crar_drake.equations.joint_limits import limit_gradient, limit_potential
from crar_drake.equations.lookahead import (
    SMALLEST_MARGIN,
    Constraints,
    LookaheadGains,
    LookaheadSolution,
    find_limits,
    join_constraints,
    limit_constraints,
    pair_constraints,
    pair_margins,
    resting_configuration,
    resting_velocity,
    row_weights,
    slip_velocity,
    solve_lookahead,
)
from crar_drake.equations.weighted_inverse import damped_weighted_pseudo_inverse

T, GV, DAMPING = 1.0 / 30.0, 30.0, 0.1
D_MIN, GAMMA = 0.002, 20.0
FASTEST = 0.5
GAINS = LookaheadGains(
    T=T,
    Gv=GV,
    damping=DAMPING,
    rho=1e-4,
    alpha=50.0,
    beta=2.0,
    rho_limits=0.01,
    distance_margin=D_MIN,
    limit_margin=1e-3,
    retreat_rate=GAMMA,
    retreat_speed=FASTEST,
    joint_retreat_speed=2.0,
    influence_distance=0.3,
    period=1e-3,
    slip_share=0.1,
)


def pair_rows(h, g, drift, slip: np.ndarray | None = None) -> Constraints:
    """The rows of pairs; without a slip unless it is given."""
    h, g, drift = (np.asarray(x, dtype=float) for x in (h, g, drift))
    return pair_constraints(
        h, g, drift, np.zeros(g.shape[1]) if slip is None else slip, GAINS
    )


def limit_rows(lower, upper, q_s, slip: np.ndarray | None = None) -> Constraints:
    """The rows of joint limits, likewise."""
    return limit_constraints(
        q_s,
        np.zeros(len(q_s)) if slip is None else slip,
        find_limits(lower, upper),
        GAINS,
    )


def solve(
    J, v_r, a_r, qdot, constraints: Constraints, posture: np.ndarray | None = None
) -> LookaheadSolution:
    posture = np.zeros(len(qdot)) if posture is None else posture
    return solve_lookahead(J, v_r, a_r, qdot, posture, constraints, GAINS)


class Problem:
    """A random problem of any dimension; near, touching and violated constraints."""

    def __init__(self, seed: int, n: int, m: int, num_rows: int, speed: float):
        rng = np.random.default_rng(seed)
        self.J = rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-3, 0.3)
        if rng.random() < 0.3:
            self.J[:, 0] = 0.0  # rank deficient
        self.v_r = speed * rng.normal(size=m)
        self.a_r = 100.0 * speed * rng.normal(size=m)
        self.qdot = speed * rng.normal(size=n)
        self.h = rng.choice(
            [-0.02, 0.0, D_MIN, D_MIN + 1e-6, 0.01, 0.1, 0.5], size=num_rows
        ) + 1e-3 * rng.normal(size=num_rows)
        self.g = 0.4 * rng.normal(size=(num_rows, n))
        self.drift = rng.choice([0.0, 1.0]) * rng.normal(size=num_rows)
        self.lower = -rng.uniform(0.2, 3.0, size=n)
        self.upper = rng.uniform(0.2, 3.0, size=n)
        unlimited = rng.random(n) < 0.2
        self.lower[unlimited], self.upper[unlimited] = -np.inf, np.inf
        self.q_s = rng.uniform(-3.2, 3.2, size=n)
        self.slip = rng.choice([0.0, 1.0]) * rng.normal(size=n)
        self.posture = rng.choice([0.0, 10.0]) * speed * rng.normal(size=n)
        # Where Gv T = 1 the wish of a joint that no task moves is 0 but for rounding,
        # and so is the rate of its limit.
        self.gains = GAINS._replace(Gv=rng.choice([GV, 0.7 * GV]))
        self.rows = pair_rows(self.h, self.g, self.drift, self.slip)
        self.limits = limit_rows(self.lower, self.upper, self.q_s, self.slip)

    @property
    def constraints(self) -> Constraints:
        return join_constraints(self.rows, self.limits)

    def solve(self) -> LookaheadSolution:
        return solve_lookahead(
            self.J,
            self.v_r,
            self.a_r,
            self.qdot,
            self.posture,
            self.constraints,
            self.gains,
        )


problems = st.builds(
    Problem,
    seed=st.integers(0, 2**31),
    n=st.integers(1, 14),
    m=st.integers(1, 24),
    num_rows=st.integers(0, 30),
    speed=st.sampled_from([0.0, 0.1, 3.0, 100.0]),
)


@given(problems)
@settings(max_examples=300, deadline=None)
def test_an_answer_always_exists_and_the_loops_end(problem: Problem) -> None:
    solution = problem.solve()
    assert np.isfinite(solution.s).all() and np.isfinite(solution.qddot).all()
    assert solution.passes <= 2 * (len(problem.rows.h) + len(problem.qdot)) + 1
    np.testing.assert_allclose(
        solution.s, problem.qdot + T * solution.qddot, rtol=1e-9, atol=1e-9
    )


@given(problems)
@settings(max_examples=200, deadline=None)
def test_weight_is_at_least_the_identity_and_at_most_every_rows(
    problem: Problem,
) -> None:
    """I <= W(A) <= W(all): the order of the matrices is that of their diagonals.

    Of W no more is told; the whole matrix is compared below, by what it does.
    """
    W, rows = problem.solve().W, problem.constraints
    assert W.shape == problem.qdot.shape
    assert (W >= 1.0).all()
    every = 1.0 + (rows.weight[:, None] * rows.g**2).sum(axis=0)
    assert (W <= every * (1.0 + 1e-9)).all()


@given(problems)
@settings(max_examples=100, deadline=None)
def test_same_bits_for_same_input(problem: Problem) -> None:
    np.testing.assert_array_equal(problem.solve().qddot, problem.solve().qddot)


class Reference(NamedTuple):
    """What `reference` finds; `doubt` is how near a row's rate came to its bound,
    relative to the terms of the rate: one that is rounding may fall either way."""

    s_0: np.ndarray
    s: np.ndarray
    qdot_c: np.ndarray
    W: np.ndarray
    doubt: float


def reference(problem: Problem) -> Reference:
    """The two stages in plain code: each solve a least-squares problem by QR of the
    stacked residuals, instead of normal equations by Cholesky."""
    n, m = len(problem.qdot), len(problem.v_r)
    rows, Gv = problem.constraints, problem.gains.Gv
    doubt = np.inf
    command = np.zeros(n)

    def penalties(active: set[int], guard: bool):
        A, b = [np.eye(n)], [np.zeros(n)]
        for j in active:
            root = np.sqrt(rows.weight[j])
            A.append(root * rows.g[j])
            b.append([root * (guard * rows.retreat[j] - rows.drift[j])])
        return np.vstack(A), np.concatenate(b)

    def grow(solve, guard: bool) -> np.ndarray:
        active: set[int] = set()
        while True:
            s = solve(active)
            more = set()
            for j in set(range(len(rows.h))) - active:
                terms = np.array([*(rows.g[j] * s), rows.drift[j]])
                over = guard * rows.retreat[j] - terms.sum()
                if over > 0.0:
                    more.add(j)
                nonlocal doubt
                scale = np.abs(terms).max() + np.abs(rows.g[j]).max() * fastest
                doubt = min(doubt, abs(over) / scale if scale > 0.0 else np.inf)
            if not more:
                return s, active
            active |= more

    fastest = np.abs(problem.qdot).max()

    def stage_1(active: set[int]) -> np.ndarray:
        nonlocal command
        A, b = penalties(active, guard=False)
        stacked = np.vstack([problem.J, DAMPING * A])
        command = np.linalg.lstsq(
            stacked, np.concatenate([problem.v_r, DAMPING * b]), rcond=None
        )[0]
        z = Gv * (command - problem.qdot)
        alpha = np.linalg.lstsq(
            stacked, np.concatenate([problem.a_r, 0.0 * b]), rcond=None
        )[0]
        if m < n:
            # z enters through the identity of W alone: lambda^2 M^-1 z; so does the
            # posture, which is no part of the velocity loop.
            free = z + problem.posture
            wish = np.concatenate([np.zeros(m), DAMPING * free, 0.0 * b[n:]])
            alpha = alpha + np.linalg.lstsq(stacked, wish, rcond=None)[0]
        return problem.qdot + T * (alpha + z)

    s_0, active = grow(stage_1, guard=False)
    qdot_c, W = command, np.eye(n)
    for j in active:
        W += rows.weight[j] * np.outer(rows.g[j], rows.g[j])

    def stage_2(active: set[int]) -> np.ndarray:
        A, b = penalties(active, guard=True)
        b[:n] = s_0
        return np.linalg.lstsq(A, b, rcond=None)[0]

    s, _ = grow(stage_2, guard=True)
    return Reference(s_0, s, qdot_c, W, doubt)


@given(
    st.builds(
        Problem,
        seed=st.integers(0, 2**31),
        n=st.integers(1, 14),
        m=st.integers(1, 24),
        num_rows=st.integers(0, 20),
        speed=st.sampled_from([0.1, 3.0, 30.0]),
    )
)
@settings(max_examples=200, deadline=None)
def test_same_as_the_plain_reference(problem: Problem) -> None:
    solution, expected = problem.solve(), reference(problem)
    s, qdot_c = solution.s, solution.qdot_c
    np.testing.assert_allclose(
        s, expected.s, rtol=1e-5, atol=1e-5 * (1.0 + np.abs(s).max())
    )
    assume(expected.doubt > 1e-9)
    np.testing.assert_allclose(
        qdot_c, expected.qdot_c, rtol=1e-5, atol=1e-5 * (1.0 + np.abs(qdot_c).max())
    )
    np.testing.assert_allclose(solution.W, np.diag(expected.W), rtol=1e-9)


@pytest.mark.parametrize("n", [1, 3, 11])
@pytest.mark.parametrize("h", [-0.05, -1e-3, 0.0, D_MIN - 1e-5])
def test_violated_row_recedes(n: int, h: float) -> None:
    """A single row inside d_min recedes at gamma (d_min - h), up to the cap, also
    while the task pushes in as hard as it can."""
    rng = np.random.default_rng(n)
    for _ in range(50):
        g = rng.normal(size=(1, n))
        J = rng.normal(size=(3, n))
        solution = solve(
            J,
            J @ g[0] * -50.0,
            J @ g[0] * -5000.0,
            rng.normal(size=n),
            pair_rows([h], g, [0.0]),
        )
        assert (g @ solution.s)[0] >= min(GAMMA * (D_MIN - h), FASTEST) - 1e-4


@given(problems, st.sampled_from([-0.02, 0.0, D_MIN - 1e-5, D_MIN, D_MIN + 1e-4]))
@settings(max_examples=300, deadline=None)
def test_one_row_is_approached_by_what_its_weight_leaves_of_the_wish(
    problem: Problem, h: float
) -> None:
    """Of s the guard changes the share along g alone, and of that it leaves
    (g s + drift - r) = (g s_0 + drift - r) / (1 + omega |g|^2), by the formula of
    Sherman and Morrison."""
    rng = np.random.default_rng(len(problem.qdot))
    g = 0.4 * rng.normal(size=(1, len(problem.qdot)))
    problem.rows = pair_rows([h], g, [rng.choice([0.0, 1.0]) * rng.normal()])
    free = np.full(len(problem.qdot), np.inf)
    problem.limits = limit_rows(-free, free, problem.q_s)
    s, s_0 = problem.solve().s, reference(problem).s_0
    g, offset = g[0], problem.rows.drift[0] - problem.rows.retreat[0]
    stiffness = problem.rows.weight[0] * (g @ g)
    assert stiffness > 0.0
    scale = np.linalg.norm(g) * np.linalg.norm(s_0) + abs(offset)
    wish, left = g @ s_0 + offset, g @ s + offset
    expected = wish if wish >= 0.0 else wish / (1.0 + stiffness)
    # The wish itself is known to 1e-7 (normal equations against QR), the rates to
    # rounding.
    slack = 1e-7 * scale / (1.0 if wish >= 0.0 else 1.0 + stiffness) + 1e-14 * scale
    assert abs(left - expected) <= slack
    across = np.eye(len(g)) - np.outer(g, g) / (g @ g)
    np.testing.assert_allclose(across @ s, across @ s_0, atol=1e-7 * (1.0 + scale))


def no_rows(n: int) -> Constraints:
    return pair_rows(np.empty(0), np.empty((0, n)), np.empty(0))


def test_no_constraints_is_the_papers_law() -> None:
    """Eqs. (15), (30), (34) with W = I, and the null-space term lambda^2 M^-1 z."""
    rng = np.random.default_rng(3)
    for m, n in ((3, 7), (7, 7), (9, 7)):
        J = rng.normal(size=(m, n))
        v_r, a_r, qdot = rng.normal(size=m), rng.normal(size=m), rng.normal(size=n)
        solution = solve(J, v_r, a_r, qdot, no_rows(n))
        J_star = damped_weighted_pseudo_inverse(J, np.ones(n), DAMPING)
        z = GV * (J_star @ v_r - qdot)
        alpha = J_star @ a_r
        if m < n:
            alpha += (np.eye(n) - J_star @ J) @ z
        np.testing.assert_allclose(solution.qdot_c, J_star @ v_r, atol=1e-10)
        np.testing.assert_allclose(solution.qddot, alpha + z, rtol=1e-9, atol=1e-9)
        assert solution.passes == 1


@pytest.mark.parametrize("m, n", [(3, 7), (6, 7), (7, 7), (9, 7)])
def test_the_posture_is_an_acceleration_in_the_null_space(m: int, n: int) -> None:
    """Without constraints it adds N posture, N = I - J* J as printed, where m < n; and
    nothing where m >= n, where N is not 0 either, by the damping. The velocity that
    the weights are judged by does not feel it."""
    rng = np.random.default_rng([m, n])
    J = rng.normal(size=(m, n))
    v_r, a_r = rng.normal(size=m), rng.normal(size=m)
    qdot, posture = rng.normal(size=(2, n))
    with_posture = solve(J, v_r, a_r, qdot, no_rows(n), posture)
    without = solve(J, v_r, a_r, qdot, no_rows(n))
    N = np.eye(n) - J.T @ np.linalg.inv(J @ J.T + DAMPING**2 * np.eye(m)) @ J
    assert np.abs(N @ posture).max() > 1e-4
    added = with_posture.qddot - without.qddot
    if m < n:
        np.testing.assert_allclose(added, N @ posture, rtol=1e-9, atol=1e-11)
    else:
        np.testing.assert_array_equal(added, 0.0)
    np.testing.assert_array_equal(with_posture.qdot_c, without.qdot_c)


def test_the_posture_gives_way_to_a_constraint() -> None:
    """Under an active row it is damped by W: lambda^2 M^-1 posture, by the whole M."""
    rng = np.random.default_rng(5)
    m, n = 2, 5
    J, g = rng.normal(size=(m, n)), 0.4 * rng.normal(size=n)
    posture = -1e3 * g  # towards the obstacle
    row = pair_rows([D_MIN + 0.01], g[None], [-0.1])
    arguments = J, np.zeros(m), np.zeros(m), np.zeros(n), row
    W = np.eye(n) + row.weight[0] * np.outer(g, g)
    M = J.T @ J + DAMPING**2 * W
    qdot_c = np.linalg.solve(M, DAMPING**2 * row.weight[0] * 0.1 * g)
    pull = GV * qdot_c + posture
    s_0 = T * (DAMPING**2 * np.linalg.solve(M, pull) + GV * qdot_c)
    assert g @ s_0 - 0.1 < 0.0  # the row is active, in the guard as well
    guard = np.linalg.inv(W) @ (s_0 + row.weight[0] * 0.1 * g)
    np.testing.assert_allclose(solve(*arguments, posture).s, guard, rtol=1e-8)


def test_sliding_along_an_obstacle_is_free() -> None:
    """Motion across the gradient is as without the row; motion along it stops."""
    J = np.eye(2)
    v_r, a_r = np.array([1.0, -1.0]), np.zeros(2)
    row = pair_rows([D_MIN], [[0.0, 1.0]], [0.0])
    s = solve(J, v_r, a_r, np.zeros(2), row).s
    s_free = solve(J, v_r, a_r, np.zeros(2), no_rows(2)).s
    assert s[0] == pytest.approx(s_free[0], rel=1e-9)
    assert s_free[1] < -0.9 and abs(s[1]) < 1e-6


@given(st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_resting_point_never_leaves_the_box(seed: int) -> None:
    """First-order law dq_s/dt = s under wishes that change at random: q_s and its
    low-pass q stay within the limits for a second."""
    rng = np.random.default_rng(seed)
    n, dt = 4, 1e-3
    lower, upper = -rng.uniform(0.3, 2.0, n), rng.uniform(0.3, 2.0, n)
    q, qdot = np.zeros(n), np.zeros(n)
    J = np.eye(n)
    v_r = np.zeros(n)
    for step in range(1000):
        if step % 100 == 0:
            v_r = rng.choice([-20.0, 20.0], size=n)
        q_s = resting_configuration(q, qdot, T)
        assert (q_s > lower).all() and (q_s < upper).all()
        assert (q > lower).all() and (q < upper).all()
        solution = solve(J, v_r, GV * (v_r - qdot), qdot, limit_rows(lower, upper, q_s))
        qdot = qdot + dt * solution.qddot
        q = q + dt * qdot


def test_row_weight_is_the_magnitude_of_eq_23() -> None:
    """By finite differences of the potential of Eq. (22) at the margin."""
    rho, alpha, beta = 1e-4, 50.0, 2.0
    h = np.array([0.005, 0.02, 0.1, 0.25])
    eta, step = h - D_MIN, 1e-7

    def f(d: np.ndarray) -> np.ndarray:
        return rho * np.exp(-alpha * d) * d**-beta

    slope = (f(eta + step) - f(eta - step)) / (2.0 * step)
    np.testing.assert_allclose(
        row_weights(h, D_MIN, rho, alpha, beta), -slope, rtol=1e-4
    )
    clamped = row_weights(np.array([-1.0, 0.0, D_MIN]), D_MIN, rho, alpha, beta)
    np.testing.assert_array_equal(
        clamped,
        row_weights(np.full(3, D_MIN + SMALLEST_MARGIN), D_MIN, rho, alpha, beta),
    )


def test_limits_see_the_nearer_side() -> None:
    lower, upper = np.array([-1.0, -1.0, -np.inf]), np.array([1.0, 1.0, np.inf])
    q_s = np.array([0.9, -1.02, 5.0])
    limits = limit_rows(lower, upper, q_s)
    # The third joint has no limits.
    np.testing.assert_allclose(limits.h, [0.1, -0.02])
    np.testing.assert_array_equal(limits.g, [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(limits.retreat, [0.0, GAMMA * 0.021])
    gradient = limit_gradient(q_s, limit_potential(lower, upper))
    np.testing.assert_allclose(limits.weight, 0.01 * np.abs(gradient[:2]))


def test_drift_of_a_moving_obstacle_is_answered() -> None:
    """An obstacle that comes nearer pushes a robot that has nothing else to do."""
    n = 3
    g = np.array([[0.5, 0.0, 0.0]])
    s = solve(
        np.zeros((3, n)),
        np.zeros(3),
        np.zeros(3),
        np.zeros(n),
        pair_rows([D_MIN], g, [-0.2]),
    ).s
    assert (g @ s)[0] == pytest.approx(0.2, abs=1e-5)


def test_slip_is_what_the_plant_did_other_than_told() -> None:
    """A plant that always accelerates by 3 rad/s^2 more than told: the slip tends to
    3 T, with the low-pass's own time constant."""
    qdot, slip = np.array([1.0, 2.0]), np.zeros(2)
    extra = np.array([3.0, 0.0])
    for step in range(1, 41):
        told = np.array([np.sin(step), 1.0])
        before, qdot = qdot, qdot + 1e-3 * (told + extra)
        slip = slip_velocity(slip, qdot, before, told, T, 1e-3, 0.1)
        expected = T * extra * (1.0 - 0.9**step)
        np.testing.assert_allclose(slip, expected, rtol=1e-9, atol=1e-12)
    # A share of 1 takes the last period's as it is.
    slip = slip_velocity(slip, qdot, qdot, -extra, T, 0.05, 1.0)
    np.testing.assert_allclose(slip, T * extra)


@pytest.mark.parametrize("of", ["pair", "limit"])
def test_slip_towards_a_constraint_is_answered_and_away_from_it_is_not(of) -> None:
    """Of a robot at its constraint: a slip of 0.3 towards it is commanded against. One
    away from it is no licence: a wish of 0.1 towards the constraint is stopped as it
    is without the slip, although the slip alone would carry the robot away."""
    n = 2
    bound = np.array([np.inf, 1.0])
    # Directions that lead towards the constraint, and where the robot is.
    towards = np.array([-1.0, 0.0] if of == "pair" else [0.0, 1.0])

    def answer(slip: np.ndarray, wish: np.ndarray) -> np.ndarray:
        if of == "pair":
            constraints = pair_rows([D_MIN], [-towards], [0.0], slip)
        else:
            constraints = limit_rows(-bound, bound, np.array([0.0, 0.999]), slip)
        return solve(np.eye(n), wish, np.zeros(n), np.zeros(n), constraints).s

    still = np.zeros(n)
    np.testing.assert_allclose(answer(0.3 * towards, still), -0.3 * towards, atol=1e-4)
    wish = 0.1 * towards
    stopped = answer(still, wish)
    assert abs(stopped @ towards) < 1e-4
    np.testing.assert_array_equal(answer(-0.3 * towards, wish), stopped)
    # Without the constraint the wish is followed, so that there is something to stop.
    free = solve(np.eye(n), wish, np.zeros(n), still, no_rows(n)).s
    assert free @ towards > 0.09


def test_braking_comes_to_rest_at_the_resting_configuration() -> None:
    """(L1): integrating q_ddot = -q_dot / T numerically, until it is over."""
    q, qdot = np.array([0.3, -1.2]), np.array([2.0, -0.7])
    run = solve_ivp(
        lambda _, x: np.concatenate([x[2:], -x[2:] / T]),
        (0.0, 40.0 * T),
        np.concatenate([q, qdot]),
        rtol=1e-10,
        atol=1e-12,
    )
    np.testing.assert_allclose(
        resting_configuration(q, qdot, T), run.y[:2, -1], atol=1e-8
    )


def test_resting_velocity_is_the_resting_configurations_derivative() -> None:
    """(L2): by differences along q(t) = sin(a t), whose derivatives are known."""
    a, t, step = np.array([2.0, 5.0]), 0.4, 1e-6

    def q_s(t: float) -> np.ndarray:
        return resting_configuration(np.sin(a * t), a * np.cos(a * t), T)

    np.testing.assert_allclose(
        resting_velocity(a * np.cos(a * t), -(a**2) * np.sin(a * t), T),
        (q_s(t + step) - q_s(t - step)) / (2.0 * step),
        rtol=1e-7,
    )


def test_pair_margins_are_the_distance_at_rest_and_its_forecast() -> None:
    """(L3), (L4) of a point that moves past two others in the plane: the distance at
    q_s, and the tangent to d(q(t)) followed for T, by differences."""
    posts = np.array([[0.5, 0.1], [-0.2, 0.4]])
    q, v, step = np.array([0.1, -0.2]), np.array([3.0, 1.5]), 1e-6

    def distances(q: np.ndarray) -> np.ndarray:
        return np.linalg.norm(q - posts, axis=1)

    q_s = resting_configuration(q, v, T)
    d = np.array([distances(q), distances(q_s)])
    dd_dv = np.array([(at - posts) / distances(at)[:, None] for at in (q, q_s)])
    rate = (distances(q + step * v) - distances(q - step * v)) / (2.0 * step)
    np.testing.assert_allclose(
        pair_margins(d, dd_dv, v, T),
        np.concatenate([distances(q) + T * rate, distances(q_s)]),
        rtol=1e-8,
    )


@pytest.mark.parametrize("h", [0.3 - 1e-9, 0.3, 0.4])
def test_pairs_beyond_the_influence_distance_do_not_count(h: float) -> None:
    rows = pair_rows([0.1, h], np.ones((2, 3)), [-0.1, -0.2])
    assert rows.h.tolist() == ([0.1, h] if h < 0.3 else [0.1])
    assert rows.drift.tolist() == ([-0.1, -0.2] if h < 0.3 else [-0.1])
    assert len(rows.g) == len(rows.weight) == len(rows.retreat) == len(rows.h)
