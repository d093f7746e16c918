"""A robot whose base floats, made of text, for tests.

A body, two arms of three joints each from its sides, and a post in the world. Inertias,
frames and shapes are skew, so that nothing agrees by symmetry.
"""

from pathlib import Path

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from crar_drake.robot.description import RobotDescription, RootPose
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

HANDS = ("left_hand", "right_hand")
PAIRS = [["left_l2", "right_l2"], ["left_l2", "body"], ["right_l2", "body"]]
WORLD_PAIR = ["left_l2", "post"]
TASKS = tuple(Task(frame=hand) for hand in HANDS)


def write_floater(folder: Path, root: str, rpy: str) -> None:
    """A robot's folder for scenarios.

    Args:
        folder: that there is.
        root: "prescribed", or "fixed".
        rpy: three angles of the rest pose, "[2.3, -1.5, 0.8]" [rad].
    """
    (folder / "robot.urdf").write_text(floating_urdf())
    (folder / "robot.yaml").write_text(
        f"name: floater\nmodel: robot.urdf\nbase: body\nroot: {root}\n"
        f"root_pose: {{xyz: [0.1, -0.2, 0.3], rpy: {rpy}}}\n"
        "task_frames: {left_hand: left_hand, right_hand: right_hand}\n"
        "pairs: [[left_l2, right_l2], [left_l2, body]]\n"
    )


def floating_urdf() -> str:
    """Links body, left_l0, left_l1, left_hand, right_...; joints left_j0, ..."""
    parts = [
        '<robot name="floater"><link name="body"><inertial>'
        '<origin xyz="0.02 0.01 -0.03"/><mass value="6"/>'
        '<inertia ixx="0.12" iyy="0.2" izz="0.25" ixy="0.01" ixz="-0.02" iyz="0.005"/>'
        '</inertial><collision><geometry><capsule radius="0.08" length="0.2"/>'
        "</geometry></collision></link>"
    ]
    for side, y in (("left", 1.0), ("right", -1.0)):
        parent, origin, rpy = "body", f"0.02 {0.22 * y} 0.05", f"0.1 0.2 {0.4 * y}"
        for k, axis in enumerate(("0 1 0", "0.36 0 0.48", f"0 {0.6 * y} 0.8")):
            link, joint = f"{side}_l{k}", f"{side}_j{k}"
            parts.append(
                f'<link name="{link}"><inertial><origin xyz="0.12 0.01 0.02"/>'
                '<mass value="0.9"/><inertia ixx="0.003" iyy="0.008" izz="0.009" '
                'ixy="0.001" ixz="0" iyz="0"/></inertial><collision>'
                '<origin xyz="0.12 0 0" rpy="0 1.5708 0"/><geometry>'
                '<capsule radius="0.03" length="0.16"/></geometry></collision></link>'
                f'<joint name="{joint}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{link}"/><origin xyz="{origin}" rpy="{rpy}"/>'
                f'<axis xyz="{axis}"/><limit lower="-2.4" upper="2.4" effort="1e4" '
                'velocity="0"/><dynamics damping="0.02"/></joint><transmission><type>'
                "transmission_interface/SimpleTransmission</type>"
                f'<joint name="{joint}"><hardwareInterface>EffortJointInterface'
                f'</hardwareInterface></joint><actuator name="{joint}"/></transmission>'
            )
            parent, origin, rpy = link, "0.24 0 0", "0 0 0"
        parts.append(
            f'<link name="{side}_hand"/><joint name="{side}_tool" type="fixed">'
            f'<parent link="{parent}"/><child link="{side}_hand"/>'
            '<origin xyz="0.25 0 0" rpy="0.3 -0.2 0.5"/></joint>'
        )
    return "".join(parts) + "</robot>"


POST = """<robot name="scene"><link name="post"><collision><origin xyz="0.6 0.5 0.2"/>
<geometry><sphere radius="0.1"/></geometry></collision></link></robot>"""


def description(root: str = "prescribed", **changes) -> RobotDescription:
    """Of the robot in `add_floater`'s plant."""
    given = {
        "base": "body",
        "root": root,
        "root_pose": RootPose([0.1, -0.2, 0.3], [0.3, -0.5, 0.8]),
        "pairs": [*PAIRS, WORLD_PAIR],
        "task_frames": {hand: hand for hand in HANDS},
    }
    return RobotDescription(**(given | changes))


def add_floater(
    builder: DiagramBuilder,
    root: str = "prescribed",
    time_step: float = 1e-3,
):
    """Plant and SceneGraph with the robot, its base free or welded where it rests."""
    plant, scene_graph = AddMultibodyPlant(
        MultibodyPlantConfig(
            time_step=time_step,
            use_sampled_output_ports=time_step > 0.0,
            discrete_contact_approximation="lagged",
        ),
        builder,
    )
    parser = Parser(plant)
    parser.AddModelsFromString(POST, "urdf")
    parser.AddModelsFromString(floating_urdf(), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("post"))
    X_WB = description().rest_pose()
    if root == "fixed":
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("body"), X_WB)
    else:
        body = plant.GetBodyByName("body")
        plant.SetDefaultFloatingBaseBodyPose(body, X_WB)
    plant.Finalize()
    return plant, scene_graph


def make_floater(
    root: str = "prescribed",
    tasks=TASKS,
    time_step: float = 1e-3,
    **changes,
) -> ControlModel:
    """The control model of the robot."""
    plant, scene_graph = add_floater(DiagramBuilder(), root, time_step)
    return ControlModel.FromPlant(
        plant, scene_graph, description(root, **changes), tasks
    )


def root_entries(model: ControlModel) -> tuple[np.ndarray, np.ndarray]:
    """Where the root's positions (7,) are in q, and its velocities (6,) in v."""
    return model.root_positions, model.prescribed[-6:]


def random_state(model: ControlModel, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Any attitude, somewhere; a quaternion of any length; joints within 1 rad."""
    rng = np.random.default_rng(seed)
    nq, nv = model.plant.num_positions(), model.plant.num_velocities()
    q, v = rng.uniform(-1.0, 1.0, nq), rng.normal(size=nv)
    at, by = root_entries(model)
    q[at[:4]] = rng.uniform(0.5, 2.0) * Rotation.random(random_state=seed).as_quat()
    v[by] *= 3.0
    return q, v


def wxyz(rotation: Rotation) -> np.ndarray:
    """Drake's order of a quaternion's entries (..., 4), from SciPy's."""
    return rotation.as_quat()[..., [3, 0, 1, 2]]
