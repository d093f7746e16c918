"""A humanoid of 29 joints on a root that floats, made of text, for tests.

Legs of six joints whose axes meet at hips and ankles, feet of four balls whose lowest
points are 6 cm below the ankles, a waist, and arms of four joints.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.robot.description import RobotDescription, load_robot_description

THIGH, SHANK, ANKLE_HEIGHT = 0.35, 0.33, 0.06  # [m]
HIP = (0.0, 0.09, -0.05)  # from the pelvis [m]
HEEL, TOE, HALF_WIDTH = -0.06, 0.12, 0.03  # of the sole, from the ankle [m]
HEIGHT = THIGH + SHANK + ANKLE_HEIGHT - HIP[2]  # of the pelvis, standing straight [m]
_BALL = 0.01  # radius of the balls of a sole [m]


def leg_points(side: str, q: dict[str, float]) -> dict[str, np.ndarray]:
    """Points of a leg in the pelvis' frame [m], by hand: hip, knee, ankle, (3,) each,
    and sole, (4, 3) the centres of its balls.

    Args:
        side: "left" or "right".
        q: name of joint to position; 0 of those that are not there.
    """
    s = 1 if side == "left" else -1
    at = [np.array([HIP[0], s * HIP[1], HIP[2]])]
    R = Rotation.identity()
    for name, axis, way in (
        ("hip_pitch", "y", 0.0),
        ("hip_roll", "x", 0.0),
        ("thigh", "z", THIGH),
        ("shank", "y", SHANK),
        ("ankle", "y", 0.0),
        ("foot", "x", 0.0),
    ):
        R = R * Rotation.from_euler(axis, q.get(f"{side}_{name}_j", 0.0))
        if way:
            at.append(at[-1] + R.apply([0.0, 0.0, -way]))
    balls = [
        [x, y, _BALL - ANKLE_HEIGHT]
        for x in (HEEL, TOE)
        for y in (-HALF_WIDTH, HALF_WIDTH)
    ]
    hip, knee, ankle = at
    return {"hip": hip, "knee": knee, "ankle": ankle, "sole": ankle + R.apply(balls)}


def _link(name: str, shapes: str = "", mass: float = 1.0) -> str:
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx="0.01" '
        f'iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{shapes}</link>'
    )


def _ball(x: float, y: float, z: float, radius: float) -> str:
    return (
        f'<collision name="{x}{y}{z}"><origin xyz="{x} {y} {z}"/><geometry>'
        f'<sphere radius="{radius}"/></geometry></collision>'
    )


def _joint(name, parent, child, axis, xyz="0 0 0", lower=-2.0, upper=2.0) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        f'<limit lower="{lower}" upper="{upper}" effort="200" velocity="20"/></joint>'
        f'<transmission name="{name}_t"><type>transmission_interface/'
        f'SimpleTransmission</type><joint name="{name}"/><actuator name="{name}"/>'
        "</transmission>"
    )


def walker(
    folder: Path,
    ankle_roll: float = 0.3,
    knee: float | None = None,
    hips: bool = False,
) -> RobotDescription:
    """Writes the robot into a folder and loads it.

    Args:
        folder: exists.
        ankle_roll: limit of the ankles' roll to both sides [rad].
        knee: radius of a ball around each knee, which are then a pair [m].
        hips: whether a joint about the vertical, below the pelvis, carries both legs.
    """
    parts = [_link("pelvis", _ball(0, 0, 0.0, 0.08), 8.0), _link("yaw", mass=0.5)]
    parts += [_link("torso", _ball(0, 0, 0.25, 0.1), 12.0)]
    parts += [_joint("waist_yaw", "pelvis", "yaw", "0 0 1", "0 0 0.05")]
    parts += [_joint("waist_pitch", "yaw", "torso", "0 1 0")]
    if hips:
        parts += [_link("hips", mass=0.5), _joint("hips_j", "pelvis", "hips", "0 0 1")]
    frames = {"waist": "pelvis", "neck": "neck", "head": "head"}
    parts += ['<frame name="neck" link="torso" xyz="0 0 0.4" rpy="0 0 0"/>']
    parts += ['<frame name="head" link="torso" xyz="0 0 0.55" rpy="0 0 0"/>']
    knees = "" if knee is None else _ball(0, 0, 0, knee)
    for side, s in (("left", 1), ("right", -1)):
        x, y, z = HIP
        sole = "".join(
            _ball(a, b, _BALL - ANKLE_HEIGHT, _BALL)
            for a in (HEEL, TOE)
            for b in (-HALF_WIDTH, HALF_WIDTH)
        )
        chain = [  # joint, axis, where from the joint before, shapes, limits
            ("hip_pitch", "0 1 0", f"{x} {s * y} {z}", "", ()),
            ("hip_roll", "1 0 0", "0 0 0", "", ()),
            ("thigh", "0 0 1", "0 0 0", "", ()),
            ("shank", "0 1 0", f"0 0 {-THIGH}", knees, (-0.05, 2.5)),
            ("ankle", "0 1 0", f"0 0 {-SHANK}", "", (-1.2, 1.0)),
            ("foot", "1 0 0", "0 0 0", sole, (-ankle_roll, ankle_roll)),
        ]
        above = "hips" if hips else "pelvis"
        for name, axis, xyz, shapes, limits in chain:
            link = f"{side}_{name}"
            parts += [
                _link(link, shapes),
                _joint(f"{link}_j", above, link, axis, xyz, *limits),
            ]
            above = link
        above = "torso"
        for name, axis, xyz in (
            ("shoulder_pitch", "0 1 0", f"0 {s * 0.18} 0.38"),
            ("shoulder", "1 0 0", "0 0 0"),
            ("upper_arm", "0 0 1", "0 0 0"),
            ("fore_arm", "0 1 0", "0 0 -0.22"),
        ):
            link = f"{side}_{name}"
            parts += [
                _link(link, mass=0.5),
                _joint(f"{link}_j", above, link, axis, xyz),
            ]
            above = link
        parts += [
            f'<frame name="{side}_wrist" link="{above}" xyz="0 0 -0.2" rpy="0 0 0"/>'
        ]
        frames |= {
            f"{side}_shoulder": f"{side}_shoulder",
            f"{side}_elbow": f"{side}_fore_arm",
            f"{side}_wrist": f"{side}_wrist",
            f"{side}_hip": f"{side}_thigh",
            f"{side}_knee": f"{side}_shank",
            f"{side}_foot": f"{side}_foot",
        }
    text = f'<robot name="walker">{"".join(parts)}</robot>'
    (folder / "walker.urdf").write_text(text)
    named = ", ".join(f"{point}: {frame}" for point, frame in frames.items())
    pairs = "[left_foot, right_foot]"
    if knee is not None:
        pairs += ", [left_shank, right_shank]"
    bent = 0.3
    posture = ", ".join(
        f"{side}_{joint}_j: {angle}"
        for side in ("left", "right")
        for joint, angle in (
            ("hip_pitch", -bent / 2),
            ("shank", bent),
            ("ankle", -bent / 2),
            ("fore_arm", -0.5),
        )
    )
    (folder / "robot.yaml").write_text(
        "name: walker\nmodel: walker.urdf\nbase: pelvis\nroot: prescribed\n"
        f"root_pose: {{xyz: [0.0, 0.0, {HEIGHT - 0.01}], rpy: [0.0, 0.0, 0.0]}}\n"
        f"task_frames: {{{named}}}\npairs: [{pairs}]\n"
        f"rest_posture: {{{posture}}}\n"
    )
    return load_robot_description(folder)
