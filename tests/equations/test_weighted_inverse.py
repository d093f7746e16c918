"""Eq. (34) against an explicit inverse and against what they minimise."""

import numpy as np
import pytest

from crar_drake.equations.weighted_inverse import (
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


@pytest.mark.parametrize("m, n", SHAPES)
def test_damped_inverse_minimises_the_weighted_damped_square_error(m, n):
    """x = J* y minimises |J x - y|^2 + lambda^2 x^T W x."""
    J, W = random_problem(m, n)
    rng = np.random.default_rng(2)
    y, damping = rng.normal(size=m), 0.3

    def cost(x: np.ndarray) -> float:
        return np.sum((J @ x - y) ** 2) + damping**2 * x @ (W * x)

    x = damped_weighted_pseudo_inverse(J, W, damping) @ y
    gradient = 2 * J.T @ (J @ x - y) + 2 * damping**2 * W * x
    np.testing.assert_allclose(gradient, 0.0, atol=1e-10 * np.abs(2 * J.T @ y).max())
    lowest = cost(x)
    for _ in range(20):
        step = rng.normal(size=n) / np.sqrt(W)
        assert cost(x + 1e-3 * step) > lowest


@pytest.mark.parametrize("m, n", [(4, 7), (4, 4), (7, 4)])
def test_damped_inverse_exists_at_a_singularity(m, n):
    rng = np.random.default_rng(5)
    J = rng.normal(size=(m, 2)) @ rng.normal(size=(2, n))
    for matrix in (J, np.zeros((m, n))):
        J_star = damped_weighted_pseudo_inverse(matrix, np.ones(n), 0.1)
        assert np.isfinite(J_star).all()
        # The largest gain of damped least squares is 1 / (2 lambda).
        assert np.linalg.norm(J_star, 2) <= 1 / 0.2 + 1e-9


@pytest.mark.parametrize("m, n", SHAPES)
def test_an_enormous_weight_stops_its_joint_only(m, n):
    J, _ = random_problem(m, n)
    W = np.ones(n)
    W[0] = 1e12
    J_star = damped_weighted_pseudo_inverse(J, W, 0.1)
    assert np.abs(J_star[0]).max() < 1e-9
    if n == 1:
        return  # no other joint is left
    rest = damped_weighted_pseudo_inverse(J[:, 1:], W[1:], 0.1)
    np.testing.assert_allclose(J_star[1:], rest, atol=1e-8)


def test_the_arguments_are_left_alone():
    for m, n in SHAPES:
        J, W = random_problem(m, n)
        J_before, W_before = J.copy(), W.copy()
        damped_weighted_pseudo_inverse(J, W, 0.1)
        np.testing.assert_array_equal(J, J_before)
        np.testing.assert_array_equal(W, W_before)


def random_full_weight(n: int) -> np.ndarray:
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    return root @ root.T + np.diag(10.0 ** rng.uniform(-1.0, 3.0, n))


@pytest.mark.parametrize("m, n", [(3, 7), (6, 11)])
def test_a_full_weight_matrix_minimises_its_quadratic_form(m, n):
    """min x^T W x with J x = y, by the Karush-Kuhn-Tucker system."""
    J, _ = random_problem(m, n)
    W, y = random_full_weight(n), np.arange(1.0, m + 1.0)
    system = np.block([[W, J.T], [J, np.zeros((m, m))]])
    x = np.linalg.solve(system, np.concatenate([np.zeros(n), y]))[:n]
    np.testing.assert_allclose(
        damped_weighted_pseudo_inverse(J, W, 0.0) @ y, x, rtol=1e-7, atol=1e-10
    )
