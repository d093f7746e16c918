"""The adaptive gain between its two values."""

import numpy as np

from crar_drake.equations.resolved_acceleration import adaptive_gain


def test_gain_is_far_away_near_at_the_constraint_and_monotone_between():
    nearness = np.concatenate([[1.0, 2.0, 4.0], np.logspace(1, 12, 12)])
    gain = adaptive_gain(10.0, 50.0, nearness)
    np.testing.assert_allclose(gain[:3], [10.0, 30.0, 40.0])
    assert (np.diff(gain) > 0.0).all()
    assert abs(gain[-1] - 50.0) < 1e-9


def test_equal_values_are_a_constant_gain():
    np.testing.assert_array_equal(adaptive_gain(30.0, 30.0, np.array([1.0, 7.0])), 30.0)
