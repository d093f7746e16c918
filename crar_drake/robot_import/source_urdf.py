"""A robot's own URDF: where it is, what is in it, and what of it is not supported."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere
from pydrake.math import RigidTransform, RollPitchYaw

from crar_drake.errors import ModelError
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
from crar_drake.robot_import.source_tree import SourceTree

# Attributes that are numbers.
_NUMBERS = (
    *("xyz", "rpy", "size", "radius", "length", "scale", "value"),
    *("lower", "upper", "effort", "velocity"),
)

# Primitive to Drake's shape, the attributes that are its size, and of how many numbers.
_PRIMITIVES = {
    "box": (Box, ("size",), 3),
    "sphere": (Sphere, ("radius",), 1),
    "cylinder": (Cylinder, ("radius", "length"), 2),
    "capsule": (Capsule, ("radius", "length"), 2),
    "ellipsoid": (Ellipsoid, ("a", "b", "c"), 3),
}

_LEAST_SCALE = 1e-8  # of a mesh, that Drake takes

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
    tree = SourceTree(path)
    colours = _read_colours(root, tree.notes)
    meshes = MeshFinder(path, package_paths)
    elements = root.findall("link")
    if not any(element.get("name") == WORLD for element in elements) and any(
        parent.get("link") == WORLD for parent in root.findall("joint/parent")
    ):
        elements.append(ElementTree.Element("link", name=WORLD))  # as Drake reads it
    for element in elements:
        with naming(path, "link", element):
            tree.add_link(_read_link(element, colours, meshes, tree.notes))
    tree.notes += meshes.check()
    for element in root.findall("joint"):
        with naming(path, "joint", element):
            tree.add_joint(_read_joint(element, tree.warnings))
    if any("," in element.get(key, "") for element in root.iter() for key in _NUMBERS):
        tree.notes.append(
            "numbers with commas: 1,5 was read as 1.5, and a comma before a space as "
            "nothing"
        )
    return tree.finished(robot_name(root.get("name") or "", path))


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


def _read_link(element, colours, meshes, notes) -> Link:
    name = element.get("name") or ""
    shapes = {
        kind: tuple(
            shape
            for entry in element.findall(kind)
            if (shape := _read_shape(entry, name, colours, meshes, notes))
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


def _read_shape(element, link, colours, meshes, notes) -> Shape | None:
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
        if min(map(abs, scale)) < _LEAST_SCALE:
            notes.append(f"link {link}: a mesh with a scale of zero is left out")
            return None
        found = meshes.find(shape.get("filename", ""), f"link {link}")
        return Shape(X_LG, Mesh(str(found), scale), rgba)
    if kind not in _PRIMITIVES:
        raise ValueError(f"unknown geometry <{kind}>")
    make, names, count = _PRIMITIVES[kind]
    size = [v for name in names for v in numbers_of(shape.get(name, ""))]
    if len(size) != count:
        raise ValueError(f"<{kind}> has no valid size")
    if not min(size) > 0.0:
        notes.append(f"link {link}: a {kind} without volume is left out")
        return None
    return Shape(X_LG, make(*size), rgba)


def _read_joint(element, warnings: list[str]) -> Joint:
    name = element.get("name") or ""
    kind = element.get("type") or ""
    if kind not in (*MOVING, "fixed", "floating", "planar"):
        raise ValueError(f"it has the unknown type {kind!r}")
    ends = {tag: element.find(tag) for tag in ("parent", "child")}
    if any(end is None for end in ends.values()):
        raise ValueError("it lacks its parent or child")
    limit = element.find("limit")
    # A weld follows nothing, whatever the file says of it.
    mimic = None if kind == "fixed" else element.find("mimic")
    dynamics, axis = element.find("dynamics"), element.find("axis")
    vector = np.array(
        three_numbers(axis.get("xyz")) if axis is not None else (1, 0, 0.0)
    )
    length = np.linalg.norm(vector)
    if kind in MOVING and not length > 0.0:
        raise ValueError("it has an axis of no length")

    def number(of, key: str) -> float | None:
        if of is None or of.get(key) is None:
            return None
        try:
            return one_number(of.get(key), infinite=of is limit)
        except ValueError as error:
            raise ValueError(f"{key}: {error}") from error

    multiplier = number(mimic, "multiplier")
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
        1.0 if multiplier is None else multiplier,
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
