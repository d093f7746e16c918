"""The motion's own clock: smooth, and never beyond the motion's ends."""

import numpy as np
import pytest

from crar_drake.play.motion_clock import MotionClock, to_and_fro, turning_time


@pytest.mark.parametrize("goal, ramp", [(1.0, 1.0), (-1.0, 0.4), (0.0, 2.0)])
def test_rate_and_acceleration_are_derivatives(goal, ramp):
    clock = MotionClock(3.0, 1.5, 0.7, -0.4, goal, ramp)
    h = 1e-5
    for time in np.linspace(3.0 + h, 3.0 + 1.5 * ramp, 23):
        (low, r_low, _), (_, rate, change), (high, r_high, _) = (
            clock.at(t) for t in (time - h, time, time + h)
        )
        assert rate == pytest.approx((high - low) / (2 * h), abs=1e-6)
        # The rate is differentiable, but its derivative has a corner at the end.
        assert change == pytest.approx((r_high - r_low) / (2 * h), abs=1e-3)


def test_a_change_begins_as_it_was_and_ends_at_its_goal():
    clock = MotionClock(0.0, 1.0, 0.2, 0.9, 1.0, 1.0)
    for time in (0.3, 0.8, 2.0):
        assert clock.toward(time, -1.0).at(time) == pytest.approx(clock.at(time))
    _, rate, change = clock.toward(0.4, -1.0).at(1.4)
    assert (rate, change) == pytest.approx((-1.0, 0.0))


def test_the_phase_goes_to_and_fro_by_the_clock():
    clock, h = MotionClock(0.0, 1.5, 0.7, -0.4, 1.0, 2.0), 1e-5
    for time in np.linspace(0.1, 6.0, 17):
        (low, r_low, _), (phase, rate, change), (high, r_high, _) = (
            clock.phase(t, 1.7) for t in (time - h, time, time + h)
        )
        assert phase == to_and_fro(clock.at(time)[0], 1.7)[0]
        assert rate == pytest.approx((high - low) / (2 * h), abs=1e-6)
        assert change == pytest.approx((r_high - r_low) / (2 * h), abs=1e-2)


@pytest.mark.parametrize("duration", [0.3, 1.0, 4.0])
def test_to_and_fro_is_smooth_and_stays_in_the_motion(duration):
    h = 1e-5
    ways = np.linspace(-0.1, 9.0 * duration, 1501)
    values = np.array([to_and_fro(u, duration) for u in ways])
    assert 0.0 <= values[:, 0].min() < 0.01 * duration
    assert 0.99 * duration < values[:, 0].max() <= duration
    low, high = (
        np.array([to_and_fro(u + side, duration) for u in ways]) for side in (-h, h)
    )
    slopes = (high - low)[:, :2] / (2.0 * h)
    np.testing.assert_allclose(values[:, 1], slopes[:, 0], atol=1e-7)
    # The second derivative has corners where a turn begins and ends.
    np.testing.assert_allclose(
        values[:, 2], slopes[:, 1], atol=20.0 * h / turning_time(duration) ** 2
    )
    assert to_and_fro(0.0, duration)[:2] == pytest.approx((0.0, 0.0))
    straight = np.abs(values[:, 2]) == 0.0
    assert (np.abs(values[straight, 1]) == 1.0).all() and straight.sum() > 300


def test_it_rests_where_it_is_stopped_and_goes_on_from_there():
    clock = MotionClock()
    assert clock.at(5.0) == (5.0, 1.0, 0.0)
    clock = clock.toward(10.0, 0.0)
    way, *rest = clock.at(11.0)
    assert rest == pytest.approx([0.0, 0.0]) and way == pytest.approx(10.5)
    assert clock.at(50.0)[0] == pytest.approx(way)
    clock = clock.toward(60.0, 1.0).toward(60.5, 0.0)  # while it speeds up
    assert clock.at(60.5)[0] > way
    assert clock.at(70.0)[1:] == pytest.approx((0.0, 0.0))
