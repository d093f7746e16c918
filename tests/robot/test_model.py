"""The control model against plain kinematics, and what it refuses."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation
from small_robots import (
    CAPSULE,
    SPHERE_POST,
    add_plant,
    chain_urdf,
    make_model,
    random_state,
)

from crar_drake.errors import ModelError
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

TASKS = [
    Task(frame="l1", kind="position", point=[0.1, -0.05, 0.02], name="elbow"),
    Task(frame="tip", kind="orientation", name="heading"),
    Task(frame="tip", kind="pose", point=[0.02, 0.03, -0.04], name="tool"),
    Task(frame="hand", kind="pose", name="alias", point=[0.0, 0.1, 0.0]),
]


@pytest.fixture(scope="module")
def model() -> ControlModel:
    """A spatial chain on a prescribed rail, with tasks of all kinds."""
    return make_model(
        chain_urdf("zyxy", rail="y", damping=0.4),
        TASKS,
        prescribed_joints={"rail": "hold"},
        task_frames={"hand": "l3"},
        pairs=[["l2", "post"], ["l0", "l3"], ["l3", "post"]],
    )


def pose(model: ControlModel, frame: str, point, q) -> RigidTransform:
    """X_WT from Drake's own forward kinematics."""
    plant = model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    X_WF = plant.GetFrameByName(frame).CalcPoseInWorld(context)
    return X_WF @ RigidTransform(np.asarray(point, dtype=float))


def task_coordinates(model: ControlModel, q, q0) -> np.ndarray:
    """(m,) per task the rotation vector from the pose at q0, and the position."""
    rows = []
    for task in TASKS:
        frame = {"hand": "l3"}.get(task.frame, task.frame)
        X, X0 = (pose(model, frame, task.point, x) for x in (q, q0))
        if task.kind != "position":
            R = X.rotation().matrix() @ X0.rotation().matrix().T
            rows.append(Rotation.from_matrix(R).as_rotvec())
        if task.kind != "orientation":
            rows.append(X.translation())
    return np.concatenate(rows)


def test_poses_are_those_of_forward_kinematics(model):
    q, v = random_state(model, 1)
    state = model.evaluate(model.MakeWorkspace(), q, v)
    poses = [
        pose(model, "l1", TASKS[0].point, q),
        pose(model, "tip", TASKS[1].point, q),
        pose(model, "tip", TASKS[2].point, q),
        pose(model, "l3", TASKS[3].point, q),
    ]
    for i, k in enumerate((0, 2, 3)):
        np.testing.assert_allclose(state.p[i], poses[k].translation(), atol=1e-14)
    for i, k in enumerate((1, 2, 3)):
        np.testing.assert_allclose(state.R[i], poses[k].rotation().matrix(), atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_jacobians_velocity_and_bias_by_finite_differences(model, seed):
    """Eqs. (5), (6), column by column; the prescribed joint has its own column."""
    q, v = random_state(model, seed)
    state = model.evaluate(model.MakeWorkspace(), q, v)
    assert state.J.shape == (18, 4) and state.J_p.shape == (18, 1)

    def slope(direction, h=1e-5):
        after = task_coordinates(model, q + h * direction, q)
        before = task_coordinates(model, q - h * direction, q)
        return (after - before) / (2 * h)

    columns = np.stack([slope(e) for e in np.eye(len(q))], axis=1)
    np.testing.assert_allclose(state.J, columns[:, model.controlled], atol=1e-9)
    np.testing.assert_allclose(state.J_p, columns[:, model.prescribed], atol=1e-9)
    np.testing.assert_allclose(state.v, slope(v), atol=1e-8)
    # With constant v the second derivative of the coordinates is the bias.
    h = 2e-4
    now = task_coordinates(model, q, q)
    curvature = (
        task_coordinates(model, q + h * v, q)
        - 2 * now
        + task_coordinates(model, q - h * v, q)
    ) / h**2
    np.testing.assert_allclose(state.Jdot_qdot, curvature, atol=1e-6)
    assert np.abs(state.Jdot_qdot).max() > 0.1


def test_split_into_controlled_and_prescribed(model):
    assert model.prescribed_names == ["rail"]
    assert model.joint_names == ["j0", "j1", "j2", "j3"]
    assert (model.n, model.n_p, model.m) == (4, 1, 18)
    q, v = random_state(model, 5)
    state = model.evaluate(model.MakeWorkspace(), q, v)
    rail = model.plant.GetJointByName("rail").position_start()
    assert state.q_p == q[rail] and state.qdot_p == v[rail]
    np.testing.assert_array_equal(state.q, np.delete(q, rail))


def smallest_distance(plant, scene_graph, diagram, link_a, link_b, q) -> float:
    """The smallest of SceneGraph's distances between two links' shapes."""
    context = diagram.CreateDefaultContext()
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), q)
    query = scene_graph.get_query_output_port().Eval(
        scene_graph.GetMyContextFromRoot(context)
    )
    ids = [
        plant.GetCollisionGeometriesForBody(plant.GetBodyByName(link))
        for link in (link_a, link_b)
    ]
    return min(
        query.ComputeSignedDistancePairClosestPoints(a, b).distance
        for a in ids[0]
        for b in ids[1]
    )


def distance_slopes(model: ControlModel, q, h=1e-6) -> np.ndarray:
    """(Nc, nv) by finite differences of the model's own distances."""
    workspace, zero = model.MakeWorkspace(), np.zeros(len(q))
    return np.stack(
        [
            (
                model.evaluate(workspace, q + h * e, zero).d
                - model.evaluate(workspace, q - h * e, zero).d
            )
            / (2 * h)
            for e in np.eye(len(q))
        ],
        axis=1,
    )


@pytest.mark.parametrize(
    "shapes",
    [
        (CAPSULE,),
        (CAPSULE, '<sphere radius="0.07"/>', '<capsule radius="0.02" length="0.25"/>'),
        ('<box size="0.06 0.08 0.25"/>',),
        ('<box size="0.06 0.08 0.25"/>', '<sphere radius="0.07"/>'),
        ('<cylinder radius="0.04" length="0.25"/>', '<sphere radius="0.07"/>'),
    ],
    ids=["capsule", "three shapes", "box", "box and sphere", "cylinder and sphere"],
)
def test_distances_and_gradients(shapes):
    """Eq. (20) for one and several shapes, closed-form or not; the post is welded
    to the world, so its share of the gradient is nothing."""
    model = make_model(
        chain_urdf("zyz", rail="y", shapes=shapes),
        prescribed_joints={"rail": "hold"},
        pairs=[["l1", "post"], ["post", "l2"]],
    )
    compared = 0
    for seed in range(6):
        q, v = random_state(model, seed)
        state = model.evaluate(model.MakeWorkspace(), q, v)
        for d, link in zip(state.d, ("l1", "l2"), strict=True):
            expected = smallest_distance(
                model.plant, model.scene_graph, model.diagram, link, "post", q
            )
            assert d == pytest.approx(expected, abs=1e-6)
        numeric = distance_slopes(model, q)
        joined = np.empty_like(numeric)
        joined[:, model.controlled] = state.dd_dq
        joined[:, model.prescribed] = state.dd_dq_p
        outside = state.d > 1e-3
        compared += outside.sum()
        np.testing.assert_allclose(joined[outside], numeric[outside], atol=2e-4)
        # A joint beyond the link cannot move it.
        assert (state.dd_dq[0, 2] == 0.0) and np.abs(state.dd_dq[1]).max() > 0.01
    assert compared >= 8


def test_two_things_welded_to_the_world_have_no_gradient():
    wall = SPHERE_POST.replace("post", "wall").replace("0.2 0.5 0.1", "0 -1 0")
    model = make_model(
        chain_urdf("zz", extra=SPHERE_POST + wall), pairs=[["post", "wall"]]
    )
    q, v = random_state(model, 1)
    state = model.evaluate(model.MakeWorkspace(), q, v)
    assert state.d[0] == pytest.approx(np.hypot(np.hypot(0.2, 1.5), 0.1) - 0.2)
    np.testing.assert_array_equal(state.dd_dq, np.zeros((1, 2)))


@pytest.mark.parametrize("time_step", [0.0, 1e-3])
def test_inverse_dynamics_is_drakes(time_step):
    """Eq. (2), with gravity, against Drake's InverseDynamics system; a discrete
    plant's implicit damping is on top."""
    damping = 0.7
    model = make_model(
        chain_urdf("zyxy", rail="z", damping=damping),
        time_step=time_step,
        prescribed_joints={"rail": "hold"},
    )
    plant, _ = add_plant(
        DiagramBuilder(),
        chain_urdf("zyxy", rail="z", damping=damping),
        time_step=time_step,
    )
    drake = InverseDynamics(plant, InverseDynamics.InverseDynamicsMode.kInverseDynamics)
    context = drake.CreateDefaultContext()
    rng = np.random.default_rng(0)
    workspace = model.MakeWorkspace()
    extra = np.full(5, time_step * damping)
    extra[plant.GetJointByName("rail").velocity_start()] = 0.0
    for seed in range(4):
        q, v = random_state(model, seed)
        vdot = rng.normal(size=5) * 10
        drake.get_input_port_estimated_state().FixValue(context, np.r_[q, v])
        drake.get_input_port_desired_acceleration().FixValue(context, vdot)
        expected = drake.get_output_port_generalized_force().Eval(context)
        model.evaluate(workspace, q, v)
        tau = model.inverse_dynamics(workspace, vdot)
        np.testing.assert_allclose(tau, expected + extra * vdot, atol=1e-9)
        # Gravity is in it: the rail carries the weight.
    model.evaluate(workspace, np.zeros(5), np.zeros(5))
    tau = model.inverse_dynamics(workspace, np.zeros(5))
    mass = 2 + 1.0 + 1.2 + 1.4 + 1.6
    rail = model.plant.GetJointByName("rail").velocity_start()
    assert tau[rail] == pytest.approx(9.81 * mass)


@pytest.mark.parametrize("time_step", [0.0, 1e-3])
@pytest.mark.parametrize("gear_ratio", [None, 50.0])
def test_actuators_in_another_order(time_step, gear_ratio):
    """Transmissions are listed in reverse; gears add the rotors' inertia."""
    urdf = chain_urdf("zyx", actuated=["j2", "j0", "j1"], gear_ratio=gear_ratio)
    model = make_model(urdf, time_step=time_step)
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, urdf, time_step=time_step, sampled=False)
    diagram = builder.Build()
    names = [
        plant.get_joint_actuator(i).joint().name()
        for i in plant.GetJointActuatorIndices()
    ]
    assert names == ["j2", "j0", "j1"]
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    workspace = model.MakeWorkspace()
    for seed in range(3):
        q, v = random_state(model, seed)
        vdot = np.random.default_rng(seed).normal(size=3) * 20
        model.evaluate(workspace, q, v)
        tau = model.inverse_dynamics(workspace, vdot)
        plant.SetPositionsAndVelocities(plant_context, np.r_[q, v])
        plant.get_actuation_input_port().FixValue(plant_context, tau)
        reached = plant.get_generalized_acceleration_output_port().Eval(plant_context)
        np.testing.assert_allclose(reached, vdot, rtol=1e-9, atol=1e-9)


def test_two_actuators_of_one_joint_share_its_effort():
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, chain_urdf("zy"), finalize=False)
    plant.AddJointActuator("second", plant.GetJointByName("j0"))
    plant.Finalize()
    model = ControlModel.FromPlant(
        plant, scene_graph, RobotDescription(), [Task(frame="tip")]
    )
    workspace = model.MakeWorkspace()
    q, v = random_state(model, 0)
    model.evaluate(workspace, q, v)
    still = model.inverse_dynamics(workspace, np.zeros(2))
    assert still.shape == (3,) and still[0] == still[2]
    # The efforts are those that the joints need, and change as the inertias say.
    context = workspace.plant_context
    vdot = np.array([3.0, -7.0])
    tau = model.inverse_dynamics(workspace, vdot)
    needed = (
        model.plant.CalcMassMatrix(context) @ vdot
        + model.plant.CalcBiasTerm(context)
        - model.plant.CalcGravityGeneralizedForces(context)
    )
    np.testing.assert_allclose(model.plant.MakeActuationMatrix() @ tau, needed)
    change = model.effort_of_joints @ model.plant.CalcMassMatrix(context) @ vdot
    np.testing.assert_allclose(tau - still, change, atol=1e-12)


def test_effort_limits_by_joint():
    """In the order of the joints, infinite where the model states none."""
    np.testing.assert_array_equal(
        make_model(chain_urdf("zz")).effort_limits, [np.inf, np.inf]
    )
    plant, scene_graph = add_plant(
        DiagramBuilder(), chain_urdf("zyx", actuated=["j2", "j0", "j1"]), finalize=False
    )
    plant.GetJointActuatorByName("j2").set_effort_limit(7.0)
    plant.GetJointActuatorByName("j0").set_effort_limit(3.0)
    plant.Finalize()
    model = ControlModel.FromPlant(
        plant, scene_graph, RobotDescription(), [Task(frame="tip")]
    )
    np.testing.assert_array_equal(model.effort_limits, [3.0, np.inf, 7.0])


def speeds_urdf(**speeds: str) -> str:
    """A chain of three joints on a rail that state these velocities."""
    text = chain_urdf("zyx", rail="y")
    for joint, speed in speeds.items():
        head, tail = text.split(f'<joint name="{joint}" type', 1)
        tail = tail.replace("<limit ", f'<limit velocity="{speed}" ', 1)
        text = f'{head}<joint name="{joint}" type{tail}'
    return text


def test_velocity_limits_by_joint():
    """In the order of the joints, infinite where the model states none, or 0."""
    rail = {"prescribed_joints": {"rail": "hold"}}
    model = make_model(speeds_urdf(rail="3", j0="2.5", j2="0"), **rail)
    by_name = dict(zip(model.position_names, model.velocity_limits, strict=True))
    assert by_name == {"rail": 3.0, "j0": 2.5, "j1": np.inf, "j2": np.inf}
    # The description says otherwise, also that there is none.
    model = make_model(
        speeds_urdf(j0="2.5", j1="1"),
        velocity_limits={"j0": np.inf, "j2": 0.25},
        **rail,
    )
    by_name = dict(zip(model.position_names, model.velocity_limits, strict=True))
    assert by_name == {"rail": np.inf, "j0": np.inf, "j1": 1.0, "j2": 0.25}


def test_the_slower_direction_counts():
    plant, scene_graph = add_plant(DiagramBuilder(), chain_urdf("zyx"), finalize=False)
    plant.GetJointByName("j0").set_velocity_limits([-4.0], [3.0])
    plant.GetJointByName("j1").set_velocity_limits([-2.0], [np.inf])
    plant.Finalize()
    model = ControlModel.FromPlant(
        plant, scene_graph, RobotDescription(), [Task(frame="tip")]
    )
    np.testing.assert_array_equal(model.velocity_limits, [3.0, 2.0, np.inf])


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (
            {"tip_wed": 1.0},
            "velocity_limits: the plant has no joint 'tip_wed'; did you",
        ),
        ({"tip_weld": 1.0}, "velocity_limits: 'tip_weld' is fixed"),
        ({"j0": 0.0}, "velocity_limits: j0: 0.0 must be positive"),
        ({"j0": -1.0}, "velocity_limits: j0: -1.0 must be positive"),
        ({"j0": np.nan}, "velocity_limits: j0: nan must be positive"),
    ],
)
def test_refused_velocity_limits(limits, message):
    with pytest.raises(ModelError, match=message):
        make_model(chain_urdf("zz"), velocity_limits=limits)


REFUSED = [
    (dict(axes="zz", actuated=["j1"]), {}, ["j0", "not"]),
    (dict(axes="zz"), dict(prescribed_joints={"waist": "hold"}), ["'waist'", "j0"]),
    (dict(axes="zz"), dict(prescribed_joints={"jj1": "hold"}), ["did you mean 'j1'"]),
    (
        dict(axes="z"),
        dict(prescribed_joints={"j0": "hold"}),
        ["no joint left to control"],
    ),
    (dict(axes="zz"), dict(pairs=[["l1", "psot"]]), ["psot", "did you mean 'post'"]),
    (dict(axes="zz"), dict(pairs=[["l1", "tip"]]), ["tip", "no collision"]),
    (dict(axes="zz"), dict(pairs=[["l1", "l1"]]), ["two different"]),
    (dict(axes="zz"), dict(pairs=[["l1", "chain::l1"]]), ["l1", "itself"]),
    (dict(axes="zz"), dict(task_frames={"tip": "tpi"}), ["tpi", "did you mean 'tip'"]),
    (
        dict(axes="zz"),
        dict(prescribed_joints={"tip_weld": "hold"}),
        ["tip_weld", "prescribed_joints"],
    ),
    (dict(axes="zz"), dict(rest_posture={"jj1": 0.1}), ["did you mean 'j1'"]),
    (
        dict(axes="zz"),
        dict(rest_posture={"tip_weld": 0.1}),
        ["tip_weld", "rest_posture"],
    ),
    (
        dict(axes="zz"),
        dict(rest_posture={"j0": float("nan")}),
        ["j0", "rest_posture"],
    ),
]


@pytest.mark.parametrize("robot, description, words", REFUSED)
def test_refused_descriptions(robot, description, words):
    with pytest.raises(ModelError) as caught:
        make_model(chain_urdf(**robot), **description)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "tasks, words",
    [
        ([Task(frame="tipp")], ["tipp", "did you mean 'tip'"]),
        ([Task(frame="hnd")], ["hnd", "did you mean 'hand'"]),
        ([Task(frame="tip"), Task(frame="tip", kind="pose")], ["two tasks", "tip"]),
        ([Task(frame="tip", kind="pos")], ["pos", "orientation"]),
        ([Task(frame="tip", point=[0.0, 0.0])], ["point", "three"]),
        ([Task(frame="tip", point=[0.0, 0.0, np.nan])], ["point"]),
        ([Task(frame="tip", position_weight=0.0)], ["position_weight"]),
        ([Task()], ["frame"]),
    ],
)
def test_refused_tasks(tasks, words):
    with pytest.raises(ModelError) as caught:
        make_model(chain_urdf("zz"), tasks, task_frames={"hand": "l1"})
    for word in words:
        assert word in str(caught.value)


def test_the_default_model_is_a_clone():
    """What the user does to the plant and its filters afterwards stays out."""
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, chain_urdf("zz"))
    model = ControlModel.FromPlant(
        plant,
        scene_graph,
        RobotDescription(pairs=[["l1", "post"]]),
        [Task(frame="tip")],
    )
    q = np.array([0.3, 0.4])
    before = model.evaluate(model.MakeWorkspace(), q, q)
    tau = model.inverse_dynamics(model.MakeWorkspace(), np.ones(2))
    plant.SetDefaultPositions([1.0, 1.0])
    plant.mutable_gravity_field().set_gravity_vector([0.0, 5.0, 0.0])
    source = plant.get_source_id()
    post = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("post"))[0]
    scene_graph.RemoveGeometry(source, post)
    after = model.evaluate(model.MakeWorkspace(), q, q)
    np.testing.assert_array_equal(before.d, after.d)
    np.testing.assert_array_equal(model.rest_positions(), [0.0, 0.0])
    np.testing.assert_array_equal(
        tau, model.inverse_dynamics(model.MakeWorkspace(), np.ones(2))
    )
