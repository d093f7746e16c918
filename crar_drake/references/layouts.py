"""The layouts of robot motions that are read and written, and how a file is
recognised."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError, nearest
from crar_drake.motion.robots_own import SUFFIXES
from crar_drake.references.robot_motion import RobotMotion


@dataclass(frozen=True)
class Layout:
    """A layout."""

    name: str  # what it is called here
    suffix: str  # of its files
    used_by: str  # who writes and reads such files
    # before the joints, in the array of the joints; 0 if the root is elsewhere
    root_columns: int = 0
    breadth_first: bool = False  # whether joints are in that order, and not depth first
    several: bool = False  # whether a file can hold several motions

    @property
    def has_rate(self) -> bool:
        """Whether a file says its rate, each of its motions another perhaps."""
        return self.suffix != ".csv" and self.name != "amass-npy"


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("xyzw-csv", ".csv", "Unitree, input of BeyondMimic and mjlab", 7),
        Layout("wxyz-csv", ".csv", "ProtoMotions, kimodo", 7),
        Layout("named-csv", ".csv", "BONES-SEED"),
        Layout("beyondmimic-npz", ".npz", "BeyondMimic, Isaac Lab", breadth_first=True),
        Layout("mjlab-npz", ".npz", "mjlab"),
        Layout("holosoma-npz", ".npz", "holosoma", 7),
        Layout("amp-npz", ".npz", "Isaac Lab's AMP, AMASS Retargeted for G1"),
        Layout("locomujoco-npz", ".npz", "LocoMuJoCo", several=True),
        Layout("phuma-npy", ".npy", "PHUMA"),
        Layout("amass-npy", ".npy", "Retargeted AMASS for robotics", 7),
        Layout("gmr-pkl", ".pkl", "GMR, TWIST"),
        Layout("motion-lib-pkl", ".pkl", "PHC, ASAP, HumanoidVerse", several=True),
    )
}


def layout_named(name: str) -> Layout:
    """The layout of that name.

    Raises:
        MotionError: there is none.
    """
    if name not in LAYOUTS:
        raise MotionError(f"there is no layout {name!r}{nearest(name, LAYOUTS)}")
    return LAYOUTS[name]


def layouts_of(path: str | os.PathLike[str]) -> list[str]:
    """Names of the layouts that a file with that suffix can have."""
    suffix = Path(path).suffix.lower()
    suffix = SUFFIXES.get(suffix, suffix)
    return [layout.name for layout in LAYOUTS.values() if layout.suffix == suffix]


def reordered(motion: RobotMotion, joint_names: Sequence[str]) -> RobotMotion:
    """The same motion with its joints in another order.

    Args:
        motion: whose joints have names.
        joint_names: the same names.

    Raises:
        MotionError: they are others.
    """
    if tuple(joint_names) == motion.joint_names:
        return motion
    if set(joint_names) != set(motion.joint_names):
        missing = sorted(set(joint_names) - set(motion.joint_names))
        unknown = sorted(set(motion.joint_names) - set(joint_names))
        raise MotionError(
            f"{motion.source}: its joints are of another robot: "
            + "; ".join(
                f"{what} {', '.join(names[:4])}"
                + (f" and {len(names) - 4} more" if len(names) > 4 else "")
                for what, names in (("it lacks", missing), ("it has", unknown))
                if names
            )
        )
    order = [motion.joint_names.index(name) for name in joint_names]
    computed = dict(motion.computed)
    # What has a column a joint goes with them; what has a row a link stays, and is
    # written only in the layout that it was read from.
    for key in {"joint_vel", "rows"} & computed.keys():
        values = np.asarray(computed[key])
        root = values.shape[1] - motion.num_joints
        computed[key] = values[:, [*range(root), *(root + i for i in order)]]
    computed.pop("pose_aa", None)
    changed = replace(
        motion,
        joint_names=tuple(joint_names),
        joint_positions=motion.joint_positions[:, order],
        computed=computed,
    )
    return changed.as_read() if motion.is_as_read else changed
