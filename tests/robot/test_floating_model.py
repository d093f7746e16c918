"""The control model of a robot whose base floats, against Drake, at any attitude."""

import numpy as np
import pytest
from floating_robots import (
    HANDS,
    PAIRS,
    add_floater,
    description,
    floating_urdf,
    make_floater,
    random_state,
    root_entries,
    wxyz,
)
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import (
    JacobianWrtVariable,
    QuaternionFloatingJoint,
    RevoluteJoint,
    SpatialInertia,
)
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from crar_drake.errors import ModelError
from crar_drake.judging.referee import Referee
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.safety_filter import SafetyFilter
from crar_drake.robot.description import (
    RobotDescription,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

TASKS = (Task(frame="left_hand", kind="pose"), Task(frame="right_hand"))
# Two at random, and upside down, where chains of three angles lock.
ATTITUDES = [
    Rotation.random(random_state=1),
    Rotation.random(random_state=2),
    Rotation.from_rotvec([np.pi, 0.0, 0.0]),
    Rotation.from_rotvec([0.0, np.pi / 2, 0.0]),
]


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return make_floater(tasks=TASKS)


def state_at(model: ControlModel, attitude: Rotation, seed: int = 3):
    q, v = random_state(model, seed)
    q[root_entries(model)[0][:4]] = -1.7 * wxyz(attitude)  # any sign, any length
    return q, v


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_kinematics_are_drakes(model: ControlModel, attitude: Rotation) -> None:
    q, v = state_at(model, attitude)
    state = model.evaluate(model.MakeWorkspace(), q, v)
    plant, context = model.plant, model.plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    world, rows = plant.world_frame(), []
    bias = []
    for hand in HANDS:
        arguments = (plant.GetFrameByName(hand), np.zeros(3), world, world)
        J = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, *arguments
        )
        A = plant.CalcBiasSpatialAcceleration(
            context, JacobianWrtVariable.kV, *arguments
        )
        rows.append(J)
        bias.append(np.concatenate([A.rotational(), A.translational()]))
    J = np.vstack([rows[0], rows[1][3:]])
    expected = np.concatenate([bias[0], bias[1][3:]])
    np.testing.assert_allclose(state.J, J[:, model.controlled], atol=1e-13)
    np.testing.assert_allclose(state.J_p, J[:, model.prescribed], atol=1e-13)
    np.testing.assert_allclose(state.v, J @ v, atol=1e-12)
    np.testing.assert_allclose(state.Jdot_qdot, expected, atol=1e-11)
    X = plant.GetFrameByName("left_hand").CalcPoseInWorld(context)
    np.testing.assert_allclose(state.R[0], X.rotation().matrix(), atol=1e-14)
    np.testing.assert_allclose(state.p[0], X.translation(), atol=1e-14)


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_distances_are_the_referees_and_their_gradients_differences(
    model: ControlModel, attitude: Rotation
) -> None:
    q, _ = state_at(model, attitude)
    nv = len(model.order)
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)

    def apart(x: np.ndarray) -> np.ndarray:
        by = np.empty(nv)
        by[model.order] = x
        moved, (at, of_root) = q.copy(), root_entries(model)
        turn = Rotation.from_rotvec(by[of_root[:3]])
        moved[at[:4]] = wxyz(turn * Rotation.from_quat(q[at[:4]][[1, 2, 3, 0]]))
        moved[at[4:]] += by[of_root[3:]]
        moved[model.controlled_positions] += by[model.controlled]
        return referee.distances(moved)

    found = model.evaluate(model.MakeWorkspace(), q, np.zeros(len(model.order)))
    # SceneGraph's are, but for what its search leaves.
    np.testing.assert_allclose(found.d, apart(np.zeros(nv)), atol=1e-6)
    h = 1e-6
    g = np.array([(apart(h * e) - apart(-h * e)) / (2.0 * h) for e in np.eye(nv)]).T
    gradients = np.hstack([found.dd_dq, found.dd_dq_p])
    np.testing.assert_allclose(gradients, g, atol=1e-3)
    # The root moves no pair of the robot's own, exactly.
    np.testing.assert_array_equal(found.dd_dq_p[: len(PAIRS)], 0.0)
    assert np.abs(found.dd_dq_p[len(PAIRS)]).max() > 0.1


def test_the_order_of_the_vectors(model: ControlModel) -> None:
    at, by = root_entries(model)
    suffixes = ["qw", "qx", "qy", "qz", "x", "y", "z"]
    assert [model.position_names[i] for i in at] == [f"body.{s}" for s in suffixes]
    suffixes = ["wx", "wy", "wz", "vx", "vy", "vz"]
    assert model.prescribed_names == [f"body.{s}" for s in suffixes]
    assert model.joint_names == [
        f"{side}_j{k}" for side in ("left", "right") for k in range(3)
    ]
    q = model.rest_positions()
    np.testing.assert_allclose(q[at[4:]], [0.1, -0.2, 0.3], atol=0)
    plant, _ = add_floater(DiagramBuilder())
    np.testing.assert_allclose(plant.GetDefaultPositions(), q, atol=1e-15)
    moved = np.arange(13.0)
    np.testing.assert_array_equal(model.in_plant(*model.in_order(moved))[0], moved)


def loose_plant() -> tuple[MultibodyPlant, SceneGraph]:
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    plant.AddRigidBody("torso", inertia)
    plant.Finalize()
    return plant, scene_graph


def test_a_base_that_floats_needs_a_word_on_what_moves_it() -> None:
    with pytest.raises(ModelError, match="'torso'.*base: torso and root: fixed"):
        ControlModel.FromPlant(*loose_plant(), RobotDescription(), [Task(frame="x")])
    with pytest.raises(ModelError, match="no joint left to control"):
        ControlModel.FromPlant(
            *loose_plant(),
            RobotDescription(base="torso", root="prescribed"),
            [Task(frame="torso")],
        )
    with pytest.raises(ModelError, match="has no link 'body'"):
        ControlModel.FromPlant(
            *loose_plant(),
            RobotDescription(base="body", root="prescribed"),
            [Task(frame="torso")],
        )
    with pytest.raises(ModelError, match="does not float"):
        ControlModel.FromPlant(
            *add_floater(DiagramBuilder(), "fixed"),
            description("prescribed"),
            [Task(frame="left_hand")],
        )


def test_a_fixed_root_is_welded_where_it_rests(tmp_path) -> None:
    (tmp_path / "robot.urdf").write_text(floating_urdf())
    text = (
        "name: floater\nmodel: robot.urdf\nbase: body\n"
        "root_pose: {xyz: [0.1, -0.2, 0.3], rpy: [0.3, -0.5, 0.8]}\n"
        "task_frames: {left_hand: left_hand}\n"
    )
    poses = []
    for root in ("fixed", "prescribed"):
        (tmp_path / "robot.yaml").write_text(f"{text}root: {root}\n")
        described = load_robot_description(tmp_path)
        model = ControlModel.FromDescription(described, [Task(frame="left_hand")])
        poses.append(model.tasks_at(model.rest_positions()))
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-15)


def test_no_law_takes_it(model: ControlModel) -> None:
    told = "root: prescribed: its base 'body' floats.*Weld it.*retarget"
    with pytest.raises(ModelError, match=told):
        ControlLaw(model)
    with pytest.raises(ModelError, match="base of this model floats.*description"):
        SafetyFilter(model)


def test_a_base_floats_on_the_world_alone() -> None:
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    arm, ball = (plant.AddRigidBody(name, inertia) for name in ("arm", "ball"))
    frames = plant.world_frame(), arm.body_frame(), ball.body_frame()
    plant.AddJoint(RevoluteJoint("turn", *frames[:2], [0, 0, 1]))
    plant.AddJoint(QuaternionFloatingJoint("float", *frames[1:]))
    plant.Finalize()
    robot = RobotDescription(base="ball", root="prescribed")
    with pytest.raises(ModelError, match="'ball' floats on 'arm'"):
        ControlModel.FromPlant(plant, scene_graph, robot, [Task(frame="arm")])
