"""A motion at another rate, or more slowly, along splines through its samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.quaternion_spline import QuaternionSpline, sign_continuous
from crar_drake.motion.rates import check_rate
from crar_drake.references.robot_motion import RobotMotion, has_rows

# A last sample is taken if it is beyond the motion's end by rounding alone [frames].
_ROUNDING = 1e-6

# A motion slows down within this time where it asks too much [s].
_SLOWING = 0.2
# Splines swing a little beyond the speeds of the samples: it is slowed to this share of
# what is allowed, and again, so often.
_SLOWED_TO, _TRIES = 0.998, 10


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
        MotionError: there is one frame only, or no motion has the rate.
    """
    if rate == motion.rate:
        return motion, ()
    if motion.num_frames < 2:
        raise MotionError(f"{motion.source}: one frame has no rate to change")
    check_rate(rate)
    count = int(np.floor(motion.duration * rate + _ROUNDING)) + 1
    times = np.minimum(np.arange(count) / rate, motion.duration)
    besides, frames = motion.extras, motion.num_frames
    left_out = tuple(key for key in besides if has_rows(besides[key], frames))
    extras = {key: value for key, value in besides.items() if key not in left_out}
    return replace(_at(motion, times), rate=float(rate), extras=extras), left_out


def retimed(
    motion: RobotMotion, slower: Callable[[RobotMotion], np.ndarray]
) -> RobotMotion:
    """The motion, slowed down where it asks too much, and nowhere else faster.

    The tempo changes gradually, over 0.2 s; what is sampled passes through the same
    configurations, along splines as `resampled`. What the file has besides for each
    frame is that of the nearest one. A motion that is not too fast is returned itself.

    Args:
        motion: of T frames.
        slower: of such a motion, how many times as slowly each way to the next frame
            is to be played, (T - 1,).

    Returns:
        The motion at the same rate, with more frames; its last one stands at its end.
    """
    share = slower(motion)
    if share.max(initial=0.0) <= 1.0:
        return motion
    # To import it takes a while, which nobody waits for whose motion is not too fast.
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    around, made = 2 * round(_SLOWING * motion.rate) + 1, motion
    factors = np.maximum(share / _SLOWED_TO, 1.0)
    for _ in range(_TRIES):
        # A mean of what is the largest nearby is nowhere less than what is needed.
        wide = maximum_filter1d(factors, around, mode="nearest")
        tempo = uniform_filter1d(wide, around, mode="nearest")
        frames = np.concatenate([[0.0], np.cumsum(tempo)])  # where the old ones come
        count = int(np.ceil(frames[-1] - _ROUNDING))
        way = PchipInterpolator(frames * (count / frames[-1]), np.arange(len(frames)))
        at = np.clip(way(np.arange(count + 1)), 0.0, len(frames) - 1)
        made = _at(motion, at / motion.rate)
        share = slower(made)
        if share.max() <= 1.0:
            break
        old = np.minimum(at[:-1].astype(int), len(factors) - 1)
        was = factors.copy()
        for step in (old, np.minimum(old + 1, len(factors) - 1)):
            np.maximum.at(factors, step, was[step] * share / _SLOWED_TO)
    return replace(made, extras=motion.frames(np.rint(at).astype(int)).extras)


def _at(motion: RobotMotion, times: np.ndarray) -> RobotMotion:
    """The motion at some times [s], without what follows from it; quaternions near the
    one before, the first near the motion's first."""
    turning = QuaternionSpline(motion.times, motion.root_rotations.as_quat())
    R_WR = np.array([turning(time)[0] for time in times])
    Q = sign_continuous(Rotation.from_matrix(R_WR).as_quat()[:, [3, 0, 1, 2]])
    if Q[0] @ motion.root_quaternions[0] < 0.0:
        Q = -Q
    return replace(
        motion,
        root_positions=CubicSpline(motion.times, motion.root_positions)(times),
        root_quaternions=Q,
        joint_positions=CubicSpline(motion.times, motion.joint_positions)(times),
        computed={},
    )
