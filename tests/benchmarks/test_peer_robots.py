"""Other robots for the peers: scenes, welded joints, points, and one root."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from benchmarks.peers import robot_files
from benchmarks.peers.problem import write_crossings, write_problem
from crar_drake import ControlModel, load_robot_description, position_tasks

FILES = ("robot.urdf", "robot_mujoco.xml", "robot_pinocchio.urdf")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    write_problem(folder, "obstacle_arm")
    return folder


def welded_plant(text: str, kind: str) -> MultibodyPlant:
    """A plant of a robot whose root stands in the world."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(text, kind)
    root = plant.GetBodyByName(robot_files.ROOT)
    if root not in plant.GetBodiesWeldedTo(plant.world_body()):
        plant.WeldFrames(plant.world_frame(), root.body_frame())
    plant.Finalize()
    return plant


@pytest.mark.parametrize("name", FILES)
def test_a_scene_is_one_robot_in_every_dialect(name, arm):
    """The arm and the post, as far from each other as in the shipped scene."""
    shipped = load_robot_description("obstacle_arm")
    reference = ControlModel.FromDescription(shipped, position_tasks(["tool"]))
    data = json.loads((arm / "problem.json").read_text())
    plant = welded_plant((arm / name).read_text(), name.rpartition(".")[2])
    context = plant.CreateDefaultContext()
    wanted_context = reference.plant.CreateDefaultContext()
    rng = np.random.default_rng(5)
    links = {link for pair in shipped.pairs for link in pair} | {"arm::tool"}
    assert {"tool"} == set(data["task_links"]) and len(data["pairs"]) == 14
    for _ in range(3):
        q = rng.uniform(-1.0, 1.0, len(data["joints"]))
        wanted = np.zeros(len(q))
        for joint, angle in zip(data["joints"], q, strict=True):
            plant.GetJointByName(joint).set_angle(context, angle)
            wanted[reference.position_names.index(joint)] = angle
        reference.plant.SetPositions(wanted_context, wanted)
        for link in links:
            model, _, own = link.partition("::")
            instance = reference.plant.GetModelInstanceByName(model)
            body = reference.plant.GetBodyByName(own, instance)
            X_WB = plant.GetBodyByName(own).EvalPoseInWorld(context)
            assert X_WB.IsNearlyEqualTo(body.EvalPoseInWorld(wanted_context), 1e-8)


def test_crossings_are_drawn_for_a_scene(arm):
    """Each starts clear and at rest, and penetrates on its way."""
    (case,) = write_crossings(arm, [3])
    data = np.load(arm / f"{case}.npz")
    shipped = load_robot_description("obstacle_arm")
    model = ControlModel.FromDescription(shipped, position_tasks(["tool"]))
    workspace = model.MakeWorkspace()
    nearest = [
        model.evaluate_distances(workspace, q).d.min()
        for q in data["q_reference"][::25]
    ]
    assert nearest[0] > 0.1 and -0.1 < min(nearest) < -0.005
    assert data["p"].shape == (len(data["time"]), 1, 3)


def test_a_scene_of_anything_else_is_refused(tmp_path):
    path = tmp_path / "scene.dmd.yaml"
    path.write_text("directives:\n  - add_frame:\n      name: hook\n")
    with pytest.raises(ValueError, match="add_frame is not a weld to the world"):
        robot_files.read(path)


ROBOT = """<robot name="small">
  <link name="slider"/>
  <joint name="slide" type="prismatic">
    <parent link="world"/><child link="slider"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/><axis xyz="0 1 0"/>
  </joint>
  <link name="turner"/>
  <joint name="turn" type="revolute">
    <parent link="slider"/><child link="turner"/>
    <origin xyz="0 0 0.5" rpy="-0.3 0.2 0.7"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <frame name="tip" link="turner" xyz="0.3 0.1 0" rpy="0 0 0.5"/>
  <frame name="other" link="turner" xyz="1 0 0" rpy="0 0 0"/>
</robot>"""


def test_welded_joints_stay_where_they_were(tmp_path):
    """By Drake's own kinematics of the robot with its joints; a frame is a link."""
    path = tmp_path / "small.urdf"
    path.write_text(ROBOT)
    free = MultibodyPlant(0.0)
    Parser(free).AddModels(str(path))
    free.Finalize()
    context = free.CreateDefaultContext()
    at = {"slide": 0.15, "turn": -0.8}
    free.GetJointByName("slide").set_translation(context, at["slide"])
    free.GetJointByName("turn").set_angle(context, at["turn"])
    made = robot_files.simplified_urdf(path, at, ["tip"])
    assert robot_files.root_link(made) == robot_files.ROOT
    plant = welded_plant(ET.tostring(made, encoding="unicode"), "urdf")
    assert plant.num_positions() == 0
    fixed = plant.CreateDefaultContext()
    wanted = free.GetFrameByName("tip").CalcPoseInWorld(context)
    X_WT = plant.GetBodyByName("tip").EvalPoseInWorld(fixed)
    assert X_WT.IsNearlyEqualTo(wanted, 1e-9)
    assert not plant.HasBodyNamed("other")
