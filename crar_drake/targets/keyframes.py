"""Poses at given times, and the smooth way between them."""

# YAML loading reads the types of the fields, so no postponed annotations here.
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from crar_drake.errors import ScenarioError, check_vector
from crar_drake.motion.quaternion_spline import QuaternionSpline
from crar_drake.targets.ways import TaskWay, held


@dataclass
class Keyframe:
    """Where a task's frame or joint is to be at one time."""

    time: float = 0.0  # since the start [s]
    xyz: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # in W [m]
    # roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll) [deg]
    rpy_deg: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    joint: float = 0.0  # position of a joint [rad or m]


def keyframe_way(name: str, keyframes: Sequence[Keyframe]) -> TaskWay:
    """The way of one task through its keyframes.

    Position and orientation are cubic splines, the latter through the keyframes'
    quaternions, normalised: twice continuously differentiable and at rest at both
    ends. Before the first and after the last keyframe the task stands still there.
    From one keyframe to the next it turns the shorter way.

    Args:
        name: of the task, for messages.
        keyframes: at least two, in order of time.

    Raises:
        ScenarioError: too few keyframes, times that do not increase, or a vector that
            is not of three finite numbers.
    """
    if len(keyframes) < 2:
        raise ScenarioError(f"keyframes of task {name}: give at least two")
    times = np.array([frame.time for frame in keyframes])
    if not (np.diff(times) > 0.0).all() or not np.isfinite(times).all():
        raise ScenarioError(
            f"keyframes of task {name}: their times must increase: {times.tolist()}"
        )
    for frame in keyframes:
        where = f"keyframes of task {name}, time {frame.time:g}"
        for key in ("xyz", "rpy_deg"):
            check_vector(f"{where}: {key}", getattr(frame, key))
        if not np.isfinite(frame.joint):
            raise ScenarioError(f"{where}: joint: {frame.joint} must be finite")
    position, joint = (
        held(
            CubicSpline(times, [getattr(f, key) for f in keyframes], bc_type="clamped"),
            float(times[0]),
            float(times[-1]),
        )
        for key in ("xyz", "joint")
    )
    angles = [list(frame.rpy_deg) for frame in keyframes]
    quaternions = Rotation.from_euler("xyz", angles, degrees=True).as_quat()
    orientation = QuaternionSpline(times, quaternions, bc_type="clamped")
    return TaskWay(float(times[-1]), position, orientation, joint)
