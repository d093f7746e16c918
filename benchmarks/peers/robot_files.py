"""One robot in the three dialects that the peers read, all made from one URDF.

Drake knows capsules in a URDF (`drake:capsule`), Pinocchio as a cylinder that is named
in `collision_checking`, MuJoCo in its own format. Several models that a scene welds to
the world become one. The prescribed joints of the waist are welded where the rest
posture has them, so that every peer has the same joints; what is only drawn is left
out.
"""

import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

DRAKE = "http://drake.mit.edu"
CAPSULE = f"{{{DRAKE}}}capsule"
WIDE = 100.0  # [rad] limits of a joint that has none
WORLD = "world"  # as Drake calls it
ROOT = "scene"  # the link in its place, since the other two have a world of their own


def unscoped(name: str) -> str:
    """A link's name without its model's: the models of a scene become one."""
    return name.rpartition("::")[2]


def read(model: Path) -> ET.Element:
    """A URDF, or the models of a scene that are welded to the world, as one robot.

    Args:
        model: a URDF, or Drake's model directives with `add_model` and `add_weld`
            only, each model in the same folder.

    Raises:
        ValueError: a scene of other directives, or of two links with one name.
    """
    if model.suffix == ".urdf":
        return ET.parse(model).getroot()
    robot = ET.Element("robot", {"name": model.parent.name})
    for directive in yaml.safe_load(model.read_text())["directives"]:
        ((kind, given),) = directive.items()
        if kind == "add_model":
            robot.extend(ET.parse(model.parent / Path(given["file"]).name).getroot())
        elif kind == "add_weld" and given["parent"] == WORLD:
            child = unscoped(given["child"])
            weld = _fixed(robot, f"{child}_weld", WORLD, child)
            at = given.get("X_PC", {}).get("translation", (0.0, 0.0, 0.0))
            ET.SubElement(weld, "origin", {"xyz": _numbers(at)})
        else:
            raise ValueError(f"{model}: {kind} is not a weld to the world")
    names = [link.get("name") for link in robot.findall("link")]
    if len(set(names)) < len(names):
        raise ValueError(f"{model}: two links have the same name")
    return robot


def root_link(robot: ET.Element) -> str:
    """The link that is nobody's child."""
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}
    (root,) = {link.get("name") for link in robot.findall("link")} - children
    return root


def simplified_urdf(
    model: Path, welded: Mapping[str, float], points: Iterable[str] = ()
) -> ET.Element:
    """The robot of a model without visuals, with some joints welded and one root link.

    Args:
        model: what `read` takes, with capsules and spheres as its only collision
            shapes.
        welded: joint to the position where it is fixed [m or rad].
        points: frames of Drake's that become links.
    """
    robot = read(model)
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
    parents = [joint.find("parent") for joint in robot.findall("joint")]
    on_world = [parent for parent in parents if parent.get("link") == WORLD]
    if on_world:
        robot.insert(0, ET.Element("link", {"name": ROOT}))
        for parent in on_world:
            parent.set("link", ROOT)
    for frame in robot.findall("frame"):
        name = frame.get("name")
        if name in points:
            robot.remove(frame)
            at, turn = frame.get("xyz", "0 0 0"), frame.get("rpy", "0 0 0")
            _add_point(robot, name, frame.get("link"), at, turn)
    return robot


def on_a_base(robot: ET.Element, reach: float, fastest: float) -> None:
    """Puts the robot on a base that slides along x and y and turns about z.

    Args:
        robot: is changed; its root link then moves.
        reach: how far the base may go [m].
        fastest: [m/s] and [rad/s].
    """
    below = root_link(robot)
    for name, kind, axis, most in (
        ("base_yaw", "revolute", "0 0 1", np.pi),
        ("base_y", "prismatic", "0 1 0", reach),
        ("base_x", "prismatic", "1 0 0", reach),
    ):
        link = ET.Element("link", {"name": f"{name}_under"})
        inertial = ET.SubElement(link, "inertial")  # MuJoCo moves nothing without
        ET.SubElement(inertial, "origin", {"xyz": "0 0 0", "rpy": "0 0 0"})
        ET.SubElement(inertial, "mass", {"value": "1"})
        moments = dict.fromkeys(("ixx", "iyy", "izz"), "1e-3")
        products = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
        ET.SubElement(inertial, "inertia", moments | products)
        joint = ET.Element("joint", {"name": name, "type": kind})
        ET.SubElement(joint, "parent", {"link": f"{name}_under"})
        ET.SubElement(joint, "child", {"link": below})
        ET.SubElement(joint, "axis", {"xyz": axis})
        limit = {"lower": f"{-most}", "upper": f"{most}", "velocity": f"{fastest}"}
        ET.SubElement(joint, "limit", limit | {"effort": "1000"})
        robot.insert(0, joint)
        robot.insert(0, link)
        motor = ET.SubElement(robot, "transmission", {"name": f"{name}_motor"})
        ET.SubElement(motor, "type").text = "transmission_interface/SimpleTransmission"
        ET.SubElement(motor, "joint", {"name": name})
        ET.SubElement(motor, "actuator", {"name": f"{name}_motor"})
        below = f"{name}_under"


def _add_point(robot: ET.Element, name: str, link: str, at: str, turn: str) -> None:
    ET.SubElement(robot, "link", {"name": name})
    joint = _fixed(robot, f"{name}_weld", link, name)
    ET.SubElement(joint, "origin", {"xyz": at, "rpy": turn})


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

    add(ET.SubElement(mujoco, "worldbody"), root_link(robot), None)
    return _text(mujoco)


def _fixed(robot: ET.Element, name: str, parent: str, child: str) -> ET.Element:
    """A new joint of the robot that holds a link fast."""
    joint = ET.SubElement(robot, "joint", {"name": name, "type": "fixed"})
    ET.SubElement(joint, "parent", {"link": parent})
    ET.SubElement(joint, "child", {"link": child})
    return joint


def _weld(joint: ET.Element, position: float) -> None:
    """Fixes a joint of one degree of freedom where its position is `position`."""
    origin = _origin(joint)
    axis = np.array(joint.find("axis").get("xyz").split(), dtype=float)
    at = np.array(origin.get("xyz", "0 0 0").split(), dtype=float)
    turned = Rotation.from_euler("xyz", _rotation(joint))
    if joint.get("type") == "prismatic":
        at = at + turned.apply(position * axis)
    else:
        turned = turned * Rotation.from_rotvec(position * axis)
    for tag in ("axis", "limit", "origin", "dynamics"):
        for part in joint.findall(tag):
            joint.remove(part)
    joint.set("type", "fixed")
    placed = {"xyz": _numbers(at), "rpy": _numbers(turned.as_euler("xyz"))}
    ET.SubElement(joint, "origin", placed)


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
