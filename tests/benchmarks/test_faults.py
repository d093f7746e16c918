"""The table of faults: one small run end to end, the rest on made-up results."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.fault_cases import Fault, Moment
from benchmarks.faults import (
    DEFAULTS,
    base_scenario,
    make_faults,
    run_fault,
    under,
)
from crar_drake.run import RunResult, run_scenario
from crar_drake.simulation.disturbances import Disturbances

MOMENT = Moment(3.0, "right_hand", np.array([0.6, 0.0, -0.8]))
HEAVY = Fault("masses +20 %", "exact model", Disturbances(mass_scale=1.2))


@pytest.fixture(scope="module")
def short() -> RunResult:
    """A run without a fault, short enough for a test."""
    return run_scenario(
        replace(base_scenario("boxing", "wrists"), duration=0.6), record=False
    )


def test_fault_end_to_end(short):
    """What the outcome says is what the log of the same run says."""
    scenario = replace(base_scenario("boxing", "wrists"), duration=0.3)
    (outcome,) = run_fault(scenario, HEAVY)
    run = run_scenario(replace(scenario, disturbances=HEAVY.disturbances), record=False)
    assert outcome.where == "boxing wrists"
    assert outcome.remedy is DEFAULTS
    assert outcome.violated == 0
    assert outcome.samples == 301  # every step of the plant, at a period of 5 ms
    assert outcome.smallest_distance == pytest.approx(run.log.signed_distances.min())
    assert outcome.peak_torque == run.summary.peak_torque
    # It is heavier than the model: the hand was not where it is without a fault.
    assert np.abs(run.log.q - short.log.q[:301]).max() > 1e-3


def test_every_fault_is_valid_and_breaks_something():
    scenario = base_scenario("dance", "upper-body")
    made = make_faults(MOMENT)
    assert len({fault.name for fault in made}) == len(made)
    for fault in made:
        assert fault.disturbances != Disturbances()
        under(scenario, fault).validate()
    scales = {fault.disturbances.mass_scale for fault in made}
    assert {0.8, 1.2} <= scales
    late = {(f.disturbances.delay_periods, f.period) for f in made}
    assert {(k, period) for k in (1, 2, 3) for period in (1e-3, 5e-3)} <= late
    pushes = [push for fault in made for push in fault.disturbances.pushes]
    assert len(pushes) >= 3
    for push in pushes:
        assert np.linalg.norm(push.force) == pytest.approx(50.0)
        assert push.duration == 0.2
        assert push.frame == "right_hand"
    jumps = [f.disturbances.target_jump for f in made]
    offsets = [j.offset for j in jumps if j.duration]
    assert [np.linalg.norm(offset) for offset in offsets] == [1.0, 1.0]
    np.testing.assert_array_equal(*[offsets[0], -np.array(offsets[1])])
