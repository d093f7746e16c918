"""What a motion drives the prescribed joints with."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from small_robots import add_plant

from crar_drake.motion.catalogue import load_clip
from crar_drake.motion.joint_centres import joint_centres
from crar_drake.motion_targets import load_motion_targets, segment_lengths
from crar_drake.robot import ControlModel
from crar_drake.robot_description import RobotDescription
from crar_drake.task import position_tasks

POINTS = {  # of a standing robot, in its trunk's frame [m]
    "neck": (0.0, 0.0, 0.4),
    "left_shoulder": (0.0, 0.2, 0.4),
    "left_elbow": (0.0, 0.2, 0.1),
    "left_wrist": (0.0, 0.2, -0.1),
    "right_shoulder": (0.0, -0.2, 0.4),
    "right_elbow": (0.0, -0.2, 0.1),
    "right_wrist": (0.0, -0.2, -0.1),
}
WAIST = (0.05, 0.02, 0.9)  # away from the heading's axis
BASE = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1", "heading": "0 0 1", "lean": "0 1 0"}


def trunk_urdf() -> str:
    inertia = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    parts, parent = ['<link name="base"/>'], "base"
    for name, axis in BASE.items():
        kind = "continuous" if name in ("heading", "lean") else "prismatic"
        parts.append(
            f'<link name="{name}_link">{inertia}</link><joint name="{name}" '
            f'type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<axis xyz="{axis}"/></joint><transmission name="t_{name}">'
            "<type>transmission_interface/SimpleTransmission</type>"
            f'<joint name="{name}"/><actuator name="{name}"/></transmission>'
        )
        parent = f"{name}_link"
    for name, p in {"waist": (0, 0, 0), **POINTS}.items():
        xyz = " ".join(map(str, np.add(p, WAIST)))
        parts.append(f'<frame name="{name}" link="{parent}" xyz="{xyz}" rpy="0 0 0"/>')
    return f'<robot name="trunk">{"".join(parts)}</robot>'


@pytest.fixture(scope="module")
def model() -> ControlModel:
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, trunk_urdf())
    description = RobotDescription(
        prescribed_joints={
            "heading": "waist.heading",
            "x": "waist.x",
            "y": "waist.y",
            "z": "waist.z",
        },
        task_frames={name: name for name in ("waist", *POINTS)},
    )
    return ControlModel.FromPlant(
        plant, scene_graph, description, position_tasks(["left_wrist"])
    )


def test_waist_and_heading_are_the_performers(model):
    """At every time the robot's waist is where the motion's is, and as turned."""
    motion = load_motion_targets("dance", model)
    centres = joint_centres(load_clip("dance"))
    scale = segment_lengths(model).waist_height / centres.hip_height
    context = model.plant.CreateDefaultContext()
    waist = model.plant.GetFrameByName("waist")
    names = list(model.description.prescribed_joints)
    for frame in range(0, centres.num_frames, 97):
        time = frame / centres.frame_rate
        if time > motion.duration:
            break
        q = motion.prescribed.value(time).ravel()
        whole = np.zeros(model.plant.num_positions())
        for name, value in zip(names, q, strict=True):
            whole[model.plant.GetJointByName(name).position_start()] = value
        model.plant.SetPositions(context, whole)
        X = waist.CalcPoseInWorld(context)
        expected = centres.positions["waist"][frame] * scale
        expected[:2] -= centres.positions["waist"][0, :2] * scale
        # The low-pass moves a fast dancer by a few millimetres.
        np.testing.assert_allclose(X.translation(), expected, atol=0.02)
        turned = X.rotation().ToRollPitchYaw().yaw_angle() - centres.heading[frame]
        assert abs(np.angle(np.exp(1j * turned))) < 0.05
    assert np.ptp(centres.heading) > np.pi  # it does turn


def test_the_heading_is_followed_beyond_a_full_turn(model):
    motion = load_motion_targets("dance", model)
    times = np.linspace(0.0, motion.duration, 500)
    heading = np.array([motion.prescribed.value(t)[0, 0] for t in times])
    assert np.abs(np.diff(heading)).max() < 1.0  # no jump by a whole turn
