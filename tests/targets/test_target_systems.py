"""Systems that emit targets: a recorded motion, and poses that rest."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import BusValue

from crar_drake import (
    InputError,
    MotionError,
    MotionSource,
    PoseTargets,
    ScenarioError,
    Task,
    load_robot_description,
    position_tasks,
)
from crar_drake.robot.model import ControlModel
from crar_drake.targets.motion import load_motion_targets

WRISTS = position_tasks(["left_wrist", "right_wrist"])


@pytest.mark.parametrize("loop", [False, True])
def test_a_motion_as_a_system(loop):
    source = MotionSource("dance", "upper_body", WRISTS, loop=loop)
    robot = load_robot_description("upper_body")
    motion = load_motion_targets("dance", ControlModel.FromDescription(robot, WRISTS))
    assert source.duration == motion.duration
    context = source.CreateDefaultContext()
    end = source.duration
    for time in (0.0, 1.234, end + 0.5):
        context.SetTime(time)
        tasks = source.get_output_port_desired_tasks().Eval(context)
        prescribed = source.get_output_port_desired_prescribed().Eval(context)
        rests = time > end and not loop
        at = min(time, end) if rests else time % end
        points, waist = motion.tasks_at(at)[:6], motion.prescribed_at(at)
        np.testing.assert_allclose(tasks[:6], points, atol=1e-9)
        np.testing.assert_allclose(prescribed[:3], waist, atol=1e-9)
        assert tasks[6:].any() != rests


def test_a_motion_that_cannot_be_a_source():
    with pytest.raises(MotionError, match="danse.*did you mean 'dance'"):
        MotionSource("danse", "upper_body", WRISTS)
    with pytest.raises(ScenarioError, match="no joint positions"):
        MotionSource("dance", "upper_body", [Task(kind="joint", joint="left_elbow")])


def test_poses_as_targets():
    tasks = [Task(frame="left_hand", kind="pose"), Task(frame="right_hand")]
    model = ControlModel.FromDescription(load_robot_description("upper_body"), tasks)
    poses = [
        RigidTransform(RollPitchYaw(0.1, -0.2, 0.3), [0.3, 0.2, 1.0]),
        RigidTransform([0.3, -0.2, 1.1]),
    ]
    bus = BusValue()
    for name, pose in zip(model.layout.names, poses, strict=True):
        bus.Set(name, Value(pose))
    for port, value in (("poses", Value(poses)), ("bus", Value(bus))):
        system = PoseTargets(model.layout)
        context = system.CreateDefaultContext()
        with pytest.raises(InputError, match="connect poses or bus"):
            system.get_output_port().Eval(context)
        system.GetInputPort(port).FixValue(context, value)
        found = model.layout.unpack(system.get_output_port().Eval(context))
        np.testing.assert_allclose(found.p, [pose.translation() for pose in poses])
        np.testing.assert_allclose(found.R[0], poses[0].rotation().matrix())
        assert not found.v.any() and not found.a.any()
    system = PoseTargets(model.layout)
    context = system.CreateDefaultContext()
    system.GetInputPort("poses").FixValue(context, Value(poses[:1]))
    with pytest.raises(InputError, match="1 poses for the tasks left_hand, right_hand"):
        system.get_output_port().Eval(context)
