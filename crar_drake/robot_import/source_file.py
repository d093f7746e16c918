"""A robot's own file, whatever its format: URDF, SDF or MJCF."""

from collections.abc import Sequence
from pathlib import Path

from crar_drake.errors import ModelError
from crar_drake.robot_import.robot_files import read_xml
from crar_drake.robot_import.source_mjcf import read_mjcf
from crar_drake.robot_import.source_robot import SourceRobot
from crar_drake.robot_import.source_sdf import read_sdf
from crar_drake.robot_import.source_urdf import read_urdf


def read_robot(path: Path, package_paths: Sequence[Path] = ()) -> SourceRobot:
    """Reads a robot by what its file's root element says that it is.

    Args:
        package_paths: as `read_urdf` has them; MuJoCo knows no packages.

    Raises:
        ModelError: it is no URDF, SDF or MJCF, or something in it is wrong or not
            supported.
    """
    root = _root_element(path)
    if root == "mujoco":
        return read_mjcf(path)
    if root == "sdf" or path.suffix == ".sdf":
        return read_sdf(path, package_paths)
    if root == "mujocoinclude":
        raise ModelError(
            f"{path}: it is a piece of an MJCF; import the file that includes it"
        )
    if path.suffix == ".xml" and root != "robot":
        what = f"its root element is <{root}>" if root else "it is no XML"
        raise ModelError(f"{path}: neither a URDF nor an SDF nor an MJCF: {what}")
    return read_urdf(path, package_paths)


def _root_element(path: Path) -> str:
    """The name of an XML file's root element; "" where it has none."""
    try:
        return read_xml(path, "an XML file").tag
    except ModelError:
        return ""
