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
        weld = ElementTree.SubElement(root, "joint", name="world_weld", type="fixed")
        ElementTree.SubElement(weld, "parent", link=WORLD)
        ElementTree.SubElement(weld, "child", link=robot.root)
        _add_origin(weld, X_WR)
    for link in robot.links:
        element = ElementTree.SubElement(root, "link", name=link)
        if link in inertias:
            _add_inertia(element, inertias[link])
        for visual in visuals.get(link, ()):
            _add_visual(element, visual)
        for index, capsule in enumerate(capsules.get(link, ())):
            _add_capsule(element, f"{link}_{index}", capsule)
    for joint in robot.joints.values():
        welded = robot.is_weld(joint)
        kind = "fixed" if welded else joint.kind
        element = ElementTree.SubElement(root, "joint", name=joint.name, type=kind)
        ElementTree.SubElement(element, "parent", link=joint.parent)
        ElementTree.SubElement(element, "child", link=joint.child)
        _add_origin(element, joint.transform(robot.locked.get(joint.name, 0.0)))
        if welded:
            continue
        ElementTree.SubElement(element, "axis", xyz=_text(joint.axis))
        limit = ElementTree.SubElement(element, "limit")
        if np.isfinite(joint.lower):
            limit.set("lower", _text([joint.lower]))
            limit.set("upper", _text([joint.upper]))
        # Drake gives a joint with an effort of zero no actuator.
        if joint.effort:
            limit.set("effort", _text([joint.effort]))
        if joint.velocity:
            limit.set("velocity", _text([joint.velocity]))
        if joint.damping:
            ElementTree.SubElement(element, "dynamics", damping=_text([joint.damping]))
        _add_transmission(root, joint.name)
    for point, frame in frames.items():
        ElementTree.SubElement(
            root,
            "frame",
            name=frame_name(point),
            link=frame.link,
            xyz=_text(frame.point),
            rpy=_text(frame.rpy),
        )
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
            link = ElementTree.SubElement(root, "link", name=child)
            small = Inertia(_BASE_MASS, RigidTransform(), np.eye(3) * 1e-6)
            _add_inertia(link, small)
        joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
        ElementTree.SubElement(joint, "parent", link=parent)
        ElementTree.SubElement(joint, "child", link=child)
        if child == first_link and not robot.X_FR.IsExactlyIdentity():
            _add_origin(joint, robot.X_FR)
        ElementTree.SubElement(joint, "axis", xyz=axis)
        _add_transmission(root, name)
        parent = child


def _add_transmission(root, joint: str) -> None:
    element = ElementTree.SubElement(root, "transmission", name=f"{joint}_transmission")
    ElementTree.SubElement(
        element, "type"
    ).text = "transmission_interface/SimpleTransmission"
    ElementTree.SubElement(element, "joint", name=joint)
    ElementTree.SubElement(element, "actuator", name=joint)


def _add_inertia(link, inertia: Inertia) -> None:
    element = ElementTree.SubElement(link, "inertial")
    _add_origin(element, inertia.X_LB)
    ElementTree.SubElement(element, "mass", value=_text([inertia.mass]))
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = inertia.moments
    values = dict(ixx=ixx, ixy=ixy, ixz=ixz, iyy=iyy, iyz=iyz, izz=izz)
    # All digits, for rounded ones of a flat body are not those of any body.
    ElementTree.SubElement(
        element, "inertia", **{key: repr(float(v)) for key, v in values.items()}
    )


def _add_visual(link, visual: VisualMesh) -> None:
    element = ElementTree.SubElement(link, "visual")
    geometry = ElementTree.SubElement(element, "geometry")
    ElementTree.SubElement(geometry, "mesh", filename=visual.file)
    material = ElementTree.SubElement(element, "material", name=f"{visual.file}_colour")
    ElementTree.SubElement(material, "color", rgba=_text(visual.rgba))


def _add_capsule(link, name: str, capsule: FittedCapsule) -> None:
    element = ElementTree.SubElement(link, "collision", name=name)
    centre = (capsule.p_L0 + capsule.p_L1) / 2.0
    x, y, z = capsule.p_L1 - capsule.p_L0
    # Roll is free for a body of revolution about its z axis.
    rpy = (0.0, np.arctan2(np.hypot(x, y), z), np.arctan2(y, x))
    _add_origin(element, RigidTransform(RollPitchYaw(*rpy), centre))
    geometry = ElementTree.SubElement(element, "geometry")
    if capsule.length < 1e-6:
        ElementTree.SubElement(geometry, "sphere", radius=_text([capsule.radius]))
    else:
        ElementTree.SubElement(
            geometry,
            "drake:capsule",
            radius=_text([capsule.radius]),
            length=_text([capsule.length]),
        )


def _add_origin(element, X: RigidTransform) -> None:
    rpy = RollPitchYaw(X.rotation()).vector()
    ElementTree.SubElement(
        element, "origin", xyz=_text(X.translation()), rpy=_text(rpy)
    )


def _text(values: Sequence[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
