"""Soles of a robot's description, and the robot that stands still on them."""

from dataclasses import replace

import numpy as np
import pytest
from standing_robots import standing_robot

from crar_drake.errors import ModelError
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import Task


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> RobotDescription:
    return standing_robot(tmp_path_factory.mktemp("robot"))


def test_legs_hold_and_the_rest_is_controlled(robot) -> None:
    standing = standing_description(robot)
    model = ControlModel.FromDescription(standing, [Task(frame="hand")])
    assert model.joint_names == ["shoulder", "elbow"]
    assert len(model.prescribed_names) == 12
    assert set(standing.prescribed_joints.values()) == {"hold"}


def test_pairs_that_cannot_move_are_left_out(robot) -> None:
    """Legs against legs and trunk cannot, the arm against both can."""
    pairs = [["forearm", "left_thigh"], ["forearm", "trunk"]]
    assert standing_description(robot).pairs == pairs


def test_soles_touch_the_floor_at_rest(robot) -> None:
    standing = standing_description(robot)
    model = ControlModel.FromDescription(standing, [Task(frame="hand")])
    context = model.MakeWorkspace().plant_context
    model.plant.SetPositions(context, model.rest_positions())
    for link, corners in standing.soles.items():
        frame = model.plant.GetFrameByName(link)
        in_world = frame.CalcPoseInWorld(context).multiply(np.array(corners).T)
        np.testing.assert_allclose(in_world[2], 0.0, atol=1e-12)


def test_robots_that_cannot_stand_are_told(robot) -> None:
    with pytest.raises(ModelError, match="soles: there are none"):
        standing_description(replace(robot, soles={}))
    with pytest.raises(ModelError, match="whose root floats"):
        standing_description(replace(robot, root="fixed"))
    with pytest.raises(ModelError, match="no joint is between"):
        standing_description(replace(robot, soles={"trunk": robot.soles["left_foot"]}))
    with pytest.raises(ModelError, match="no link 'toe'"):
        standing_description(replace(robot, soles={"toe": robot.soles["left_foot"]}))
