"""Weights and bridges: what they promise, for random samples."""

import numpy as np
import pytest

from crar_drake.motion.smooth_steps import (
    bridge,
    smooth_flags,
    smooth_step,
    soft_positive,
)


def test_a_step_has_no_slope_and_no_curvature_at_its_ends():
    h = 1e-4
    for end, value in ((0.0, 0.0), (1.0, 1.0)):
        s = end + h * np.array([-1.0, 0.0, 1.0])
        before, at, after = smooth_step(s)
        assert at == pytest.approx(value, abs=1e-12)
        assert abs(after - before) / (2 * h) < 1e-6
        assert abs(after - 2 * at + before) / h**2 < 1e-2


@pytest.mark.parametrize("margin", [1, 5, 30])
def test_flags_are_one_where_set_and_zero_far_away(margin):
    rng = np.random.default_rng(margin)
    flags = np.repeat(rng.random(40) < 0.2, 15)
    weights = smooth_flags(flags, margin)
    assert (weights[flags] == 1.0).all()
    away = np.abs(np.arange(600)[:, None] - np.flatnonzero(flags)).min(axis=1)
    assert (weights[away > margin] == 0.0).all()
    assert (weights >= 0.0).all() and (weights <= 1.0).all()
    assert not smooth_flags(np.zeros(7, dtype=bool), margin).any()


def test_soft_positive_is_above_both_its_asymptotes():
    x = np.linspace(-1.0, 1.0, 401)
    y = soft_positive(x, 0.01)
    assert (y > np.maximum(x, 0.0)).all()
    np.testing.assert_allclose(y[[0, -1]], [0.0, 1.0], atol=1e-4)
    assert (np.diff(y) > 0.0).all()


def test_a_bridge_keeps_values_and_slopes():
    rate = 100.0
    t = np.arange(300) / rate
    values = np.column_stack([np.sin(3.0 * t), 0.2 * t])
    known = (t < 0.8) | (t > 1.9)
    known[:20] = known[-30:] = False
    filled = bridge(values, known, rate, 0.15)
    np.testing.assert_array_equal(filled[known], values[known])
    # Slopes do not jump: each dies out within 0.15 s.
    largest = np.abs(np.diff(values, axis=0)).max()
    assert np.abs(np.diff(filled, 2, axis=0)).max() < 6.0 * largest / (0.15 * rate)
    np.testing.assert_allclose(filled[0], filled[3], atol=0.05)
    assert not bridge(values, np.zeros(300, dtype=bool), rate, 0.1).any()
