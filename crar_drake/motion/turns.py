"""How parts of a performer are turned, in the robot's world frame, and smoothly."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import DEFAULT_CUTOFF, low_pass
from crar_drake.motion.formats.asf_amc import Clip
from crar_drake.motion.leg_shape import TrunkShape
from crar_drake.motion.performer import Performer
from crar_drake.motion.performers.asf_amc import as_performer
from crar_drake.motion.quaternion_spline import sign_continuous

# Shorter than this a mean of quaternions tells no orientation.
_LEAST_NORM = 0.05


def hip_turns(
    motion: Performer | Clip,
    cutoff: float = DEFAULT_CUTOFF,
    trunk: TrunkShape | None = None,
) -> np.ndarray:
    """How the performer's hips are turned from where they face x, upright.

    Args:
        motion: the performer, or a clip.
        cutoff: of the zero-phase low-pass [Hz].
        trunk: of the robot that follows; where it cannot lean from the hips as the
            performer's does, the hips lean as far as it lacks.

    Returns:
        (T, 4) unit quaternions (x y z w) of rotations in the robot's world W: z up, x
        forward, y left.

    Raises:
        MotionError: the motion does not tell, it is too short, the cutoff too high, or
            the hips turn to and fro so fast that no mean is left.
    """
    performer = as_performer(motion)
    if "pelvis" not in performer.orientations:
        raise MotionError(
            f"motion {performer.name}: it does not tell how the pelvis is turned, and "
            "so not how a root that floats is; weld the base, or use another motion"
        )
    R = performer.orientations["pelvis"]
    if trunk is not None and {"neck", "pelvis"} <= set(performer.positions):
        way = performer.positions["neck"] - performer.positions["pelvis"]
        R = _leaning(R, way, trunk)
    return smooth_turns(
        R,
        performer.frame_rate,
        cutoff,
        f"motion {performer.name}: the hips",
        "prescribe no root",
    )


def _leaning(R: np.ndarray, way: np.ndarray, trunk: TrunkShape) -> np.ndarray:
    """Hips (T, 3, 3) that lean by what a trunk cannot, for it to point along `way`."""
    from_hips = np.einsum("tji,tj->ti", R, way)
    norm = np.linalg.norm(from_hips, axis=1, keepdims=True)
    wished = from_hips / np.maximum(norm, 1e-9)
    pitch = np.clip(np.arctan2(wished[:, 0], wished[:, 2]), *trunk.pitch)
    roll = np.clip(np.arcsin(np.clip(-wished[:, 1], -1.0, 1.0)), *trunk.roll)
    can = np.column_stack(
        [np.sin(pitch) * np.cos(roll), -np.sin(roll), np.cos(pitch) * np.cos(roll)]
    )
    # Without a direction there is nothing to lean to.
    lacking = between(can, np.where(norm > 1e-6, wished, can))
    return R @ lacking.as_matrix()


def between(a: np.ndarray, b: np.ndarray) -> Rotation:
    """The shortest turns of directions a, (3,) or (T, 3), to each of b (T, 3)."""
    axis, cosine = np.cross(a, b), np.sum(a * b, axis=1)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, cosine)
    return Rotation.from_rotvec(axis * (angle / np.maximum(sine, 1e-9))[:, None])


def smooth_turns(
    R: np.ndarray, frame_rate: float, cutoff: float, what: str, otherwise: str
) -> np.ndarray:
    """Quaternions after a low-pass, filtered as positions are, and normalised.

    Args:
        R: (T, 3, 3) rotations.
        frame_rate: samples per second [Hz].
        cutoff: of the zero-phase low-pass [Hz].
        what, otherwise: for an error: "motion m: what turns", and how to do without.

    Returns:
        (T, 4) unit quaternions (x y z w), their signs continuous.

    Raises:
        MotionError: the motion is too short, the cutoff too high, or it turns to and
            fro so fast that no mean is left.
    """
    quaternions = sign_continuous(Rotation.from_matrix(R).as_quat())
    try:
        filtered = low_pass(quaternions, frame_rate, cutoff)
    except MotionError as error:
        raise MotionError(f"{what}: {error}") from error
    norm = np.linalg.norm(filtered, axis=1)
    frame = int(np.argmin(norm))
    # Written so that a NaN fails, too.
    if not norm[frame] >= _LEAST_NORM:
        raise MotionError(
            f"{what} turns so fast about frame {frame + 1} that a low-pass of "
            f"{cutoff:g} Hz leaves no orientation; raise the cutoff, or {otherwise}"
        )
    return filtered / norm[:, None]
