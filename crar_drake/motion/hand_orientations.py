"""How a performer's hands are turned, in the robot's world frame."""

from dataclasses import dataclass

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import DEFAULT_CUTOFF
from crar_drake.motion.performer import Performer
from crar_drake.motion.turns import smooth_turns

HANDS = ("left_hand", "right_hand")


@dataclass(frozen=True)
class HandOrientations:
    """Orientations of the hands in the robot's world W: z up, x forward, y left.

    A hand's frame H is one of anatomy, so that it is the same on every performer and
    robot: x to the fingertips, z to the thumb's side. So the palm faces -y at the
    left and +y at the right hand. In the skeleton's rest pose the thumbs' side is the
    front: palms down if its arms are spread, towards the body if they hang.
    """

    name: str  # the motion's name
    frame_rate: float  # samples per second [Hz]
    rotations: dict[str, np.ndarray]  # name of HANDS to (T, 3, 3) R_WH

    def smooth(self, cutoff: float = DEFAULT_CUTOFF) -> dict[str, np.ndarray]:
        """Name of HANDS to (T, 4) unit quaternions (x y z w) after a low-pass.

        Args:
            cutoff: of the zero-phase low-pass [Hz].

        Raises:
            MotionError: the motion is too short, the cutoff too high, or a hand
                turns to and fro so fast that no mean is left.
        """
        return {
            hand: smooth_turns(
                R_WH,
                self.frame_rate,
                cutoff,
                f"motion {self.name}: {hand}",
                "do not track this hand's orientation",
            )
            for hand, R_WH in self.rotations.items()
        }


def hand_orientations(performer: Performer) -> HandOrientations:
    """Returns the orientations of the hands of a motion, unfiltered.

    Raises:
        MotionError: the file does not tell how a hand is turned; the message says why.
    """
    if performer.hands_obstacle:
        raise MotionError(performer.hands_obstacle)
    return HandOrientations(performer.name, performer.frame_rate, dict(performer.hands))
