"""From a motion-capture file to a trajectory that fits a robot."""

from crar_drake.motion.catalogue import (
    MotionFiles,
    available_trials,
    builtin_names,
    cached_trials,
    load_clip,
    load_performer,
    resolve,
)
from crar_drake.motion.conditioning import low_pass, spline
from crar_drake.motion.fetch import LICENCE_NOTICE, fetch, rich_progress
from crar_drake.motion.formats.asf_amc import (
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
from crar_drake.motion.hand_orientations import (
    HANDS,
    HandOrientations,
    hand_orientations,
)
from crar_drake.motion.joint_centres import JOINT_CENTRES, JointCentres, joint_centres
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import JOINTS, Fact, Performer
from crar_drake.motion.picture import plot_motion
from crar_drake.motion.report import MotionReport, describe, inspect
from crar_drake.motion.retarget import RetargetedMotion, SegmentLengths, retarget

__all__ = [
    "HANDS",
    "JOINTS",
    "JOINT_CENTRES",
    "LICENCE_NOTICE",
    "Bone",
    "BonePoses",
    "Clip",
    "Fact",
    "HandOrientations",
    "JointCentres",
    "MotionFiles",
    "MotionOptions",
    "MotionReport",
    "Performer",
    "RetargetedMotion",
    "SegmentLengths",
    "Skeleton",
    "available_trials",
    "builtin_names",
    "cached_trials",
    "describe",
    "fetch",
    "forward_kinematics",
    "hand_orientations",
    "inspect",
    "joint_centres",
    "load_clip",
    "load_performer",
    "low_pass",
    "plot_motion",
    "read_amc",
    "read_asf",
    "resolve",
    "rest_pose",
    "retarget",
    "rich_progress",
    "spline",
    "write_amc",
    "write_asf",
]
