"""A motion's hips as the pose of a root that floats."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.errors import ModelError, MotionError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.joint_centres import joint_centres
from crar_drake.motion.turns import hip_turns
from crar_drake.robot.description import (
    RootPose,
    find_frame,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import position_tasks
from crar_drake.targets.motion import load_motion_targets

RAILS = ("waist_x", "waist_y", "waist_z")


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> ControlModel:
    """The built-in robot off its rails: what they carry floats, turned at rest."""
    rails = load_robot_description("upper_body")
    folder = tmp_path_factory.mktemp("floating")
    ET.register_namespace("drake", "http://drake.mit.edu")
    tree = ET.parse(f"{rails.folder}/{rails.model}")
    robot = tree.getroot()
    carried = {}
    for joint in robot.findall("joint"):
        if joint.get("name") in RAILS:
            carried[joint.find("parent").get("link")] = joint.find("child").get("link")
            robot.remove(joint)
    base = next(link for link in carried.values() if link not in carried)
    for link in robot.findall("link"):
        if link.get("name") in carried:
            robot.remove(link)
    for transmission in robot.findall("transmission"):
        if transmission.find("joint").get("name") in RAILS:
            robot.remove(transmission)
    tree.write(folder / "robot.urdf")
    height = rails.rest_posture["waist_z"]
    description = replace(
        rails,
        name="floating",
        model="robot.urdf",
        folder=str(folder),
        base=base,
        root="prescribed",
        root_pose=RootPose([0.0, 0.0, height], [0.0, 0.0, 0.3]),
        prescribed_joints={},
        rest_posture={
            joint: at for joint, at in rails.rest_posture.items() if joint not in RAILS
        },
    )
    description.validate()
    with pytest.raises(ModelError, match="waist_x: the root floats"):
        replace(description, prescribed_joints={"waist_x": "waist.x"}).validate()
    return ControlModel.FromDescription(description, position_tasks(["left_wrist"]))


def test_the_root_is_turned_as_the_hips_and_carries_the_waist(model) -> None:
    motion = load_motion_targets("dance", model)
    source = motion.MakePrescribedSource()
    context = source.CreateDefaultContext()
    centres = joint_centres(load_performer("dance"))
    waist = find_frame(model.plant, model.description.task_frames["waist"])
    height = model.description.root_pose.xyz[2]
    scale = height / centres.hip_height
    plant, place = model.plant, model.plant.CreateDefaultContext()
    at_rest = Rotation.from_euler("z", 0.3)

    def at(time):
        context.SetTime(time)
        return source.get_output_port().Eval(context)

    headings, first = [], centres.positions["waist"][0, :2] * scale
    for frame in range(60, centres.num_frames - 60, 40):
        time = frame / centres.frame_rate
        x = at(time)
        np.testing.assert_allclose(motion.prescribed_at(time), x[:7])
        assert np.linalg.norm(x[:4]) == pytest.approx(1.0)
        q = model.rest_positions()
        q[model.prescribed_positions] = x[:7]
        plant.SetPositions(place, q)
        found = waist.CalcPoseInWorld(place).translation()
        expected = centres.positions["waist"][frame] * scale
        expected[:2] -= first
        # A low-pass of 6 Hz lies between.
        np.testing.assert_allclose(found, expected, atol=0.02)
        R = Rotation.from_quat(x[[1, 2, 3, 0]]) * at_rest.inv()
        # The twist about the vertical is the heading of the joint centres.
        twist = 2.0 * np.arctan2(*R.as_quat()[[2, 3]])
        headings.append(np.sin(0.5 * (twist - centres.heading[frame])))
        h = 1e-4
        before, after = at(time - h), at(time + h)
        turn = Rotation.from_quat(after[[1, 2, 3, 0]])
        turn = turn * Rotation.from_quat(before[[1, 2, 3, 0]]).inv()
        rates = np.concatenate([turn.as_rotvec(), after[4:7] - before[4:7]])
        np.testing.assert_allclose(x[7:13], rates / (2.0 * h), atol=1e-4)
        rates = (after[7:13] - before[7:13]) / (2.0 * h)
        np.testing.assert_allclose(x[13:], rates, atol=1e-2)
    assert np.abs(headings).max() < 1e-3
    assert len(headings) > 10
    still = at(motion.duration + 1.0)
    np.testing.assert_array_equal(still[7:], 0.0)


@pytest.mark.parametrize(
    ("root", "positions", "rates"),
    [
        ("prescribed_orientation", slice(0, 4), slice(0, 3)),
        ("prescribed_position", slice(4, 7), slice(3, 6)),
    ],
)
def test_half_a_root_is_told_half_of_that(model, root, positions, rates) -> None:
    """Bit for bit; joints that hold are told first."""
    changes = {"root": root, "prescribed_joints": {"left_elbow": "hold"}}
    half = ControlModel.FromDescription(
        replace(model.description, **changes), position_tasks(["left_wrist"])
    )
    whole, part = (load_motion_targets("dance", each) for each in (model, half))
    sources = [each.MakePrescribedSource() for each in (whole, part)]
    bend = half.description.rest_posture["left_elbow"]
    for time in (0.0, 1.7, 5.0):
        found = []
        for source in sources:
            context = source.CreateDefaultContext()
            context.SetTime(time)
            found.append(source.get_output_port().Eval(context))
        told = np.split(found[0], [7, 13])
        expected = [told[0][positions], told[1][rates], told[2][rates]]
        expected = [
            np.insert(x, 0, held)
            for x, held in zip(expected, (bend, 0.0, 0.0), strict=True)
        ]
        np.testing.assert_array_equal(found[1], np.concatenate(expected))
        np.testing.assert_array_equal(part.prescribed_at(time), expected[0])


def test_a_motion_without_a_pelvis_is_told() -> None:
    performer = replace(load_performer("dance"), orientations={})
    with pytest.raises(MotionError, match="dance: it does not tell how the pelvis"):
        hip_turns(performer)
