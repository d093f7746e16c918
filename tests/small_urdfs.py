"""URDF texts for the tests of the import."""

from collections.abc import Iterable
from pathlib import Path


def link(name: str, shape: str = "", xyz: str = "0 0 0", mass: float = 1.0) -> str:
    """A link with one visual shape, e.g. '<box size="1 1 1"/>', and a mass."""
    visual = (
        f'<visual><origin xyz="{xyz}"/><geometry>{shape}</geometry>'
        '<material name="m"><color rgba="0.2 0.4 0.8 1"/></material></visual>'
        if shape
        else ""
    )
    inertia = (
        f'<inertial><origin xyz="{xyz}"/><mass value="{mass}"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
        if mass
        else ""
    )
    return f'<link name="{name}">{inertia}{visual}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    axis: str = "0 0 1",
    xyz: str = "0 0 0",
    kind: str = "revolute",
    extra: str = "",
    limits: str = 'lower="-1.5" upper="1.5" effort="20" velocity="5"',
) -> str:
    """A joint; `extra` is XML inside of it, e.g. a mimic element."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        f"<limit {limits}/>{extra}</joint>"
    )


def robot(parts: Iterable[str], name: str = "small") -> str:
    """The parts as a URDF."""
    return f'<robot name="{name}">{"".join(parts)}</robot>'


def write(folder: Path, text: str, name: str = "small.urdf") -> Path:
    """Writes the text and returns its path."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def humanoid() -> str:
    """Pelvis, legs, a trunk with a yaw joint, and arms of five joints, x forward.

    Its arms hang at y = 0.2 from shoulders 0.4 m above the pelvis; 0.25 m from
    shoulder to elbow and from elbow to wrist; its soles are 0.8 m below.
    """
    parts = [
        link("pelvis", '<box size="0.16 0.24 0.16"/>', mass=5.0),
        link("torso", '<box size="0.16 0.24 0.3"/>', "0 0 0.28", mass=8.0),
        joint("waist_yaw", "pelvis", "torso"),
        link("head", '<sphere radius="0.09"/>', mass=2.0),
        joint("neck_joint", "torso", "head", xyz="0 0 0.56"),
    ]
    for side, y in (("left", 1), ("right", -1)):
        leg, arm = f"{side}_leg", f"{side}_arm"
        parts += [
            link(leg, '<cylinder radius="0.05" length="0.66"/>', "0 0 -0.37", 4.0),
            joint(f"{side}_hip", "pelvis", leg, "0 1 0", f"0 {0.08 * y} -0.1"),
            link(f"{arm}_pitch", mass=0.5),
            joint(f"{arm}_1", "torso", f"{arm}_pitch", "0 1 0", f"0 {0.2 * y} 0.4"),
            link(f"{arm}_roll", mass=0.5),
            joint(f"{arm}_2", f"{arm}_pitch", f"{arm}_roll", "1 0 0"),
            link(
                f"{arm}_upper", '<cylinder radius="0.04" length="0.16"/>', "0 0 -0.12"
            ),
            joint(f"{arm}_3", f"{arm}_roll", f"{arm}_upper", "0 0 1"),
            link(f"{arm}_fore", '<cylinder radius="0.03" length="0.16"/>', "0 0 -0.12"),
            joint(
                f"{arm}_4",
                f"{arm}_upper",
                f"{arm}_fore",
                "0 1 0",
                "0 0 -0.25",
                limits='lower="-2.2" upper="0.0" effort="20" velocity="5"',
            ),
            link(f"{arm}_wrist", mass=0.2),
            joint(f"{arm}_5", f"{arm}_fore", f"{arm}_wrist", "0 0 1", "0 0 -0.25"),
            link(f"{arm}_hand", '<box size="0.05 0.03 0.12"/>', "0 0 -0.07", 0.3),
            joint(f"{arm}_6", f"{arm}_wrist", f"{arm}_hand", "1 0 0"),
            link(f"{arm}_finger", '<box size="0.01 0.01 0.05"/>', "0 0 -0.02", 0.02),
            joint(f"{arm}_finger_1", f"{arm}_hand", f"{arm}_finger", xyz="0 0 -0.13"),
            link(f"{arm}_thumb", '<box size="0.01 0.01 0.05"/>', "0 0 -0.02", 0.02),
            joint(
                f"{arm}_finger_2",
                f"{arm}_hand",
                f"{arm}_thumb",
                xyz="0.02 0 -0.13",
                extra=f'<mimic joint="{arm}_finger_1" multiplier="-1"/>',
            ),
        ]
    return robot(parts, "small_humanoid")


def humanoid_with_legs() -> str:
    """The small humanoid on legs of six joints: knees at 0.3 m, ankles at 0.6 m below
    the hips, which are 0.1 m to each side and 0.15 m below the pelvis."""
    text = humanoid()
    for side, y in (("left", 1), ("right", -1)):
        old = joint(
            f"{side}_hip", "pelvis", f"{side}_leg", "0 1 0", f"0 {0.08 * y} -0.1"
        )
        assert old in text
        steps = [  # axis, and where from the joint before
            ("yaw", "0 0 1", f"0 {0.1 * y} -0.05"),
            ("roll", "1 0 0", "0 0 -0.1"),
            ("pitch", "0 1 0", "0 0 0"),
            ("knee", "0 1 0", "0 0 -0.3"),
            ("ankle", "0 1 0", "0 0 -0.3"),
            ("ankle_roll", "1 0 0", "0 0 0"),
        ]
        below, parts = "pelvis", []
        for name, axis, xyz in steps:
            parts += [
                link(f"{side}_{name}"),
                joint(f"{side}_{name}_joint", below, f"{side}_{name}", axis, xyz),
            ]
            below = f"{side}_{name}"
        weld = joint(f"{side}_sole", below, f"{side}_leg", kind="fixed")
        text = text.replace(old, "".join(parts) + weld)
    return text
