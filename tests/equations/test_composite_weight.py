"""Eqs. (27) and (28) at values computed by hand; the inertia against mechanics."""

import numpy as np
import pytest

from crar_drake.equations.composite_weight import (
    composite_index,
    composite_weights,
    inertia_weight,
)


@pytest.mark.parametrize("num_pairs, a", [(0, 1.0), (1, 0.5), (30, 1 / 31)])
def test_index(num_pairs, a):
    assert composite_index(num_pairs) == pytest.approx(a)


def test_weights_are_the_weighted_mean():
    W = composite_weights(np.array([2.0, 1.0]), np.array([10.0, 1.0]), 0.25)
    np.testing.assert_allclose(W, [8.0, 1.0])


def test_without_pairs_only_the_limits_count():
    W_JL = np.array([3.0, 5.0])
    np.testing.assert_array_equal(
        composite_weights(W_JL, np.ones(2), composite_index(0)), W_JL
    )


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
