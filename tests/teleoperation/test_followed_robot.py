"""Measured positions against commands whose course is known."""

import math

import numpy as np
import pytest

from crar_drake.teleoperation.followed_robot import FollowedRobot

PERIOD = 0.01


def told(latency: float = 0.0, most: float = math.inf) -> FollowedRobot:
    """Two joints that were told t and -2 t until t = 0.5 s."""
    robot = FollowedRobot(["a", "b"], latency, most)
    for k in range(51):
        robot.tell(k * PERIOD, np.array([k * PERIOD, -2.0 * k * PERIOD]))
    return robot


@pytest.mark.parametrize("latency", [0.0, 0.03, 0.0271])
def test_what_is_measured_late_is_compared_with_what_was_told_then(latency):
    robot = told(latency)
    robot.hear({"a": 0.4 - latency, "b": -0.8 + 2.0 * latency + 0.02}, 0.4)
    assert robot.error == pytest.approx(0.02, abs=1e-12) and robot.joint == "b"
    robot.hear({"a": 0.4 - latency - 0.005}, 0.4)
    assert robot.error == pytest.approx(0.02, abs=1e-12), "b is still off"
    robot.hear({"b": -0.8 + 2.0 * latency}, 0.4)
    assert robot.error == pytest.approx(0.005, abs=1e-12) and robot.joint == "a"


def test_a_robot_that_lags_by_a_time_is_off_by_its_speed_times_that():
    robot = told()
    robot.hear({"a": 0.3 - 0.02, "b": -2.0 * (0.3 - 0.02)}, 0.3)
    assert robot.error == pytest.approx(2.0 * 0.02, abs=1e-12) and robot.joint == "b"


def test_it_may_move_while_it_follows_and_is_heard():
    robot = told(most=0.05)
    assert robot.reason_to_brake(0.5, 0.1) == "not heard: a, b"
    robot.hear({"a": 0.5, "b": -1.0}, 0.5)
    assert robot.reason_to_brake(0.55, 0.1) is None
    assert robot.reason_to_brake(0.61, 0.1) == "not heard: a, b"
    robot.hear({"a": 0.5, "b": -0.949}, 0.5)
    assert robot.reason_to_brake(0.5, 0.1) == "not followed: b"
    robot.hear({"a": 0.5, "b": -0.951}, 0.5)
    assert robot.reason_to_brake(0.5, 0.1) is None
    assert told().reason_to_brake(0.5, 0.1) is None, "nothing is asked of it"


def test_joints_in_messages_of_their_own_are_merged():
    """What is said of one joint says nothing of another."""
    robot = told(most=0.2)
    robot.hear({"a": 1.5}, 0.5)  # 1 rad off
    assert robot.reason_to_brake(0.5, 0.1) == "not heard: b"
    robot.hear({"b": -1.0}, 0.5)
    assert robot.reason_to_brake(0.5, 0.1) == "not followed: a"
    robot.hear({"a": 0.5}, 0.5)
    assert robot.reason_to_brake(0.5, 0.1) is None
    assert robot.positions == {"a": 0.5, "b": -1.0}
    robot.hear({"b": -1.0}, 0.65)
    assert robot.reason_to_brake(0.65, 0.1) == "not heard: a"


def test_before_the_first_command_nothing_is_compared_and_memory_is_bounded():
    robot = FollowedRobot(["a"], most=0.1)
    robot.hear({"a": 3.0}, 0.0)
    assert math.isnan(robot.error) and robot.reason_to_brake(0.0, 0.1) is None
    for k in range(10_000):
        robot.tell(k * PERIOD, np.zeros(1))
    assert len(robot._told) < 110
