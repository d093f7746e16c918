"""The URDF that the controller uses: joints welded, a prescribed base, capsules."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from crar_drake.files import whole_file
from crar_drake.robot_import.capsule_fitting import Capsules, FittedCapsule
from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.source_robot import WORLD, Inertia, SourceRobot

# Prescribed joint -> (type, axis, what of the motion drives it).
BASE_JOINTS = {
    "waist_x": ("prismatic", "1 0 0", "waist.x"),
    "waist_y": ("prismatic", "0 1 0", "waist.y"),
    "waist_z": ("prismatic", "0 0 1", "waist.z"),
    "waist_heading": ("continuous", "0 0 1", "waist.heading"),
}
_BASE_MASS = 1e-3  # [kg] of the links between the prescribed joints


@dataclass(frozen=True)
class VisualMesh:
    """A converted mesh in the link's frame: file beside the URDF, and colour."""

    file: str
    rgba: Sequence[float]


def frame_name(point: str) -> str:
    """What the frame of a motion's point is called in the URDF."""
    return f"{point}_point"


def write_urdf(
    path: Path,
    robot: SourceRobot,
    name: str,
    *,
    base: str,
    height: float = 0.0,
    frames: Mapping[str, FrameChoice],
    visuals: Mapping[str, Sequence[VisualMesh]],
    capsules: Capsules,
    inertias: Mapping[str, Inertia],
) -> bool:
    """Writes the generated URDF.

    Args:
        base: one of `choices.BASES`: "prescribed", joints that the motion drives carry
            the root link; "floating", the file does not connect it with the world.
        height: of a fixed root link above the ground [m].
        visuals, capsules, inertias: by link; links that are in none are bare.

    Returns:
        Whether the file connects the root link with the world.
    """
    root = ElementTree.Element("robot", name=name)
    root.set("xmlns:drake", "http://drake.mit.edu")
    root.append(
        ElementTree.Comment(
            " Made by crar-drake import-robot from import.yaml; do not edit. "
        )
    )
    prescribed = base == "prescribed"
    if prescribed:
        _add_base(root, robot)
    X_WR = RigidTransform(np.array([0.0, 0.0, height])) @ robot.X_FR
    there = robot.root == WORLD or X_WR.IsExactlyIdentity()
    lifted = base == "fixed" and not there
    if lifted:
        _add_joint(root, "world_weld", "fixed", WORLD, robot.root, X_WR)
    for link in robot.links:
        element = _add(root, "link", name=link)
        if link in inertias:
            _add_inertia(element, inertias[link])
        for visual in visuals.get(link, ()):
            _add_visual(element, visual)
        for index, capsule in enumerate(capsules.get(link, ())):
            _add_capsule(element, f"{link}_{index}", capsule)
    for joint in robot.joints.values():
        welded = robot.is_weld(joint)
        kind = "fixed" if welded else joint.kind
        X_PC = joint.transform(robot.locked.get(joint.name, 0.0))
        element = _add_joint(root, joint.name, kind, joint.parent, joint.child, X_PC)
        if welded:
            continue
        _add(element, "axis", xyz=joint.axis)
        limits = {}
        if np.isfinite(joint.lower):
            limits = {"lower": joint.lower, "upper": joint.upper}
        # Drake gives a joint with an effort of zero no actuator.
        if joint.effort:
            limits["effort"] = joint.effort
        if joint.velocity:
            limits["velocity"] = joint.velocity
        _add(element, "limit", **limits)
        if joint.damping:
            _add(element, "dynamics", damping=joint.damping)
        _add_transmission(root, joint.name)
    for point, at in frames.items():
        name = frame_name(point)
        _add(root, "frame", name=name, link=at.link, xyz=at.point, rpy=at.rpy)
    ElementTree.indent(root)
    with whole_file(path) as temporary:
        temporary.write_bytes(ElementTree.tostring(root, xml_declaration=True))
    return prescribed or lifted or robot.root == WORLD


def _add_base(root, robot: SourceRobot) -> None:
    parent, first_link = WORLD, robot.root
    children = [f"{name}_carriage" for name in list(BASE_JOINTS)[:-1]] + [first_link]
    for (name, (kind, axis, _)), child in zip(
        BASE_JOINTS.items(), children, strict=True
    ):
        if child != first_link:
            small = Inertia(_BASE_MASS, RigidTransform(), np.eye(3) * 1e-6)
            _add_inertia(_add(root, "link", name=child), small)
        turned = child == first_link and not robot.X_FR.IsExactlyIdentity()
        X_PC = robot.X_FR if turned else None
        joint = _add_joint(root, name, kind, parent, child, X_PC)
        _add(joint, "axis", xyz=axis)
        _add_transmission(root, name)
        parent = child


def _add_joint(
    root, name: str, kind: str, parent: str, child: str, X_PC: RigidTransform | None
) -> ElementTree.Element:
    """A joint; without an origin if there is no X_PC."""
    joint = _add(root, "joint", name=name, type=kind)
    _add(joint, "parent", link=parent)
    _add(joint, "child", link=child)
    if X_PC is not None:
        _add_origin(joint, X_PC)
    return joint


def _add_transmission(root, joint: str) -> None:
    element = _add(root, "transmission", name=f"{joint}_transmission")
    _add(element, "type").text = "transmission_interface/SimpleTransmission"
    _add(element, "joint", name=joint)
    _add(element, "actuator", name=joint)


def _add_inertia(link, inertia: Inertia) -> None:
    element = _add(link, "inertial")
    _add_origin(element, inertia.X_LB)
    _add(element, "mass", value=inertia.mass)
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = inertia.moments
    values = dict(ixx=ixx, ixy=ixy, ixz=ixz, iyy=iyy, iyz=iyz, izz=izz)
    # All digits, for rounded ones of a flat body are not those of any body.
    _add(element, "inertia", **{key: repr(float(v)) for key, v in values.items()})


def _add_visual(link, visual: VisualMesh) -> None:
    element = _add(link, "visual")
    _add(_add(element, "geometry"), "mesh", filename=visual.file)
    material = _add(element, "material", name=f"{visual.file}_colour")
    _add(material, "color", rgba=visual.rgba)


def _add_capsule(link, name: str, capsule: FittedCapsule) -> None:
    element = _add(link, "collision", name=name)
    centre = (capsule.p_L0 + capsule.p_L1) / 2.0
    x, y, z = capsule.p_L1 - capsule.p_L0
    # Roll is free for a body of revolution about its z axis.
    rpy = (0.0, np.arctan2(np.hypot(x, y), z), np.arctan2(y, x))
    _add_origin(element, RigidTransform(RollPitchYaw(*rpy), centre))
    geometry, radius = _add(element, "geometry"), capsule.radius
    if capsule.length < 1e-6:
        _add(geometry, "sphere", radius=radius)
    else:
        _add(geometry, "drake:capsule", radius=radius, length=capsule.length)


def _add_origin(element, X: RigidTransform) -> None:
    rpy = RollPitchYaw(X.rotation()).vector()
    _add(element, "origin", xyz=X.translation(), rpy=rpy)


def _add(
    element, tag: str, **values: str | float | Sequence[float]
) -> ElementTree.Element:
    """An element below another, with attributes that are texts, numbers or vectors."""
    text = {
        key: value
        if isinstance(value, str)
        else " ".join(f"{number:.9g}" for number in np.ravel(value))
        for key, value in values.items()
    }
    return ElementTree.SubElement(element, tag, text)
