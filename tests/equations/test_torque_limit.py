"""The torque limit takes the largest share that it may, judged by brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crar_drake.equations.torque_limit import torque_scale

vectors = arrays(float, 4, elements=st.floats(-50.0, 50.0))
THETA = np.linspace(0.0, 1.0, 2001)


def scale(tau, tau_brake, tau_still, limits, dt_T=0.0):
    return torque_scale(
        np.asarray(tau, float),
        np.asarray(tau_brake, float),
        np.asarray(tau_still, float),
        np.asarray(limits, float),
        period_over_horizon=dt_T,
    )


def torques(tau, tau_brake):
    return tau_brake + THETA[:, None] * (tau - tau_brake)


@settings(max_examples=200, deadline=None)
@given(vectors, vectors, arrays(float, 4, elements=st.floats(1.0, 40.0)))
def test_the_largest_share_within_the_limits(tau, tau_brake, limits):
    # At rest braking is standing still: nothing is to be reserved.
    found = scale(tau, tau_brake, tau_brake, limits)
    allowed = (np.abs(torques(tau, tau_brake)) <= limits).all(axis=1)
    commanded = tau_brake + found.theta * (tau - tau_brake)
    if found.excess == 0.0:
        assert (np.abs(commanded) <= limits * (1 + 1e-6)).all()
    if allowed.any():
        assert found.excess == pytest.approx(0.0, abs=1e-6)
    else:
        worst = np.max(np.abs(torques(tau, tau_brake)) / limits, axis=1).min() - 1.0
        assert found.excess <= worst + 1e-9
        assert found.excess == pytest.approx(worst, abs=0.06)


def test_within_the_limits_all_is_allowed():
    assert scale([3, -4], [0, 0], [0, 0], [5, 5]).theta == 1.0


def test_half_of_it():
    assert scale([10, 0], [0, 0], [0, 0], [5, 5]).theta == pytest.approx(0.5)


def test_unlimited_actuators_do_not_count():
    assert scale([1e6, 1], [0, 0], [0, 0], [np.inf, 5]).theta == 1.0
    assert scale([1e6], [0], [0], [np.inf]).theta == 1.0


def test_not_even_braking_is_within_the_limits():
    found = scale([20.0], [8.0], [8.0], [5.0])
    assert found.theta == 0.0 and found.excess == pytest.approx(0.6)


def test_speed_is_kept_low_enough_to_brake():
    """A mass pushed by a far target under the limit never outruns its brakes."""
    mass, limit, T, dt = 2.0, 10.0, 0.05, 1e-3
    v, fastest = 0.0, 0.0
    for _ in range(3000):
        tau_brake, wish = -mass * v / T, mass * (5.0 - v) / T  # s = 5 m/s
        found = scale([wish], [tau_brake], [0.0], [limit], dt / T)
        tau = tau_brake + found.theta * (wish - tau_brake)
        assert found.excess == 0.0 and abs(tau) <= limit * (1 + 1e-9)
        v += dt * tau / mass
        fastest = max(fastest, v)
    assert mass * fastest / T <= limit  # braking at q_ddot = -q_dot / T is possible
    assert fastest > 0.7 * limit * T / mass  # and it is not needlessly slow
