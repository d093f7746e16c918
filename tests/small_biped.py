"""A robot with two legs and a trunk, whose poses and distances have closed forms.

A leg is a hip about x and a knee about y, 0.4 below; the foot is a ball of radius 0.05,
0.4 below the knee. The trunk turns about z. Depth first the joints are left_hip,
left_knee, right_hip, right_knee, waist; breadth first left_hip, right_hip, waist,
left_knee, right_knee.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

DEPTH_FIRST = ("left_hip", "left_knee", "right_hip", "right_knee", "waist")
BREADTH_FIRST = ("left_hip", "right_hip", "waist", "left_knee", "right_knee")
THIGH = SHIN = 0.4  # [m]
HIP = 0.1  # beside the middle [m]
TRUNK = 0.1  # above the root [m]
FOOT = 0.05  # radius [m]
LIMIT, SPEED = 2.0, 8.0  # of every joint [rad], [rad/s]

_INERTIA = (
    '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" '
    'ixz="0" iyz="0"/></inertial>'
)
YAML = """
name: biped
model: biped.urdf
base: pelvis
task_frames: {left_foot: left_shin, right_foot: right_shin}
pairs: [[left_shin, right_shin], [left_shin, trunk]]
"""


def biped(folder: Path, *, base: str = "pelvis") -> Path:
    """Writes the robot into a folder, and returns that.

    Args:
        folder: is made.
        base: of robot.yaml; "prescribed" for a root that a joint of the motion carries.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text, yaml = ['<robot name="biped">'], YAML
    if base == "prescribed":
        yaml = YAML.replace(
            "base: pelvis", "base: ''\nprescribed_joints: {up: waist.z}"
        )
        text.append(
            '<joint name="up" type="prismatic"><parent link="world"/>'
            '<child link="pelvis"/><axis xyz="0 0 1"/><limit effort="9"/></joint>'
        )
    text += [_link("pelvis"), _link("trunk", "0 0 0.3")]
    for side, y in (("left", HIP), ("right", -HIP)):
        text += [
            _link(f"{side}_thigh"),
            _link(f"{side}_shin", f"0 0 {-SHIN}"),
            _joint(f"{side}_hip", "pelvis", f"{side}_thigh", "1 0 0", f"0 {y} 0"),
            _joint(
                f"{side}_knee",
                f"{side}_thigh",
                f"{side}_shin",
                "0 1 0",
                f"0 0 {-THIGH}",
            ),
        ]
    text.append(_joint("waist", "pelvis", "trunk", "0 0 1", f"0 0 {TRUNK}"))
    (folder / "biped.urdf").write_text("".join(text) + "</robot>")
    (folder / "robot.yaml").write_text(yaml)
    return folder


def whole_biped(folder: Path, **options) -> WholeBody:
    """The robot, ready for its motions."""
    return WholeBody(load_robot_description(biped(folder, **options)))


def link_poses(q: np.ndarray) -> dict[str, tuple[np.ndarray, Rotation]]:
    """Of each link in the root's frame, from (5,) joints depth first: by hand."""
    poses = {"pelvis": (np.zeros(3), Rotation.identity())}
    for side, y, hip, knee in (("left", HIP, *q[:2]), ("right", -HIP, *q[2:4])):
        R = Rotation.from_rotvec([hip, 0, 0])
        p = np.array([0, y, 0])
        poses[f"{side}_thigh"] = (p, R)
        p = p + R.apply([0, 0, -THIGH])
        poses[f"{side}_shin"] = (p, R * Rotation.from_rotvec([0, knee, 0]))
    poses["trunk"] = (np.array([0, 0, TRUNK]), Rotation.from_rotvec([0, 0, q[4]]))
    return poses


def moving_samples(frames: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(T, 3) root positions, (T, 4) quaternions w x y z, (T, 5) joints."""
    t = np.linspace(0.0, 1.0, frames)[:, None]
    p = np.array([0.3, -0.2, 0.85]) + 0.1 * np.sin(
        t * [2.0, 3.0, 1.0] + [0.0, 1.0, 2.0]
    )
    turn = Rotation.from_rotvec(t * [0.1, 0.2, 1.0] + [0.02, -0.03, 0.4])
    q = 0.5 * np.sin(t * [1.0, 2.0, 3.0, 4.0, 5.0] + [0.1, 0.2, 0.3, 0.4, 0.5])
    return p, turn.as_quat()[:, [3, 0, 1, 2]], q


def _link(name: str, ball: str = "") -> str:
    shape = ""
    if ball:
        shape = (
            f'<collision name="{name}_ball"><origin xyz="{ball}"/><geometry>'
            f'<sphere radius="{FOOT}"/></geometry></collision>'
        )
    return f'<link name="{name}">{_INERTIA}{shape}</link>'


def _joint(name: str, parent: str, child: str, axis: str, xyz: str) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        f'<limit lower="{-LIMIT}" upper="{LIMIT}" effort="9" velocity="{SPEED}"/>'
        "</joint>"
    )
