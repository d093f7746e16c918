"""Eq. (34) against an explicit inverse, and at a singularity."""

import numpy as np
import pytest

from crar_drake.law.paper import (
    damped_inverse,
    inverse_times,
    project_to_null_space,
)

SHAPES = [(3, 7), (6, 11), (6, 6), (7, 4), (21, 11), (1, 1), (3, 1)]


def damped_weighted_pseudo_inverse(J, W, damping: float) -> np.ndarray:
    """J* (n, m) of Eq. (34) as a matrix, from the product's factors."""
    J_star = damped_inverse(J, W, damping)
    return np.array([inverse_times(J_star, e) for e in np.eye(len(J))]).T


def random_problem(m: int, n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A Jacobian and a diagonal W that spans six decades, as near a constraint."""
    rng = np.random.default_rng([seed, m, n])
    return rng.normal(size=(m, n)), 10.0 ** rng.uniform(0.0, 6.0, n)


@pytest.mark.parametrize("full", [False, True], ids=["diagonal", "full"])
@pytest.mark.parametrize("m, n", SHAPES)
def test_products_with_the_damped_inverse_are_those_of_the_printed_matrices(m, n, full):
    """J* x and N zeta = (I - J* J) zeta, which is what the controller uses of J*."""
    J, diagonal = random_problem(m, n)
    W = random_full_weight(n) if full else diagonal
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
        J_star = damped_weighted_pseudo_inverse(matrix, np.ones(n), 0.1)
        assert np.isfinite(J_star).all()
        # The largest gain of damped least squares is 1 / (2 lambda).
        assert np.linalg.norm(J_star, 2) <= 1 / 0.2 + 1e-9


def random_full_weight(n: int) -> np.ndarray:
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    return root @ root.T + np.diag(10.0 ** rng.uniform(-1.0, 3.0, n))
