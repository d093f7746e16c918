"""The points of a performer that a robot follows, in the robot's world frame."""

from dataclasses import dataclass

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.performer import ARM, SIDES, Performer, Sampled

# What robots call the points: all but one as the performer's joints.
JOINT_CENTRES = (
    "waist",
    "neck",
    *(f"{side}_{joint}" for side in SIDES for joint in ARM),
)


@dataclass(frozen=True)
class JointCentres(Sampled):
    """Joint centres of one motion in the robot's world W: z up, x forward, y left."""

    name: str  # the motion's name
    frame_rate: float  # samples per second [Hz]
    positions: dict[str, np.ndarray]  # name of JOINT_CENTRES to (T, 3) p_WC [m]
    heading: np.ndarray  # (T,) yaw of the hips about z, unwrapped [rad]; 0 faces x
    # the root's height above the lowest point of the feet in the skeleton's rest pose
    # [m]
    hip_height: float


def file_joint(name: str) -> str:
    """The performer's joint that a name of JOINT_CENTRES stands for."""
    return "pelvis" if name == "waist" else name


def joint_centres(performer: Performer) -> JointCentres:
    """Returns the joint centres of a motion.

    Raises:
        MotionError: the performer lacks joint centres of the upper body, or has no
            legs to take the hip height from.
    """
    if performer.obstacle:
        raise MotionError(performer.obstacle)
    return JointCentres(
        name=performer.name,
        frame_rate=performer.frame_rate,
        positions={
            name: performer.positions[file_joint(name)] for name in JOINT_CENTRES
        },
        heading=performer.heading,
        hip_height=performer.hip_height,
    )
