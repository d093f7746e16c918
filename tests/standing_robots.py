"""A small robot on two soles, and a cell on four feet, for tests of standing.

A trunk floats; each leg is a chain of six joints down to a flat foot (hip about z, x,
y, knee and ankle about y, ankle about x), bent so that the sole is level; an arm of two
joints is on the trunk. Lengths of thigh and shin are `LEG`.
"""

from pathlib import Path

import numpy as np

from crar_drake.robot.description import RobotDescription, load_robot_description

LEG = 0.4  # of thigh, of shin [m]
HIP = 0.12  # of a hip beside the middle [m]
BELOW = 0.06  # of a sole below its ankle [m]
BEND = 0.3  # of hip and ankle at rest; the knee's is twice that [rad]
CORNERS = [[0.12, 0.05], [-0.08, 0.05], [-0.08, -0.05], [0.12, -0.05]]  # [m]
HEIGHT = 2.0 * LEG * np.cos(BEND) + BELOW  # of the trunk's origin at rest [m]

AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


def _link(name: str, mass: float, middle: str = "0 0 0", shape: str = "") -> str:
    size = 0.01 * mass
    collision = f'<collision><origin xyz="{middle}"/><geometry>{shape}</geometry>'
    return (
        f'<link name="{name}"><inertial><origin xyz="{middle}"/><mass value="{mass}"/>'
        f'<inertia ixx="{size}" iyy="{size}" izz="{size}" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial>{collision + '</collision>' if shape else ''}</link>"
    )


def _joint(
    name: str, parent: str, child: str, axis: str, at: str, effort: float
) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{at}"/><axis xyz="{AXES[axis]}"/>'
        f'<limit lower="-2" upper="2" velocity="20" effort="{effort}"/></joint>'
        f'<transmission name="{name}"><type>transmission_interface/'
        f'SimpleTransmission</type><joint name="{name}"/>'
        f'<actuator name="{name}"/></transmission>'
    )


def standing_robot(
    folder: Path, *, effort: float = 200.0, more: str = ""
) -> RobotDescription:
    """Writes the robot into a folder, and loads it.

    Args:
        folder: is made.
        effort: that each leg's joint can give [Nm].
        more: lines of robot.yaml.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ball = '<sphere radius="0.05"/>'
    text = ['<robot name="stander">', _link("trunk", 10.0, "0 0 0.2", ball)]
    for side, y in (("left", HIP), ("right", -HIP)):
        links = [f"{side}_{name}" for name in ("yaw", "roll", "thigh", "shin", "ankle")]
        links.append(f"{side}_foot")
        parents = ["trunk", *links]
        places = [f"0 {y} 0", "0 0 0", "0 0 0", f"0 0 {-LEG}", f"0 0 {-LEG}", "0 0 0"]
        masses = [0.3, 0.3, 3.0, 2.0, 0.3, 0.5]
        middles = ["0 0 0", "0 0 0", f"0 0 {-LEG / 2}", f"0 0 {-LEG / 2}", "0 0 0"]
        middles.append("0 0 -0.03")
        joints = (
            "hip_yaw",
            "hip_roll",
            "hip_pitch",
            "knee",
            "ankle_pitch",
            "ankle_roll",
        )
        for i, axis in enumerate("zxyyyx"):
            shape = ball if links[i].endswith(("thigh", "shin")) else ""
            text.append(_link(links[i], masses[i], middles[i], shape))
            name = f"{side}_{joints[i]}"
            text.append(_joint(name, parents[i], links[i], axis, places[i], effort))
    text.append(_link("upper_arm", 1.0, "0.15 0 0", ball))
    text.append(_joint("shoulder", "trunk", "upper_arm", "y", "0 0 0.4", 60.0))
    text.append(_link("forearm", 1.0, "0.15 0 0", ball))
    text.append(_joint("elbow", "upper_arm", "forearm", "z", "0.3 0 0", 60.0))
    text.append('<link name="hand"/><joint name="hand" type="fixed">')
    text.append('<parent link="forearm"/><child link="hand"/><origin xyz="0.3 0 0"/>')
    text.append("</joint></robot>")
    (folder / "stander.urdf").write_text("".join(text))
    corners = [[x, y, -BELOW] for x, y in CORNERS]
    bends = {"hip_pitch": -BEND, "knee": 2 * BEND, "ankle_pitch": -BEND}
    rest = {f"{s}_{j}": b for s in ("left", "right") for j, b in bends.items()}
    rest |= {"shoulder": 0.6, "elbow": 0.4}
    lines = [
        "name: stander",
        "model: stander.urdf",
        "base: trunk",
        "root: prescribed",
        f"root_pose: {{xyz: [0.0, 0.0, {HEIGHT}]}}",
        f"soles: {{left_foot: {corners}, right_foot: {corners}}}",
        f"rest_posture: {{{', '.join(f'{j}: {b}' for j, b in rest.items())}}}",
        "task_frames: {hand: hand}",
        "pairs: [[left_shin, right_shin], [trunk, left_shin], [forearm, left_thigh],",
        "  [forearm, trunk], [forearm, ground]]",
        "ground: -0.005",
        more,
    ]
    (folder / "robot.yaml").write_text("\n".join(lines))
    return load_robot_description(folder)


PAD, APART = 0.015, 0.15  # of the cell's feet: half their width, from its middle [m]
FEET = {f"foot_{i}": (x, y) for i, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1)], 1)}
FEET["foot_4"] = (-1, -1)


def tipping_cell(folder: Path) -> RobotDescription:
    """Writes an arm on a light table, its base fixed, with four small feet of their own
    at the height 0.2 m, and loads it; a heavy post is welded to the world beside it.
    """
    folder.mkdir(parents=True, exist_ok=True)

    def fixed(parent: str, child: str, at: str) -> str:
        return (
            f'<joint name="{child}_weld" type="fixed"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{at}"/></joint>'
        )

    ball = '<sphere radius="0.05"/>'
    text = ['<robot name="cell"><link name="world"/>', _link("post", 50.0, "0 0 0.5")]
    text += [fixed("world", "post", "1 1 0"), _link("table", 5.0, "0 0 0.4", ball)]
    for name, (x, y) in FEET.items():
        text.append(_link(name, 0.2, "0 0 0.01"))
        text.append(fixed("table", name, f"{x * APART} {y * APART} 0"))
    text.append(_link("upper_arm", 3.0, "0.15 0 0", ball))
    text.append(_joint("shoulder", "table", "upper_arm", "y", "0 0 0.7", 200.0))
    text.append(_link("forearm", 2.0, "0.15 0 0", ball))
    text.append(_joint("elbow", "upper_arm", "forearm", "z", "0.3 0 0", 200.0))
    text.append(f'<link name="hand"/>{fixed("forearm", "hand", "0.3 0 0")}</robot>')
    (folder / "cell.urdf").write_text("".join(text))
    corners = [[PAD, PAD, 0.0], [-PAD, PAD, 0.0], [-PAD, -PAD, 0.0], [PAD, -PAD, 0.0]]
    lines = [
        "name: cell",
        "model: cell.urdf",
        "base: table",
        "root_pose: {xyz: [0.0, 0.0, 0.2]}",
        f"soles: {{{', '.join(f'{foot}: {corners}' for foot in FEET)}}}",
        "rest_posture: {shoulder: -1.2, elbow: 0.0}",
        "task_frames: {hand: hand}",
        "pairs: [[forearm, table]]",
    ]
    (folder / "robot.yaml").write_text("\n".join(lines))
    return load_robot_description(folder)
