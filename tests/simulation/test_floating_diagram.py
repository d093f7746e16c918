"""A robot whose root floats in closed loop: the plant, its log, and what judges it."""

import numpy as np
import pytest
from floating_robots import (
    TASKS,
    add_floater,
    description,
    make_floater,
    root_entries,
    stay_apart,
    write_floater,
)
from floating_runs import check_log, hands_scenario
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from scipy.spatial.transform import Rotation
from tumbling import Tumbling

from crar_drake.control.parameters import CrarParameters
from crar_drake.errors import ModelError, ScenarioError
from crar_drake.judging.referee import Referee
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import load_robot_description
from crar_drake.run import RunResult, run_scenario
from crar_drake.simulation.diagram import AddCrarController
from crar_drake.simulation.disturbances import AddMeasurement, Disturbances
from crar_drake.simulation.scenario import parse_scenario
from crar_drake.targets.sources import TimeFunctionSource


def closed_loop(time_step: float, turning: float, end: float):
    """The robot, its root told to tumble, its hands to stay in the body."""
    builder = DiagramBuilder()
    plant, scene_graph = add_floater(builder, time_step=time_step)
    controller = AddCrarController(
        builder, plant, scene_graph, description(), TASKS, CrarParameters(period=5e-3)
    )
    model = controller.model
    root = Tumbling(model.description.rest_pose(), turning)
    q = stay_apart(model)
    X_WB = model.description.rest_pose()
    hands = np.array(
        [X_WB.inverse().multiply(p) for p in model.layout.unpack(model.tasks_at(q)).p]
    )

    def tasks(time):
        p, v, a = root.carried(time, hands)
        return model.layout.pack(np.zeros((0, 3, 3)), p, v.ravel(), a.ravel())

    for name, size, function, port in (
        ("tasks", model.layout.size, tasks, controller.get_input_port_desired_tasks()),
        (
            "root",
            model.prescribed_size,
            root.vector,
            controller.get_input_port_desired_prescribed(),
        ),
    ):
        source = builder.AddSystem(TimeFunctionSource(name, size, function))
        builder.Connect(source.get_output_port(), port)
    plant.SetDefaultPositions(q)
    simulator = Simulator(builder.Build())
    at, by = root_entries(model)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    errors = []
    simulator.Initialize()
    for time in np.linspace(0.0, end, 11)[1:]:
        simulator.AdvanceTo(time)
        x, R_p = plant.GetPositions(context)[at], root.pose(time)
        turned = (Rotation.from_quat(x[[1, 2, 3, 0]]) * R_p[0].inv()).magnitude()
        errors.append((turned, np.linalg.norm(x[4:] - R_p[1])))
    loop = controller.GetMyContextFromRoot(simulator.get_context())
    task_error = controller.diagnostics(loop)["task_error"]
    return np.array(errors), task_error


@pytest.mark.parametrize("time_step", [1e-3, 0.0])
def test_the_simulated_root_follows_its_pose(time_step: float) -> None:
    """From where it rests, through a start that it is blended onto."""
    errors, task_error = closed_loop(time_step, 0.4, 0.8 if time_step else 0.6)
    assert errors[-1, 0] < 5e-3, "rad"
    assert errors[-1, 1] < 1e-3, "m"
    assert np.abs(task_error).max() < 5e-3


def test_a_force_port_that_is_taken_is_told() -> None:
    builder = DiagramBuilder()
    plant, scene_graph = add_floater(builder)
    taken = builder.AddSystem(ConstantVectorSource(np.zeros(plant.num_velocities())))
    builder.Connect(
        taken.get_output_port(), plant.get_applied_generalized_force_input_port()
    )
    with pytest.raises(ModelError, match="applied_generalized_force.*Adder"):
        AddCrarController(builder, plant, scene_graph, description(), TASKS)


def test_noise_turns_the_root_as_it_turns_joints() -> None:
    """A random turn about each axis of the deviation that is stated."""
    builder = DiagramBuilder()
    plant, _ = add_floater(builder)
    noise = Disturbances(position_noise=1e-3)
    port = AddMeasurement(builder, plant, noise, 1e-3)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyContextFromRoot(context)
    q, turns, moves = plant.GetPositions(plant_context), [], []
    there = Rotation.from_quat(q[[1, 2, 3, 0]])
    measurement = port.get_system().GetMyContextFromRoot(context)
    for tick in range(2000):
        context.SetTime(tick * 1e-3)
        found = port.Eval(measurement)[: len(q)]
        turn = Rotation.from_quat(found[[1, 2, 3, 0]]) * there.inv()
        turns.append(turn.as_rotvec())
        moves.append(found[4:] - q[4:])
    for deviations in (turns, moves):
        assert np.std(deviations, axis=0) == pytest.approx(1e-3, rel=0.08)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> RunResult:
    """Keyframes: the root is held at a skew pose, and one hand moves."""
    folder = tmp_path_factory.mktemp("floater")
    write_floater(folder, "prescribed", "[2.3, -1.5, 0.8]")
    model = make_floater(root_pose=load_robot_description(folder).root_pose)
    hands = model.layout.unpack(model.tasks_at(stay_apart(model))).p
    then = [hands[0] + [0.05, 0.02, 0.03], hands[1]]
    scenario = hands_scenario(folder, hands, then, duration=0.3)
    return run_scenario(scenario, folder / "out", record=False)


def test_a_run_leaves_a_log_that_is_judged_and_drawn(run: RunResult, tmp_path) -> None:
    log = SimulationLog.load(run.files[0])
    plant: MultibodyPlant = run.setup.model.plant
    scene_graph: SceneGraph = run.setup.model.scene_graph
    nq, nv = plant.num_positions(), plant.num_velocities()
    assert log.q.shape == (len(log.time), nq) and log.v.shape == (len(log.time), nv)
    assert log.position_names[:5].tolist() == [
        "body.qw",
        "body.qx",
        "body.qy",
        "body.qz",
        "body.x",
    ]
    assert log.velocity_names[2:7].tolist() == [
        "body.wz",
        "body.vx",
        "body.vy",
        "body.vz",
        "left_j0",
    ]
    np.testing.assert_allclose(np.linalg.norm(log.q[:, :4], axis=1), 1.0, atol=1e-12)
    # The root stays, though the arms swing and gravity pulls.
    np.testing.assert_allclose(log.q[:, :7] - log.q[0, :7], 0.0, atol=1e-9)
    assert np.abs(log.task_error[-1]).max() < 0.02
    # The figures' joints are the log's columns of the same name.
    column = log.velocity_names.tolist().index("left_j0")
    torque = log.actuation[:, log.actuator_names == "left_j0"].ravel()
    assert np.abs(torque * log.v[:, column]).max() > 0.0
    assert run.summary.mean_power > 0.0
    referee = Referee(plant, scene_graph, run.setup.model.description.pairs)
    assert referee.violations(log.q, log.v).num_violated == 0
    check_log(run, log, tmp_path)


def test_prescribed_joints_that_a_motion_moves_need_one(run: RunResult) -> None:
    assert run.setup.motion.prescribed_at(0.0).shape == (7,)
    scenario = parse_scenario(
        "robot: upper_body\ntasks: [{frame: left_wrist}]\n"
        "keyframes:\n  left_wrist:\n  - {time: 0, xyz: [0, 0, 1]}\n"
        "  - {time: 1, xyz: [0, 0, 1]}\n",
        "test",
    )
    with pytest.raises(ScenarioError, match="need a motion"):
        run_scenario(scenario)
