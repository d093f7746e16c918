"""Eqs. (19)-(26) at contact and inside of it, and what counts as approaching.

Elsewhere they are compared in `tests/acceptance/test_paper_law.py`.
"""

import numpy as np
import pytest

from crar_drake.law.capsule_distances import distance_gradient_about_origin
from crar_drake.law.paper import (
    Gains,
    approach_weights,
    collision_potential_slope,
    collision_proximity,
    constraint_weights,
    limit_potential,
)

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


def test_pair_weight_branches_per_pair_and_joint():
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
