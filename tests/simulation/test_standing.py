"""Robots that stand in contact simulation: still, pushed, following, falling."""

from dataclasses import replace

import numpy as np
import pytest
from ground_demand import ground_wrench
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from standing_robots import APART, HEIGHT, PAD, standing_robot, tipping_cell

from crar_drake import (
    AddRobot,
    AddStandingController,
    CrarWarning,
    MakeCrarDiagram,
    StandingLaw,
    add_contact_ground,
    load_robot_description,
    standing_description,
)
from crar_drake.commands import main
from crar_drake.errors import ModelError, ScenarioError
from crar_drake.law.parameters import BalanceParameters, LookaheadParameters
from crar_drake.results.log import SimulationLog
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.run import run_scenario
from crar_drake.simulation.disturbances import Disturbances, Push
from crar_drake.simulation.scenario import Scenario, Standing, parse_scenario
from crar_drake.targets.keyframes import Keyframe


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    standing_robot(folder)
    return folder


def hand_at(shoulder: float, elbow: float) -> list[float]:
    """(3,) where the hand is [m]: the arm is turned about y, then bent about z."""
    along, aside = 0.3 + 0.3 * np.cos(elbow), 0.3 * np.sin(elbow)
    height = HEIGHT + 0.4 - along * np.sin(shoulder)
    return [float(along * np.cos(shoulder)), float(aside), float(height)]


def scenario(folder, *poses: tuple[float, float], **options) -> Scenario:
    """The hand goes from where it rests to where other angles have it, each half
    second."""
    frames = [
        Keyframe(time=0.5 * i, xyz=hand_at(*pose)) for i, pose in enumerate(poses)
    ]
    made = Scenario(
        robot=str(folder),
        tasks=[Task(frame="hand")],
        keyframes={"hand": frames},
        standing=Standing(),
        controller=LookaheadParameters(period=0.005),
    )
    made.plant_config.time_step = 0.0025
    return replace(made, **options)


REST = (0.6, 0.4)  # shoulder, elbow [rad]


@pytest.mark.parametrize("contact", ["point", "hydroelastic_with_fallback"])
def test_it_stands_still(folder, contact) -> None:
    still = scenario(folder, REST, REST, REST)
    still.plant_config.contact_model = contact
    result = run_scenario(still)
    stood = result.summary.stance
    assert stood.fell is None
    assert stood.lean < np.radians(0.5)
    assert stood.slide < 1e-3 and abs(stood.lift) < 1e-3
    assert np.abs(result.log.v[-1]).max() < 0.02
    assert result.summary.violated_samples == 0


@pytest.fixture(scope="module")
def moved(folder, tmp_path_factory):
    """A hand that moves, and a folder with the files of the run."""
    out = tmp_path_factory.mktemp("out")
    moving = scenario(folder, REST, (0.3, 0.7), (0.0, 0.5), (0.2, 0.2), (0.2, 0.2))
    return run_scenario(moving, out), out


def test_the_hand_goes_where_it_is_to(moved) -> None:
    result, _ = moved
    assert result.summary.stance.fell is None
    assert result.summary.tasks["hand"].rms_error < 0.03
    assert np.linalg.norm(result.log.task_error[-1]) < 0.005
    # Of the robot itself: the model that floats, at the log's last state.
    simulated = result.setup.simulated
    at = simulated.tasks_at(result.log.q[-1])[:3]
    error = result.log.desired_tasks[-1, :3] - at
    np.testing.assert_allclose(result.log.task_error[-1], error, atol=1e-9)
    # The feet stay, and the robot's weight is on motors of the legs.
    assert result.summary.stance.slide < 5e-3
    knee = result.log.actuator_names.tolist().index("left_knee")
    assert np.abs(result.log.actuation[-1, knee]) > 5.0


def test_its_run_is_recorded_and_judged(moved, capsys) -> None:
    result, out = moved
    assert {path.name for path in result.files} >= {"log.npz", "recording.html"}
    log = SimulationLog.load(out / "log.npz")
    assert log.q.shape[1] == 21 and log.v.shape[1] == 20
    names = [f"{a} - {b}" for a, b in result.setup.simulated.description.pairs]
    assert log.pair_names.tolist() == names
    assert main(["judge", str(out / "log.npz"), "--no-meshes"]) == 0
    assert "smallest distance" in capsys.readouterr().out


def test_pushes_and_other_masses_do_not_make_it_fall(folder) -> None:
    """30 N for 0.2 s ahead, then aside; the robot is a tenth lighter than believed."""
    pushes = [
        Push("trunk", [30.0, 0.0, 0.0], 0.1, 0.2),
        Push("trunk", [0.0, 30.0, 0.0], 0.7, 0.2),
    ]
    pushed = scenario(
        folder,
        *(5 * [REST]),
        disturbances=Disturbances(mass_scale=0.9, pushes=pushes),
    )
    stood = run_scenario(pushed).summary.stance
    assert stood.fell is None
    assert 1e-3 < stood.lean < np.radians(15.0)


def test_a_fall_is_told(folder, tmp_path, capsys) -> None:
    """300 N ahead throw it over: VIOLATED, and the run comes to its end."""
    thrown = scenario(
        folder,
        *(5 * [REST]),
        disturbances=Disturbances(pushes=[Push("trunk", [300.0, 0, 0], 0.1, 0.3)]),
    )
    file = tmp_path / "thrown.yaml"
    file.write_text(thrown.to_yaml())
    out = tmp_path / "out"
    command = ["run", str(file), "--no-page", "--out", str(out)]
    assert main(command) == 1
    printed = capsys.readouterr().out
    assert "VIOLATED" in printed and "the robot fell at" in printed
    log = SimulationLog.load(out / "log.npz")
    assert log.time[-1] == pytest.approx(2.0)
    assert np.abs(log.q).max() < 100.0  # it lies, and is not thrown to infinity


def test_what_cannot_stand_is_told(folder, tmp_path) -> None:
    still = scenario(folder, REST, REST)
    with pytest.raises(ModelError, match="soles: there are none"):
        run_scenario(replace(still, robot="upper_body"))
    with pytest.raises(ScenarioError, match="standing.friction: -1"):
        replace(still, standing=Standing(friction=-1.0)).validate()
    continuous = "keyframes: {}\nstanding: {}\nplant_config: {time_step: 0.0}\n"
    with pytest.raises(ScenarioError, match="needs a discrete plant"):
        parse_scenario(continuous)


def test_a_run_of_a_cell_whose_base_is_fixed(tmp_path) -> None:
    """No `standing`: its feet carry what it does, by Drake's dynamics of the same cell
    with a base that floats. It begins at rest, far from its first target."""
    cell = tipping_cell(tmp_path)
    floating = ControlModel.FromDescription(replace(cell, root="prescribed"), [])
    swing = [Keyframe(0.3 * i, xyz=[0.5 * (-1.0) ** i, 0.0, 1.2]) for i in range(5)]
    farthest = []
    for balance in (BalanceParameters(), None):
        controller = LookaheadParameters(period=0.005, balance=balance)
        run = run_scenario(
            scenario(
                tmp_path,
                keyframes={"hand": swing},
                standing=None,
                controller=controller,
            )
        )
        q = np.tile(floating.rest_positions(), (len(run.log.q), 1))
        v, a = np.zeros((2, len(q), floating.plant.num_velocities()))
        q[:, floating.controlled_positions] = run.log.q
        v[:, floating.controlled] = run.log.v
        a[:, floating.controlled] = run.log.desired_acceleration
        centres = np.abs(ground_wrench(floating.plant, q, v, a).centres(0.2))
        # None where the ground would have to hold it down.
        farthest.append(np.nan_to_num(centres, nan=np.inf).max())
        if balance:
            rest = run.setup.model.rest_positions()
            np.testing.assert_array_equal(run.log.q[0], rest)
            assert run.summary.changed_for_balance > 10
            assert np.abs(run.log.v).max() > 1.0
    assert farthest[0] < APART + PAD - 0.02 + 1e-6
    assert farthest[1] > APART + PAD


def test_a_step_at_which_contact_may_explode(folder) -> None:
    long = scenario(folder, REST, REST, duration=0.01)
    long.plant_config.time_step = 0.005
    with pytest.warns(CrarWarning, match="0.005 s: contact.* explode; take at most"):
        MakeCrarDiagram(long)


def test_it_stands_beside_other_things(folder) -> None:
    """A ball falls on the floor; the robot stands, and reaches for its target."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    described = load_robot_description(folder)
    robot = AddRobot(plant, described)
    ball = plant.AddRigidBody(
        "ball",
        plant.AddModelInstance("ball"),
        SpatialInertia.SolidSphereWithMass(1.0, 0.05),
    )
    friction = CoulombFriction(0.5, 0.5)
    shape = Sphere(0.05)
    plant.RegisterCollisionGeometry(ball, RigidTransform(), shape, "ball", friction)
    plant.SetDefaultFloatingBaseBodyPose(ball, RigidTransform([1.0, 0.0, 0.2]))
    law = StandingLaw(ControlModel.FromDescription(described, []).plant, described, 0.8)
    add_contact_ground(plant, scene_graph, described, 0.8, law.floor, robot)
    plant.Finalize()
    still = standing_description(described)
    model = ControlModel.FromDescription(still, [Task(frame="hand")], time_step=0.0)
    controller, standing = AddStandingController(
        *(builder, plant, law, model, LookaheadParameters(period=0.005)),
        model_instance=robot,
    )
    rest = model.rest_positions()
    target = model.tasks_at(rest)
    target[:3] = hand_at(0.5, 0.5)
    for value, port in (
        (target, controller.get_input_port_desired_tasks()),
        (model.prescribed_at(rest), controller.get_input_port_desired_prescribed()),
    ):
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.Connect(source.get_output_port(), port)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0)
    root = simulator.get_context()
    of_ball = plant.EvalBodyPoseInWorld(plant.GetMyContextFromRoot(root), ball)
    assert of_ball.translation()[2] == pytest.approx(0.05, abs=2e-3)
    status = standing.GetOutputPort("status")
    assert status.Eval(standing.GetMyContextFromRoot(root))[1] == 0.0
    told = controller.diagnostics(controller.GetMyContextFromRoot(root))
    assert np.abs(told["task_error"]).max() < 5e-3
