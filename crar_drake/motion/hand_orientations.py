"""How a performer's hands are turned, in the robot's world frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import DEFAULT_CUTOFF
from crar_drake.motion.formats.asf_amc import Clip, forward_kinematics, rest_pose
from crar_drake.motion.joint_centres import robot_frame
from crar_drake.motion.turns import robot_rotation, smooth_turns

# Hand: the bone that says how it is turned. That is the wrist, the forearm's last
# third, which turns with the hand and was fitted to the two markers at its sides; it
# knows no bending of the wrist. The hand bones, fitted to a single marker, know it,
# but spin and flip by half a turn in some trials (135_02), as thumbs and fingers do.
_BONE_OF = {"left_hand": "lwrist", "right_hand": "rwrist"}

HANDS = tuple(_BONE_OF)


@dataclass(frozen=True)
class HandOrientations:
    """Orientations of the hands in the robot's world W: z up, x forward, y left.

    A hand's frame H is one of anatomy, so that it is the same on every performer and
    robot: x to the fingertips, z to the thumb's side. So the palm faces -y at the
    left and +y at the right hand. In the skeleton's rest pose the thumbs' side is the
    front: palms down if its arms are spread, towards the body if they hang.

    Attributes:
        name: the motion's name.
        frame_rate: samples per second [Hz].
        rotations: name of HANDS to (T, 3, 3) R_WH.
    """

    name: str
    frame_rate: float  # [Hz]
    rotations: dict[str, np.ndarray]

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


def hand_orientations(clip: Clip) -> HandOrientations:
    """Returns the orientations of the hands of a clip, unfiltered.

    Raises:
        MotionError: the skeleton lacks a hand, or at rest it points forward, so that
            the thumb's side is unknown.
    """
    missing = [bone for bone in _BONE_OF.values() if bone not in clip.skeleton.bones]
    if missing:
        raise MotionError(
            f"motion {clip.name}: skeleton {clip.skeleton.name!r} lacks the bones "
            f"{', '.join(missing)}, which give the hands' orientations; use a skeleton "
            f"with the CMU database's bone names, or track positions only"
        )
    rest = rest_pose(clip.skeleton).rotation
    poses = forward_kinematics(clip).rotation
    rotations = {}
    for hand, bone in _BONE_OF.items():
        fingers = rest[bone][0] @ clip.skeleton.bones[bone].direction
        x = robot_frame(fingers) / np.linalg.norm(fingers)
        z = np.array([1.0, 0.0, 0.0]) - x[0] * x
        if np.linalg.norm(z) < 0.5:
            raise MotionError(
                f"motion {clip.name}: skeleton {clip.skeleton.name!r}: {bone} points "
                f"forward at rest, so its thumb's side is unknown; use a skeleton at "
                f"rest with its arms spread or hanging, or track positions only"
            )
        z /= np.linalg.norm(z)
        R_WH_rest = np.stack([x, np.cross(z, x), z], axis=1)
        turned = robot_rotation(poses[bone] @ rest[bone][0].T)
        rotations[hand] = turned @ R_WH_rest
    return HandOrientations(clip.name, clip.frame_rate, rotations)
