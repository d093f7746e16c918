"""Keyframes and the source that emits them, by finite differences."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from scipy.spatial.transform import Rotation

from crar_drake.errors import ScenarioError
from crar_drake.law.tasks import TaskLayout
from crar_drake.targets.keyframes import Keyframe, keyframe_way
from crar_drake.targets.sources import PoseTrajectorySource
from crar_drake.targets.ways import TaskWay

KEYFRAMES = [
    Keyframe(0.5, [0.4, 0.0, 0.3], [180, 0, 180]),
    Keyframe(1.5, [0.6, 0.2, 0.3], [150, -20, 210]),
    Keyframe(2.0, [0.5, 0.4, 0.6], [100, 30, 250]),
    Keyframe(4.0, [0.2, -0.1, 0.4], [10, 60, 170]),
]
INSIDE = [0.51, 0.9, 1.5, 1.77, 2.0, 3.3, 3.99]
LAYOUT = TaskLayout(
    ("tool", "head", "hand"), ("pose", "orientation", "position")
)  # 12 rows


@pytest.fixture(scope="module")
def way() -> TaskWay:
    return keyframe_way("tool", KEYFRAMES)


@pytest.fixture(scope="module")
def source() -> PoseTrajectorySource:
    slow = [Keyframe(2.0 * frame.time, frame.xyz, frame.rpy_deg) for frame in KEYFRAMES]
    return PoseTrajectorySource(
        LAYOUT,
        {
            "hand": keyframe_way("hand", slow),
            "tool": keyframe_way("tool", KEYFRAMES),
            "head": keyframe_way("head", KEYFRAMES[:2]),
        },
    )


def test_it_passes_through_the_keyframes(way):
    """R = Rz(yaw) Ry(pitch) Rx(roll), as Drake's RollPitchYaw."""
    for frame in KEYFRAMES:
        np.testing.assert_allclose(way.position(frame.time)[0], frame.xyz, atol=1e-12)
        R = RollPitchYaw(np.radians(frame.rpy_deg)).ToRotationMatrix().matrix()
        np.testing.assert_allclose(way.orientation(frame.time)[0], R, atol=1e-12)


@pytest.mark.parametrize("t", INSIDE)
def test_position_derivatives(way, t):
    h = 1e-5
    before, now, after = (way.position(t + k * h) for k in (-1, 0, 1))
    np.testing.assert_allclose(now[1], (after[0] - before[0]) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(now[2], (after[1] - before[1]) / (2 * h), atol=1e-4)


@pytest.mark.parametrize("t", INSIDE)
def test_orientation_derivatives(way, t):
    """omega in W from R(t+h) R(t-h)^T, its derivative from omega."""
    h = 1e-5
    before, now, after = (way.orientation(t + k * h) for k in (-1, 0, 1))
    turn = Rotation.from_matrix(after[0] @ before[0].T).as_rotvec() / (2 * h)
    np.testing.assert_allclose(now[1], turn, atol=1e-7)
    np.testing.assert_allclose(now[2], (after[1] - before[1]) / (2 * h), atol=1e-3)
    np.testing.assert_allclose(now[0] @ now[0].T, np.eye(3), atol=1e-12)


def test_velocity_and_acceleration_are_continuous_at_keyframes(way):
    for frame in KEYFRAMES[1:-1]:
        for f in (way.position, way.orientation):
            before, after = f(frame.time - 1e-7), f(frame.time + 1e-7)
            np.testing.assert_allclose(before[1], after[1], atol=1e-5)
            np.testing.assert_allclose(before[2], after[2], atol=1e-4)


@pytest.mark.parametrize("t", [-1.0, 0.0, 0.499, 4.001, 100.0])
def test_it_stands_still_before_and_after(way, t):
    end = KEYFRAMES[0] if t < 1 else KEYFRAMES[-1]
    for f in (way.position, way.orientation):
        x, v, a = f(t)
        np.testing.assert_allclose(x, f(end.time)[0], atol=1e-12)
        assert not v.any() and not a.any()


def test_it_starts_and_ends_at_rest(way):
    """Nothing jumps where it goes over to standing still."""
    for t in (0.5, 4.0):
        for f in (way.position, way.orientation):
            np.testing.assert_allclose(f(t)[1], 0.0, atol=1e-9)


def test_it_turns_the_shorter_way():
    """From a yaw of 170 to one of 190 degrees, through 180, though given as -170."""
    way = keyframe_way(
        "tool",
        [Keyframe(0.0, rpy_deg=[0, 0, 170]), Keyframe(2.0, rpy_deg=[0, 0, -170])],
    )
    np.testing.assert_allclose(
        way.orientation(1.0)[0], np.diag([-1.0, -1.0, 1.0]), atol=1e-9
    )
    assert way.orientation(1.0)[1][2] > 0.0


@pytest.mark.parametrize("t", [0.7, 1.2, 1.8, 3.0, 5.0, 7.5])
def test_source_emits_the_layout(source, t):
    """[x_d; v_d; a_d] in the layout's order, whatever that of the mapping."""
    context = source.CreateDefaultContext()
    context.SetTime(t)
    value = source.get_output_port().Eval(context)
    np.testing.assert_array_equal(value, source.at(t))
    desired = LAYOUT.unpack(value)
    tool, head = keyframe_way("tool", KEYFRAMES), KEYFRAMES[:2]
    head = keyframe_way("head", head)
    np.testing.assert_allclose(desired.R[0], tool.orientation(t)[0], atol=1e-12)
    np.testing.assert_allclose(desired.R[1], head.orientation(t)[0], atol=1e-12)
    np.testing.assert_allclose(desired.p[0], tool.position(t)[0])
    # `hand` runs at half the speed of `tool`.
    half = tool.position(t / 2)
    np.testing.assert_allclose(desired.p[1], half[0], atol=1e-12)
    np.testing.assert_allclose(desired.v[9:], half[1] / 2, atol=1e-12)
    np.testing.assert_allclose(desired.a[9:], half[2] / 4, atol=1e-12)
    expected = [tool.orientation(t)[1], tool.position(t)[1], head.orientation(t)[1]]
    np.testing.assert_allclose(desired.v[:9], np.concatenate(expected))


def test_source_lasts_as_long_as_the_longest(source):
    assert source.duration == 8.0


def test_tasks_and_keyframes_must_agree():
    way = keyframe_way("tool", KEYFRAMES)
    layout = TaskLayout(("tool",), ("pose",))
    with pytest.raises(ScenarioError, match="none for task tool"):
        PoseTrajectorySource(layout, {})
    with pytest.raises(ScenarioError, match="no task tol.*tool"):
        PoseTrajectorySource(layout, {"tool": way, "tol": way})
