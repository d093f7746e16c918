"""How parts of a performer are turned, in the robot's world W, and smoothly.

A hand's frame H is one of anatomy, so that it is the same on every performer and robot:
x to the fingertips, z to the thumb's side. So the palm faces -y at the left and +y at
the right hand. In the skeleton's rest pose the thumbs' side is the front: palms down if
its arms are spread, towards the body if they hang.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import DEFAULT_CUTOFF, low_pass
from crar_drake.motion.performer import Performer
from crar_drake.motion.quaternion_spline import sign_continuous

HANDS = ("left_hand", "right_hand")

# Shorter than this a mean of quaternions tells no orientation.
_LEAST_NORM = 0.05


def smooth_hands(
    performer: Performer, cutoff: float = DEFAULT_CUTOFF
) -> dict[str, np.ndarray]:
    """Name of HANDS to (T, 4) unit quaternions (x y z w) of R_WH after a low-pass.

    Args:
        cutoff: of the zero-phase low-pass [Hz].

    Raises:
        MotionError: the file does not tell how a hand is turned (the message says why);
            or as of `smooth_turns`.
    """
    if performer.hands_obstacle:
        raise MotionError(performer.hands_obstacle)
    return {
        hand: smooth_turns(
            R_WH,
            performer.frame_rate,
            cutoff,
            f"motion {performer.name}: {hand}",
            "do not track this hand's orientation",
        )
        for hand, R_WH in performer.hands.items()
    }


def hip_turns(performer: Performer, cutoff: float = DEFAULT_CUTOFF) -> np.ndarray:
    """How the performer's hips are turned from where they face x, upright.

    Args:
        cutoff: of the zero-phase low-pass [Hz].

    Returns:
        (T, 4) unit quaternions (x y z w) of rotations in the robot's world W: z up, x
        forward, y left.

    Raises:
        MotionError: the motion does not tell, or as of `smooth_turns`.
    """
    if "pelvis" not in performer.orientations:
        raise MotionError(
            f"motion {performer.name}: it does not tell how the pelvis is turned, and "
            "so not how a robot's root is; use another motion"
        )
    return smooth_turns(
        performer.orientations["pelvis"],
        performer.frame_rate,
        cutoff,
        f"motion {performer.name}: the hips",
        "use another motion",
    )


def smooth_turns(
    R: np.ndarray, frame_rate: float, cutoff: float, what: str, otherwise: str
) -> np.ndarray:
    """Unit quaternions (T, 4) x y z w after a low-pass, filtered as positions are.

    Args:
        R: (T, 3, 3) rotations.
        frame_rate: samples per second [Hz].
        cutoff: of the zero-phase low-pass [Hz].
        what, otherwise: for an error: "motion m: what turns", and how to do without.

    Raises:
        MotionError: the motion is too short, the cutoff too high, or it turns to and
            fro so fast that no mean is left.
    """
    # Directions of points that coincide make no rotation.
    if len(lost := np.flatnonzero(~(np.linalg.det(R) > 0.5))):
        raise MotionError(
            f"{what}: no orientation in frame {lost[0] + 1}, where points coincide; "
            f"repair the file, or {otherwise}"
        )
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
