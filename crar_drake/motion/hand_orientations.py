"""How a performer's hands are turned, in the robot's world frame W.

A hand's frame H is one of anatomy, so that it is the same on every performer and robot:
x to the fingertips, z to the thumb's side. So the palm faces -y at the left and +y at
the right hand. In the skeleton's rest pose the thumbs' side is the front: palms down if
its arms are spread, towards the body if they hang.
"""

from collections.abc import Mapping

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import DEFAULT_CUTOFF
from crar_drake.motion.performer import Performer
from crar_drake.motion.turns import smooth_turns

HANDS = ("left_hand", "right_hand")


def hand_orientations(performer: Performer) -> Mapping[str, np.ndarray]:
    """Name of HANDS to (T, 3, 3) R_WH, unfiltered.

    Raises:
        MotionError: the file does not tell how a hand is turned; the message says why.
    """
    if performer.hands_obstacle:
        raise MotionError(performer.hands_obstacle)
    return performer.hands


def smooth_hands(
    performer: Performer, cutoff: float = DEFAULT_CUTOFF
) -> dict[str, np.ndarray]:
    """Name of HANDS to (T, 4) unit quaternions (x y z w) after a low-pass.

    Args:
        cutoff: of the zero-phase low-pass [Hz].

    Raises:
        MotionError: as of `hand_orientations`; or the motion is too short, the cutoff
            too high, or a hand turns to and fro so fast that no mean is left.
    """
    return {
        hand: smooth_turns(
            R_WH,
            performer.frame_rate,
            cutoff,
            f"motion {performer.name}: {hand}",
            "do not track this hand's orientation",
        )
        for hand, R_WH in hand_orientations(performer).items()
    }
