"""One robot in the three dialects that the peers read, all made from one URDF.

Drake knows capsules in a URDF (`drake:capsule`), Pinocchio as a cylinder that is named
in `collision_checking`, MuJoCo in its own format. The prescribed joints of the waist
are welded where the rest posture has them, so that every peer has the same joints;
what is only drawn is left out.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

DRAKE = "http://drake.mit.edu"
CAPSULE = f"{{{DRAKE}}}capsule"
WIDE = 100.0  # [rad] limits of a joint that has none


def simplified_urdf(urdf: Path, welded: Mapping[str, float]) -> ET.Element:
    """The robot of a URDF without visuals, with some sliding joints welded.

    Args:
        urdf: with capsules and spheres as its only collision shapes.
        welded: sliding joint to the position where it is fixed [m].
    """
    robot = ET.parse(urdf).getroot()
    for unused in [*robot.findall("material"), *robot.findall("transmission")]:
        if unused.tag == "transmission" and unused.find("joint").get("name") in welded:
            robot.remove(unused)
        elif unused.tag == "material":
            robot.remove(unused)
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for joint in robot.findall("joint"):
        if joint.get("name") in welded:
            _weld(joint, welded[joint.get("name")])
    return robot


def drake_urdf(robot: ET.Element) -> str:
    """The URDF for Drake: as it is."""
    return _text(robot)


def pinocchio_urdf(robot: ET.Element) -> str:
    """The URDF for Pinocchio: capsules are cylinders that are named as capsules.

    A joint without limits becomes one with very wide limits, since Pinocchio gives an
    unlimited one two positions (its cosine and sine), and PlaCo counts on one.
    """
    robot = copy.deepcopy(robot)
    for only_drake in [x for x in robot if x.tag.startswith(f"{{{DRAKE}}}")]:
        robot.remove(only_drake)
    for joint in robot.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            joint.find("limit").set("lower", f"{-WIDE}")
            joint.find("limit").set("upper", f"{WIDE}")
    for link in robot.findall("link"):
        capsules = []
        for collision in link.findall("collision"):
            geometry = collision.find("geometry")
            capsule = geometry.find(CAPSULE)
            if capsule is not None:
                geometry.remove(capsule)
                ET.SubElement(geometry, "cylinder", dict(capsule.attrib))
                capsules.append(collision.get("name"))
        if capsules:
            checking = ET.SubElement(link, "collision_checking")
            for name in capsules:
                ET.SubElement(checking, "capsule", {"name": name})
    return _text(robot)


def mjcf(robot: ET.Element, task_links: Sequence[str]) -> str:
    """The robot for MuJoCo, with a site at the origin of each task link.

    Contacts are off; the peer asks distances pair by pair.
    """
    mujoco = ET.Element("mujoco", {"model": robot.get("name")})
    ET.SubElement(mujoco, "compiler", {"angle": "radian", "autolimits": "true"})
    option = ET.SubElement(mujoco, "option")
    ET.SubElement(option, "flag", {"contact": "disable"})
    joints = robot.findall("joint")
    links = {link.get("name"): link for link in robot.findall("link")}
    children = {joint.find("child").get("link") for joint in joints}
    (root,) = links.keys() - children

    def add(parent: ET.Element, name: str, joint: ET.Element | None) -> None:
        attributes = {"name": name}
        if joint is not None:
            attributes |= _mjcf_pose(joint)
        body = ET.SubElement(parent, "body", attributes)
        if joint is not None and joint.get("type") != "fixed":
            body.append(_mjcf_joint(joint))
        link = links[name]
        inertial = link.find("inertial")
        if inertial is not None:
            body.append(_mjcf_inertial(inertial))
        for collision in link.findall("collision"):
            body.append(_mjcf_geom(collision))
        if name in task_links:
            ET.SubElement(body, "site", {"name": name})
        for below in joints:
            if below.find("parent").get("link") == name:
                add(body, below.find("child").get("link"), below)

    add(ET.SubElement(mujoco, "worldbody"), root, None)
    return _text(mujoco)


def _weld(joint: ET.Element, position: float) -> None:
    """Fixes a sliding joint where its position is `position`."""
    origin = _origin(joint)
    axis = np.array(joint.find("axis").get("xyz").split(), dtype=float)
    start = np.array(origin.get("xyz", "0 0 0").split(), dtype=float)
    if _rotation(joint).any():
        raise ValueError(f"{joint.get('name')}: origin is rotated")
    at = start + position * axis
    for tag in ("axis", "limit", "origin", "dynamics"):
        for part in joint.findall(tag):
            joint.remove(part)
    joint.set("type", "fixed")
    ET.SubElement(joint, "origin", {"xyz": " ".join(f"{x:.9g}" for x in at)})


def _origin(element: ET.Element) -> ET.Element:
    """The <origin>, empty where there is none."""
    origin = element.find("origin")
    return ET.Element("origin") if origin is None else origin


def _rotation(element: ET.Element) -> np.ndarray:
    """(3,) roll, pitch and yaw of its origin [rad]."""
    return np.array(_origin(element).get("rpy", "0 0 0").split(), dtype=float)


def _mjcf_pose(element: ET.Element) -> dict[str, str]:
    """Where its origin is, as MuJoCo writes it."""
    pose = {"pos": _origin(element).get("xyz", "0 0 0")}
    rotation = Rotation.from_euler("xyz", _rotation(element))
    if rotation.magnitude():
        x, y, z, w = rotation.as_quat()
        pose["quat"] = _numbers((w, x, y, z))
    return pose


def _mjcf_inertial(inertial: ET.Element) -> ET.Element:
    """In the link's axes: MuJoCo turns none that has products of inertia."""
    inertia = inertial.find("inertia")
    xx, yy, zz, xy, xz, yz = (
        float(inertia.get(key)) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    R = Rotation.from_euler("xyz", _rotation(inertial)).as_matrix()
    I_B = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    return ET.Element(
        "inertial",
        {
            "pos": _origin(inertial).get("xyz", "0 0 0"),
            "mass": inertial.find("mass").get("value"),
            "fullinertia": _numbers(
                [I_B[0, 0], I_B[1, 1], I_B[2, 2], I_B[0, 1], I_B[0, 2], I_B[1, 2]]
            ),
        },
    )


def _mjcf_joint(joint: ET.Element) -> ET.Element:
    kind = "slide" if joint.get("type") == "prismatic" else "hinge"
    made = ET.Element(
        "joint",
        {
            "name": joint.get("name"),
            "type": kind,
            "axis": joint.find("axis").get("xyz"),
        },
    )
    if joint.get("type") != "continuous":
        limit = joint.find("limit")
        made.set("range", f"{limit.get('lower')} {limit.get('upper')}")
    return made


def _mjcf_geom(collision: ET.Element) -> ET.Element:
    (shape,) = collision.find("geometry")
    geom = ET.Element("geom", {"name": collision.get("name")})
    geom.set("pos", _origin(collision).get("xyz", "0 0 0"))
    radius = shape.get("radius")
    if shape.tag == "sphere":
        geom.set("type", "sphere")
        geom.set("size", radius)
        return geom
    if shape.tag != CAPSULE:
        raise ValueError(f"{collision.get('name')}: neither a capsule nor a sphere")
    # Both formats lay a capsule along z; MuJoCo wants half the length.
    axis = Rotation.from_euler("xyz", _rotation(collision)).apply([0.0, 0.0, 1.0])
    geom.set("type", "capsule")
    geom.set("size", f"{radius} {0.5 * float(shape.get('length')):.9g}")
    geom.set("zaxis", _numbers(axis))
    return geom


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{x:.12g}" for x in values)


def _text(root: ET.Element) -> str:
    ET.register_namespace("drake", DRAKE)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
