"""Eqs. (9) and (14): what the error does when the reference is realised."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from crar_drake.equations.references import (
    reference_acceleration,
    reference_velocity,
)


def target(t: float) -> tuple[float, float, float]:
    """A moving target with its derivatives."""
    return np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)


def test_velocity_reference_makes_the_error_decay_exponentially():
    """x_dot = v_d + K (x_d - x) gives e(t) = e(0) exp(-K t)."""

    def x_dot(t, x):
        x_d, v_d, _ = target(t)
        return reference_velocity(np.array([v_d]), x_d - x, 30.0)

    run = solve_ivp(x_dot, (0.0, 0.1), [0.5], rtol=1e-10, atol=1e-12)
    e = target(0.1)[0] - run.y[0, -1]
    assert e == pytest.approx(-0.5 * np.exp(-3.0), rel=1e-7)


def test_acceleration_reference_gives_a_second_order_error():
    """x_dd = a_r gives e_dd + Kv e_d + Kp e = 0, solved by a matrix exponential."""
    Kp, Kv = 300.0, 7.0

    def rate(t, y):
        x_d, v_d, a_d = target(t)
        x, v = y[:1], y[1:]
        a_r = reference_acceleration(np.array([a_d]), v_d, v, x_d - x, Kp, Kv)
        return np.r_[v, a_r]

    run = solve_ivp(rate, (0.0, 0.2), [0.5, 1.0], rtol=1e-10, atol=1e-12)
    e_0 = np.array([0.0 - 0.5, 3.0 - 1.0])
    x_d, v_d, _ = target(0.2)
    expected = expm(0.2 * np.array([[0.0, 1.0], [-Kp, -Kv]])) @ e_0
    actual = np.array([x_d, v_d]) - run.y[:, -1]
    np.testing.assert_allclose(actual, expected, rtol=1e-6)


def test_gains_may_differ_by_row():
    one = np.ones(2)
    gains = np.array([10.0, 20.0])
    np.testing.assert_array_equal(reference_velocity(one, 2 * one, gains), [21.0, 41.0])
    np.testing.assert_array_equal(
        reference_acceleration(one, 3 * one, one, 2 * one, gains, 0.1 * gains),
        [1 + 2 + 20, 1 + 4 + 40],
    )
