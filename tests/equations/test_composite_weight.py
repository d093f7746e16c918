"""Eqs. (27) and (28) at values computed by hand."""

import numpy as np
import pytest

from crar_drake.equations.composite_weight import composite_index, composite_weights


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
