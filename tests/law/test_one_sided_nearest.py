"""The nearest point that rows allow, by another method than the product's."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from one_sided_least_squares import one_sided_least_squares

from crar_drake.law.one_sided import one_sided_nearest, one_sided_nearest_in
from crar_drake.law.vectors import cholesky


def value(x: np.ndarray, x_0: np.ndarray, rows: np.ndarray, wish: np.ndarray) -> float:
    return ((x - x_0) ** 2).sum() + (np.maximum(0.0, wish - rows @ x) ** 2).sum()


@given(
    seed=st.integers(0, 2**31),
    n=st.integers(1, 29),
    num_rows=st.integers(0, 60),
    parallel=st.booleans(),
    stiff=st.sampled_from([1.0, 1e2, 1e3]),
)
@settings(max_examples=300, deadline=None)
def test_no_other_point_is_better(seed, n, num_rows, parallel, stiff):
    rng = np.random.default_rng(seed)
    x_0 = rng.normal(size=n)
    rows = stiff * rng.normal(size=(num_rows, n)) * (rng.random((num_rows, n)) < 0.5)
    if parallel and num_rows:
        rows[num_rows // 2 :] = rows[: num_rows - num_rows // 2]
    wish = stiff * rng.normal(size=num_rows)
    x = one_sided_nearest(x_0, rows, wish)
    expected, _ = one_sided_least_squares(np.eye(n), x_0, rows, wish)
    best = value(expected, x_0, rows, wish)
    assert value(x, x_0, rows, wish) <= best * (1.0 + 1e-9) + 1e-12


@given(seed=st.integers(0, 2**31), n=st.integers(1, 20), num_rows=st.integers(0, 60))
@settings(max_examples=100, deadline=None)
def test_no_other_point_is_better_in_another_norm(seed, n, num_rows):
    rng = np.random.default_rng(seed)
    x_0, A = rng.normal(size=n), rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-3, 1, n)
    M = A.T @ A + 1e-4 * np.eye(n)
    rows, wish = rng.normal(size=(num_rows, n)), rng.normal(size=num_rows)
    x = one_sided_nearest_in(cholesky(M), x_0, rows, wish)
    up = np.linalg.cholesky(M).T
    expected, _ = one_sided_least_squares(up, up @ x_0, rows, wish)

    def cost(x: np.ndarray) -> float:
        return (x - x_0) @ M @ (x - x_0) + (np.maximum(0.0, wish - rows @ x) ** 2).sum()

    assert cost(x) <= cost(expected) * (1.0 + 1e-8) + 1e-10


def test_by_hand():
    """x >= 1 and x >= 2 of weight 3 from 0: 9 (2 - x) = x; y is left where it is."""
    rows = np.array([[3.0, 0.0], [1.0, 0.0], [-1.0, 0.0]])
    x = one_sided_nearest(np.array([0.0, 7.0]), rows, np.array([6.0, 1.0, -5.0]))
    np.testing.assert_allclose(x, [1.8, 7.0], rtol=1e-12)
    free = np.array([0.5, -0.5])
    np.testing.assert_array_equal(one_sided_nearest(free, rows, np.full(3, -9.0)), free)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_it_comes_to_an_end_whatever_the_numbers(bad):
    rows = np.array([[1.0, 0.0], [bad, 1.0]])
    x = one_sided_nearest(np.zeros(2), rows, np.array([1.0, 1.0]))
    assert x.shape == (2,)


@pytest.mark.parametrize("seed", range(5))
def test_where_many_rows_hold_it_is_the_minimum_too(seed):
    """As among sixty obstacles around a robot: hundreds of rows, of which most hold."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((400, 6))
    x_0, desired = rng.standard_normal(6), rng.normal(0.5, 2.0, 400)
    x = one_sided_nearest(x_0, rows, desired)
    lacks = np.maximum(desired - rows @ x, 0.0)
    assert (lacks > 0.0).sum() > 100
    np.testing.assert_allclose(x - x_0, rows.T @ lacks, rtol=0.0, atol=1e-9)
