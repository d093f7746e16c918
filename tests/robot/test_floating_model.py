"""The control model of a robot whose base floats, against Drake, at any attitude."""

import numpy as np
import pytest
from floating_robots import (
    HANDS,
    PAIRS,
    WORLD_PAIR,
    add_floater,
    description,
    floating_urdf,
    make_floater,
    random_state,
    root_entries,
    wxyz,
)
from pydrake.geometry import SceneGraph
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import (
    JacobianWrtVariable,
    MultibodyForces,
    SpatialInertia,
)
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations.admission import path_bounds
from crar_drake.equations.compilation import hold
from crar_drake.equations.free_joints import displaced
from crar_drake.errors import ModelError
from crar_drake.judging.referee import Referee
from crar_drake.robot.description import (
    RobotDescription,
    RootPose,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import find_reaches
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
    workspace, nv = model.MakeWorkspace(), len(model.order)
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)

    def apart(x: np.ndarray) -> np.ndarray:
        (moved,) = model.in_plant(displaced(*model.in_order(q), x, model.turn))
        return referee.distances(moved)

    found = model.evaluate_distances(workspace, q)
    np.testing.assert_allclose(found.d, apart(np.zeros(nv)), atol=1e-13)
    h = 1e-6
    g = np.array([(apart(h * e) - apart(-h * e)) / (2.0 * h) for e in np.eye(nv)]).T
    gradients = np.hstack([found.dd_dq, found.dd_dq_p])
    np.testing.assert_allclose(gradients, g, atol=1e-8)
    # The root moves no pair of the robot's own, exactly.
    np.testing.assert_array_equal(found.dd_dq_p[: len(PAIRS)], 0.0)
    assert np.abs(found.dd_dq_p[len(PAIRS)]).max() > 0.1


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_torque_and_root_force_realise_the_accelerations(
    model: ControlModel, attitude: Rotation
) -> None:
    """In Drake's own forward dynamics, with the force on the root as a wrench."""
    q, v = state_at(model, attitude)
    vdot = np.random.default_rng(4).normal(size=len(v))
    workspace = model.MakeWorkspace()
    model.evaluate(workspace, q, v)
    torque = model.inverse_dynamics(workspace, vdot)
    force = model.root_force(workspace, vdot)
    plant, context = model.plant, model.plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    by = root_entries(model)[1]
    np.testing.assert_array_equal(np.delete(force, by), 0.0)
    forces = MultibodyForces(plant)
    plant.CalcForceElementsContribution(context, forces)
    body = plant.GetBodyByName("body")
    p_BoBq_B = np.zeros(3)
    body.AddInForce(
        context,
        p_BoBq_B,
        SpatialForce(force[by[:3]], force[by[3:]]),
        plant.world_frame(),
        forces,
    )
    tau = plant.MakeActuationMatrix() @ torque + plant.CalcGeneralizedForces(
        context, forces
    )
    M, C = plant.CalcMassMatrix(context), plant.CalcBiasTerm(context)
    damping = 1e-3 * 0.02 * np.isin(np.arange(len(v)), model.controlled)
    found = np.linalg.solve(M + np.diag(damping), tau - C)
    np.testing.assert_allclose(found, vdot, atol=1e-9)


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
    rest = model.prescribed_at(q)
    assert rest.shape == (model.prescribed_size,) == (19,)
    np.testing.assert_allclose(rest[4:7], [0.1, -0.2, 0.3], atol=0)
    plant, _ = add_floater(DiagramBuilder())
    np.testing.assert_allclose(plant.GetDefaultPositions(), q, atol=1e-15)
    moved = np.arange(13.0)
    np.testing.assert_array_equal(model.in_plant(*model.in_order(moved))[0], moved)


def test_bounds_hold_on_ways_of_a_free_root_past_the_world(model: ControlModel) -> None:
    """(A5) against the referee, along ways of constant velocity; the root tumbles."""
    plant = model.plant
    reaches = find_reaches(
        model.joints,
        model.pairs,
        model.order,
        plant.GetPositionLowerLimits(),
        plant.GetPositionUpperLimits(),
    )
    referee = Referee(plant, model.scene_graph, model.description.pairs)
    robot, rng = model.robot_ahead.value, np.random.default_rng(9)
    count, tight = len(model.description.pairs), []
    for seed in range(60):
        q, v = random_state(model, seed)
        (start,) = model.in_order(q)
        x = v[model.order] * rng.choice([0.02, 0.1, 0.3])
        level = rng.uniform(0.0, 0.3, count)
        asked = np.ones(count, dtype=bool)
        bounds = path_bounds(start, x, 0.0 * x, level, asked, robot, hold(reaches))
        ways = [displaced(start, t * x, model.turn) for t in np.linspace(0.0, 1.0, 41)]
        d = np.array([referee.distances(model.in_plant(way)[0]) for way in ways])
        smallest = d.min(axis=0)
        clear = bounds.at < 0.0
        assert (smallest[clear] >= bounds.low[clear] - 1e-12).all()
        assert (bounds.low[clear] >= level[clear] - 1e-12).all()
        assert (smallest >= level - 1e-12)[clear].all()
        if clear[-1]:
            tight.append(smallest[-1] - bounds.low[-1])
        # And what moves is what the reaches say, at most.
        travelled = np.abs(x) @ reaches.farthest
        assert (np.abs(d[-1] - d[0]) <= travelled + 1e-12).all()
    assert len(tight) > 10
    assert WORLD_PAIR == model.description.pairs[-1]


def loose_plant() -> tuple[MultibodyPlant, SceneGraph]:
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    plant.AddRigidBody("torso", inertia)
    plant.Finalize()
    return plant, scene_graph


def test_a_base_that_floats_needs_a_word_on_what_moves_it() -> None:
    with pytest.raises(ModelError, match="'torso'.*base: torso and root: prescribed"):
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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"root": "loose", "base": "body"}, "root: 'loose' is none of fixed, presc"),
        ({"root": "prescribed"}, "needs the name of the link that floats"),
        ({"root_pose": RootPose(xyz=[0.0, np.nan, 1.0])}, "root_pose.xyz"),
        ({"root_pose": RootPose(rpy=[0.0])}, "root_pose.rpy"),
    ],
)
def test_descriptions_that_cannot_be(changes, message) -> None:
    with pytest.raises(ModelError, match=message):
        RobotDescription(**changes).validate()


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


def test_velocity_and_effort_limits_leave_the_root_alone(model: ControlModel) -> None:
    law = ControlLaw(model, CrarParameters())
    np.testing.assert_array_equal(law.speed_limits[model.prescribed], np.inf)
    assert law.effort_limits.shape == (6,)
