"""Targets are judged one by one; between them they go on, and then they stand still."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.law.tasks import TaskLayout
from crar_drake.teleoperation.gate import Gate
from crar_drake.teleoperation.messages import TargetMessage
from crar_drake.teleoperation.target_stream import TargetStream

LAYOUT = TaskLayout(("wrist", "hand"), ("position", "pose"))
GATE = Gate(speed=1.0, angular_speed=2.0, distance=0.5, timeout=0.2)
PERIOD = 0.05  # [s]
HERE = LAYOUT.pack(np.eye(3)[np.newaxis], np.zeros((2, 3)))
WRIST, HAND = 0, 1


@pytest.fixture
def stream() -> TargetStream:
    return TargetStream(LAYOUT, GATE, PERIOD)


def wrist(x: float, time: float | None) -> TargetMessage:
    return TargetMessage(time, {WRIST: np.array([x, 0.0, 0.0])})


def hand(angle: float, x: float, time: float) -> TargetMessage:
    turned = Rotation.from_rotvec([0.0, 0.0, angle]).as_quat()[[3, 0, 1, 2]]
    return TargetMessage(time, {HAND: np.concatenate((turned, [x, 0.0, 0.0]))})


def test_verdicts(stream):
    assert stream.take(wrist(0.1, 5.0), 0.0, HERE) == {WRIST: "passed"}
    assert stream.take(wrist(0.11, 5.02), 0.02, HERE) == {WRIST: "passed"}  # 0.5 m/s
    assert stream.take(wrist(0.2, 5.04), 0.04, HERE) == {WRIST: "clamped"}  # 4.5 m/s
    # Too far from the wrist; overtaken by a later one; twice.
    assert stream.take(wrist(0.6, 5.06), 0.06, HERE) == {WRIST: "rejected"}
    assert stream.take(wrist(0.2, 5.03), 0.07, HERE) == {WRIST: "late"}
    assert stream.take(wrist(0.2, 5.04), 0.07, HERE) == {WRIST: "late"}
    assert stream.counts == {"passed": 2, "clamped": 1, "rejected": 1, "late": 2}
    # After a gap a sender may have started again, with another clock.
    assert stream.take(wrist(0.2, 0.0), 0.5, HERE) == {WRIST: "passed"}
    assert stream.counts["passed"] == 3


def test_each_sender_has_a_clock_of_its_own(stream):
    assert stream.take(wrist(0.1, 1e300), 0.0, HERE, "a") == {WRIST: "passed"}
    assert stream.take(wrist(0.1, 2.0), 0.01, HERE, "b") == {WRIST: "passed"}
    assert stream.take(wrist(0.1, 1.0), 0.02, HERE, "b") == {WRIST: "late"}


def test_a_turn_that_is_too_fast(stream):
    stream.take(hand(0.0, 0.0, 1.0), 0.0, HERE)
    stream.take(hand(0.03, 0.01, 1.02), 0.02, HERE)  # 1.5 rad/s, 0.5 m/s
    stream.take(hand(0.09, 0.02, 1.04), 0.04, HERE)  # 3 rad/s
    assert stream.counts == {"passed": 2, "clamped": 1}


def test_between_two_targets_it_goes_on_and_then_stands_still(stream):
    stream.take(wrist(0.00, 1.00), 0.0, HERE)
    # 0.5 m/s by the sender's clock, however late the network brings it.
    stream.take(wrist(0.02, 1.04), 0.07, HERE)
    for now, x, v in ((0.07, 0.02, 0.5), (0.09, 0.03, 0.5), (0.12, 0.04, 0.0)):
        desired = LAYOUT.unpack(stream.desired_at(now, HERE))
        np.testing.assert_allclose(desired.p[0], [x, 0, 0], atol=1e-12)
        np.testing.assert_allclose(desired.v[:3], [v, 0, 0], atol=1e-12)
        assert not desired.a.any()


def test_a_pose_goes_on_turning(stream):
    stream.take(hand(0.00, 0.0, 1.00), 0.0, HERE)
    stream.take(hand(0.05, 0.02, 1.05), 0.05, HERE)
    desired = LAYOUT.unpack(stream.desired_at(0.07, HERE))
    turned = Rotation.from_matrix(desired.R[0]).as_rotvec()
    np.testing.assert_allclose(turned, [0, 0, 0.07], atol=1e-12)
    np.testing.assert_allclose(desired.p[1], [0.028, 0, 0], atol=1e-12)
    np.testing.assert_allclose(desired.v[3:], [0, 0, 1, 0.4, 0, 0], atol=1e-12)


def test_a_jump_is_approached_and_does_not_go_on(stream):
    stream.take(wrist(0.0, 1.0), 0.0, HERE)
    stream.take(wrist(0.12, 1.02), 0.02, HERE)
    for now, x in ((0.02, 0.05), (0.07, 0.1), (0.12, 0.12)):
        desired = LAYOUT.unpack(stream.desired_at(now, HERE))
        np.testing.assert_allclose(desired.p[0], [x, 0, 0], atol=1e-12)
        assert not desired.v.any() and not desired.a.any()


def test_a_task_without_targets_stays_where_it_was(stream):
    assert np.isnan(stream.desired_at(0.0, HERE)).all()
    stream.take(wrist(0.1, 1.0), 0.0, HERE)
    assert LAYOUT.unpack(stream.desired_at(0.01, HERE)).p[1] == pytest.approx([0, 0, 0])
    # The hand has moved; it is still to stay where it was.
    moved = LAYOUT.pack(np.eye(3)[np.newaxis], np.full((2, 3), 0.1))
    assert LAYOUT.unpack(stream.desired_at(0.02, moved)).p[1] == pytest.approx(
        [0, 0, 0]
    )
    # Both are lost: the robot brakes, and what comes later begins where that ended.
    assert np.isnan(stream.desired_at(0.3, moved)).all()
    stream.take(hand(0.0, 0.0, 2.0), 0.4, moved)
    desired = LAYOUT.unpack(stream.desired_at(0.4, moved))
    assert desired.p[0] == pytest.approx([0.1, 0.1, 0.1])


def pose(x: float, angle: float, v: float = 0.0, rate: float = 0.0) -> np.ndarray:
    """Targets: the wrist at rest, the hand at x, turned about z, at these rates."""
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    desired = LAYOUT.pack(turn[np.newaxis], np.array([[0.0, 0, 0], [x, 0, 0]]))
    desired[LAYOUT.size_x + 5] = rate
    desired[LAYOUT.size_x + 6] = v
    return desired


def test_within_the_bounds_targets_are_passed_as_they_are():
    limiter = TargetStream(LAYOUT, GATE, PERIOD)
    limiter.limit(HERE, HERE)
    for k in range(1, 40):
        x, angle = 0.99 * PERIOD * k, 1.98 * PERIOD * k
        desired = pose(x, angle, v=0.99, rate=1.98)
        np.testing.assert_array_equal(limiter.limit(desired, HERE), desired)


def test_a_leap_of_a_pose_is_a_straight_way_and_a_turn_the_shorter_way_round():
    limiter = TargetStream(LAYOUT, GATE, PERIOD)
    limiter.limit(HERE, HERE)
    goal = pose(0.3, np.deg2rad(-170.0))
    places, angles = [0.0], [0.0]
    for _ in range(30):  # 170 degrees at 2 rad/s; the way of 0.3 m takes 6 of them
        passed = limiter.limit(goal, HERE)
        at = LAYOUT.unpack(passed)
        places.append(at.p[1, 0])
        angles.append(Rotation.from_matrix(at.R[0]).as_rotvec()[2])
        assert not at.v.any()
    np.testing.assert_array_equal(passed, goal)
    np.testing.assert_allclose(np.diff(places)[:6], 0.05, atol=1e-9)
    np.testing.assert_allclose(np.diff(angles)[:29], -0.1, atol=1e-9)
    assert not LAYOUT.unpack(passed).v.any()


def test_after_lost_targets_the_way_begins_where_the_robot_is():
    limiter = TargetStream(LAYOUT, GATE, PERIOD)
    limiter.limit(pose(0.02, 0.0), HERE)
    lost = np.full(LAYOUT.size, np.nan)
    assert np.isnan(limiter.limit(lost, HERE)).all()
    there = pose(0.2, 0.0)
    passed = LAYOUT.unpack(limiter.limit(pose(0.0, 0.0), there))
    np.testing.assert_allclose(passed.p[1], [0.15, 0, 0], atol=1e-12)
    # A robot that did not get there does not hold the way up.
    passed = LAYOUT.unpack(limiter.limit(pose(0.0, 0.0), there))
    np.testing.assert_allclose(passed.p[1], [0.10, 0, 0], atol=1e-12)
