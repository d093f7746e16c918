"""The lookahead's two stages: what they promise, for random problems."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crar_drake.equations.joint_limits import LimitPotential
from crar_drake.equations.lookahead import (
    SMALLEST_MARGIN,
    Constraints,
    JointLimits,
    LookaheadSolution,
    make_rows,
    resting_configuration,
    row_weights,
    slip_velocity,
    solve_lookahead,
)
from crar_drake.equations.weighted_inverse import damped_weighted_pseudo_inverse

T, GV, DAMPING = 1.0 / 30.0, 30.0, 0.1
D_MIN, GAMMA = 0.002, 20.0
FASTEST = 0.5
ROWS = dict(
    d_min=D_MIN,
    influence=0.3,
    gamma=GAMMA,
    fastest=FASTEST,
    rho=1e-4,
    alpha=50.0,
    beta=2.0,
)
LIMITS = dict(margin=1e-3, gamma=GAMMA, fastest=2.0, rho=0.01)


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
        self.rows = make_rows(self.h, self.g, self.drift, **ROWS, slip=self.slip)
        self.limits = JointLimits(self.lower, self.upper, **LIMITS)(self.q_s, self.slip)

    @property
    def constraints(self) -> Constraints:
        return self.rows.with_(self.limits)

    def solve(self) -> LookaheadSolution:
        return solve_lookahead(
            self.J,
            self.v_r,
            self.a_r,
            self.qdot,
            self.constraints,
            T=T,
            Gv=GV,
            damping=DAMPING,
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
def test_weight_is_symmetric_positive_definite(problem: Problem) -> None:
    W = problem.solve().W
    np.testing.assert_array_equal(W, W.T)
    # W >= I by construction, up to rounding of its largest entry.
    assert np.linalg.eigvalsh(W).min() >= 1.0 - 1e-12 * np.abs(W).max()


@given(problems)
@settings(max_examples=100, deadline=None)
def test_same_bits_for_same_input(problem: Problem) -> None:
    np.testing.assert_array_equal(problem.solve().qddot, problem.solve().qddot)


def reference(problem: Problem) -> np.ndarray:
    """The two stages in plain code: each solve a least-squares problem by QR of the
    stacked residuals, instead of normal equations by Cholesky."""
    n, m = len(problem.qdot), len(problem.v_r)
    rows = problem.constraints

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
            more = {
                j
                for j in range(len(rows.h))
                if rows.g[j] @ s + rows.drift[j] < guard * rows.retreat[j]
            } - active
            if not more:
                return s
            active |= more

    def stage_1(active: set[int]) -> np.ndarray:
        A, b = penalties(active, guard=False)
        stacked = np.vstack([problem.J, DAMPING * A])
        qdot_c = np.linalg.lstsq(
            stacked, np.concatenate([problem.v_r, DAMPING * b]), rcond=None
        )[0]
        z = GV * (qdot_c - problem.qdot)
        alpha = np.linalg.lstsq(
            stacked, np.concatenate([problem.a_r, 0.0 * b]), rcond=None
        )[0]
        if m < n:
            # z enters through the identity of W alone: lambda^2 M^-1 z.
            wish = np.concatenate([np.zeros(m), DAMPING * z, 0.0 * b[n:]])
            alpha = alpha + np.linalg.lstsq(stacked, wish, rcond=None)[0]
        return problem.qdot + T * (alpha + z)

    s_0 = grow(stage_1, guard=False)

    def stage_2(active: set[int]) -> np.ndarray:
        A, b = penalties(active, guard=True)
        b[:n] = s_0
        return np.linalg.lstsq(A, b, rcond=None)[0]

    return grow(stage_2, guard=True)


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
    s = problem.solve().s
    np.testing.assert_allclose(
        s, reference(problem), rtol=1e-5, atol=1e-5 * (1.0 + np.abs(s).max())
    )


@pytest.mark.parametrize("n", [1, 3, 11])
@pytest.mark.parametrize("h", [-0.05, -1e-3, 0.0, D_MIN - 1e-5])
def test_violated_row_recedes(n: int, h: float) -> None:
    """A single row inside d_min recedes at gamma (d_min - h), up to the cap, also
    while the task pushes in as hard as it can."""
    rng = np.random.default_rng(n)
    for _ in range(50):
        g = rng.normal(size=(1, n))
        J = rng.normal(size=(3, n))
        solution = solve_lookahead(
            J,
            J @ g[0] * -50.0,
            J @ g[0] * -5000.0,
            rng.normal(size=n),
            make_rows(np.array([h]), g, np.zeros(1), **ROWS),
            T=T,
            Gv=GV,
            damping=DAMPING,
        )
        assert (g @ solution.s)[0] >= min(GAMMA * (D_MIN - h), FASTEST) - 1e-4


@given(problems)
@settings(max_examples=300, deadline=None)
def test_rows_inside_the_margin_are_not_approached(problem: Problem) -> None:
    """Where one row alone counts, its approach is at most what its weight leaves of
    the wish: (g s - r) = (g s_0 - r) / (1 + omega |g|^2)."""
    inside = problem.h < D_MIN
    if not inside.any():
        return
    j = int(np.argmax(inside))
    problem.rows = make_rows(
        problem.h[j : j + 1], problem.g[j : j + 1], problem.drift[j : j + 1], **ROWS
    )
    free = np.full(len(problem.qdot), np.inf)
    problem.limits = JointLimits(-free, free, **LIMITS)(problem.q_s)
    s = problem.solve().s
    speed = problem.g[j] @ s + problem.drift[j] - problem.rows.retreat[0]
    stiffness = problem.rows.weight[0] * problem.g[j] @ problem.g[j]
    wish = 1.0 + np.abs(problem.v_r).max() + np.abs(problem.a_r).max()
    gain = np.linalg.norm(problem.g[j]) * (1.0 + 1.0 / DAMPING)
    slack = 1e3 * gain * (wish + np.abs(problem.qdot).max() + np.abs(problem.drift[j]))
    assert speed >= -slack / stiffness - 1e-9


def test_no_constraints_is_the_papers_law() -> None:
    """Eqs. (15), (30), (34) with W = I, and the null-space term lambda^2 M^-1 z."""
    rng = np.random.default_rng(3)
    for m, n in ((3, 7), (7, 7), (9, 7)):
        J = rng.normal(size=(m, n))
        v_r, a_r, qdot = rng.normal(size=m), rng.normal(size=m), rng.normal(size=n)
        solution = solve_lookahead(
            J,
            v_r,
            a_r,
            qdot,
            make_rows(np.empty(0), np.empty((0, n)), np.empty(0), **ROWS),
            T=T,
            Gv=GV,
            damping=DAMPING,
        )
        J_star = damped_weighted_pseudo_inverse(J, np.ones(n), DAMPING)
        z = GV * (J_star @ v_r - qdot)
        alpha = J_star @ a_r
        if m < n:
            alpha += (np.eye(n) - J_star @ J) @ z
        np.testing.assert_allclose(solution.qdot_c, J_star @ v_r, atol=1e-10)
        np.testing.assert_allclose(solution.qddot, alpha + z, rtol=1e-9, atol=1e-9)
        assert solution.passes == 1


def test_sliding_along_an_obstacle_is_free() -> None:
    """Motion across the gradient is as without the row; motion along it stops."""
    J = np.eye(2)
    v_r, a_r = np.array([1.0, -1.0]), np.zeros(2)
    row = make_rows(np.array([D_MIN]), np.array([[0.0, 1.0]]), np.zeros(1), **ROWS)
    arguments = dict(T=T, Gv=GV, damping=DAMPING)
    s = solve_lookahead(J, v_r, a_r, np.zeros(2), row, **arguments).s
    none = make_rows(np.empty(0), np.empty((0, 2)), np.empty(0), **ROWS)
    s_free = solve_lookahead(J, v_r, a_r, np.zeros(2), none, **arguments).s
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
    limits = JointLimits(lower, upper, **LIMITS)
    v_r = np.zeros(n)
    for step in range(1000):
        if step % 100 == 0:
            v_r = rng.choice([-20.0, 20.0], size=n)
        q_s = resting_configuration(q, qdot, T)
        assert (q_s > lower).all() and (q_s < upper).all()
        assert (q > lower).all() and (q < upper).all()
        solution = solve_lookahead(
            J,
            v_r,
            GV * (v_r - qdot),
            qdot,
            limits(q_s),
            T=T,
            Gv=GV,
            damping=DAMPING,
        )
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
    limits = JointLimits(lower, upper, **LIMITS)(q_s)
    # The third joint has no limits.
    np.testing.assert_allclose(limits.h, [0.1, -0.02])
    np.testing.assert_array_equal(limits.g, [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(limits.retreat, [0.0, GAMMA * 0.021])
    gradient = LimitPotential(lower, upper).gradient(q_s)
    np.testing.assert_allclose(limits.weight, 0.01 * np.abs(gradient[:2]))


def test_drift_of_a_moving_obstacle_is_answered() -> None:
    """An obstacle that comes nearer pushes a robot that has nothing else to do."""
    n = 3
    g = np.array([[0.5, 0.0, 0.0]])
    s = solve_lookahead(
        np.zeros((3, n)),
        np.zeros(3),
        np.zeros(3),
        np.zeros(n),
        make_rows(np.array([D_MIN]), g, np.array([-0.2]), **ROWS),
        T=T,
        Gv=GV,
        damping=DAMPING,
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
        slip = slip_velocity(
            slip, qdot, before, told, T=T, period=1e-3, time_constant=0.01
        )
        expected = T * extra * (1.0 - 0.9**step)
        np.testing.assert_allclose(slip, expected, rtol=1e-9, atol=1e-12)
    # A period longer than the time constant takes the last period's as it is.
    slip = slip_velocity(slip, qdot, qdot, -extra, T=T, period=0.05, time_constant=0.01)
    np.testing.assert_allclose(slip, T * extra)


def test_slip_towards_a_constraint_is_answered_and_away_from_it_is_not() -> None:
    n = 2
    rows = dict(h=np.array([D_MIN]), g=np.array([[1.0, 0.0]]), drift=np.zeros(1))
    bound = np.array([np.inf, 1.0])
    limits = JointLimits(-bound, bound, **LIMITS)

    def answer(slip: np.ndarray, near_limit: bool) -> np.ndarray:
        return solve_lookahead(
            np.zeros((3, n)),
            np.zeros(3),
            np.zeros(3),
            np.zeros(n),
            limits(np.array([0.0, 0.999]), slip)
            if near_limit
            else make_rows(**rows, **ROWS, slip=slip),
            T=T,
            Gv=GV,
            damping=DAMPING,
        ).s

    np.testing.assert_allclose(
        answer(np.array([-0.3, 0.0]), False), [0.3, 0], atol=1e-4
    )
    np.testing.assert_allclose(answer(np.array([0.3, 0.0]), False), [0, 0], atol=1e-9)
    np.testing.assert_allclose(answer(np.array([0.0, 0.3]), True), [0, -0.3], atol=1e-4)
    np.testing.assert_allclose(answer(np.array([0.0, -0.3]), True), [0, 0], atol=1e-9)
