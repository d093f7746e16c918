"""A motion at another rate, along splines through its samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.quaternion_spline import QuaternionSpline, sign_continuous
from crar_drake.references.robot_motion import RobotMotion

# A last sample is taken if it is beyond the motion's end by rounding alone [frames].
_ROUNDING = 1e-6


def resampled(motion: RobotMotion, rate: float) -> tuple[RobotMotion, tuple[str, ...]]:
    """The motion at another rate.

    Joints and the root's position follow cubic splines, its orientation a spline on the
    sphere (`QuaternionSpline`); both pass through all samples. Between them they may
    swing beyond the samples, and so beyond a joint's limit. The first sample stays; the
    last is the last one that is not after the motion's end.

    Args:
        motion: with two frames at least.
        rate: samples per second [Hz].

    Returns:
        The motion, and the keys of what the file had besides and was left out, since it
        has a row for each of the old frames.

    Raises:
        MotionError: there is one frame only.
    """
    if rate == motion.rate:
        return motion, ()
    if motion.num_frames < 2:
        raise MotionError(f"{motion.source}: one frame has no rate to change")
    count = int(np.floor(motion.duration * rate + _ROUNDING)) + 1
    times = np.minimum(np.arange(count) / rate, motion.duration)
    turning = QuaternionSpline(motion.times, motion.root_rotations.as_quat())
    R_WR = np.array([turning(time)[0] for time in times])
    quaternions = Rotation.from_matrix(R_WR).as_quat()[:, [3, 0, 1, 2]]
    left_out = tuple(
        key
        for key, value in motion.extras.items()
        if np.ndim(value) > 0 and len(value) == motion.num_frames
    )
    return replace(
        motion,
        root_positions=CubicSpline(motion.times, motion.root_positions)(times),
        root_quaternions=_signed_as(quaternions, motion.root_quaternions[0]),
        joint_positions=CubicSpline(motion.times, motion.joint_positions)(times),
        rate=float(rate),
        extras={k: v for k, v in motion.extras.items() if k not in left_out},
        computed={},
    ), left_out


def _signed_as(quaternions: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Signs such that none is far from the one before, the first not from `first`."""
    continuous = sign_continuous(quaternions)
    return continuous if continuous[0] @ first >= 0.0 else -continuous
