"""The filter's faults: what the robot does is simulated, and told as it is."""

import numpy as np
import pytest

from benchmarks.fault_cases import Fault
from benchmarks.filter_faults import (
    PERIOD,
    filter_table,
    make_filter,
    run_filter_fault,
    stated_errors,
)
from crar_drake.simulation.disturbances import Disturbances, Push

E = 0.02


@pytest.fixture(scope="module")
def filter():
    return make_filter(E)


def swing(filter, periods: int) -> np.ndarray:
    """Both elbows and a shoulder to and fro about the rest posture."""
    wanted = np.tile(filter.model.rest_positions(), (periods, 1))
    way = 0.3 * (1.0 - np.cos(2.0 * np.pi * np.arange(periods) * PERIOD))
    wanted[:, filter.joint_names.index("left_shoulder_roll")] += way
    return wanted


def test_errors_are_those_of_stiffness_masses_pushes_and_delays(filter):
    wanted = swing(filter, 60)
    push = Push("right_hand", [0.0, 0.0, 400.0], 0.1, 0.15)
    light, heavy, pushed, late = (
        run_filter_fault(filter, E, wanted, fault, "swing")
        for fault in (
            Fault("light", "", Disturbances(0.2)),
            Fault("heavy", "", Disturbances(2.0)),
            Fault("pushed", "", Disturbances(pushes=[push])),
            Fault("late", late_commands=0.03),
        )
    )
    assert light.error < heavy.error and light.error < pushed.error
    # A lag of 30 ms at up to 1.9 rad/s; E of slides is a tenth.
    assert 1.0 < late.error < 0.03 * 1.9 / E + 1.0
    assert late.joint == "left_shoulder_roll" and late.braked > 0
    assert light.braked == 0 and light.periods == 60 and light.samples == 300
    assert all(o.violated == 0 for o in (light, heavy, pushed, late))
    allowed = stated_errors(filter, E)
    assert set(allowed.round(12)) == {E, 0.1 * E}


def test_noise_beyond_the_error_stops_the_robot(filter):
    wanted = swing(filter, 40)
    noise = Fault("", "", Disturbances(position_noise=0.1))
    noisy = run_filter_fault(filter, E, wanted, noise, "swing")
    assert noisy.braked > 30
    table = filter_table([noisy], E, 0.004)
    assert table.rows[0][4] == f"{noisy.braked} of 40"
    assert table.rows[0][3] == "kept" and "E = 0.02 rad" in table.title
