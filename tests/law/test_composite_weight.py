"""The weights with the robot's inertia, against mechanics."""

import numpy as np
import pytest

from crar_drake.law.paper import inertia_weight


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
