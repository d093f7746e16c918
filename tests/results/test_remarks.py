"""What is called bad about a run: on both sides of every threshold."""

import numpy as np
import pytest
from small_logs import small_log

from crar_drake.results.controlled_joints import controlled_joints
from crar_drake.results.limb_directions import LimbDirection
from crar_drake.results.remarks import remarks
from crar_drake.results.summary import summarize


def found(lowest=None, limbs=None, **changes) -> str:
    """Of a run that is bad in nothing but the changes."""
    good = {
        "actuation": np.zeros((3, 3)),
        "torque_limit": np.tile([1.0, 0.0], (3, 1)),
        "q": np.array([[9.0, 0.5, 0.0]] * 3),
    }
    log = small_log(**(good | changes))
    summary = summarize(log)
    share = summary.torque_limited_samples / summary.samples
    return "\n".join(remarks(controlled_joints(log), share, limbs or {}, lowest))


def test_a_good_run_has_no_remark():
    assert found() == ""
    assert summarize(small_log()).remarks  # and this one has


@pytest.mark.parametrize(
    "torques, told",
    [
        ([9.9, 0.0, 40.3], ""),  # turn 10, swing 40: at the limit, but for rounding
        ([0.0, 0.0, 6000.0], "peak torque of swing 6000 Nm, where its motor gives 40"),
        ([0.0, 9e9, 0.0], ""),  # the rail is prescribed
    ],
)
def test_a_torque_that_no_motor_gives(torques, told):
    assert found(actuation=np.tile(torques, (3, 1))) == told


def test_a_torque_that_no_motor_of_any_robot_gives():
    free = np.full(3, np.inf)
    strong = np.tile([999.0, 0.0, 1001.0], (3, 1))
    text = found(actuation=strong, effort_limits=free)
    assert text.startswith("peak torque of swing 1001 Nm") and "turn" not in text


def test_limits_that_hold_back():
    held = np.tile([0.5, 0.0], (3, 1))
    assert "hold the robot back in 100 % of the samples" in found(torque_limit=held)


@pytest.mark.parametrize("at, bad", [(0.98, False), (0.995, True), (-0.995, True)])
def test_a_joint_at_its_limit(at, bad):
    q = np.array([[9.0, at, 0.0], [9.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    assert ("swing is at its limit for 33 % of the time" in found(q=q)) == bad


def test_what_is_below_the_floor():
    assert found(lowest=(-0.009, "left_foot", 1.0)) == ""
    text = found(lowest=(-0.033, "left_foot", 1.0))
    assert text.startswith("33 mm BELOW THE FLOOR: left_foot at 1.00 s")


@pytest.mark.parametrize(
    "degrees, followed, bad",
    [((29, 89), True, False), ((31, 40), True, True), ((5, 91), True, True)]
    + [((120, 170), False, False)],
)
def test_a_limb_that_points_elsewhere(degrees, followed, bad):
    limb = LimbDirection(*np.radians(degrees), followed)
    text = found(limbs={"left_forearm": limb})
    assert ("left forearm points" in text) == bad


def test_of_many_the_first_two_are_told():
    limbs = {f"limb_{i}": LimbDirection(1.0, 1.0, True) for i in range(5)}
    lines = found(limbs=limbs).splitlines()
    assert len(lines) == 2 and lines[1].endswith("; and 3 more so")
