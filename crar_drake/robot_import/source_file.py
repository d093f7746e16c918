"""A robot's own file, whatever its format: URDF, SDF or MJCF."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from crar_drake.errors import ModelError
from crar_drake.robot_import.robot_files import read_xml
from crar_drake.robot_import.source_mjcf import read_mjcf
from crar_drake.robot_import.source_robot import Joint, SourceRobot
from crar_drake.robot_import.source_sdf import read_sdf
from crar_drake.robot_import.source_urdf import read_urdf


def read_robot(path: Path, package_paths: Sequence[Path] = ()) -> SourceRobot:
    """Reads a robot by what its file's root element says that it is.

    Raises:
        ModelError: it is no URDF, SDF or MJCF, or something in it is wrong or not
            supported.
    """
    root = _root_element(path)
    if root == "mujoco":
        return with_checked_limits(read_mjcf(path))
    if root == "sdf" or path.suffix == ".sdf":
        return with_checked_limits(read_sdf(path, package_paths))
    if root == "mujocoinclude":
        raise ModelError(
            f"{path}: it is a piece of an MJCF; import the file that includes it"
        )
    if path.suffix == ".xml" and root != "robot":
        what = f"its root element is <{root}>" if root else "it is no XML"
        raise ModelError(f"{path}: neither a URDF nor an SDF nor an MJCF: {what}")
    return with_checked_limits(read_urdf(path, package_paths))


def _root_element(path: Path) -> str:
    """The name of an XML file's root element; "" where it has none."""
    try:
        return read_xml(path, "an XML file").tag
    except ModelError:
        return ""


def with_checked_limits(robot: SourceRobot) -> SourceRobot:
    """The robot; an infinite speed or effort limit is none.

    Raises:
        ModelError: a joint's limits are NaN, reversed, negative or on one side; it is
            named.
    """
    joints = {}
    for joint in robot.joints.values():
        if joint.moves:
            joint = replace(
                joint,
                effort=_bound(robot, joint, "effort"),
                velocity=_bound(robot, joint, "velocity"),
            )
            _check_range(robot, joint)
        joints[joint.name] = joint
    return replace(robot, joints=joints)


def _bound(robot: SourceRobot, joint: Joint, key: str) -> float | None:
    value = getattr(joint, key)
    if value is None or value == np.inf:
        return None
    if not value >= 0.0:
        raise ModelError(
            f"{robot.path}: joint {joint.name!r}: {key} is {value:g}; give a positive "
            "number, or none"
        )
    return value


def _check_range(robot: SourceRobot, joint: Joint) -> None:
    lower, upper = joint.lower, joint.upper
    if lower == -np.inf and upper == np.inf:
        return
    wrong = (
        "lower is above upper"
        if lower > upper
        else "give both limits or none"
        if not np.isfinite(upper - lower)
        else ""
    )
    if wrong:
        raise ModelError(
            f"{robot.path}: joint {joint.name!r}: its range is {lower:g} to {upper:g} "
            f"{joint.unit}: {wrong}"
        )
