"""Simulated time against the clock: what is due, what is late, what is given up on."""

import pytest

from crar_drake.play.pacing import FASTEST, Pacer


def test_a_step_is_due_when_its_time_has_come():
    pacer = Pacer(100.0)
    assert pacer.wait(100.0, 0.005) == pytest.approx(0.005)
    assert pacer.wait(100.02, 0.005) == pytest.approx(-0.015)
    assert pacer.late(100.02, 0.005) == pytest.approx(0.015)
    assert pacer.late(100.0, 0.005) == 0.0
    pacer.set_speed(0.5, 101.0, 1.0)
    assert pacer.wait(101.0, 1.005) == pytest.approx(0.01)
    pacer.set_speed(1e9, 101.0, 1.0)
    assert pacer.speed == FASTEST


def test_what_is_too_late_is_told_and_not_made_up_for():
    """A simulation at a quarter of real time, seen for 4 s."""
    pacer, now, time = Pacer(0.0), 0.0, 0.0
    waits = []
    while now < 4.0:
        waits.append(pacer.wait(now, time))
        pacer.rate(now, time)
        now, time = now + 0.02, time + 0.005
    assert min(waits) > -0.12  # never a pile of steps that are all due
    assert pacer.behind + pacer.late(now, time) == pytest.approx(3.0, abs=0.02)
    assert pacer.rate(now, time) == pytest.approx(0.25, abs=0.01)
    # A small delay is made up for.
    pacer = Pacer(0.0)
    assert pacer.wait(0.05, 0.0) < 0.0 and pacer.behind == 0.0


def test_a_pause_is_no_delay():
    pacer = Pacer(0.0)
    pacer.set_paused(True, 1.0, 1.0)
    assert pacer.rate(30.0, 1.0) == 0.0
    pacer.set_paused(False, 60.0, 1.0)
    assert pacer.wait(60.0, 1.0) == 0.0 and pacer.behind == 0.0
