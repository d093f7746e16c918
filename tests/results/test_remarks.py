"""What is called bad about a run: on both sides of every threshold."""

import re
import shutil

import numpy as np
import pytest
from small_logs import small_log

from crar_drake.commands import main
from crar_drake.resources import data_folder
from crar_drake.results.controlled_joints import controlled_joints
from crar_drake.results.limb_directions import LimbDirection
from crar_drake.results.log import SimulationLog
from crar_drake.results.remarks import clipped_line, lasting_error_warnings, remarks
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


# --- targets that are never reached --------------------------------------------------


def errors(hand: float, turned: float, shift: np.ndarray | None = None):
    """Three samples, 1 s; the hand's distance [m] and the tool's angle [rad]."""
    error = np.zeros((3, 9))
    error[:, 1], error[:, 4] = hand, turned
    if shift is not None:
        error[:, 1] += shift
    return small_log(task_error=error)


def test_a_hand_that_stays_away_and_a_tool_that_stays_turned():
    lines = lasting_error_warnings(errors(0.12, 0.6), 0.0)
    assert [line.partition(" is never ")[0] for line in lines] == ["hand", "tool"]
    assert "than 120 mm:" in lines[0] and "than 34 deg:" in lines[1]


@pytest.mark.parametrize("shift", [[0.0, -0.05, 0.0], [np.nan, 0.0, -0.05]])
def test_once_near_is_near(shift):
    """Samples without targets say nothing, and what is short says nothing."""
    assert lasting_error_warnings(errors(0.12, 0.4, np.array(shift)), 0.0) == []
    assert lasting_error_warnings(errors(0.12, 0.6), 0.5) == []


def test_what_is_blended_in_does_not_count():
    """Near at the start only, where targets are blended in from where it stands."""
    far = small_log(
        time=np.arange(3) * 1.0,
        task_error=errors(0.2, 0.0, np.array([-0.2, 0, 0])).task_error,
    )
    assert lasting_error_warnings(far, 0.0) == []
    assert "never nearer" in lasting_error_warnings(far, 0.5)[0]


# --- motors that cannot even brake ---------------------------------------------------


# Of the shoulder [Nm]; it needs more than that to hold the arm stretched out.
WEAK = 6.0


def test_the_first_sample_and_the_motors_at_their_limits_are_named():
    rounding, some = [1.0, 5e-5], [0.4, 0.3]
    log = small_log(
        torque_limit=np.array([rounding, some, some]),
        actuation=np.array([[10.0, 0.0, 0.0], [9.0, 0.0, -40.0], [10.0, 0.0, 40.0]]),
    )
    line = clipped_line(log)
    assert "clipped in 2 samples, the first at 0.500 s" in line
    assert "limits of swing (40), turn (10). " in line
    assert clipped_line(small_log(torque_limit=np.array([rounding] * 3))) == ""


def test_an_arm_too_weak_for_its_weight_falls_and_it_is_said_why(
    tmp_path, monkeypatch, capsys
):
    arm = tmp_path / "arm"
    shutil.copytree(data_folder("models") / "obstacle_arm", arm)
    urdf = arm / "obstacle_arm.urdf"
    text = urdf.read_text()
    strong = 'effort="200"'  # joint2's
    assert text.count(strong) == 1
    urdf.write_text(text.replace(strong, f'effort="{WEAK}"'))
    monkeypatch.chdir(tmp_path)
    given = [
        "--set",
        "controller.constraints=lookahead",
        "--duration",
        "1.5",
        "--no-page",
    ]
    main(["run", "obstacle_arm", "--robot", str(arm), *given, "--out", "fell"])
    said = capsys.readouterr().out
    log = SimulationLog.load("fell/log.npz")
    share = log.torque_limit[:, 1].max()
    assert share > 0.1, share
    first = log.time[log.torque_limit[:, 1] > 1e-4][0]
    told = f"the first at {first:.3f} s: not even braking"
    assert re.search(f"^BAD: torques were clipped.*{re.escape(told)}", said, re.M)
    assert f"joint2 ({WEAK:g})" in said
    main(["judge", "fell/log.npz"])
    judged = capsys.readouterr().out
    assert re.search(
        f"^assumption broken: torques were clipped.*{re.escape(told)}", judged, re.M
    )
