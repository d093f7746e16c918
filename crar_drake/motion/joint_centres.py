"""The points of a performer that a robot follows, in the robot's world frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.formats.asf_amc import (
    Clip,
    Skeleton,
    forward_kinematics,
    rest_pose,
)

# Joint centre: the bone at whose start it lies ("root" for the root itself).
_BONE_OF = {
    "waist": "root",
    "neck": "lowerneck",
    "left_shoulder": "lhumerus",
    "left_elbow": "lradius",
    "left_wrist": "lwrist",
    "right_shoulder": "rhumerus",
    "right_elbow": "rradius",
    "right_wrist": "rwrist",
}

JOINT_CENTRES = tuple(_BONE_OF)


@dataclass(frozen=True)
class JointCentres:
    """Joint centres of one motion in the robot's world W: z up, x forward, y left.

    Attributes:
        name: the motion's name.
        frame_rate: samples per second [Hz].
        positions: name of JOINT_CENTRES to (T, 3) p_WC [m].
        heading: (T,) yaw of the hips about z, unwrapped [rad]; 0 faces x.
        hip_height: the root's height above the lowest point of the feet in the
            skeleton's rest pose [m].
    """

    name: str
    frame_rate: float  # [Hz]
    positions: dict[str, np.ndarray]  # [m]
    heading: np.ndarray  # [rad]
    hip_height: float  # [m]

    @property
    def num_frames(self) -> int:
        """Number of samples T."""
        return len(self.heading)

    @property
    def time(self) -> np.ndarray:
        """(T,) sample times, from 0 [s]."""
        return np.arange(self.num_frames) / self.frame_rate


def robot_frame(p_file: np.ndarray) -> np.ndarray:
    """Returns (..., 3) positions of the y-up file as z-up ones: (z, x, y)."""
    return p_file[..., [2, 0, 1]]


def joint_centres(clip: Clip) -> JointCentres:
    """Returns the joint centres of a clip.

    Raises:
        MotionError: the skeleton lacks bones that the joint centres are read from,
            or has nothing below its root to take the hip height from.
    """
    missing = [
        bone
        for bone in _BONE_OF.values()
        if bone != "root" and bone not in clip.skeleton.bones
    ]
    if missing:
        raise MotionError(
            f"motion {clip.name}: skeleton {clip.skeleton.name!r} lacks the bones "
            f"{', '.join(missing)}, which mark the neck and the arms; use a skeleton "
            f"with the CMU database's bone names"
        )
    lowest = min(end[0, 1] for end in rest_pose(clip.skeleton).end.values())
    if lowest >= 0.0:
        raise MotionError(
            f"motion {clip.name}: skeleton {clip.skeleton.name!r} has nothing below "
            f"its root, so its hip height is unknown; it needs legs"
        )
    poses = forward_kinematics(clip)
    return JointCentres(
        name=clip.name,
        frame_rate=clip.frame_rate,
        positions={
            name: robot_frame(poses.start[bone]) for name, bone in _BONE_OF.items()
        },
        heading=_heading(poses.rotation["root"]),
        hip_height=float(-lowest),
    )


def moved_by(skeleton: Skeleton, name: str) -> set[str]:
    """The bones whose rotations move a joint centre, "root" among them."""
    bones = set()
    bone = _BONE_OF[name]
    while bone != "root":
        bone = skeleton.bones[bone].parent
        bones.add(bone)
    return bones


def _heading(R_WB: np.ndarray) -> np.ndarray:
    """Returns the (T,) unwrapped yaw [rad] of (T, 3, 3) rotations of the y-up file.

    It is the twist about the vertical, 2 atan2(q_up, q_w): unlike the direction of
    the belly it is defined for a performer who bends over by 90 degrees.
    """
    x, z = 0, 2
    sine = R_WB[:, x, z] - R_WB[:, z, x]
    cosine = R_WB[:, z, z] + R_WB[:, x, x]
    return np.unwrap(np.arctan2(sine, cosine))
