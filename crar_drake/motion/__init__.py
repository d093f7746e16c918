"""From a motion-capture file to a trajectory that fits a robot."""

from crar_drake.motion.asf_amc import (
    Bone,
    BonePoses,
    Clip,
    Skeleton,
    forward_kinematics,
    read_amc,
    read_asf,
    rest_pose,
    write_amc,
    write_asf,
)
from crar_drake.motion.conditioning import low_pass, spline
from crar_drake.motion.joint_centres import JOINT_CENTRES, JointCentres, joint_centres
from crar_drake.motion.report import (
    MotionReport,
    describe,
    inspect,
    plot_motion,
)
from crar_drake.motion.retarget import RetargetedMotion, SegmentLengths, retarget

__all__ = [
    "JOINT_CENTRES",
    "Bone",
    "BonePoses",
    "Clip",
    "JointCentres",
    "MotionReport",
    "RetargetedMotion",
    "SegmentLengths",
    "Skeleton",
    "describe",
    "forward_kinematics",
    "inspect",
    "joint_centres",
    "low_pass",
    "plot_motion",
    "read_amc",
    "read_asf",
    "rest_pose",
    "retarget",
    "spline",
    "write_amc",
    "write_asf",
]
