"""A small URDF writer: links out of primitives, with inertias from the solid shapes.

Only what the two models beside this file need. Lengths in metres, angles in
radians, masses in kilograms; every pose is expressed in its link's frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.multibody.tree import SpatialInertia

Vector = Sequence[float]


@dataclass(frozen=True)
class Shape:
    """A primitive: "capsule", "sphere", "ellipsoid" or "cylinder".

    `size` is (radius, length), (radius,), (a, b, c) or (radius, length), as in
    URDF: a capsule's length is that of its segment, without the caps.
    """

    kind: str
    size: tuple[float, ...]
    center: tuple[float, ...]
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)

    def axis(self) -> np.ndarray:
        """Returns the unit vector of the shape's z axis in the link frame, (3,)."""
        _, pitch, yaw = self.rpy
        return np.array(
            [
                np.sin(pitch) * np.cos(yaw),
                np.sin(pitch) * np.sin(yaw),
                np.cos(pitch),
            ]
        )

    def mirrored(self) -> "Shape":
        """Returns the mirror image in the plane y = 0."""
        x, y, z = self.center
        roll, pitch, yaw = self.rpy
        return replace(self, center=(x, -y, z), rpy=(-roll, pitch, -yaw))


def _along(kind: str, radius: float, p_start: Vector, p_end: Vector) -> Shape:
    start, end = np.asarray(p_start, float), np.asarray(p_end, float)
    x, y, z = end - start
    length = float(np.linalg.norm(end - start))
    # Roll is free for a body of revolution: R = Rz(yaw) Ry(pitch).
    pitch, yaw = float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x))
    center = tuple(float(c) for c in (start + end) / 2)
    return Shape(kind, (radius, length), center, (0.0, pitch, yaw))


def capsule(radius: float, p_start: Vector, p_end: Vector) -> Shape:
    """Returns the capsule around the segment from `p_start` to `p_end`."""
    return _along("capsule", radius, p_start, p_end)


def cylinder(radius: float, p_start: Vector, p_end: Vector) -> Shape:
    """Returns the cylinder whose axis runs from `p_start` to `p_end`."""
    return _along("cylinder", radius, p_start, p_end)


def sphere(radius: float, center: Vector = (0, 0, 0)) -> Shape:
    """Returns a sphere."""
    return Shape("sphere", (radius,), tuple(center))


def ellipsoid(
    semi_axes: Vector, center: Vector = (0, 0, 0), rpy: Vector = (0, 0, 0)
) -> Shape:
    """Returns an ellipsoid with its semi-axes along x, y, z before `rpy`."""
    return Shape("ellipsoid", tuple(semi_axes), tuple(center), tuple(rpy))


@dataclass
class Link:
    """A link: its solids (shape and mass), its collision shapes and its looks.

    Without solids it is massless: a carriage or a mere frame.
    """

    name: str
    solids: list[tuple[Shape, float]] = field(default_factory=list)
    collisions: list[Shape] = field(default_factory=list)
    visuals: list[tuple[Shape, str]] = field(default_factory=list)

    def mirrored(self, name: str) -> "Link":
        """Returns the mirror image in the plane y = 0 under another name."""
        return Link(
            name,
            [(shape.mirrored(), mass) for shape, mass in self.solids],
            [shape.mirrored() for shape in self.collisions],
            [(shape.mirrored(), color) for shape, color in self.visuals],
        )


@dataclass
class Joint:
    """A joint; "fixed" ones need no axis and get no actuator.

    `lower` and `upper` [rad or m] are left out for a continuous joint; `effort`
    is in Nm or N, `velocity` in rad/s or m/s.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[int, int, int] = (0, 0, 1)
    lower: float | None = None
    upper: float | None = None
    effort: float = 0.0
    velocity: float = 0.0


def _numbers(values: Sequence[float]) -> str:
    # Adding 0.0 turns -0.0 into 0.0, which would print as "-0".
    return " ".join(f"{round(float(v), 9) + 0.0:.9g}" for v in values)


def _shape_lines(shape: Shape) -> list[str]:
    tag, names = {
        "capsule": ("drake:capsule", ("radius", "length")),
        "sphere": ("sphere", ("radius",)),
        "ellipsoid": ("drake:ellipsoid", ("a", "b", "c")),
        "cylinder": ("cylinder", ("radius", "length")),
    }[shape.kind]
    pairs = zip(names, shape.size, strict=True)
    size = " ".join(f'{name}="{_numbers([value])}"' for name, value in pairs)
    return [
        f'      <origin xyz="{_numbers(shape.center)}" rpy="{_numbers(shape.rpy)}"/>',
        f"      <geometry><{tag} {size}/></geometry>",
    ]


def _solid_inertia(shape: Shape, mass: float) -> SpatialInertia:
    """Returns the inertia of a homogeneous solid about the link origin."""
    if shape.kind == "sphere":
        inertia = SpatialInertia.SolidSphereWithMass(mass, *shape.size)
    elif shape.kind == "capsule":
        inertia = SpatialInertia.SolidCapsuleWithMass(mass, *shape.size, shape.axis())
    else:
        raise ValueError(f"masses are carried by capsules and spheres, not {shape}")
    return inertia.Shift(-np.array(shape.center))


def _inertial_lines(link: Link) -> list[str]:
    if not link.solids:
        return []
    total = _solid_inertia(*link.solids[0])
    for solid in link.solids[1:]:
        total += _solid_inertia(*solid)
    p_com = total.get_com()
    central = total.Shift(p_com).CalcRotationalInertia()
    moments, products = central.get_moments(), central.get_products()
    ixx, iyy, izz, ixy, ixz, iyz = (_numbers([v]) for v in (*moments, *products))
    return [
        "    <inertial>",
        f'      <origin xyz="{_numbers(p_com)}" rpy="0 0 0"/>',
        f'      <mass value="{_numbers([total.get_mass()])}"/>',
        f'      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}"'
        f' ixy="{ixy}" ixz="{ixz}" iyz="{iyz}"/>',
        "    </inertial>",
    ]


def _link_lines(link: Link) -> list[str]:
    lines = [f'  <link name="{link.name}">', *_inertial_lines(link)]
    for k, shape in enumerate(link.collisions):
        lines.append(f'    <collision name="{link.name}_collision_{k}">')
        lines += [*_shape_lines(shape), "    </collision>"]
    for k, (shape, color) in enumerate(link.visuals):
        lines.append(f'    <visual name="{link.name}_visual_{k}">')
        lines += [*_shape_lines(shape), f'      <material name="{color}"/>']
        lines.append("    </visual>")
    return [*lines, "  </link>"]


def _joint_lines(joint: Joint) -> list[str]:
    lines = [
        f'  <joint name="{joint.name}" type="{joint.kind}">',
        f'    <parent link="{joint.parent}"/>',
        f'    <child link="{joint.child}"/>',
        f'    <origin xyz="{_numbers(joint.origin)}" rpy="0 0 0"/>',
    ]
    if joint.kind == "fixed":
        return [*lines, "  </joint>"]
    limits = ""
    if joint.lower is not None and joint.upper is not None:
        lower, upper = _numbers([joint.lower]), _numbers([joint.upper])
        limits = f'lower="{lower}" upper="{upper}" '
    return [
        *lines,
        f'    <axis xyz="{_numbers(joint.axis)}"/>',
        f'    <limit {limits}effort="{_numbers([joint.effort])}"'
        f' velocity="{_numbers([joint.velocity])}"/>',
        '    <dynamics damping="0" friction="0"/>',
        "  </joint>",
        f'  <transmission name="{joint.name}_transmission">',
        "    <type>transmission_interface/SimpleTransmission</type>",
        f'    <joint name="{joint.name}">',
        "      <hardwareInterface>hardware_interface/EffortJointInterface"
        "</hardwareInterface>",
        "    </joint>",
        f'    <actuator name="{joint.name}"/>',
        "  </transmission>",
    ]


def urdf(
    name: str,
    script: str,
    colors: dict[str, Vector],
    links: Sequence[Link],
    joints: Sequence[Joint] = (),
    filters: dict[str, tuple[Sequence[str], Sequence[str]]] | None = None,
) -> str:
    """Returns the URDF text of a robot.

    Args:
        name: the robot's name.
        script: the file that the numbers come from, named in the first comment.
        colors: material name -> (r, g, b, a) in [0, 1].
        links: all links.
        joints: all joints; each that moves gets an actuator of the same name.
        filters: collision filter group -> (its links, the groups it ignores).
    """
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- Written by models/{script}: change that, and run it again. -->",
        f'<robot name="{name}" xmlns:drake="http://drake.mit.edu">',
    ]
    for color, rgba in colors.items():
        lines.append(
            f'  <material name="{color}"><color rgba="{_numbers(rgba)}"/></material>'
        )
    for link in links:
        lines += _link_lines(link)
    for joint in joints:
        lines += _joint_lines(joint)
    for group, (members, ignored) in (filters or {}).items():
        lines.append(f'  <drake:collision_filter_group name="{group}">')
        lines += [f'    <drake:member link="{member}"/>' for member in members]
        lines += [
            f'    <drake:ignored_collision_filter_group name="{other}"/>'
            for other in ignored
        ]
        lines.append("  </drake:collision_filter_group>")
    return "\n".join([*lines, "</robot>", ""])
