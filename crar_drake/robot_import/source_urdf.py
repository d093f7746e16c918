"""A robot's own URDF: where it is, what is in it, and what of it is not supported."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from crar_drake.errors import ModelError, nearest
from crar_drake.robot_import.robot_files import (
    MeshFinder,
    naming,
    numbers_of,
    one_number,
    read_xml,
    robot_name,
    three_numbers,
)
from crar_drake.robot_import.source_robot import (
    MOVING,
    WORLD,
    Inertia,
    Joint,
    Link,
    Shape,
    SourceRobot,
)

# Attributes that are numbers.
_NUMBERS = (
    *("xyz", "rpy", "size", "radius", "length", "scale", "value"),
    *("lower", "upper", "effort", "velocity"),
)

_QUATERNION = "quat_xyzw"  # how URDF 1.1 turns an <origin>

# Drake's elements that close a chain, which the controller's model has no part for.
_LOOPS = (
    "drake:linear_bushing_rpy",
    "drake:ball_constraint",
    "drake:tendon_constraint",
    "loop_joint",
)


def read_urdf(path: Path, package_paths: Sequence[Path] = ()) -> SourceRobot:
    """Reads a URDF and resolves its meshes.

    Args:
        package_paths: folders that contain packages, besides those that the
            environment (ROS_PACKAGE_PATH, AMENT_PREFIX_PATH) and the file's own
            place suggest.

    Raises:
        ModelError: the file is no URDF, its links are not one tree, or a mesh or
            package is not there; the message names link, address and remedy.
    """
    root = read_xml(path, "a URDF")
    if root.tag != "robot":
        raise ModelError(f"{path}: not a URDF: its root element is <{root.tag}>")
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise ModelError(
            f"{path}: it is made of macros that are not expanded; expand it with "
            f"ROS's xacro ({path.name} > robot.urdf) and import what that writes"
        )
    refuse_loops(root, path)
    notes, warnings = [], []
    colours = _read_colours(root, notes)
    meshes = MeshFinder(path, package_paths)
    links = {}
    elements = root.findall("link")
    if not any(element.get("name") == WORLD for element in elements) and any(
        parent.get("link") == WORLD for parent in root.findall("joint/parent")
    ):
        elements.append(ElementTree.Element("link", name=WORLD))  # as Drake reads it
    for element in elements:
        with naming(path, "link", element):
            link = _read_link(element, colours, meshes, path, notes)
        if link.name in links:
            raise ModelError(f"{path}: two links are named {link.name!r}")
        links[link.name] = link
    notes += meshes.check()
    joints = {}
    for element in root.findall("joint"):
        with naming(path, "joint", element):
            joint = _read_joint(element, path, warnings)
        if joint.name in joints:
            raise ModelError(f"{path}: two joints are named {joint.name!r}")
        joints[joint.name] = joint
    if any("," in element.get(key, "") for element in root.iter() for key in _NUMBERS):
        notes.append(
            "numbers with commas: 1,5 was read as 1.5, and a comma before a space as "
            "nothing"
        )
    name = robot_name(root.get("name") or "", path)
    robot = SourceRobot(name, path, links, joints, tuple(notes), tuple(warnings))
    check_tree(robot)
    return robot


def refuse_loops(root: ElementTree.Element, path: Path) -> None:
    """Raises ModelError, which names it, if something of a `read_xml` closes a chain
    without being a joint."""
    for tag in _LOOPS:
        element = next(root.iter(tag.replace("drake:", "_drake_")), None)
        if element is not None:
            raise ModelError(
                f"{path}: <{tag}> {element.get('name', '')!r} closes a chain, "
                "which the controller does not support; take it out of the file"
            )


def check_tree(robot: SourceRobot) -> None:
    """Raises ModelError: the links are not one tree, or a name is of nothing."""
    path, links, joints = robot.path, robot.links, robot.joints
    if not links:
        raise ModelError(f"{path}: it has no links")
    parents: dict[str, Joint] = {}
    for joint in joints.values():
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ModelError(
                    f"{path}: joint {joint.name!r} names the link {end!r}, which is "
                    f"not there{nearest(end, links)}"
                )
        if joint.child in parents:
            raise ModelError(
                f"{path}: link {joint.child!r} hangs on the joints "
                f"{parents[joint.child].name!r} and {joint.name!r}: a closed chain, "
                "which is not supported; remove one of them"
            )
        parents[joint.child] = joint
        if joint.mimic and joint.mimic not in joints:
            raise ModelError(
                f"{path}: joint {joint.name!r} mimics {joint.mimic!r}, which is not "
                f"there{nearest(joint.mimic, joints)}"
            )
    tops = [name for name in links if name not in parents]
    if len(tops) != 1:
        raise ModelError(
            f"{path}: the links are not one tree; these have no parent: "
            f"{', '.join(tops) or 'none (a closed chain)'}"
        )
    # A ring of joints beside the tree leaves links that no way leads to.
    tree = set(robot.below(tops[0]))
    if lost := [name for name in links if name not in tree]:
        raise ModelError(
            f"{path}: these links form a closed chain, which is not supported: "
            f"{', '.join(lost)}"
        )


def _read_colours(
    root: ElementTree.Element, notes: list[str]
) -> dict[str | None, tuple[float, ...] | None]:
    """Material to its colour; a robot moves as well without one."""
    colours = {}
    for material in root.iter("material"):
        if (colour := material.find("color")) is None:
            continue
        name = material.get("name")
        colours[name] = _rgba(colour)
        note = (
            f"material {name!r}: {colour.get('rgba')!r} is no colour, which is four "
            "numbers from 0 to 1: it is left out"
        )
        if colours[name] is None and note not in notes:
            notes.append(note)
    return colours


def _rgba(colour: ElementTree.Element) -> tuple[float, ...] | None:
    """A colour; None where it is none that Drake can show."""
    try:
        rgba = numbers_of(colour.get("rgba"))
    except ValueError:
        return None
    return rgba if len(rgba) == 4 and all(0.0 <= v <= 1.0 for v in rgba) else None


def _read_link(element, colours, meshes, path, notes) -> Link:
    name = element.get("name") or ""
    shapes = {
        kind: tuple(
            shape
            for entry in element.findall(kind)
            if (shape := _read_shape(entry, name, colours, meshes, path, notes))
        )
        for kind in ("visual", "collision")
    }
    return Link(name, shapes["visual"], shapes["collision"], _read_inertia(element))


def _read_inertia(link: ElementTree.Element) -> Inertia | None:
    """A link's inertia; None without a mass."""
    element = link.find("inertial")
    if element is None:
        return None
    X_LB, mass, matrix = _origin(element), *map(element.find, ("mass", "inertia"))
    xx, yy, zz, xy, xz, yz = (
        0.0 if matrix is None else one_number(matrix.get(key, "0"))
        for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    if mass is None:
        return None
    moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Inertia(one_number(mass.get("value", "0")), X_LB, moments)


def _read_shape(element, link, colours, meshes, path, notes) -> Shape | None:
    geometry = element.find("geometry")
    if geometry is None or not len(geometry):
        return None
    shape = geometry[0]
    material = element.find("material")
    rgba = None
    if material is not None:
        colour = material.find("color")
        rgba = (
            _rgba(colour) if colour is not None else colours.get(material.get("name"))
        )
    X_LG = _origin(element)
    kind = shape.tag.removeprefix("_drake_")
    if kind == "mesh":
        scale = three_numbers(shape.get("scale", "1 1 1"))
        if not all(scale):
            notes.append(f"link {link}: a mesh with a scale of zero is left out")
            return None
        found = meshes.find(shape.get("filename", ""), f"link {link}")
        return Shape(X_LG, kind, found, scale, rgba=rgba)
    sizes = {"box": ("size",), "sphere": ("radius",)}
    names = sizes.get(kind, ("radius", "length"))
    if kind not in ("box", "sphere", "cylinder", "capsule"):
        raise ModelError(f"{path}: link {link!r}: unknown geometry <{kind}>")
    size = tuple(v for name in names for v in numbers_of(shape.get(name, "")))
    if len(size) != {"box": 3, "sphere": 1}.get(kind, 2):
        raise ModelError(f"{path}: link {link!r}: <{kind}> has no valid size")
    if not min(size) > 0.0:
        notes.append(f"link {link}: a {kind} without volume is left out")
        return None
    return Shape(X_LG, kind, size=size, rgba=rgba)


def _read_joint(element, path: Path, warnings: list[str]) -> Joint:
    name = element.get("name") or ""
    kind = element.get("type") or ""
    if kind not in (*MOVING, "fixed", "floating", "planar"):
        raise ModelError(f"{path}: joint {name!r} has the unknown type {kind!r}")
    ends = {tag: element.find(tag) for tag in ("parent", "child")}
    if any(end is None for end in ends.values()):
        raise ModelError(f"{path}: joint {name!r} lacks its parent or child")
    limit = element.find("limit")
    # A weld follows nothing, whatever the file says of it.
    mimic = None if kind == "fixed" else element.find("mimic")
    dynamics, axis = element.find("dynamics"), element.find("axis")
    vector = np.array(
        three_numbers(axis.get("xyz")) if axis is not None else (1, 0, 0.0)
    )
    length = np.linalg.norm(vector)
    if kind in MOVING and not length > 0.0:
        raise ModelError(f"{path}: joint {name!r} has an axis of no length")

    def number(of, key: str) -> float | None:
        if of is None or of.get(key) is None:
            return None
        try:
            return one_number(of.get(key), infinite=of is limit)
        except ValueError as error:
            raise ValueError(f"{key}: {error}") from error

    lower, upper = number(limit, "lower"), number(limit, "upper")
    if kind == "continuous" or lower is upper is None:
        lower, upper = -np.inf, np.inf
    elif lower is None or upper is None:
        missing = "lower" if lower is None else "upper"
        lower, upper = lower or 0.0, upper or 0.0
        warnings.append(
            f"limits: joint {name} has no {missing} limit, which URDF takes for 0: "
            f"its range is {lower:g} to {upper:g}"
        )
    return Joint(
        name,
        kind,
        ends["parent"].get("link", ""),
        ends["child"].get("link", ""),
        _origin(element),
        vector / length if length else vector,
        lower,
        upper,
        number(limit, "effort"),
        number(limit, "velocity"),
        number(dynamics, "damping") or 0.0,
        "" if mimic is None else mimic.get("joint", ""),
        number(mimic, "multiplier")
        if mimic is not None and mimic.get("multiplier")
        else 1.0,
        number(mimic, "offset") or 0.0,
    )


def _origin(element) -> RigidTransform:
    origin = element.find("origin")
    if origin is None:
        return RigidTransform()
    if origin.get(_QUATERNION) is not None:
        raise ValueError(
            f"its <origin> turns by {_QUATERNION} (URDF 1.1), which is not read: write "
            "the same rotation as rpy"
        )
    return RigidTransform(
        RollPitchYaw(three_numbers(origin.get("rpy", "0 0 0"))),
        three_numbers(origin.get("xyz", "0 0 0")),
    )
