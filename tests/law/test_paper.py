"""The paper's equations (16)-(28), (31), (34) at their edges: at and beyond limits, in
contact, in narrow ranges, at singularities; and the weight with the robot's inertia.

Elsewhere they are compared in `tests/acceptance/test_paper_law.py`.
"""

import numpy as np
import pytest

from crar_drake.law.capsule_distances import distance_gradient_about_origin
from crar_drake.law.paper import (
    LIMIT_CLAMP,
    Gains,
    approach_weights,
    collision_potential_slope,
    collision_proximity,
    constraint_weights,
    damped_inverse,
    inertia_weight,
    inverse_times,
    limit_gradient,
    limit_potential,
    limit_proximity,
    project_to_null_space,
)

# --- joint limits: (17), (18)

LOWER, UPPER = np.array([-0.7]), np.array([1.9])


def joint_limit_gradient(q, lower, upper) -> np.ndarray:
    return limit_gradient(q, limit_potential(lower, upper))


def joint_limit_proximity(q, lower, upper) -> np.ndarray:
    limits = limit_potential(lower, upper)
    return limit_proximity(q, limit_gradient(q, limits), limits)


def gradient_at(q) -> np.ndarray:
    q = np.atleast_1d(np.asarray(q, dtype=float))
    return joint_limit_gradient(q, np.full(q.shape, LOWER), np.full(q.shape, UPPER))


def proximity_at(q) -> np.ndarray:
    q = np.atleast_1d(np.asarray(q, dtype=float))
    return joint_limit_proximity(q, np.full(q.shape, LOWER), np.full(q.shape, UPPER))


def weight_of_move(q_before: float, q_now: float) -> float:
    """W_JL of one joint that went from q_before to q_now in one step."""
    W = approach_weights(
        gradient_at(q_now), proximity_at(q_now), proximity_at(q_before)
    )
    return W[0]


@pytest.mark.parametrize(
    "lower, upper",
    [(-np.inf, np.inf), (-np.inf, 1.0), (-1.0, np.inf)],
)
@pytest.mark.parametrize("q", [0.0, 1.0, -1.0, 100.0, -1e6])
def test_unlimited_joints_weigh_nothing(lower, upper, q):
    """A limit on one side only has no range for Eq. (17): it counts as unlimited."""
    q, lower, upper = np.array([q]), np.array([lower]), np.array([upper])
    assert joint_limit_gradient(q, lower, upper) == 0.0
    assert joint_limit_proximity(q, lower, upper) == 0.0
    W = approach_weights(np.zeros(1), np.zeros(1), np.zeros(1))
    assert W == 1.0


def test_gradient_is_finite_and_monotone_through_both_limits():
    inside = np.geomspace(1e-12, 0.5, 200)
    q = np.sort(
        np.r_[LOWER - inside, LOWER, LOWER + inside, UPPER - inside, UPPER,
              UPPER + inside, LOWER - 100, UPPER + 100]
    )  # fmt: skip
    gradient = gradient_at(q)
    assert np.isfinite(gradient).all()
    assert (np.diff(gradient) >= 0.0).all()
    assert gradient[0] < -1e6 and gradient[-1] > 1e6


@pytest.mark.parametrize("past", [0.0, 1e-9, 1e-5, 0.1, 3.0])
def test_beyond_a_limit_it_is_the_value_just_inside(past):
    np.testing.assert_allclose(
        gradient_at(UPPER + past), gradient_at(UPPER - LIMIT_CLAMP), rtol=1e-9
    )
    np.testing.assert_allclose(
        gradient_at(LOWER - past), gradient_at(LOWER + LIMIT_CLAMP), rtol=1e-9
    )


@pytest.mark.parametrize("span", [0.0, 1e-300, 1e-12, 1e-7, 1e-4, 3e-4, 1e-3])
def test_narrow_ranges_and_equal_limits_stay_finite(span):
    lower = np.full(601, 0.3)
    q = 0.3 + 0.5 * span + np.linspace(-1e-3, 1e-3, 601)
    gradient = joint_limit_gradient(q, lower, lower + span)
    proximity = joint_limit_proximity(q, lower, lower + span)
    assert np.isfinite(gradient).all() and np.isfinite(proximity).all()
    assert (np.diff(gradient) >= 0.0).all()
    assert gradient[0] < -1e3 and gradient[-1] > 1e3


@pytest.mark.parametrize(
    "span, effective", [(0.0, 1e-4), (5e-5, 1e-4), (1e-4, 1e-4), (2e-4, 2e-4)]
)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_narrow_range_is_clamped_at_a_quarter_of_it(span, effective, sign):
    """Eq. (17) at a quarter of the range r from a limit is 32 / (9 r); a range narrower
    than a clamp counts as one as wide, about the same middle."""
    assert LIMIT_CLAMP == 1e-4
    middle = 0.3
    lower, upper = np.array([middle - 0.5 * span]), np.array([middle + 0.5 * span])

    def gradient(offset: float) -> float:
        q = np.array([middle + sign * offset])
        return sign * joint_limit_gradient(q, lower, upper)[0]

    at_clamp = 32.0 / (9.0 * effective)
    for offset in (0.25, 0.3, 0.5, 1.0, 1e5):
        assert gradient(offset * effective) == pytest.approx(at_clamp, rel=1e-9)
    # Further inside it is Eq. (17) as printed: r^2 2x / (4 (r^2/4 - x^2)^2).
    for share in (0.2, 0.1, 0.0):
        x, r = share * effective, effective
        printed = r**2 * 2.0 * x / (4.0 * (0.25 * r**2 - x**2) ** 2)
        assert gradient(x) == pytest.approx(printed, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("span", [3.9e-4, 4e-4, 4.1e-4, 1e-3])
def test_the_clamp_is_a_quarter_of_the_range_or_its_own_width(span):
    """Whichever is less: on both sides of four clamps, from the printed formula."""
    lower, upper = np.array([0.0]), np.array([span])
    clamp = 0.25 * span if span < 4e-4 else 1e-4
    rest = span - clamp
    printed = span**2 * (rest - clamp) / (4 * clamp**2 * rest**2)
    beyond = joint_limit_gradient(upper + 1.0, lower, upper)
    np.testing.assert_allclose(beyond, printed, rtol=1e-9)
    np.testing.assert_allclose(
        joint_limit_gradient(lower - 1.0, lower, upper), -printed
    )
    # Beyond the clamp, the proximity grows by one gradient per LIMIT_CLAMP.
    past = upper - clamp + 3.0 * LIMIT_CLAMP
    np.testing.assert_allclose(
        joint_limit_proximity(past, lower, upper), 4.0 * printed, rtol=1e-9
    )


def test_proximity_grows_strictly_outwards_without_a_jump():
    out = np.r_[np.linspace(-0.5, -2e-4, 200), np.linspace(-2e-4, 2e-4, 400)[1:],
                np.linspace(2e-4, 2.0, 200)[1:]]  # fmt: skip
    for proximity in (proximity_at(UPPER + out), proximity_at(LOWER - out)):
        assert np.isfinite(proximity).all()
        assert (np.diff(proximity) > 0.0).all()
    step = 1e-12
    for edge in (UPPER - LIMIT_CLAMP, LOWER + LIMIT_CLAMP):
        ratio = proximity_at(edge + step) / proximity_at(edge - step)
        assert ratio == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    "q_before, q_now, approaching",
    [
        (1.5, 1.6, True),
        (1.6, 1.5, False),
        (-0.3, -0.4, True),
        (-0.4, -0.3, False),
        (1.6, 1.6, True),
        (1.89, 1.95, True),  # over the limit in one step
        (1.95, 2.0, True),  # further out
        (2.0, 1.95, False),  # coming back, still outside
        (1.95, 1.89, False),  # back inside in one step
        (1.89999, 1.89995, False),  # within the clamp
        (1.89995, 1.89999, True),
        (-0.75, -0.8, True),
        (-0.8, -0.75, False),
    ],
)
def test_weight_of_a_move(q_before, q_now, approaching):
    expected = 1.0 + abs(gradient_at(q_now)[0]) if approaching else 1.0
    assert weight_of_move(q_before, q_now) == pytest.approx(expected)
    assert expected > 1.0 or not approaching


# --- pairs: (20)-(26)

PAPER = {"rho": 1.0, "alpha": 50.0, "beta": 2.0}


@pytest.mark.parametrize("d", [1e-3, 5e-4, 1e-12, 0.0, -1e-12, -1e-3, -0.3])
def test_slope_at_contact_and_inside_is_that_of_one_millimetre(d):
    """rho = 1: -e^-0.05 * 1e6 * (2000 + 50)."""
    slope = collision_potential_slope(np.array([d]), **PAPER)
    np.testing.assert_allclose(slope, -np.exp(-0.05) * 1e6 * 2050.0, rtol=1e-12)


def test_slope_is_finite_negative_and_monotone():
    d = np.linspace(-0.5, 2.0, 2501)
    slope = collision_potential_slope(d, **PAPER)
    assert np.isfinite(slope).all()
    assert (slope <= 0.0).all()
    assert (np.diff(slope) >= 0.0).all()


def test_distance_gradient_about_origin_is_that_of_the_witness_points():
    """Each point's Jacobian, column by column: J_v + J_omega x p, for witness points
    at different places of the line, each on its own link."""
    rng = np.random.default_rng(4)
    count, n = 7, 5
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    p_a = rng.normal(size=(count, 3))
    p_b = p_a - rng.normal(size=(count, 1)) * normal
    S = rng.normal(size=(6, n))
    carries_a, carries_b = rng.integers(2, size=(2, count, n)).astype(float)
    expected = np.empty((count, n))
    for j, i in np.ndindex(count, n):
        omega, v = S[:3, i], S[3:, i]
        v_a = carries_a[j, i] * (v + np.cross(omega, p_a[j]))
        v_b = carries_b[j, i] * (v + np.cross(omega, p_b[j]))
        expected[j, i] = normal[j] @ (v_a - v_b)
    moves = carries_a - carries_b
    for point in (p_a, p_b):
        np.testing.assert_allclose(
            distance_gradient_about_origin(normal, point, S, moves),
            expected,
            atol=1e-13,
        )


def test_proximity_grows_strictly_with_depth_without_a_jump():
    d = np.linspace(0.02, -0.2, 2000)
    slope = collision_potential_slope(d, **PAPER)
    proximity = collision_proximity(slope[:, None] * np.array([0.3, -0.2]), d)
    assert np.isfinite(proximity).all()
    assert (np.diff(proximity, axis=0) > 0.0).all()
    # One millimetre further in adds the value at the clamp once more.
    at = collision_proximity(np.array([[2.0]]), np.array([0.0]))
    assert at.item() == pytest.approx(4.0)


def test_weights_branch_per_constraint_and_joint():
    """Approaching, unchanged (counts as approaching), leaving."""
    gradient = np.array([[2.0, -3.0, 4.0], [-4.0, 3.0, -2.0]])
    previous = np.array([[1.9, 3.0, 4.1], [4.1, 3.0, 1.9]])
    W = approach_weights(gradient, np.abs(gradient), previous)
    np.testing.assert_array_equal(W, [[3.0, 4.0, 1.0], [1.0, 4.0, 3.0]])


@pytest.mark.parametrize(
    "d_before, d_now, approaching",
    [
        (0.05, 0.04, True),
        (0.04, 0.05, False),
        (2e-3, -1e-3, True),  # into the other segment in one step
        (-1e-3, -2e-3, True),  # deeper
        (-2e-3, -1e-3, False),  # coming out, still inside
        (-1e-3, 2e-3, False),  # out in one step
        (5e-4, 4e-4, True),  # within the clamp
        (4e-4, 5e-4, False),
    ],
)
def test_pair_weight_of_a_move(d_before, d_now, approaching):
    dd_dq = np.array([[0.3, -0.2]])

    def at(d: float) -> tuple[np.ndarray, np.ndarray]:
        d = np.array([d])
        gradient = collision_potential_slope(d, **PAPER)[:, None] * dd_dq
        return gradient, collision_proximity(gradient, d)

    gradient, proximity = at(d_now)
    W = approach_weights(gradient, proximity, at(d_before)[1])
    expected = 1.0 + np.abs(gradient) if approaching else np.ones((1, 2))
    np.testing.assert_array_equal(W, expected)


def test_without_pairs_only_the_limits_weigh():
    q, limits = np.array([0.1, 0.9]), limit_potential(-np.ones(2), np.ones(2))
    gains = Gains(0.1, 10.0, 10.0, *PAPER.values(), 0.3, 0.01, False)
    none, before = np.zeros((0, 2)), np.zeros(2)
    W, *_ = constraint_weights(q, np.zeros(0), none, before, none, limits, gains)
    # Eq. (17): 4 (2 q) / (4 (1 - q^2)^2) between -1 and 1.
    np.testing.assert_allclose(W, 1.0 + 0.3 * 2.0 * q / (1.0 - q**2) ** 2)


# --- the inertia as a weight


def random_inertia(n: int, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    return 1e-2 * root @ root.T + 1e-3 * np.eye(n)


def test_inertia_weight_without_constraints_is_the_inertia_of_determinant_one():
    H = random_inertia(5)
    W = inertia_weight(H, np.ones(5))
    assert np.linalg.det(W) == pytest.approx(1.0)
    np.testing.assert_allclose(W / W[0, 0], H / H[0, 0], rtol=1e-12)
    # Whatever the unit of the inertia.
    np.testing.assert_allclose(inertia_weight(1e4 * H, np.ones(5)), W, rtol=1e-12)


def test_inertia_weight_is_positive_definite_at_any_constraint():
    rng = np.random.default_rng(4)
    for seed in range(20):
        constraints = 1.0 + 10.0 ** rng.uniform(-6.0, 9.0, 6)
        W = inertia_weight(random_inertia(6, seed), constraints)
        np.testing.assert_allclose(W, W.T, rtol=1e-12)
        np.linalg.cholesky(W)


def test_inertia_weight_of_a_stopped_joint_is_that_of_the_robot_with_it_locked():
    """W^-1 then has no row for it, and elsewhere the inverse of H without it."""
    H = random_inertia(4)
    W = inertia_weight(H, np.array([1.0, 1e12, 1.0, 1.0]))
    others = [0, 2, 3]
    locked = np.zeros((4, 4))
    locked[np.ix_(others, others)] = np.linalg.inv(H[np.ix_(others, others)])
    scale = np.linalg.det(H) ** 0.25
    np.testing.assert_allclose(
        np.linalg.inv(W) / scale, locked, rtol=1e-6, atol=1e-6 * locked.max()
    )


# --- the damped inverse: (16), (31), (34)

SHAPES = [(3, 7), (6, 11), (6, 6), (7, 4), (21, 11), (1, 1), (3, 1)]


@pytest.mark.parametrize("full", [False, True], ids=["diagonal", "full"])
@pytest.mark.parametrize("m, n", SHAPES)
def test_products_with_the_damped_inverse_are_those_of_the_printed_matrices(m, n, full):
    """J* x and N zeta = (I - J* J) zeta, which is what the controller uses of J*."""
    rng = np.random.default_rng([1, m, n])
    J, W = rng.normal(size=(m, n)), 10.0 ** rng.uniform(0.0, 6.0, n)
    if full:
        W = 1e2 * random_inertia(n) + np.diag(10.0 ** rng.uniform(-1.0, 3.0, n))
    inverse = np.linalg.inv(W if full else np.diag(W))
    printed = inverse @ J.T @ np.linalg.inv(J @ inverse @ J.T + 0.01 * np.eye(m))
    J_star = damped_inverse(J, W, 0.1)
    vectors = np.random.default_rng(9).normal(size=(m, n))
    for x, zeta in zip(np.eye(m), vectors, strict=True):
        np.testing.assert_allclose(
            inverse_times(J_star, x), printed @ x, rtol=1e-8, atol=1e-11
        )
        np.testing.assert_allclose(
            project_to_null_space(J_star, J, zeta),
            (np.eye(n) - printed @ J) @ zeta,
            rtol=1e-8,
            atol=1e-8,
        )


@pytest.mark.parametrize("m, n", [(4, 7), (4, 4), (7, 4)])
def test_damped_inverse_exists_at_a_singularity(m, n):
    rng = np.random.default_rng(5)
    J = rng.normal(size=(m, 2)) @ rng.normal(size=(2, n))
    for matrix in (J, np.zeros((m, n))):
        factors = damped_inverse(matrix, np.ones(n), 0.1)
        J_star = np.array([inverse_times(factors, e) for e in np.eye(m)])
        assert np.isfinite(J_star).all()
        # The largest gain of damped least squares is 1 / (2 lambda).
        assert np.linalg.norm(J_star, 2) <= 1 / 0.2 + 1e-9
