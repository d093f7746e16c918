"""The lookahead's two stages: what they promise, for random problems."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from one_sided_least_squares import (
    every_consistent_minimum,
    one_sided_least_squares,
)
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

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
    NOMINAL_SPEED_LIMIT,
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
    retreat_speed,
    row_weights,
    slip_velocity,
    that_weigh,
    weighed_margins,
)
from crar_drake.equations.one_sided import _lowest_on_way, one_sided_minimum

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


def test_passes_are_counted() -> None:
    """Of x^2 - 2 x: the minimum 1 breaks no row, x >= 2, and this and then x <= 1.2."""
    M, right, x = np.eye(1), np.ones(1), np.ones(1)

    def passes(rows: list[float], wish: list[float]) -> int:
        return one_sided_minimum(M, right, np.array([rows]).T, np.array(wish), x)[2]

    assert passes([1.0], [0.5]) == 0
    assert passes([1.0], [2.0]) == 1
    assert passes([1.0, -1.0], [2.0, -1.2]) == 2  # the first pass leads to 1.5


@given(one_sided_problems)
@settings(max_examples=200, deadline=None)
def test_the_minimum_is_that_of_slacks(problem: OneSided) -> None:
    x, _, _ = problem.solve()
    expected, _ = one_sided_least_squares(
        problem.A, problem.b, problem.rows, problem.wish
    )
    np.testing.assert_allclose(
        x, expected, rtol=1e-6, atol=1e-6 * (1.0 + np.abs(expected).max())
    )


@given(
    st.builds(
        OneSided,
        seed=st.integers(0, 2**31),
        n=st.integers(1, 5),
        num_rows=st.integers(1, 7),
        nearly_parallel=st.booleans(),
    )
)
@settings(max_examples=60, deadline=None)
def test_the_minimum_is_the_only_one_that_agrees_with_its_rows(
    problem: OneSided,
) -> None:
    x, _, _ = problem.solve()
    found = every_consistent_minimum(problem.A, problem.b, problem.rows, problem.wish)
    assert found
    for expected in found:  # more than one where a row just holds
        np.testing.assert_allclose(
            x, expected, rtol=1e-6, atol=1e-6 * (1.0 + np.abs(expected).max())
        )


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


def test_rows_without_weight_are_left_out() -> None:
    """Of limits those of the far half; whatever weighs stays, however little."""
    rows = pair_rows(np.zeros(4), np.eye(4), np.arange(4.0))
    rows = rows._replace(weight=np.array([0.0, 1e-9, 0.0, 2.0]))
    left = that_weigh(rows)
    for found, all_of_them in zip(left, rows, strict=True):
        np.testing.assert_array_equal(found, all_of_them[[1, 3]])


def growing_set(s_0: np.ndarray, rows: Constraints) -> np.ndarray:
    """What the guard must not do: rows once exceeded are equations for good."""
    active = np.zeros(len(rows.h), dtype=bool)
    s = s_0
    while True:
        exceeded = rows.g @ s + rows.drift < rows.retreat
        if (exceeded <= active).all():
            return s
        active |= exceeded
        g, weight = rows.g[active], rows.weight[active]
        wish = (rows.retreat - rows.drift)[active]
        M = np.eye(len(s)) + g.T @ (weight[:, None] * g)
        s = np.linalg.solve(M, s_0 + g.T @ (weight * wish))


@pytest.mark.parametrize("spread", [1e-3, 1e-2, 0.1])
def test_nearly_parallel_rows_do_not_fight(spread: float) -> None:
    """Rows that some velocity y satisfies never move s farther from the wish than y
    is. The growing set of rows did, by a factor of hundreds."""
    worst = 0.0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        n = 5
        g = 0.4 * (rng.normal(size=n) + spread * rng.normal(size=(6, n)))
        h = rng.uniform(-0.02, D_MIN, size=6)
        y = 3.0 * rng.normal(size=n)
        rows = pair_rows(h, g, np.zeros(6))
        rows = rows._replace(
            drift=rows.retreat - g @ y + rng.choice([0.0, 0.3], size=6)
        )
        s_0 = 2.0 * rng.normal(size=n)
        s = guard(s_0, rows, np.eye(len(s_0)))
        farthest = np.linalg.norm(y - s_0)
        assert np.linalg.norm(s - s_0) <= farthest * (1.0 + 1e-6) + 1e-9
        worst = max(worst, np.linalg.norm(growing_set(s_0, rows) - s_0) / farthest)
    if spread < 0.1:
        assert worst > 30.0


def test_starts_in_several_penetrations_are_left_gently() -> None:
    """With depths of centimetres in many rows at once, s is no larger than what some
    velocity needs that leaves all of them; the growing set of rows took more."""
    more = 0.0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        n = 6
        away = rng.normal(size=n)
        away /= np.linalg.norm(away)
        g = 0.3 * rng.normal(size=(8, n))
        g += np.outer(np.maximum(0.05 - g @ away, 0.0), away)  # away leaves all rows
        rows = pair_rows(rng.uniform(-0.05, 0.0, size=8), g, np.zeros(8))
        s = guard(np.zeros(n), rows, np.eye(n))
        assert np.linalg.norm(s) <= FASTEST / (g @ away).min() * (1.0 + 1e-6)
        assert (g @ s > 0.99 * rows.retreat).all()
        taken = np.linalg.norm(growing_set(np.zeros(n), rows))
        more = max(more, taken / np.linalg.norm(s))
    assert more > 2.0


def test_the_minimum_is_continuous_where_rows_come_and_go() -> None:
    """On straight ways through the problems the active set switches; there, 1e-11
    of the way changes the minimum by next to nothing."""
    switches = 0
    for seed in range(8):
        a, b = (OneSided(2 * seed + k, 6, 20, True, stiffest=30.0) for k in (0, 1))
        rng = np.random.default_rng(seed)
        a.A, b.A = (np.vstack([0.3 * rng.normal(size=(4, 6)), np.eye(6)]),) * 2
        a.b, b.b = 10.0 * rng.normal(size=(2, 10))

        def at(t: float, a=a, b=b) -> tuple[np.ndarray, np.ndarray]:
            between = OneSided(0, 1, 0, False)
            for name in ("A", "b", "rows", "wish"):
                setattr(
                    between, name, (1 - t) * getattr(a, name) + t * getattr(b, name)
                )
            return between.solve()[:2]

        for low, high in zip(np.arange(20) / 20, np.arange(1, 21) / 20, strict=True):
            active = at(low)[1]
            if (at(high)[1] == active).all():
                continue
            while high - low > 1e-11:
                middle = 0.5 * (low + high)
                if (at(middle)[1] == active).all():
                    low = middle
                else:
                    high = middle
            switches += 1
            assert np.abs(at(high)[0] - at(low)[0]).max() < 1e-7
    assert switches > 40


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


@pytest.mark.parametrize("seed", range(30))
def test_the_lowest_on_the_way_is_that_of_a_search(seed: int) -> None:
    """Rows begin and end to be violated on it; one holds alike all the way."""
    rng = np.random.default_rng(seed)
    n, C = rng.integers(1, 6), rng.integers(1, 12)
    root = rng.normal(size=(n, n))
    M, right = root @ root.T + 0.1 * np.eye(n), rng.normal(size=n)
    rows, x = 3.0 * rng.normal(size=(C, n)), rng.normal(size=n)
    wish = rows @ x + rng.choice([-1.0, 0.0, 1.0], C) * rng.uniform(0.0, 3.0, C)

    def value(share: float) -> float:
        y = x + share * way
        short = np.maximum(wish - rows @ y, 0.0)
        return y @ M @ y - 2.0 * right @ y + short @ short

    short = np.maximum(wish - rows @ x, 0.0)
    down = right - M @ x + rows.T @ short
    way = 2.0 * rng.uniform() * down / (down @ down) ** 0.5
    rows[0] -= (rows[0] @ way) / (way @ way) * way  # this one does not change
    wish[0] = rows[0] @ x + 0.5
    # Nor does this one, to the last bit; and it just holds.
    rows, wish = np.vstack([rows, np.zeros(n)]), np.append(wish, 0.0)
    found = _lowest_on_way(M, right, rows, wish, x, way)
    sought = minimize_scalar(value, (0.0, 1.0), tol=1e-10)
    assert found > 0.0
    assert value(found) <= sought.fun + 1e-9 * abs(sought.fun)
    assert found == pytest.approx(sought.x, rel=1e-4)


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


@given(problems)
@settings(max_examples=200, deadline=None)
def test_weight_is_at_least_the_identity_and_at_most_every_rows(
    problem: Problem,
) -> None:
    """I <= W <= W of all rows: the order of the matrices is that of their diagonals.

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


def test_the_step_is_continuous_in_all_that_is_given() -> None:
    """Both stages between random problems: 1e-10 of the way changes s by less than
    1e-6 of what it is, also where the active sets switch."""
    switches = 0
    for seed in range(4):
        a, b = (Problem(seed, 7, 5, 12, 1.0) for _ in (0, 1))
        rng = np.random.default_rng(seed)
        b.v_r, b.a_r = rng.normal(size=5), 30.0 * rng.normal(size=5)
        b.qdot = rng.normal(size=7)

        def at(t: float, a=a, b=b):
            mixed = [
                (1 - t) * getattr(a, name) + t * getattr(b, name)
                for name in ("v_r", "a_r", "qdot")
            ]
            rows = pair_rows(a.h + 0.01 * t, a.g + 0.1 * t, a.drift - 0.1 * t)
            s_0, _, W = nominal_velocity(
                a.J,
                damped_gram(a.J, GAINS),
                *mixed,
                np.zeros(7),
                rows,
                GAINS._replace(nominal_speed_limit=30.0),
                NONE,
                NONE,
            )
            return guard(s_0, rows, np.eye(7)), W

        for low, high in zip(np.arange(12) / 12, np.arange(1, 13) / 12, strict=True):
            here, there = at(low), at(high)
            # Where the diagonal of W jumps, a row was taken up or left.
            while high - low > 1e-10:
                middle = 0.5 * (low + high)
                between = at(middle)
                if (
                    np.abs(here[1] - between[1]).sum()
                    > np.abs(there[1] - between[1]).sum()
                ):
                    high, there = middle, between
                else:
                    low, here = middle, between
            switches += bool(np.abs(here[1] - there[1]).max() > 1e-3)
            moved = np.abs(here[0] - there[0]).max()
            assert moved <= 1e-6 * (1.0 + np.abs(here[0]).max())
    assert switches > 20


def test_no_joint_of_the_wish_is_faster_than_the_fastest() -> None:
    """Scaled as a whole, so that its direction stays."""
    rng = np.random.default_rng(1)
    J, none = np.eye(4), no_rows(4)
    wish = np.array([900.0, -300.0, 20.0, 0.0])
    for target in (wish, 1e-3 * wish, 1e6 * rng.normal(size=4)):
        arguments = J, target, GV * target, np.zeros(4), none
        free = solve(*arguments).s_0
        gains = GAINS._replace(nominal_speed_limit=NOMINAL_SPEED_LIMIT)
        bounded = solve(*arguments, gains=gains).s_0
        np.testing.assert_allclose(
            bounded, free * min(1.0, 16.0 / np.abs(free).max()), rtol=1e-9, atol=1e-12
        )
        assert np.abs(bounded).max() <= 16.0 * (1.0 + 1e-12)


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
    # Of z alone, q_s would approach at this rate; alpha is to make up for it.
    rate = T * GV * g @ qdot_c - 0.1
    alpha = DAMPING**2 * np.linalg.solve(M, pull - row.weight[0] * rate / T * g)
    s_0 = T * (alpha + GV * qdot_c)
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
@settings(max_examples=20, deadline=None)
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


def test_margins_that_weigh_fall_at_once_and_rise_slowly() -> None:
    told = np.array([0.3, 0.01, -2.0, -2.0, 0.1, 0.1, 0.1])  # one row, seven periods
    expected = [0.3, 0.01, -2.0, -2.0, D_MIN + 5e-4, D_MIN + 1e-3, D_MIN + 1.5e-3]
    weighed = np.array([np.inf])
    for h, wanted in zip(told, expected, strict=True):
        weighed = weighed_margins(np.array([h]), weighed, D_MIN, 5e-4)
        assert weighed[0] == pytest.approx(wanted, abs=1e-15)
    # Of rows that were others nothing is known.
    np.testing.assert_array_equal(weighed_margins(told, np.zeros(0), D_MIN, 1.0), told)


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


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_joint_with_one_limit_stops_at_it_and_is_free_otherwise(side: str) -> None:
    sign = -1.0 if side == "lower" else 1.0
    lower = np.array([-1.0 if side == "lower" else -np.inf])
    upper = np.array([np.inf if side == "lower" else 1.0])
    J = np.eye(1)

    def answer(q_s: float, wish: float) -> float:
        rows = limit_rows(lower, upper, np.array([q_s]))
        wish = np.array([wish])
        return solve(J, wish, np.zeros(1), np.zeros(1), rows).s[0]

    free = solve(J, np.ones(1), np.zeros(1), np.zeros(1), no_rows(1)).s[0]
    assert free > 0.9
    assert abs(answer(sign * 0.9985, sign)) < 0.05 * free
    assert sign * answer(sign * 1.05, sign) < -0.9  # beyond it: back, at 20 / s of 0.05
    for q_s in (0.9985, -4.0, -100.0):
        assert sign * answer(sign * q_s, -sign) == pytest.approx(-free, rel=1e-9)
    for q_s in (-4.0, -100.0):
        assert sign * answer(sign * q_s, sign) == pytest.approx(free, rel=1e-9)


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


def test_retreat_is_proportional_to_what_a_margin_lacks_and_capped() -> None:
    h = np.array([-1.0, -0.01, 0.0, 0.004, 0.005, 0.3])
    np.testing.assert_allclose(
        retreat_speed(h, 0.005, 20.0, 0.5, 0.0),
        [0.5, 0.3, 0.1, 0.02, 0.0, 0.0],
        atol=1e-15,
    )
    np.testing.assert_allclose(
        retreat_speed(h, 0.005, 20.0, 0.5, 40.0),
        [0.5, 0.3, 0.1, 0.02, 0.0, -11.8],
        atol=1e-14,
    )


@pytest.mark.parametrize("h", [0.3 - 1e-9, 0.3, 0.4])
def test_pairs_beyond_the_influence_distance_do_not_count(h: float) -> None:
    rows = pair_rows([0.1, h], np.ones((2, 3)), [-0.1, -0.2])
    assert rows.h.tolist() == ([0.1, h] if h < 0.3 else [0.1])
    assert rows.drift.tolist() == ([-0.1, -0.2] if h < 0.3 else [-0.1])
    assert len(rows.g) == len(rows.weight) == len(rows.retreat) == len(rows.h)


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
