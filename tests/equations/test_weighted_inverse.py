"""Eqs. (16), (34) against an explicit inverse and against what they minimise."""

import numpy as np
import pytest
from reference_forms import (
    damped_weighted_pseudo_inverse,
    null_space_projector,
    weighted_pseudo_inverse,
)
from scipy.optimize import minimize

from crar_drake.equations.weighted_inverse import (
    damped_inverse,
    inverse_times,
    project_to_null_space,
)

SHAPES = [(3, 7), (6, 11), (6, 6), (7, 4), (21, 11), (1, 1), (3, 1)]
WIDE = [(3, 7), (6, 11), (6, 6), (1, 1)]


def random_problem(m: int, n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A Jacobian and a diagonal W that spans six decades, as near a constraint."""
    rng = np.random.default_rng([seed, m, n])
    return rng.normal(size=(m, n)), 10.0 ** rng.uniform(0.0, 6.0, n)


@pytest.mark.parametrize("m, n", SHAPES)
@pytest.mark.parametrize("damping", [0.1, 1.0])
def test_damped_inverse_is_the_printed_formula(m, n, damping):
    J, W = random_problem(m, n)
    W_inverse = np.linalg.inv(np.diag(W))
    printed = (
        W_inverse @ J.T @ np.linalg.inv(J @ W_inverse @ J.T + damping**2 * np.eye(m))
    )
    np.testing.assert_allclose(
        damped_weighted_pseudo_inverse(J, W, damping), printed, rtol=1e-8, atol=1e-14
    )


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


def test_damped_inverse_is_what_a_numerical_minimiser_finds():
    J, _ = random_problem(4, 6)
    W, y = np.array([1.0, 2.0, 5.0, 1.0, 20.0, 3.0]), np.arange(4.0)
    found = minimize(
        lambda x: np.sum((J @ x - y) ** 2) + 0.04 * x @ (W * x), np.zeros(6), tol=1e-12
    )
    x = damped_weighted_pseudo_inverse(J, W, 0.2) @ y
    np.testing.assert_allclose(x, found.x, atol=1e-5)


@pytest.mark.parametrize("m, n", WIDE)
def test_undamped_inverse_is_a_right_inverse(m, n):
    J, W = random_problem(m, n)
    J_plus = weighted_pseudo_inverse(J, W)
    np.testing.assert_allclose(J @ J_plus, np.eye(m), atol=1e-8)


@pytest.mark.parametrize("m, n", WIDE)
def test_undamped_inverse_gives_the_smallest_weighted_solution(m, n):
    """Of all x with J x = y, x^T W x is least: W x is in the range of J^T."""
    J, W = random_problem(m, n)
    y = np.random.default_rng(3).normal(size=m)
    x = weighted_pseudo_inverse(J, W) @ y
    _, _, Vt = np.linalg.svd(J)
    kernel = Vt[m:]
    scale = np.linalg.norm(W * x)
    np.testing.assert_allclose(kernel @ (W * x) / scale, 0.0, atol=1e-9)


def test_undamped_inverse_with_unit_weight_is_moore_penrose():
    J, _ = random_problem(6, 11)
    np.testing.assert_allclose(
        weighted_pseudo_inverse(J, np.ones(11)), np.linalg.pinv(J), atol=1e-12
    )


def test_undamped_inverse_of_a_square_matrix_is_its_inverse_for_any_weight():
    J, W = random_problem(6, 6)
    np.testing.assert_allclose(
        weighted_pseudo_inverse(J, W), np.linalg.inv(J), rtol=1e-5, atol=1e-8
    )


def test_damped_inverse_tends_to_the_undamped_one():
    J, _ = random_problem(3, 7)
    W = np.linspace(1.0, 9.0, 7)
    limit = weighted_pseudo_inverse(J, W)
    errors = [
        np.abs(damped_weighted_pseudo_inverse(J, W, damping) - limit).max()
        for damping in (1e-2, 1e-3, 1e-4)
    ]
    # The difference is of second order in lambda.
    assert errors[1] == pytest.approx(errors[0] / 100, rel=0.05)
    assert errors[2] == pytest.approx(errors[1] / 100, rel=0.05)


def test_undamped_inverse_refuses_a_jacobian_without_full_row_rank():
    rng = np.random.default_rng(4)
    deficient = rng.normal(size=(4, 2)) @ rng.normal(size=(2, 7))
    tall = rng.normal(size=(7, 4))
    for J in (deficient, tall, np.zeros((2, 3))):
        with pytest.raises(np.linalg.LinAlgError):
            weighted_pseudo_inverse(J, np.ones(J.shape[1]))


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


def test_null_space_projector_leaves_the_tasks_alone_when_undamped():
    J, _ = random_problem(3, 7)
    W = np.linspace(1.0, 9.0, 7)
    N = null_space_projector(J, weighted_pseudo_inverse(J, W))
    np.testing.assert_allclose(J @ N, 0.0, atol=1e-12)
    np.testing.assert_allclose(N @ N, N, atol=1e-12)  # a projector
    assert np.trace(N) == pytest.approx(4.0)  # onto n - m dimensions


def test_null_space_projector_keeps_motion_that_is_in_the_null_space():
    J, W = random_problem(3, 7)
    N = null_space_projector(J, damped_weighted_pseudo_inverse(J, W, 0.1))
    kernel = np.linalg.svd(J)[2][3:].T
    np.testing.assert_allclose(N @ kernel, kernel, atol=1e-10)


def random_full_weight(n: int) -> np.ndarray:
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    return root @ root.T + np.diag(10.0 ** rng.uniform(-1.0, 3.0, n))


@pytest.mark.parametrize("m, n", SHAPES)
def test_a_full_weight_matrix_gives_the_printed_formula(m, n):
    J, _ = random_problem(m, n)
    W = random_full_weight(n)
    inverse = np.linalg.inv(W)
    printed = inverse @ J.T @ np.linalg.inv(J @ inverse @ J.T + 0.01 * np.eye(m))
    np.testing.assert_allclose(
        damped_weighted_pseudo_inverse(J, W, 0.1), printed, rtol=1e-8, atol=1e-11
    )


@pytest.mark.parametrize("m, n", SHAPES)
def test_a_diagonal_matrix_is_its_diagonal(m, n):
    J, W = random_problem(m, n)
    np.testing.assert_allclose(
        damped_weighted_pseudo_inverse(J, np.diag(W), 0.1),
        damped_weighted_pseudo_inverse(J, W, 0.1),
        rtol=1e-8,
        atol=1e-14,
    )


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
