"""The whole diagram of a scenario."""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometrySet,
    SceneGraph,
)
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from crar_drake.errors import ScenarioError
from crar_drake.law.standing_law import StandingLaw
from crar_drake.robot.description import (
    RobotDescription,
    add_robot,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.standing import standing_description
from crar_drake.simulation.builders import AddStandingController, connect_controller
from crar_drake.simulation.contact_ground import add_contact_ground
from crar_drake.simulation.disturbances import (
    AddMeasurement,
    PushSource,
    ScaleMasses,
    TargetStep,
)
from crar_drake.simulation.moving_obstacles import ObstacleSource
from crar_drake.simulation.scenario import Scenario, SimulatedRobot
from crar_drake.targets.desired_motion import DesiredMotion
from crar_drake.targets.keyframes import keyframe_way
from crar_drake.targets.motion import load_motion_targets
from crar_drake.targets.sources import PoseTrajectorySource
from crar_drake.targets.start_pose import solve_start_pose


@dataclass(frozen=True)
class Setup:
    """What a scenario needs before it can be built."""

    model: ControlModel  # the control model
    motion: DesiredMotion  # the desired motion
    start_positions: np.ndarray  # (nq,) of `simulated` at the start, at rest
    # a model of what is simulated: `model`, unless that stands still on its soles,
    # where the root of what is simulated floats
    simulated: ControlModel | None = None

    def __post_init__(self) -> None:
        if self.simulated is None:
            object.__setattr__(self, "simulated", self.model)


def PrepareScenario(scenario: Scenario) -> Setup:
    """Loads a scenario's robot and motion and solves for its start pose.

    Raises:
        CrarError: something in the scenario, its robot or its motion is wrong.
    """
    scenario.validate()
    description = load_robot_description(scenario.robot)
    if scenario.standing is not None:
        return _prepare_standing(scenario, description)
    description.refuse_floating()
    model = ControlModel.FromDescription(
        description,
        scenario.task_list(),
        time_step=scenario.plant_config.time_step,
    )
    motion = load_desired_motion(scenario, model)
    if scenario.controller.balance is not None:
        start = model.rest_positions()  # known to be balanced
    else:
        start = solve_start_pose(model, motion.tasks_at(0.0), motion.prescribed_at(0.0))
    return Setup(model, motion, start)


def _prepare_standing(scenario: Scenario, description: RobotDescription) -> Setup:
    """The law's model stands still on its soles, and is at each instant what the law
    commands; what is simulated floats. Both start as the robot rests."""
    tasks = scenario.task_list()
    standing = standing_description(description)
    model, simulated = (
        ControlModel.FromDescription(described, tasks, time_step=time_step)
        for described, time_step in (
            (standing, 0.0),
            (description, scenario.plant_config.time_step),
        )
    )
    motion = load_desired_motion(scenario, model)
    return Setup(model, motion, simulated.rest_positions(), simulated)


def load_desired_motion(scenario: Scenario, model: ControlModel) -> DesiredMotion:
    """Loads the scenario's motion, or its keyframes, for the robot.

    Raises:
        MotionError: the motion cannot be found, read or scaled.
        ScenarioError: tasks and motion or keyframes do not fit each other.
    """
    if scenario.keyframes:
        return _from_keyframes(scenario, model)
    return load_motion_targets(
        scenario.motion,
        model,
        options=scenario.motion_options(),
        cutoff=scenario.cutoff,
    )


def _from_keyframes(scenario: Scenario, model: ControlModel) -> DesiredMotion:
    sources = model.description.prescribed_joints
    if any(source != "hold" for source in sources.values()):
        raise ScenarioError(
            f"robot {model.description.name}: its prescribed joints need a motion; "
            "keyframes drive robots whose prescribed joints hold"
        )
    held = model.prescribed_at(model.rest_positions())
    ways = {
        name: keyframe_way(name, frames) for name, frames in scenario.keyframes.items()
    }
    source = PoseTrajectorySource(model.layout, ways)
    return DesiredMotion(
        source.duration,
        lambda: PoseTrajectorySource(model.layout, ways),
        (lambda: ConstantVectorSource(held)) if model.n_p else None,
    )


def MakeCrarDiagram(scenario: Scenario, setup: Setup | None = None) -> Diagram:
    """Builds the whole diagram of a scenario.

    Where the robot stands, the controller runs on its own command, which a
    "standing_controller" lets the robot on the floor follow; the logs are then those of
    "actuation" and "acceleration" of that one, too.

    Subsystems, by name: "plant", "scene_graph", "crar_controller", "pushes",
    "desired_tasks", (if there are prescribed joints) "desired_prescribed" and (if there
    are any) "obstacles"; one "log_state", "log_desired_tasks" and "log_diagnostics" (of
    the controller), "log_obstacles". The plant asks its own scene for contact, from
    which filters leave out what the scenario does not want to touch. The default
    context starts at rest in a valid pose near the first target.

    Exported outputs: "state", "query", "desired_tasks" and every output of the
    controller. There are no inputs.

    Args:
        scenario: from `load_scenario`, or made in Python.
        setup: of this scenario, if it is at hand already.

    Raises:
        CrarError: something in the scenario, its robot or its motion is wrong.
    """
    setup = setup or PrepareScenario(scenario)
    model, disturbances = setup.model, scenario.disturbances
    description = setup.simulated.description
    if scenario.standing is not None:
        description = description.without_ground()  # it gets one with contact
    builder = DiagramBuilder()
    try:
        plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
    except RuntimeError as error:
        raise ScenarioError(f"plant_config: {error}") from error
    add_robot(plant, description)
    lift_limits(plant, scenario.simulated_robot)
    law = None
    if scenario.standing is not None:
        friction = scenario.standing.friction
        law = StandingLaw(setup.simulated.plant, setup.simulated.description, friction)
        add_contact_ground(plant, scene_graph, description, friction, law.floor)
    plant.Finalize()
    if law is None and not scenario.simulated_robot.contact:
        leave_out_contact(plant, scene_graph)
    plant.SetDefaultPositions(setup.start_positions)

    parameters, time_step = scenario.controller, plant.time_step()
    ticks, period = parameters.torque_ticks(time_step)
    if law is not None:
        ticks, period = round(parameters.period / time_step), time_step
    measured = AddMeasurement(builder, plant, disturbances, period, ticks)
    logged = {"state": plant.get_state_output_port()}
    if law is None:
        controller = connect_controller(
            builder,
            plant,
            model,
            parameters,
            estimated_state=measured,
            obstacle_speeds=[obstacle.fastest for obstacle in scenario.obstacles],
        )
    else:
        controller, standing = AddStandingController(
            builder, plant, law, model, parameters, estimated_state=measured
        )
        logged["actuation"] = standing.get_output_port_actuation()
        logged["acceleration"] = standing.get_output_port_acceleration()
    source = builder.AddNamedSystem("desired_tasks", setup.motion.MakeTaskSource())
    tasks = source.get_output_port()
    if disturbances.target_jump.duration:
        jump = builder.AddSystem(TargetStep(model.layout, disturbances.target_jump))
        builder.Connect(tasks, jump.get_input_port())
        tasks = jump.get_output_port()
    builder.Connect(tasks, controller.get_input_port_desired_tasks())
    pushes = builder.AddSystem(
        PushSource(plant, model.description.task_frames, disturbances.pushes)
    )
    builder.Connect(
        pushes.get_output_port(), plant.get_applied_spatial_force_input_port()
    )
    if setup.motion.MakePrescribedSource is not None:
        prescribed = builder.AddNamedSystem(
            "desired_prescribed", setup.motion.MakePrescribedSource()
        )
        builder.Connect(
            prescribed.get_output_port(), controller.get_input_port_desired_prescribed()
        )

    logged["desired_tasks"] = tasks
    logged["diagnostics"] = controller.get_output_port_diagnostics()
    if scenario.obstacles:
        source = builder.AddSystem(ObstacleSource(scenario.obstacles))
        logged["obstacles"] = source.get_output_port()
        builder.Connect(source.get_output_port(), controller.get_input_port_obstacles())
    period = scenario.log_period_for(scenario.duration or setup.motion.duration)
    for name, port in logged.items():
        LogVectorOutput(port, builder, period).set_name(f"log_{name}")

    builder.ExportOutput(plant.get_state_output_port(), "state")
    builder.ExportOutput(scene_graph.get_query_output_port(), "query")
    builder.ExportOutput(tasks, "desired_tasks")
    for i in range(controller.num_output_ports()):
        port = controller.get_output_port(i)
        builder.ExportOutput(port, port.get_name())
    diagram = builder.Build()
    diagram.set_name("crar")
    return diagram


def MakeSimulator(scenario: Scenario, diagram: Diagram) -> Simulator:
    """The simulator of a scenario's diagram, with the masses that it has there."""
    simulator = Simulator(diagram)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    if (scale := scenario.disturbances.mass_scale) != 1.0:
        plant = diagram.GetSubsystemByName("plant")
        context = simulator.get_mutable_context()
        ScaleMasses(plant, plant.GetMyMutableContextFromRoot(context), scale)
    return simulator


def lift_limits(plant: MultibodyPlant, simulated: SimulatedRobot) -> None:
    """Takes off what would hide a violation, unless the scenario keeps it."""
    if not simulated.position_limits:
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            unlimited = np.full(joint.num_positions(), np.inf)
            joint.set_position_limits(-unlimited, unlimited)
    if not simulated.effort_limits:
        plant.RemoveAllJointActuatorEffortLimits()


def leave_out_contact(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Filters every pair of shapes: contact would hide that the law let them touch."""
    frames = [
        plant.GetBodyFrameIdOrThrow(BodyIndex(i)) for i in range(plant.num_bodies())
    ]
    scene_graph.collision_filter_manager().Apply(
        CollisionFilterDeclaration().ExcludeWithin(GeometrySet(frames))
    )
