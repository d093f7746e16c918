"""Eqs. (19)-(26): finite differences, values by hand, a planar arm of our own."""

import numpy as np
import pytest

from crar_drake.equations.collisions import (
    DISTANCE_CLAMP,
    collision_gradient,
    collision_potential_slope,
    collision_proximity,
    collision_weights,
    distance_gradient_about_origin,
    pair_weights,
)

PAPER = {"rho": 1.0, "alpha": 50.0, "beta": 2.0}
LENGTHS = (0.4, 0.3, 0.25)
OBSTACLE = np.array([0.55, 0.35, 0.0])


def tip_and_middle(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forward kinematics of a planar arm: the tip, and the first link's middle."""
    phi = np.cumsum(q)
    steps = np.array(
        [[length * np.cos(a), length * np.sin(a), 0.0]
         for length, a in zip(LENGTHS, phi, strict=True)]
    )  # fmt: skip
    return steps.sum(axis=0), 0.5 * steps[0]


def jacobians(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Translational Jacobians of both points by z x (point - joint)."""
    phi = np.cumsum(q)
    joints, p = [], np.zeros(3)
    for length, a in zip(LENGTHS, phi, strict=True):
        joints.append(p)
        p = p + length * np.array([np.cos(a), np.sin(a), 0.0])
    tip, middle = tip_and_middle(q)
    z = np.array([0.0, 0.0, 1.0])
    J_tip = np.column_stack([np.cross(z, tip - joint) for joint in joints])
    J_middle = np.zeros((3, 3))
    J_middle[:, 0] = np.cross(z, middle)
    return J_tip, J_middle


def arm_pairs(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distances, normals and Jacobians of (tip, middle) and (tip, obstacle)."""
    tip, middle = tip_and_middle(q)
    J_tip, J_middle = jacobians(q)
    gaps = np.array([tip - middle, tip - OBSTACLE])
    d = np.linalg.norm(gaps, axis=1)
    return (
        d,
        gaps / d[:, None],
        np.array([J_tip, J_tip]),
        np.array([J_middle, np.zeros((3, 3))]),
    )


def collision_potential(d, rho, alpha, beta) -> np.ndarray:
    """Eqs. (22), (24), of which the product needs the slope only."""
    return rho * np.exp(-alpha * d) * d**-beta


def distance_gradient(normal, J_a, J_b) -> np.ndarray:
    """Eq. (20), with n = (p_a - p_b) / d: n^T (J_a - J_b)."""
    return np.einsum("ci,cin->cn", normal, J_a - J_b)


def difference_quotients(function, q: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """Columns d function / d q_i by central differences."""
    steps = h * np.eye(len(q))
    return np.column_stack(
        [(function(q + step) - function(q - step)) / (2 * h) for step in steps]
    )


def test_slope_at_values_computed_by_hand():
    """d = 0.1: -e^-5 * 100 * (20 + 50); d = 0.02: -e^-1 * 2500 * (100 + 50)."""
    np.testing.assert_allclose(
        collision_potential_slope(np.array([0.1, 0.02]), **PAPER),
        [-47.1656289935983, -137954.790439291],
        rtol=1e-12,
    )


def test_slope_is_the_derivative_of_the_potential():
    rng = np.random.default_rng(1)
    d = rng.uniform(2e-3, 1.0, 200)
    rho, alpha = rng.uniform(0.1, 3.0, 200), rng.uniform(1.0, 80.0, 200)
    beta = rng.uniform(0.5, 3.0, 200)
    h = 1e-5 * d
    quotient = (
        collision_potential(d + h, rho, alpha, beta)
        - collision_potential(d - h, rho, alpha, beta)
    ) / (2 * h)
    np.testing.assert_allclose(
        collision_potential_slope(d, rho, alpha, beta), quotient, rtol=1e-6
    )


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
    at different places of the line, each on its own link; two configurations."""
    rng = np.random.default_rng(4)
    K, count, n = 2, 7, 5
    normal = rng.normal(size=(K, count, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    p_a = rng.normal(size=(K, count, 3))
    p_b = p_a - rng.normal(size=(K, count, 1)) * normal
    S = rng.normal(size=(K, 6, n))
    carries_a, carries_b = rng.integers(2, size=(2, count, n)).astype(float)
    expected = np.empty((K, count, n))
    for k, j, i in np.ndindex(K, count, n):
        omega, v = S[k, :3, i], S[k, 3:, i]
        v_a = carries_a[j, i] * (v + np.cross(omega, p_a[k, j]))
        v_b = carries_b[j, i] * (v + np.cross(omega, p_b[k, j]))
        expected[k, j, i] = normal[k, j] @ (v_a - v_b)
    moves = carries_a - carries_b
    for point in (p_a.reshape(-1, 3), p_b.reshape(-1, 3)):
        np.testing.assert_allclose(
            distance_gradient_about_origin(normal.reshape(-1, 3), point, S, moves),
            expected,
            atol=1e-13,
        )


def test_collision_gradient_is_the_derivative_of_the_potential_by_q():
    rng = np.random.default_rng(5)
    for q in rng.uniform(-1.2, 1.2, (20, 3)):
        d, normal, J_a, J_b = arm_pairs(q)
        if d.min() < 0.02:
            continue
        gradient = collision_gradient(
            collision_potential_slope(d, **PAPER), distance_gradient(normal, J_a, J_b)
        )
        expected = difference_quotients(
            lambda x: collision_potential(arm_pairs(x)[0], **PAPER), q, h=1e-7
        )
        scale = np.abs(expected).max(axis=1, keepdims=True)
        np.testing.assert_allclose(gradient / scale, expected / scale, atol=1e-6)


def test_proximity_is_the_gradients_magnitude_down_to_the_clamp():
    gradient = np.array([[3.0, -4.0], [-5.0, 0.0]])
    proximity = collision_proximity(gradient, np.array([0.2, DISTANCE_CLAMP]))
    np.testing.assert_array_equal(proximity, np.abs(gradient))


def test_proximity_grows_strictly_with_depth_without_a_jump():
    d = np.linspace(0.02, -0.2, 2000)
    slope = collision_potential_slope(d, **PAPER)
    proximity = collision_proximity(slope[:, None] * np.array([0.3, -0.2]), d)
    assert np.isfinite(proximity).all()
    assert (np.diff(proximity, axis=0) > 0.0).all()
    # One millimetre further in adds the value at the clamp once more.
    at = collision_proximity(np.array([[2.0]]), np.array([0.0]))
    assert at.item() == pytest.approx(4.0)


def test_first_step_counts_as_approaching():
    gradient = np.array([[2.0, -3.0], [0.0, 4.0]])
    W = pair_weights(gradient, np.abs(gradient), np.zeros((2, 2)))
    np.testing.assert_array_equal(W, [[3.0, 4.0], [1.0, 5.0]])


def test_pair_weight_branches_per_pair_and_joint():
    """Approaching, unchanged (counts as approaching), leaving."""
    gradient = np.array([[2.0, -3.0, 4.0], [-4.0, 3.0, -2.0]])
    previous = np.array([[1.9, 3.0, 4.1], [4.1, 3.0, 1.9]])
    W = pair_weights(gradient, np.abs(gradient), previous)
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
        gradient = collision_gradient(collision_potential_slope(d, **PAPER), dd_dq)
        return gradient, collision_proximity(gradient, d)

    gradient, proximity = at(d_now)
    W = pair_weights(gradient, proximity, at(d_before)[1])
    expected = 1.0 + np.abs(gradient) if approaching else np.ones((1, 2))
    np.testing.assert_array_equal(W, expected)


def test_collision_weights_are_the_mean_over_all_pairs():
    W_COL_j = np.array([[1.0, 4.0], [1.0, 1.0], [7.0, 1.0]])
    np.testing.assert_allclose(collision_weights(W_COL_j), [3.0, 2.0])


def test_without_pairs_nothing_is_weighed():
    none = np.empty((0, 4))
    d = np.empty(0)
    slope = collision_potential_slope(d, **PAPER)
    gradient = collision_gradient(slope, none)
    proximity = collision_proximity(gradient, d)
    for previous in (none, proximity):
        W_COL_j = pair_weights(gradient, proximity, previous)
        np.testing.assert_array_equal(collision_weights(W_COL_j), np.ones(4))
