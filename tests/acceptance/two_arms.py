"""A trunk with two arms, as URDF, SDF and MJCF with the same numbers.

Shoulders 0.2 m to each side, 0.25 m to the elbow and to the wrist, arms hang at zero.
"""

from dataclasses import dataclass, replace
from pathlib import Path

LIMIT, EFFORT, SPEED = 1.5, 20.0, 5.0  # of each joint [rad, Nm, rad/s]


@dataclass(frozen=True)
class Joint:
    """A joint and the link that it turns, which has the same name."""

    name: str
    parent: str
    xyz: tuple[float, float, float]  # in the parent [m]
    axis: str
    radius: float  # of a sphere at the joint, or of a cylinder about it [m]
    length: float = 0.0  # of the cylinder, along z [m]
    lower: float | str = -LIMIT
    upper: float | str = LIMIT


def joints() -> list[Joint]:
    """The twelve of both arms, the left first."""
    found = []
    for side, y in (("left", 0.2), ("right", -0.2)):
        parent = "trunk"
        for number, (xyz, axis, radius, length) in enumerate(
            [
                ((0.0, y, 0.2), "0 1 0", 0.02, 0.0),
                ((0.0, 0.0, 0.0), "1 0 0", 0.02, 0.0),
                ((0.0, 0.0, 0.0), "0 0 1", 0.03, 0.16),
                ((0.0, 0.0, -0.25), "0 1 0", 0.03, 0.16),
                ((0.0, 0.0, -0.25), "0 0 1", 0.02, 0.0),
                ((0.0, 0.0, 0.0), "1 0 0", 0.02, 0.0),
            ],
            start=1,
        ):
            name = f"{side}_arm_{number}"
            found.append(Joint(name, parent, xyz, axis, radius, length))
            parent = name
    return found


def changed(name: str, **values: float | str) -> list[Joint]:
    """The joints, one of them with other values."""
    return [replace(j, **values) if j.name == name else j for j in joints()]


def write_urdf(path: Path, of: list[Joint] | None = None, trunk: str = "") -> Path:
    """The robot; `trunk` is another geometry of the trunk."""
    box = trunk or '<box size="0.16 0.2 0.5"/>'
    parts = [_urdf_link("trunk", box, 8.0)]
    for j in of or joints():
        x, y, z = j.xyz
        parts += [
            _urdf_link(
                j.name,
                f'<cylinder radius="{j.radius}" length="{j.length}"/>'
                if j.length
                else f'<sphere radius="{j.radius}"/>',
                0.5,
            ),
            f'<joint name="{j.name}_joint" type="revolute"><parent link="{j.parent}"/>'
            f'<child link="{j.name}"/><origin xyz="{x} {y} {z}"/>'
            f'<axis xyz="{j.axis}"/><limit lower="{j.lower}" upper="{j.upper}" '
            f'effort="{EFFORT}" velocity="{SPEED}"/></joint>',
        ]
    return _write(path, f'<robot name="cell">{"".join(parts)}</robot>')


def write_sdf(path: Path) -> Path:
    """The same as SDF."""
    box = "<box><size>0.16 0.2 0.5</size></box>"
    parts = [_sdf_link("trunk", "", box, 8.0)]
    for j in joints():
        shape = (
            f"<cylinder><radius>{j.radius}</radius><length>{j.length}</length></cylinder>"
            if j.length
            else f"<sphere><radius>{j.radius}</radius></sphere>"
        )
        x, y, z = j.xyz
        pose = f'<pose relative_to="{j.parent}">{x} {y} {z} 0 0 0</pose>'
        parts += [
            _sdf_link(j.name, pose, shape, 0.5),
            f'<joint name="{j.name}_joint" type="revolute"><parent>{j.parent}</parent>'
            f"<child>{j.name}</child><axis><xyz>{j.axis}</xyz><limit>"
            f"<lower>{j.lower}</lower><upper>{j.upper}</upper><effort>{EFFORT}</effort>"
            f"<velocity>{SPEED}</velocity></limit></axis></joint>",
        ]
    text = f'<sdf version="1.9"><model name="cell">{"".join(parts)}</model></sdf>'
    return _write(path, text)


def write_mjcf(path: Path) -> Path:
    """The same as MJCF, which knows no limits of speeds."""
    of, sides = joints(), []
    for arm in (of[:6], of[6:]):
        body = ""
        for j in reversed(arm):
            x, y, z = j.xyz
            size = f"{j.radius} {j.length / 2}" if j.length else f"{j.radius}"
            kind = "cylinder" if j.length else "sphere"
            body = (
                f'<body name="{j.name}" pos="{x} {y} {z}"><inertial pos="0 0 0" '
                'mass="0.5" diaginertia="0.01 0.01 0.01"/>'
                f'<joint name="{j.name}_joint" axis="{j.axis}" limited="true" '
                f'range="{j.lower} {j.upper}"/><geom type="{kind}" size="{size}"/>'
                f"{body}</body>"
            )
        sides.append(body)
    motors = "".join(
        f'<motor joint="{j.name}_joint" gear="{EFFORT}" ctrlrange="-1 1" '
        'ctrllimited="true"/>'
        for j in of
    )
    text = (
        '<mujoco model="cell"><compiler angle="radian"/><worldbody><body name="trunk">'
        '<inertial pos="0 0 0" mass="8" diaginertia="0.1 0.1 0.1"/>'
        f'<geom type="box" size="0.08 0.1 0.25"/>{"".join(sides)}</body></worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )
    return _write(path, text)


def _urdf_link(name: str, shape: str, mass: float) -> str:
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx="0.01" '
        'iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry>'
        f"{shape}</geometry></visual></link>"
    )


def _sdf_link(name: str, pose: str, shape: str, mass: float) -> str:
    return (
        f'<link name="{name}">{pose}<inertial><mass>{mass}</mass><inertia>'
        "<ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia></inertial>"
        f'<visual name="look"><geometry>{shape}</geometry></visual></link>'
    )


def _write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path
