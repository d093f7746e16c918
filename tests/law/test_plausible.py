"""Measured states that no robot has: the robot brakes, and it is reported."""

import numpy as np
import pytest
from small_logs import small_log

from crar_drake.law.control_law import ControlLaw
from crar_drake.law.measured import MeasuredStates
from crar_drake.law.parameters import LookaheadParameters, PaperParameters
from crar_drake.law.solution import (
    STATUS_BLENDING,
    STATUS_BRAKING,
    STATUS_IMPLAUSIBLE,
    STATUS_TRACKING,
)
from crar_drake.results.summary import summarize
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import position_tasks

PERIOD = 5e-3


@pytest.fixture(scope="module")
def model():
    return ControlModel.FromDescription(
        load_robot_description("upper_body"),
        position_tasks(["left_wrist", "right_wrist"]),
        time_step=PERIOD,
    )


def run(model, changed, kind=LookaheadParameters, steps=300, at=100):
    """Statuses, torques and accelerations of steps towards a target, of which one, or
    all from one on, are told another state."""
    law = ControlLaw(model, kind(period=PERIOD))
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
    tasks = model.tasks_at(q)
    prescribed = model.prescribed_at(q)
    tasks[2] += 0.1
    found = []
    for k in range(steps):
        told = changed(k - at, q.copy(), v.copy())
        found.append(law.step(*told, tasks, prescribed))
        q, v = np.split(found[-1].position_command, [len(q)])
    statuses = np.array([each.status[0] for each in found])
    torques = np.array([each.actuation for each in found])
    return statuses, torques, found


ELBOW = 9  # its index in q and in v


@pytest.mark.parametrize("speed", [150.0, 1000.0, -1e6, 1e300])
def test_a_speed_that_no_joint_has(model, speed):
    def glitch(k, q, v):
        if k == 0:
            v[ELBOW] = speed
        return q, v

    statuses, torques, found = run(model, glitch)
    assert statuses[100] == STATUS_IMPLAUSIBLE
    # One glitch: the targets are blended in anew, and nothing was asked of motors.
    assert set(statuses[101:]) == {STATUS_BLENDING, STATUS_TRACKING}
    ordinary = np.abs(torques[:100]).max()
    assert np.abs(torques).max() < 1.1 * ordinary
    assert np.isnan(found[100].task_error).all()


def test_a_speed_that_stays_wrong_brakes_all_along(model):
    def wrong(k, q, v):
        if k >= 0:
            v[ELBOW] = 1000.0
        return q, v

    statuses, torques, found = run(model, wrong)
    assert set(statuses[100:]) == {STATUS_IMPLAUSIBLE}
    assert np.abs(torques).max() < 1.1 * np.abs(torques[:100]).max()
    # It brakes from what was believed, not from 1000 rad/s; in the end all rests.
    asked = np.array([np.delete(each.acceleration, ELBOW) for each in found[100:]])
    assert np.abs(asked[-1]).max() < 0.05 * np.abs(asked[0]).max()
    assert abs(found[-1].acceleration[ELBOW]) < 1e-3


def test_a_jump_of_a_joint(model):
    def jump(k, q, v):
        if k == 0:
            q[ELBOW] -= 1.0
        return q, v

    statuses, torques, _ = run(model, jump)
    assert statuses[100] == STATUS_IMPLAUSIBLE
    assert set(statuses[101:]) == {STATUS_BLENDING, STATUS_TRACKING}
    assert np.abs(torques).max() < 1.2 * np.abs(torques[:100]).max()


def test_what_a_robot_can_do_is_believed(model):
    def violent(k, q, v):
        if k == 0:
            v[ELBOW], q[ELBOW] = -30.0, q[ELBOW] - 0.2
        return q, v

    statuses, _, _ = run(model, violent)
    assert STATUS_IMPLAUSIBLE not in statuses


def test_the_papers_constraints_believe_everything(model):
    """To the letter."""

    def glitch(k, q, v):
        if k == 0:
            v[ELBOW] = 150.0
        return q, v

    statuses, torques, _ = run(model, glitch, kind=PaperParameters, steps=102)
    assert statuses[100] == STATUS_TRACKING or statuses[100] == STATUS_BLENDING
    assert np.abs(torques[100]).max() > 3.0 * np.abs(torques[:100]).max()


def test_thresholds_by_hand(model):
    plausible = MeasuredStates(model, PERIOD, 0.0, False)
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
    most = max(100.0, 3.0 * model.velocity_limits[ELBOW])
    fast = v.copy()
    fast[ELBOW] = most + 1.0
    assert plausible.believed(fast, None)[ELBOW] == 0.0
    assert plausible.believed(fast, np.full_like(v, 2.0))[ELBOW] == 2.0
    fast[ELBOW] = most - 1.0
    assert plausible.believed(fast, None) is fast
    there = q.copy()
    there[ELBOW] += 0.25 + (most - 1.0) * PERIOD - 1e-9
    assert plausible.way(q, v, there, fast) and plausible.way(q, fast, there, v)
    there[ELBOW] += 1e-6
    assert not plausible.way(q, v, there, fast)
    # The torso's yaw has no limits, and may be told within one turn.
    yaw = model.position_names.index("torso_yaw")
    there = q.copy()
    there[yaw] += 2.0 * np.pi - 0.01
    assert plausible.way(q, v, there, v)
    there[yaw] += 1.0
    assert not plausible.way(q, v, there, v)
    # The waist is prescribed, whose samples may be anywhere.
    there = q.copy()
    there[0] += 1.0
    assert plausible.way(q, v, there, v)


def test_a_run_says_so():
    log = small_log()
    log.status[:] = STATUS_TRACKING
    log.status[1:] = STATUS_IMPLAUSIBLE
    summary = summarize(log)
    assert summary.implausible_samples == len(log.time) - 1
    said = f"{len(log.time) - 1} samples with a measured state that no robot has"
    said += f", the first at {log.time[1]:.3f} s"
    assert any(line.startswith(said) for line in summary.remarks)
    log.status[1:] = STATUS_BRAKING
    assert not any("no robot has" in line for line in summarize(log).remarks)
