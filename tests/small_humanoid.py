"""A humanoid with the 29 joints of a G1 and their limits, and round lengths.

It crouches on flat soles with hips at -0.3, knees at 0.6 and ankles at -0.3 rad.
"""

from pathlib import Path

import numpy as np

from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

THIGH = SHIN = 0.3  # [m]
ANKLE, RADIUS = 0.04, 0.02  # height above the soles' centres, of their balls [m]
# Height of the root in a crouch [m].
CROUCH = 0.1 + (THIGH + SHIN) * np.cos(0.3) + ANKLE + RADIUS
PARTS = {  # of a side or the waist: joint, axis, from the joint before [m], limits
    "leg": (
        ("hip_pitch", "0 1 0", "0 {y} -0.1", -2.53, 2.88),
        ("hip_roll", "1 0 0", "0 0 0", -0.52, 2.97),
        ("hip_yaw", "0 0 1", "0 0 0", -2.76, 2.76),
        ("knee", "0 1 0", f"0 0 {-THIGH}", -0.09, 2.88),
        ("ankle_pitch", "0 1 0", f"0 0 {-SHIN}", -0.87, 0.52),
        ("ankle_roll", "1 0 0", "0 0 0", -0.26, 0.26),
    ),
    "waist": (
        ("waist_yaw", "0 0 1", "0 0 0.05", -2.62, 2.62),
        ("waist_roll", "1 0 0", "0 0 0.04", -0.52, 0.52),
        ("waist_pitch", "0 1 0", "0 0 0.01", -0.52, 0.52),
    ),
    "arm": (
        ("shoulder_pitch", "0 1 0", "0 {y} 0.3", -3.09, 2.67),
        ("shoulder_roll", "1 0 0", "0 {y} 0", -1.59, 2.25),
        ("shoulder_yaw", "0 0 1", "0 0 -0.1", -2.62, 2.62),
        ("elbow", "0 1 0", "0 0 -0.1", -1.05, 2.09),
        ("wrist_roll", "1 0 0", "0.1 0 0", -1.97, 1.97),
        ("wrist_pitch", "0 1 0", "0.04 0 0", -1.61, 1.61),
        ("wrist_yaw", "0 0 1", "0.05 0 0", -1.61, 1.61),
    ),
}
INERTIA = (
    '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" '
    'ixz="0" iyz="0"/></inertial>'
)


def humanoid(folder: Path) -> WholeBody:
    """Writes the robot into a folder, and reads it."""
    text = [f'<robot name="humanoid"><link name="pelvis">{INERTIA}</link>']
    for side, y in (("left", 0.1), ("right", -0.1)):
        text += _limb("leg", f"{side}_", "pelvis", y)
    text += _limb("waist", "", "pelvis", 0.0)
    for side, y in (("left", 0.1), ("right", -0.1)):
        text += _limb("arm", f"{side}_", "waist_pitch_link", y)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "humanoid.urdf").write_text("".join(text) + "</robot>")
    feet = {f"{side}_foot": f"{side}_ankle_roll_link" for side in ("left", "right")}
    (folder / "robot.yaml").write_text(
        f"name: humanoid\nmodel: humanoid.urdf\nbase: pelvis\ntask_frames: {feet}\n"
        "pairs: [[left_ankle_roll_link, right_ankle_roll_link]]\n".replace("'", "")
    )
    return WholeBody(load_robot_description(folder))


def _limb(part: str, side: str, parent: str, y: float) -> list[str]:
    text = []
    for name, axis, xyz, lower, upper in PARTS[part]:
        if name.endswith("roll") and side == "right_" and -lower != upper:
            lower, upper = -upper, -lower
        balls = ""
        if name == "ankle_roll":
            balls = "".join(
                f'<collision name="{side}{x}"><origin xyz="{x} 0 {-ANKLE}"/><geometry>'
                f'<sphere radius="{RADIUS}"/></geometry></collision>'
                for x in (-0.05, 0.12)
            )
        joint, link = f"{side}{name}_joint", f"{side}{name}_link"
        text.append(
            f'<link name="{link}">{INERTIA}{balls}</link><joint name="{joint}" '
            f'type="revolute"><parent link="{parent}"/><child link="{link}"/>'
            f'<origin xyz="{xyz.format(y=y)}"/><axis xyz="{axis}"/><limit '
            f'lower="{lower}" upper="{upper}" effort="9" velocity="20"/></joint>'
        )
        parent = link
    return text


def crouching(robot: WholeBody, frames: int = 60, rate: float = 30.0):
    """(T, 3) root positions, (T, 4) quaternions w x y z, (T, 29) joints of somebody who
    crouches, turns and swings his arms."""
    t = np.arange(frames) / rate
    swing = np.sin(np.pi * t)
    angles = {"hip_pitch": -0.3, "knee": 0.6, "ankle_pitch": -0.3, "elbow": 0.7}
    q = np.zeros((frames, robot.n))
    for i, name in enumerate(robot.joint_names):
        sign = 1.0 if name.startswith("left") else -1.0
        q[:, i] = next((v for part, v in angles.items() if part in name), 0.0)
        if "shoulder_roll" in name:
            q[:, i] = 0.35 * sign
        if "shoulder_pitch" in name:
            q[:, i] = 0.4 * sign * swing
        if "waist_yaw" in name:
            q[:, i] = 0.2 * swing
    yaw = 0.6 * np.sin(np.pi / 2.0 * t)
    zero = np.zeros(frames)
    Q = np.column_stack([np.cos(yaw / 2.0), zero, zero, np.sin(yaw / 2.0)])
    return np.column_stack([0.03 * t, zero, zero + CROUCH]), Q, q
