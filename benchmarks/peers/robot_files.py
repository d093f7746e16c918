"""One robot in the three dialects that the peers read, all made from one URDF.

Drake knows capsules in a URDF (`drake:capsule`), Pinocchio as a cylinder that is named
in `collision_checking`, MuJoCo in its own format. The prescribed joints of the waist
are welded where the rest posture has them, so that every peer has the same joints;
what is only drawn is left out.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

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
            attributes["pos"] = _origin(joint).get("xyz", "0 0 0")
        body = ET.SubElement(parent, "body", attributes)
        if joint is not None and joint.get("type") != "fixed":
            body.append(_mjcf_joint(joint))
        link = links[name]
        inertial = link.find("inertial")
        if inertial is not None:
            inertia = inertial.find("inertia")
            order = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
            ET.SubElement(
                body,
                "inertial",
                {
                    "pos": _origin(inertial).get("xyz", "0 0 0"),
                    "mass": inertial.find("mass").get("value"),
                    "fullinertia": " ".join(inertia.get(key) for key in order),
                },
            )
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
    at = start + position * axis  # no rotation: `_origin` checks it
    for tag in ("axis", "limit", "origin", "dynamics"):
        for part in joint.findall(tag):
            joint.remove(part)
    joint.set("type", "fixed")
    ET.SubElement(joint, "origin", {"xyz": " ".join(f"{x:.9g}" for x in at)})


def _origin(element: ET.Element) -> ET.Element:
    """The <origin>; joints and inertias of this robot have translations only."""
    origin = element.find("origin")
    if origin is None:
        return ET.Element("origin")
    if any(float(angle) for angle in origin.get("rpy", "0 0 0").split()):
        raise ValueError(f"{element.get('name') or element.tag}: origin is rotated")
    return origin


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
    origin = collision.find("origin")
    geom = ET.Element("geom", {"name": collision.get("name")})
    geom.set("pos", origin.get("xyz", "0 0 0"))
    radius = shape.get("radius")
    if shape.tag == "sphere":
        geom.set("type", "sphere")
        geom.set("size", radius)
        return geom
    if shape.tag != CAPSULE:
        raise ValueError(f"{collision.get('name')}: neither a capsule nor a sphere")
    # Both formats lay a capsule along z; MuJoCo wants half the length.
    roll, pitch, yaw = (float(x) for x in origin.get("rpy", "0 0 0").split())
    axis = (
        np.cos(yaw) * np.sin(pitch) * np.cos(roll) + np.sin(yaw) * np.sin(roll),
        np.sin(yaw) * np.sin(pitch) * np.cos(roll) - np.cos(yaw) * np.sin(roll),
        np.cos(pitch) * np.cos(roll),
    )
    geom.set("type", "capsule")
    geom.set("size", f"{radius} {0.5 * float(shape.get('length')):.9g}")
    geom.set("zaxis", " ".join(f"{x:.12g}" for x in axis))
    return geom


def _text(root: ET.Element) -> str:
    ET.register_namespace("drake", DRAKE)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
