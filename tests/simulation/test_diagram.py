"""The builders: AddCrarController beside a plant, MakeCrarDiagram of a scenario."""

import re
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from small_robots import add_plant, chain_urdf, make_model

from crar_drake.errors import CrarError, ModelError, ScenarioError
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.motion.catalogue import builtin_names
from crar_drake.resources import data_folder
from crar_drake.robot.description import (
    RobotDescription,
    RootPose,
    add_robot,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.simulation.diagram import (
    AddCrarController,
    AddRobot,
    MakeCrarDiagram,
    PrepareScenario,
)
from crar_drake.simulation.scenario import (
    Scenario,
    SimulatedRobot,
    load_scenario,
    scenario_names,
)
from crar_drake.targets.keyframes import Keyframe

TIP = [Task(frame="tip")]


def controlled(plant, scene_graph, builder, **options):
    return AddCrarController(
        builder, plant, scene_graph, RobotDescription(), TIP, **options
    )


def test_two_controllers_of_one_robot_are_refused():
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, chain_urdf("zyz"))
    controlled(plant, scene_graph, builder)
    systems = len(builder.GetSystems())
    with pytest.raises(ModelError, match="actuation is connected already"):
        controlled(plant, scene_graph, builder)
    assert len(builder.GetSystems()) == systems


@pytest.mark.parametrize(
    "other, words",
    [
        (dict(axes="zzz"), ["2 positions", "3"]),
        (dict(axes="z", rail="y"), ["positions", "j0, j1", "rail, j0"]),
        (dict(axes="zz", actuated=["j1", "j0"]), ["actuators", "j1, j0"]),
    ],
)
def test_control_model_of_another_robot(other, words):
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, chain_urdf("zz"))
    with pytest.raises(ModelError) as caught:
        controlled(
            plant, scene_graph, builder, control_model=make_model(chain_urdf(**other))
        )
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "xyz, rpy, fits",
    [
        ([0.0, 0.0, 0.7], [0.0, 0.0, 0.0], False),
        ([0.0, 0.0, 0.0], [0.3, 0.0, 0.0], False),
        ([0.001, 0.0, 0.001], [0.0, 0.001, 0.0], True),  # as calibrations err
    ],
)
def test_a_robot_that_stands_elsewhere_than_its_model(tmp_path, xyz, rpy, fits):
    """Refused, since targets and gravity would be another robot's; the description can
    say where it stands."""
    (tmp_path / "robot.urdf").write_text(chain_urdf("zyz", rail="y", extra=""))
    robot = RobotDescription(
        name="arm", model="robot.urdf", base="base", folder=str(tmp_path)
    )
    there = replace(robot, root_pose=RootPose(xyz, rpy))
    for description, refused in ((robot, not fits), (there, False)):
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        add_robot(plant, there)
        plant.Finalize()
        model = ControlModel.FromDescription(description, TIP)
        told = pytest.raises(ModelError, match="the control model has it.*root_pose")
        with told if refused else nullcontext():
            controlled(plant, scene_graph, builder, control_model=model)


def test_actuators_may_have_other_names():
    """Those of a file have names of their own, and an import makes others."""
    builder = DiagramBuilder()
    urdf = chain_urdf("zz")
    plant, scene_graph = add_plant(builder, urdf)
    renamed = re.sub(r'<actuator name="(\w+)"', r'<actuator name="motor_\1"', urdf)
    model = make_model(renamed)
    assert model.plant.GetActuatorNames() != plant.GetActuatorNames()
    controlled(plant, scene_graph, builder, control_model=model)


def test_which_of_several_robots_is_meant_has_to_be_said():
    """Something like a gripper comes first in the plant."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    parser = Parser(plant)
    parser.SetAutoRenaming(True)
    arm_urdf = chain_urdf("zyz", shapes=(), extra="")
    gripper_urdf = chain_urdf("z", shapes=(), extra="")
    instances = [
        parser.AddModelsFromString(urdf, "urdf")[0] for urdf in (gripper_urdf, arm_urdf)
    ]
    gripper, arm = instances
    for each in instances:
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base", each))
    plant.Finalize()
    model = make_model(arm_urdf)
    with pytest.raises(ModelError, match="4 positions but.*model_instance names it"):
        controlled(plant, scene_graph, builder, control_model=model)
    with pytest.raises(ModelError, match="needs control_model"):
        controlled(plant, scene_graph, builder, model_instance=arm)
    with pytest.raises(ModelError, match="1 positions but the control model 3"):
        controlled(
            plant, scene_graph, builder, control_model=model, model_instance=gripper
        )
    controlled(plant, scene_graph, builder, control_model=model, model_instance=arm)


def test_a_robot_that_something_else_carries_is_refused():
    """Its base is where the model has it at rest, and goes elsewhere."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    parser = Parser(plant)
    parser.SetAutoRenaming(True)
    cart, arm = (
        parser.AddModelsFromString(chain_urdf(axes, shapes=(), extra=""), "urdf")[0]
        for axes in ("z", "zyz")
    )
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base", cart))
    on_cart = plant.GetFrameByName("l0", cart), plant.GetFrameByName("base", arm)
    plant.WeldFrames(*on_cart)
    plant.Finalize()
    model = make_model(chain_urdf("zyz", shapes=(), extra=""))
    with pytest.raises(ModelError, match="'base' is carried by joint 'j0' of.*weld"):
        controlled(plant, scene_graph, builder, control_model=model, model_instance=arm)


def test_period_that_is_not_a_multiple():
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, chain_urdf("zz"), time_step=2e-3)
    with pytest.raises(ScenarioError, match="controller.period: 0.003 s.*0.002 s"):
        controlled(
            plant, scene_graph, builder, parameters=LookaheadParameters(period=3e-3)
        )


def test_plant_heavier_than_its_model_is_accepted():
    """A plant 10 % heavier than the model: same joints, another mass."""
    builder = DiagramBuilder()
    heavier = chain_urdf("zz").replace('<mass value="1.0"/>', '<mass value="1.1"/>')
    plant, scene_graph = add_plant(builder, heavier)
    controlled(plant, scene_graph, builder, control_model=make_model(chain_urdf("zz")))


def test_a_robot_by_path_and_by_description():
    path = data_folder("models") / "obstacle_arm"
    described = load_robot_description(path)
    for robot in (path, str(path / "robot.yaml"), described):
        plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
        assert AddRobot(plant, robot) == described
        assert plant.HasBodyNamed("forearm") and not plant.is_finalized()


def test_a_robot_that_cannot_be_added():
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    with pytest.raises(ModelError, match="'uper_body'.*did you mean 'upper_body'"):
        AddRobot(plant, "uper_body")
    with pytest.raises(ModelError, match="AddMultibodyPlantSceneGraph"):
        AddRobot(MultibodyPlant(1e-3), "upper_body")
    plant.Finalize()
    with pytest.raises(ModelError, match="finalized already"):
        AddRobot(plant, "upper_body")


def runnable(name: str, request) -> Scenario:
    """The shipped scenario; on a real recording where its motion is not shipped.

    A robot that is not imported is skipped: `tests/robot_import` imports and runs it.
    """
    scenario = load_scenario(name)
    try:
        load_robot_description(scenario.robot)
    except ModelError as error:
        if "import-robot" not in str(error):
            raise
        pytest.skip(str(error))
    if scenario.motion and scenario.motion not in builtin_names():
        cmu = request.getfixturevalue("cmu")
        scenario.motion = str(cmu / "subjects" / "05" / "05_02.amc")
    return scenario


@pytest.fixture(scope="module", params=scenario_names())
def built(request) -> tuple[Scenario, Diagram]:
    scenario = runnable(request.param, request)
    return scenario, MakeCrarDiagram(scenario)


def test_it_starts_at_rest_and_valid(built):
    """No pair nearer than 2 cm; or, if it is in the rest posture, than there, or than
    5 mm. The first command is that of a robot at rest, so nothing jumps."""
    scenario, diagram = built
    context = diagram.CreateDefaultContext()
    plant = diagram.GetSubsystemByName("plant")
    model = diagram.GetSubsystemByName("crar_controller").law.model
    plant_context = plant.GetMyContextFromRoot(context)
    assert not plant.GetVelocities(plant_context).any()
    controller = diagram.GetSubsystemByName("crar_controller")
    controller_context = controller.GetMyContextFromRoot(context)
    state = controller.get_input_port_estimated_state().Eval(controller_context)
    q = state[model.controlled_positions]
    assert (q > model.lower).all() and (q < model.upper).all()
    parts = controller.diagnostics(controller_context)
    d = parts["signed_distances"]
    rest = model.evaluate(
        model.MakeWorkspace(), model.rest_positions(), np.zeros(model.n + model.n_p)
    )
    least = np.where(rest.d < 0.02, np.minimum(rest.d, 0.005), 0.02)
    assert (d >= least - 1e-9).all()
    acceleration = diagram.GetOutputPort("desired_acceleration").Eval(context)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-6)
    error = parts["task_error"]
    layout = model.layout
    assert np.isfinite(error).all()
    # One that stands begins as it rests, where it is known to be balanced.
    farthest = 0.3 if scenario.standing is None else 0.5  # [m]
    assert np.abs(error[layout.linear_rows]).max(initial=0.0) < farthest
    # A hand may have to turn far from the rest posture; blending does the rest.
    assert np.abs(error[layout.angular_rows]).max(initial=0.0) < 0.9  # sine


def what_may_touch(diagram):
    """The pairs of shapes that the plant may find in contact, in its own scene."""
    plant = diagram.GetSubsystemByName("plant")
    root = diagram.CreateDefaultContext()
    context = plant.GetMyContextFromRoot(root)
    inspector = plant.get_geometry_query_input_port().Eval(context).inspector()
    in_plant = plant.num_collision_geometries()
    assert inspector.num_geometries() >= in_plant > 0
    return inspector.GetCollisionCandidates()


def test_nothing_hides_a_violation(built):
    """By default the plant has neither contact nor limits; the control model has. A
    robot that stands touches the floor, and nothing else."""
    scenario, diagram = built
    plant = diagram.GetSubsystemByName("plant")
    assert np.isinf(plant.GetPositionUpperLimits()).all()
    assert np.isinf(plant.GetPositionLowerLimits()).all()
    assert np.isinf(plant.GetEffortUpperLimits()).all()
    if scenario.standing is None:
        assert not what_may_touch(diagram)
    else:
        (floor,) = plant.GetCollisionGeometriesForBody(plant.world_body())
        touching = what_may_touch(diagram)
        assert touching and all(floor in pair for pair in touching)
    model = diagram.GetSubsystemByName("crar_controller").law.model
    assert np.isfinite(model.upper).any() and np.isfinite(model.effort_limits).any()
    assert model.scene_graph.model_inspector().GetCollisionCandidates()


def test_it_runs(built):
    scenario, diagram = built
    period = scenario.log_period_for(0.05)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.05)
    root = simulator.get_context()
    sizes = {}
    for name in ("state", "desired_tasks", "diagnostics"):
        log = diagram.GetSubsystemByName(f"log_{name}").FindLog(root)
        sizes[name] = log.num_samples()
        # Of a law without balance that part is missing.
        missing = name == "diagnostics" and scenario.controller.balance is None
        assert np.isfinite(log.data()).all() != missing
    assert set(sizes.values()) == {round(0.05 / period) + 1}


def test_simulated_robot_options():
    """Each is kept when asked for, by itself."""
    scenario = load_scenario("obstacle_arm")
    setup = PrepareScenario(scenario)
    for option in ("contact", "position_limits", "effort_limits"):
        scenario.simulated_robot = replace(SimulatedRobot(), **{option: True})
        diagram = MakeCrarDiagram(scenario, setup=setup)
        plant = diagram.GetSubsystemByName("plant")
        assert bool(what_may_touch(diagram)) == (option == "contact")
        kept = np.isfinite(plant.GetPositionUpperLimits()).all()
        assert kept == (option == "position_limits")
        assert np.isfinite(plant.GetEffortUpperLimits()).all() == (
            option == "effort_limits"
        )


def test_continuous_plant_and_log_period():
    """A scenario may choose both."""
    scenario = load_scenario("obstacle_arm")
    scenario.plant_config.time_step = 0.0
    scenario.plant_config.use_sampled_output_ports = False
    scenario.controller.period = 5e-3
    scenario.log_period = 0.01
    diagram = MakeCrarDiagram(scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1)
    log = diagram.GetSubsystemByName("log_state").FindLog(simulator.get_context())
    np.testing.assert_allclose(log.sample_times(), np.arange(11) * 0.01, atol=1e-12)


def arm_with(**changes) -> Scenario:
    scenario = load_scenario("obstacle_arm")
    for name, value in changes.items():
        setattr(scenario, name, value)
    return scenario


def still(name: str, xyz=(0.4, 0.0, 0.3)) -> dict[str, list[Keyframe]]:
    return {name: [Keyframe(t, list(xyz)) for t in (0.0, 1.0)]}


@pytest.mark.parametrize(
    "scenario, words",
    [
        (arm_with(robot="obstacle_rm"), ["did you mean 'obstacle_arm'"]),
        (arm_with(tasks=[Task(frame="tol")]), ["tol", "did you mean 'tool'"]),
        (arm_with(keyframes=still("tol")), ["none for task tool"]),
        (arm_with(keyframes=still("tool") | still("x")), ["no task x"]),
        (arm_with(keyframes=still("tool", (0.4, 0.0))), ["tool", "xyz", "three"]),
        (arm_with(keyframes={"tool": [Keyframe()]}), ["tool", "at least two"]),
        (arm_with(keyframes={}, motion="nowhere"), ["tool", "keyframes"]),
        (arm_with(robot="upper_body", tasks=[Task(frame="neck")]), ["prescribed"]),
        (
            arm_with(controller=LookaheadParameters(period=1.5e-3)),
            ["controller.period"],
        ),
    ],
)
def test_refused_scenarios(scenario, words):
    with pytest.raises(CrarError) as caught:
        MakeCrarDiagram(scenario)
    for word in words:
        assert word in str(caught.value)


def test_two_robots_in_one_diagram_do_as_each_alone():
    """Of two kinds, and of one: names are unique, and nothing is shared."""

    def torques(*robots: tuple[str, str]) -> list[np.ndarray]:
        builder, controllers = DiagramBuilder(), []
        for number, (name, frame) in enumerate(robots):
            plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
            plant.set_name(f"plant_{number}")
            scene_graph.set_name(f"scene_graph_{number}")
            robot = AddRobot(plant, name)
            plant.Finalize()
            controller = AddCrarController(
                builder, plant, scene_graph, robot, [Task(frame=frame)]
            )
            model = controller.model
            target = model.tasks_at(model.rest_positions())
            target[2] += 0.05
            values = [(target, controller.get_input_port_desired_tasks())]
            if model.n_p:
                still = model.prescribed_at(model.rest_positions())
                values.append((still, controller.get_input_port_desired_prescribed()))
            for value, port in values:
                source = builder.AddSystem(ConstantVectorSource(value))
                builder.Connect(source.get_output_port(), port)
            controllers.append(controller)
        simulator = Simulator(builder.Build())
        simulator.AdvanceTo(0.1)
        root = simulator.get_context()
        return [
            c.get_output_port_actuation().Eval(c.GetMyContextFromRoot(root))
            for c in controllers
        ]

    body, arm = ("upper_body", "left_wrist"), ("obstacle_arm", "tool")
    alone = [*torques(body), *torques(arm)]
    for both, expected in (
        (torques(body, arm), alone),
        (torques(arm, arm), [alone[1]] * 2),
    ):
        for found, its in zip(both, expected, strict=True):
            np.testing.assert_array_equal(found, its)
