"""The lookahead's two stages: what they promise, for random problems."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from one_sided_least_squares import (
    one_sided_least_squares,
)
from scipy.integrate import solve_ivp

from crar_drake.equations.joint_limits import limit_gradient, limit_potential
from crar_drake.equations.lookahead_guard import (
    damped_gram,
    guard,
    guard_norm,
    nominal_velocity,
    share_within,
)
from crar_drake.equations.lookahead_rows import (
    BOUNDING_WEIGHT,
    ONE_SIDED_RANGE,
    SMALLEST_MARGIN,
    Constraints,
    LookaheadGains,
    find_limits,
    join_constraints,
    limit_constraints,
    limit_margins,
    margin_curvature,
    pair_constraints,
    pair_margins,
    resting_configuration,
    resting_velocity,
    row_weights,
)
from crar_drake.equations.one_sided import one_sided_minimum

T, GV, DAMPING = 1.0 / 30.0, 30.0, 0.1
D_MIN, GAMMA = 0.002, 20.0
FASTEST = 0.5
NONE = np.zeros(0)
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
    nominal_speed_limit=np.inf,
)


def pair_rows(h, g, drift, slip: np.ndarray | None = None) -> Constraints:
    """The rows of pairs; without a slip unless it is given."""
    h, g, drift = (np.asarray(x, dtype=float) for x in (h, g, drift))
    return pair_constraints(
        h, h, g, drift, np.zeros(g.shape[1]) if slip is None else slip, GAINS
    )


def limit_rows(lower, upper, q_s, slip: np.ndarray | None = None) -> Constraints:
    """The rows of joint limits, likewise."""
    limits = find_limits(lower, upper, np.full(len(q_s), np.inf))
    h = limit_margins(q_s, limits)
    slip = np.zeros(len(q_s)) if slip is None else slip
    return limit_constraints(h, h, slip, limits, GAINS)


class Solution(NamedTuple):
    """Of both stages."""

    s: np.ndarray
    s_0: np.ndarray
    qddot: np.ndarray
    qdot_c: np.ndarray
    W: np.ndarray


def solve(
    J,
    v_r,
    a_r,
    qdot,
    constraints: Constraints,
    posture: np.ndarray | None = None,
    gains: LookaheadGains = GAINS,
) -> Solution:
    posture = np.zeros(len(qdot)) if posture is None else posture
    s_0, qdot_c, W = nominal_velocity(
        J,
        damped_gram(J, gains),
        v_r,
        a_r,
        qdot,
        posture,
        constraints,
        gains,
        NONE,
        NONE,
    )
    s = guard(s_0, constraints, np.eye(len(qdot)))
    return Solution(s, s_0, (s - qdot) / T, qdot_c, W)


# --- the one-sided problem by itself ------------------------------------------------


class OneSided:
    """A random problem of `one_sided_minimum`, of any scale."""

    def __init__(
        self,
        seed: int,
        n: int,
        num_rows: int,
        nearly_parallel: bool,
        stiffest: float = 1e4,
    ):
        rng = np.random.default_rng(seed)
        # |A x - b|^2, with A of rank n.
        self.A = np.vstack([rng.normal(size=(rng.integers(0, 2 * n), n)), np.eye(n)])
        self.b = 10.0 ** rng.uniform(-1, 2) * rng.normal(size=len(self.A))
        directions = rng.normal(size=(num_rows, n))
        if nearly_parallel and num_rows:
            directions = directions[:1] + 1e-3 * directions
        scale = 10.0 ** rng.uniform(-2.0, np.log10(stiffest), size=num_rows)
        self.rows = scale[:, None] * directions
        self.wish = scale * rng.choice([0.0, 0.5, -0.5, 5.0], size=num_rows)
        self.wish = self.wish + 0.1 * scale * rng.normal(size=num_rows)

    def solve(self) -> tuple[np.ndarray, np.ndarray, int]:
        M, right = self.A.T @ self.A, self.A.T @ self.b
        return one_sided_minimum(
            M, right, self.rows, self.wish, np.linalg.solve(M, right)
        )


one_sided_problems = st.builds(
    OneSided,
    seed=st.integers(0, 2**31),
    n=st.integers(1, 14),
    num_rows=st.integers(0, 60),
    nearly_parallel=st.booleans(),
)


@given(one_sided_problems)
@settings(max_examples=300, deadline=None)
def test_the_minimum_has_no_gradient(problem: OneSided) -> None:
    """Of a convex function with a continuous gradient, that is all there is to show;
    the gradient is summed from its terms, to their rounding."""
    x, violated, passes = problem.solve()
    missing = problem.wish - problem.rows @ x
    pull = problem.rows.T @ np.maximum(missing, 0.0)
    gradient = problem.A.T @ (problem.A @ x - problem.b) - pull
    sizes = np.abs(problem.A).T @ (np.abs(problem.A @ x) + np.abs(problem.b))
    terms = np.abs(problem.rows) @ np.abs(x) + np.abs(problem.wish)
    sizes += np.abs(problem.rows[violated]).T @ terms[violated]
    assert (np.abs(gradient) <= 1e-11 * sizes.max(initial=1e-300)).all()
    # What counts as violated is, and nothing else.
    assert (missing[violated] >= -1e-11 * terms[violated]).all()
    assert (missing[~violated] <= 1e-11 * terms[~violated]).all()
    assert passes < 60


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e9])
def test_the_minimum_scales_with_all_that_is_wished(seed: int, scale: float) -> None:
    """Least squares of c b and c wish have c times the solution, whatever its size."""
    problem = OneSided(seed, n=6, num_rows=12, nearly_parallel=False, stiffest=10.0)
    x, violated, passes = problem.solve()
    problem.b, problem.wish = scale * problem.b, scale * problem.wish
    scaled, still_violated, still_passes = problem.solve()
    largest = np.abs(x).max()
    np.testing.assert_allclose(scaled / scale, x, rtol=0.0, atol=1e-9 * largest)
    np.testing.assert_array_equal(still_violated, violated)
    assert still_passes == passes


@pytest.mark.parametrize("rate", [0.0, 0.5, 5.0])
def test_rows_that_bound_how_fast_they_are_approached_weigh_alike(rate: float) -> None:
    """And all others as their margins are, pairs and limits."""
    gains = GAINS._replace(approach_rate=rate, limit_approach_rate=rate)
    h, still = np.array([0.01, 0.05]), np.zeros(2)
    of_pairs = pair_constraints(h, h, np.eye(2), still, still, gains)
    lower, upper = np.full(2, -1.0), np.full(2, 1.0)
    limits = find_limits(lower, upper, np.full(2, np.inf))
    margins = limit_margins(np.array([0.5, -0.9]), limits)
    of_limits = limit_constraints(margins, margins, still, limits, gains)
    for rows, margin in ((of_pairs, D_MIN), (of_limits, GAINS.limit_margin)):
        if rate > 0.0:
            np.testing.assert_array_equal(rows.weight, BOUNDING_WEIGHT)
            np.testing.assert_allclose(rows.retreat, -rate * (rows.h - margin))
        else:
            assert (rows.weight < 0.1 * BOUNDING_WEIGHT).all()
            np.testing.assert_array_equal(rows.retreat, 0.0)


# --- both stages --------------------------------------------------------------------


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
        self.lower[rng.random(n) < 0.1] = -np.inf  # one limit only
        narrow = rng.random(n) < 0.1
        self.upper[narrow] = self.lower[narrow] + 1e-3
        self.q_s = rng.uniform(-3.2, 3.2, size=n)
        self.slip = rng.choice([0.0, 1.0]) * rng.normal(size=n)
        self.posture = rng.choice([0.0, 10.0]) * speed * rng.normal(size=n)
        # Where Gv T = 1 the wish of a joint that no task moves is 0 but for rounding,
        # and so is the rate of its limit.
        self.gains = GAINS._replace(Gv=float(rng.choice([GV, 0.7 * GV])))
        self.fastest = float(rng.choice([np.inf, 150.0, 1.0]))
        self.rows = pair_rows(self.h, self.g, self.drift, self.slip)
        self.limits = limit_rows(self.lower, self.upper, self.q_s, self.slip)

    @property
    def constraints(self) -> Constraints:
        return join_constraints(self.rows, self.limits)

    def solve(self) -> Solution:
        return solve(
            self.J,
            self.v_r,
            self.a_r,
            self.qdot,
            self.constraints,
            self.posture,
            self.gains._replace(nominal_speed_limit=self.fastest),
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
    # The guard's loop has ended where its function is lowest: its derivative is 0.
    rows, s, s_0 = problem.constraints, solution.s, solution.s_0
    short = np.maximum(rows.retreat - rows.drift - rows.g @ s, 0.0)
    push = rows.g.T @ (rows.weight * short)
    size = np.abs(rows.g).T @ (
        rows.weight * (np.abs(rows.retreat - rows.drift) + np.abs(rows.g) @ np.abs(s))
    )
    assert (np.abs(s - s_0 - push) <= 1e-9 * (size + np.abs(s_0) + 1.0)).all()
    assert np.abs(solution.s_0).max() <= problem.fastest * (1.0 + 1e-12)


class Reference(NamedTuple):
    """What `reference` finds."""

    s_0: np.ndarray
    s: np.ndarray
    qdot_c: np.ndarray
    active: np.ndarray
    rates: np.ndarray


def reference(problem: Problem) -> Reference:
    """Both stages from residuals as they are printed, by least squares with slacks."""
    J, rows, Gv = problem.J, problem.constraints, problem.gains.Gv
    m, n = J.shape
    root = np.sqrt(rows.weight)
    regular = np.vstack([J, DAMPING * np.eye(n)])
    G = DAMPING * root[:, None] * rows.g
    qdot_c, _ = one_sided_least_squares(
        regular,
        np.concatenate([problem.v_r, np.zeros(n)]),
        G,
        -DAMPING * root * rows.drift,
    )
    z = Gv * (qdot_c - problem.qdot)
    # |x|^2 - 2 z^T x is |x - z|^2 but for a constant; so is the posture's share.
    pull = z + problem.posture if m < n else np.zeros(n)
    without_x = rows.g @ (problem.qdot + T * z) + rows.drift
    alpha, active = one_sided_least_squares(
        regular,
        np.concatenate([problem.a_r, DAMPING * pull]),
        G,
        -DAMPING * root * without_x / T,
    )
    s_0 = problem.qdot + T * (alpha + z)
    rates = rows.g @ s_0 + rows.drift
    s_0 = s_0 * min(1.0, problem.fastest / max(np.abs(s_0).max(), 1e-9))
    s, _ = one_sided_least_squares(
        np.eye(n), s_0, root[:, None] * rows.g, root * (rows.retreat - rows.drift)
    )
    return Reference(s_0, s, qdot_c, active, rates)


@given(problems)
@settings(max_examples=200, deadline=None)
def test_both_stages_are_the_printed_least_squares(problem: Problem) -> None:
    assume(np.abs(problem.v_r).max() > 0.0)
    solution, expected = problem.solve(), reference(problem)
    for name in ("s_0", "s", "qdot_c"):
        found, wanted = getattr(solution, name), getattr(expected, name)
        np.testing.assert_allclose(
            found, wanted, rtol=1e-6, atol=1e-6 * (1.0 + np.abs(wanted).max())
        )
    # Rows whose rate is 0 but for rounding may count either way.
    rows = problem.constraints
    scale = np.abs(rows.g) @ np.abs(expected.s_0) + np.abs(rows.drift)
    sure = np.abs(expected.rates) > 1e-6 * (scale + np.abs(problem.qdot).max())
    least, most = (
        1.0 + (rows.weight[some, None] * rows.g[some] ** 2).sum(axis=0)
        for some in (expected.active & sure, expected.active | ~sure)
    )
    assert (solution.W >= least * (1.0 - 1e-9)).all()
    assert (solution.W <= most * (1.0 + 1e-9)).all()


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
    solution = problem.solve()
    s, s_0 = solution.s, solution.s_0
    g, offset = g[0], problem.rows.drift[0] - problem.rows.retreat[0]
    stiffness = problem.rows.weight[0] * (g @ g)
    assert stiffness > 0.0
    scale = np.linalg.norm(g) * np.linalg.norm(s_0) + abs(offset)
    wish, left = g @ s_0 + offset, g @ s + offset
    expected = wish if wish >= 0.0 else wish / (1.0 + stiffness)
    assert abs(left - expected) <= 1e-12 * scale
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
        J_star = J.T @ np.linalg.inv(J @ J.T + DAMPING**2 * np.eye(m))
        z = GV * (J_star @ v_r - qdot)
        alpha = J_star @ a_r
        if m < n:
            alpha += (np.eye(n) - J_star @ J) @ z
        np.testing.assert_allclose(solution.qdot_c, J_star @ v_r, atol=1e-10)
        np.testing.assert_allclose(solution.qddot, alpha + z, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(solution.s, solution.s_0)


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


def test_every_finite_limit_has_a_row_of_its_own() -> None:
    lower = np.array([-1.0, -1.0, -np.inf, -2.0, -np.inf])
    upper = np.array([1.0, 1.0, np.inf, np.inf, 0.5])
    q_s = np.array([0.9, -1.02, 5.0, -1.9, 0.6])
    limits = limit_rows(lower, upper, q_s)
    # First the lower limits, of joints 0, 1 and 3; then the upper, of 0, 1 and 4.
    np.testing.assert_allclose(limits.h, [1.9, -0.02, 0.1, 0.1, 2.02, -0.1])
    expected = np.zeros((6, 5))
    for row, (joint, sign) in enumerate(
        [(0, 1), (1, 1), (3, 1), (0, -1), (1, -1), (4, -1)]
    ):
        expected[row, joint] = sign
    np.testing.assert_array_equal(limits.g, expected)
    np.testing.assert_allclose(limits.retreat, [0.0, GAMMA * 0.021, 0.0, 0.0, 0.0, 2.0])
    # Eq. (17) on the half that is nearer, 0 on the other; a joint with one limit as if
    # the other were a turn away.
    lower[4], upper[3] = upper[4] - ONE_SIDED_RANGE, lower[3] + ONE_SIDED_RANGE
    gradient = np.abs(limit_gradient(q_s, limit_potential(lower, upper)))
    np.testing.assert_allclose(
        limits.weight,
        0.01 * np.array([0.0, gradient[1], gradient[3], gradient[0], 0.0, gradient[4]]),
    )
    assert (limits.weight[[1, 2, 3, 5]] > 0.0).all()


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


def posts_at(q: np.ndarray, posts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances of a point in the plane to some others, and their gradients."""
    d = np.linalg.norm(q - posts, axis=1)
    return d, (q - posts) / d[:, None]


def test_margin_curvature_is_what_the_rows_rate_lacks() -> None:
    """d/dt of (L3) is g s, and of (L4) g s + curvature to the first order in T: by
    differences along accelerated motion past two posts. Halving T halves the error."""
    posts = np.array([[0.5, 0.1], [-0.2, 0.4]])
    q, v, qddot = np.array([0.1, -0.2]), np.array([1.0, 0.5]), np.array([3.0, -7.0])
    errors, step = [], 1e-6
    for horizon in (0.02, 0.01, 0.005):

        def margins(t: float, T=horizon) -> np.ndarray:
            q_t, v_t = q + t * v + 0.5 * t * t * qddot, v + t * qddot
            here, there = posts_at(q_t, posts), posts_at(q_t + T * v_t, posts)
            d, dd_dv = (np.array(both) for both in zip(here, there, strict=True))
            return pair_margins(d, dd_dv, v_t, T)

        rate = (margins(step) - margins(-step)) / (2.0 * step)
        dd_dv = np.array([posts_at(x, posts)[1] for x in (q, q + horizon * v)])
        s = resting_velocity(v, qddot, horizon)
        lacks = rate - np.concatenate([dd_dv[0] @ s, dd_dv[1] @ s])
        found = margin_curvature(dd_dv, v)
        np.testing.assert_allclose(found[2:], 0.0)
        np.testing.assert_allclose(lacks[2:], 0.0, atol=1e-7)
        assert (np.abs(lacks[:2]) > 1e-4).all()
        errors.append(np.abs(found[:2] / lacks[:2] - 1.0).max())
    assert errors[0] < 0.1
    assert errors[1] < 0.6 * errors[0] and errors[2] < 0.6 * errors[1]


def test_the_largest_share_within_bounds():
    lowest, highest = np.array([-1.0, -2.0, 0.0]), np.array([3.0, 0.0, 5.0])
    for s, share in (
        ([2.0, -1.0, 4.0, 1e9], 1.0),  # the last has no bounds
        ([-4.0, -1.0, 4.0, 0.0], 0.25),
        ([6.0, -8.0, 4.0, 0.0], 0.25),
        ([1.0, 1e-6, 1.0, 0.0], 0.0),
        ([0.0, 0.0, 0.0, 0.0], 1.0),
        ([3.0, -2.0, 5.0, 0.0], 1.0),
    ):
        assert share_within(np.array(s), lowest, highest) == share
    lowest, highest = np.array([-9.0, -0.1]), np.array([0.25, 9.0])
    for s, share in (([0.5, -0.1], 0.5), ([0.1, -0.4], 0.25), ([0.5, -0.4], 0.25)):
        assert share_within(np.array(s), lowest, highest) == share


def test_the_guard_changes_tasks_of_high_weight_the_least():
    """One row that must give way, in closed form: the change is along N^-1 g."""
    rng = np.random.default_rng(11)
    J, g, s_0 = rng.normal(size=(3, 5)), rng.normal(size=5), rng.normal(size=5)
    J[0] *= 100.0
    rows = Constraints(
        np.zeros(1), g[None], np.zeros(1), np.array([1e3]), np.array([s_0 @ g + 1.0])
    )
    normal = damped_gram(J, GAINS)
    norm = guard_norm(normal, GAINS._replace(task_norm=True, guard_damping=0.3))
    np.testing.assert_allclose(norm, J.T @ J + 0.09 * np.eye(5), atol=1e-9)
    less = guard_norm(normal, GAINS._replace(task_norm=True, guard_damping=0.05))
    np.testing.assert_allclose(less, J.T @ J + 0.0025 * np.eye(5), atol=1e-9)
    its_own = guard_norm(normal, GAINS._replace(task_norm=True, guard_damping=DAMPING))
    np.testing.assert_allclose(its_own, J.T @ J + DAMPING**2 * np.eye(5), atol=1e-9)
    np.testing.assert_array_equal(guard_norm(normal, GAINS), np.eye(5))
    s = guard(s_0, rows, norm)
    along = np.linalg.solve(norm, g)
    expected = along * 1e3 / (1.0 + 1e3 * g @ along)
    np.testing.assert_allclose(s - s_0, expected, atol=1e-9)
    plain = guard(s_0, rows, np.eye(5))
    assert abs(J[0] @ (s - s_0)) < 0.05 * abs(J[0] @ (plain - s_0))
