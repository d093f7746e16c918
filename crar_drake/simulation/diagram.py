"""Builders: the controller in anybody's diagram, and one whole diagram."""

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometrySet,
    Meshcat,
    SceneGraph,
)
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort
from pydrake.systems.lcm import ApplyLcmBusConfig
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput
from pydrake.visualization import ApplyVisualizationConfig

from crar_drake.errors import ModelError, ScenarioError
from crar_drake.law.commanded_motion import CommandedMotion
from crar_drake.law.controller import CrarController
from crar_drake.law.parameters import LookaheadParameters, Parameters
from crar_drake.law.standing_controller import StandingController
from crar_drake.law.standing_law import StandingLaw
from crar_drake.robot.description import (
    RobotDescription,
    add_robot,
    find_joint,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.same_place import check_place
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import Task
from crar_drake.simulation.contact_ground import add_contact_ground
from crar_drake.simulation.disturbances import AddMeasurement, PushSource, TargetStep
from crar_drake.simulation.moving_obstacles import ObstacleSource
from crar_drake.simulation.scenario import (
    Scenario,
    SimulatedRobot,
    check_multiple,
)
from crar_drake.simulation.visuals import draw_collision_shapes, set_surroundings
from crar_drake.targets.desired_motion import DesiredMotion
from crar_drake.targets.keyframes import KeyframeTrajectory
from crar_drake.targets.motion import load_motion_targets
from crar_drake.targets.sources import PoseTrajectorySource
from crar_drake.targets.start_pose import solve_start_pose


def AddRobot(
    plant: MultibodyPlant, robot: str | os.PathLike[str] | RobotDescription
) -> RobotDescription:
    """Adds a robot to a plant that is not finalized yet, in its rest posture.

    Its model file is parsed, its base welded to the world (or, if it floats, placed
    there), and the rest posture made the default of its joints. The plant may hold
    other things, too.

    Args:
        plant: of `AddMultibodyPlantSceneGraph`; call `Finalize` afterwards.
        robot: the name of a shipped robot (`crar-drake list` tells them) or of one
            that `crar-drake import-robot` made, the path of a robot.yaml or of its
            folder, or a description made in Python.

    Returns:
        The robot's description, which `AddCrarController` asks for.

    Raises:
        ModelError: the plant is finalized or has no SceneGraph, there is no such
            robot, it is not imported yet, or its model cannot be parsed.
    """
    if plant.is_finalized():
        raise ModelError("the plant is finalized already; call AddRobot before it")
    if not plant.geometry_source_is_registered():
        raise ModelError(
            "the plant has no SceneGraph; make it by AddMultibodyPlantSceneGraph"
        )
    description = (
        robot if isinstance(robot, RobotDescription) else load_robot_description(robot)
    )
    add_robot(plant, description)
    for name, position in description.rest_posture.items():
        joint = find_joint(plant, name)
        if joint.num_positions() == 1:  # others are refused by the control model
            joint.set_default_positions([position])
    return description


def AddCrarController(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    description: RobotDescription,
    tasks: Sequence[Task],
    parameters: Parameters | None = None,
    *,
    control_model: ControlModel | None = None,
    model_instance: ModelInstanceIndex | None = None,
    estimated_state: OutputPort | None = None,
    obstacle_speeds: Sequence[float] = (),
) -> CrarController:
    """Adds a controller beside a plant and connects state and actuation.

    What remains to be connected are `desired_tasks` and, if the description
    prescribes joints, `desired_prescribed`; see `CrarController` for what they carry.

    Args:
        builder: of the diagram that owns the plant.
        plant: finalized.
        scene_graph: where the plant's geometry is registered.
        description: the names in the plant: task frames, watched pairs,
            prescribed joints. From `AddRobot`, `load_robot_description`, or made in
            Python.
        tasks: what is tracked.
        parameters: `PaperParameters` or `LookaheadParameters`; by default these.
        control_model: the model that the controller computes with; by default a
            clone of `plant` and `scene_graph` as they are now. A model that is given
            has description, tasks and distances of its own, which then count. Its
            actuators may have other names, if they move joints of the same names.
        model_instance: the robot in a plant that has other things that move: a
            gripper, say, or a box. It needs `control_model`, which lacks them.
        estimated_state: port of the measured [q; v]; by default that of the plant, or
            of its `model_instance`.
        obstacle_speeds: see `CrarController`.

    Raises:
        ModelError: the plant is not finalized, has another state or other
            actuators than the control model or stands elsewhere, or a name is not in
            it; or its actuation is connected already; or its base floats, or something
            that moves carries it; or `model_instance` lacks `control_model`.
        ScenarioError: a parameter is out of range, or the control period is not a
            multiple of the plant's time step.
    """
    parameters = parameters or LookaheadParameters()
    parameters.validate()
    if not plant.is_finalized():
        raise ModelError("the plant is not finalized: call plant.Finalize() first")
    check_multiple("controller.period", parameters.period, plant.time_step())
    part = () if model_instance is None else (model_instance,)
    if part and control_model is None:
        raise ModelError(
            "model_instance: a part of a plant needs control_model, a model of that "
            "robot alone: ControlModel.FromDescription(description, tasks)"
        )
    if control_model is None:
        control_model = ControlModel.FromPlant(plant, scene_graph, description, tasks)
    model_plant = control_model.plant
    for what, theirs, ours in (
        ("positions", plant.num_positions(*part), model_plant.num_positions()),
        ("velocities", plant.num_velocities(*part), model_plant.num_velocities()),
        ("actuators", plant.num_actuators(*part), model_plant.num_actuators()),
        # The same numbers in another order would drive the wrong joints.
        ("positions", _position_names(plant, *part), _position_names(model_plant)),
        ("actuators", _actuated(plant, *part), _actuated(model_plant)),
    ):
        if theirs != ours:
            raise ModelError(
                f"the plant has {theirs} {what} but the control model {ours}; they "
                "must be the same robot (model_instance names it in a plant with more)"
            )
    check_place(plant, control_model, *part)
    if builder.IsConnectedOrExported(plant.get_actuation_input_port(*part)):
        raise ModelError(
            "the robot's actuation is connected already, to another controller perhaps"
        )
    damped = any(
        plant.get_joint(index).default_damping_vector().any()
        for index in plant.GetJointIndices()
    )
    if damped and plant.time_step() != model_plant.time_step():
        raise ModelError(
            f"the plant's time step is {plant.time_step():g} s but the control model's "
            f"{model_plant.time_step():g} s; with joint damping they must be the same"
        )
    controller = CrarController(
        control_model,
        parameters,
        plant_is_discrete=plant.time_step() > 0.0,
        obstacle_speeds=obstacle_speeds,
    )
    # A diagram's systems have names of their own; so a second robot can have one.
    name, number = controller.get_name(), 1
    while builder.HasSubsystemNamed(controller.get_name()):
        number += 1
        controller.set_name(f"{name}_{number}")
    builder.AddSystem(controller)
    builder.Connect(
        estimated_state or plant.get_state_output_port(*part),
        controller.get_input_port_estimated_state(),
    )
    builder.Connect(
        controller.get_output_port_actuation(), plant.get_actuation_input_port(*part)
    )
    return controller


def _position_names(plant: MultibodyPlant, *part: ModelInstanceIndex) -> str:
    names = plant.GetPositionNames(
        *part, add_model_instance_prefix=False, always_add_suffix=False
    )
    return ", ".join(names)


def _actuated(plant: MultibodyPlant, *part: ModelInstanceIndex) -> str:
    """The joints that actuators move, in the actuators' order, by their own names."""
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices(*part))
    return ", ".join(actuator.joint().name() for actuator in actuators)


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
        name: KeyframeTrajectory(name, frames)
        for name, frames in scenario.keyframes.items()
    }
    source = PoseTrajectorySource(model.layout, ways)
    return DesiredMotion(
        source.duration,
        source.at,
        lambda time: held[: model.n_p],
        lambda: PoseTrajectorySource(model.layout, ways),
        (lambda: ConstantVectorSource(held)) if model.n_p else None,
    )


def MakeCrarDiagram(
    scenario: Scenario, meshcat: Meshcat | None = None, setup: Setup | None = None
) -> Diagram:
    """Builds the whole diagram of a scenario.

    Where the robot stands, the controller runs on its own command ("commanded_motion"),
    which a "standing_controller" lets the robot on the floor follow; the logs are then
    those of "actuation" and "acceleration" of that one, too.

    Subsystems, by name: "plant", "scene_graph", "crar_controller",
    "desired_tasks", (if there are prescribed joints) "desired_prescribed" and (if there
    are any) "obstacles"; one "log_state", "log_desired_tasks" and "log_diagnostics" (of
    the controller), "log_obstacles"; with `meshcat` its visualiser. The plant asks its
    own scene for contact, from which filters leave out what the scenario does not want
    to touch. The default context starts at rest in a valid pose near the first target.

    Exported outputs: "state", "query", "desired_tasks" and every output of the
    controller. There are no inputs.

    Args:
        scenario: from `load_scenario`, or made in Python.
        meshcat: draws the robot while it moves; None for none.
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
    _lift_limits(plant, scenario.simulated_robot)
    law = None
    if scenario.standing is not None:
        friction = scenario.standing.friction
        law = StandingLaw(setup.simulated.plant, setup.simulated.description, friction)
        add_contact_ground(plant, scene_graph, description, friction, law.floor)
    plant.Finalize()
    if law is None and not scenario.simulated_robot.contact:
        _leave_out_contact(plant, scene_graph)
    plant.SetDefaultPositions(setup.start_positions)

    parameters, time_step = scenario.controller, plant.time_step()
    ticks = parameters.torque_ticks(time_step)
    period = parameters.torque_period_for(time_step)
    if law is not None:
        ticks, period = round(parameters.period / time_step), time_step
    measured = AddMeasurement(builder, plant, disturbances, period, ticks)
    logged = {"state": plant.get_state_output_port()}
    if law is None:
        controller = AddCrarController(
            builder,
            plant,
            scene_graph,
            model.description,
            model.tasks,
            parameters,
            control_model=model,
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
    if disturbances.pushes:
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
    if meshcat is not None:
        _draw(builder, scenario, meshcat, plant, scene_graph)

    builder.ExportOutput(plant.get_state_output_port(), "state")
    builder.ExportOutput(scene_graph.get_query_output_port(), "query")
    builder.ExportOutput(tasks, "desired_tasks")
    for i in range(controller.num_output_ports()):
        port = controller.get_output_port(i)
        builder.ExportOutput(port, port.get_name())
    diagram = builder.Build()
    diagram.set_name("crar")
    return diagram


def AddStandingController(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    law: StandingLaw,
    model: ControlModel,
    parameters: Parameters | None = None,
    *,
    estimated_state: OutputPort | None = None,
) -> tuple[CrarController, StandingController]:
    """Adds what keeps a plant's robot on its soles while its upper body follows tasks,
    and connects it.

    A `CrarController` moves a `CommandedMotion`, its own command, from the rest posture
    on. A `StandingController` lets the robot on the floor follow that. What remains to
    be connected are the first one's `desired_tasks` and `desired_prescribed`.

    Args:
        builder: of the diagram that owns the plant.
        plant: finalized, with the robot alone on a floor (`add_contact_ground`).
        law: of that robot.
        model: of the robot that stands still (`standing_description`), continuous.
        parameters: of the controller; by default `LookaheadParameters()`.
        estimated_state: port of the measured [q; v]; by default that of the plant.

    Raises:
        ModelError: the plant's joints are not those of the law or the model.
        ScenarioError: as of `AddCrarController`.
    """
    parameters = parameters or LookaheadParameters()
    parameters.validate()
    check_multiple("controller.period", parameters.period, plant.time_step())
    ours, theirs = _position_names(law.plant), _position_names(plant)
    if ours != theirs:
        raise ModelError(
            f"the plant has positions {theirs} but the standing law {ours}; they must "
            "be the same robot"
        )
    controller = builder.AddSystem(
        CrarController(model, parameters, plant_is_discrete=False)
    )
    motion = builder.AddSystem(
        CommandedMotion(model.rest_positions(), parameters.period)
    )
    standing = builder.AddSystem(StandingController(law, model.velocity_names))
    command = motion.get_output_port_state()
    acceleration = controller.get_output_port_desired_acceleration()
    state = estimated_state or plant.get_state_output_port()
    for source, port in (
        (command, controller.get_input_port_estimated_state()),
        (acceleration, motion.get_input_port_acceleration()),
        (state, standing.get_input_port_estimated_state()),
        (command, standing.get_input_port_commanded_state()),
        (acceleration, standing.get_input_port_commanded_acceleration()),
        (standing.get_output_port_actuation(), plant.get_actuation_input_port()),
    ):
        builder.Connect(source, port)
    return controller, standing


def _lift_limits(plant: MultibodyPlant, simulated: SimulatedRobot) -> None:
    """Takes off what would hide a violation, unless the scenario keeps it."""
    if not simulated.position_limits:
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            unlimited = np.full(joint.num_positions(), np.inf)
            joint.set_position_limits(-unlimited, unlimited)
    if not simulated.effort_limits:
        plant.RemoveAllJointActuatorEffortLimits()


def _leave_out_contact(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Filters every pair of shapes: contact would hide that the law let them touch."""
    frames = [
        plant.GetBodyFrameIdOrThrow(BodyIndex(i)) for i in range(plant.num_bodies())
    ]
    scene_graph.collision_filter_manager().Apply(
        CollisionFilterDeclaration().ExcludeWithin(GeometrySet(frames))
    )


def _draw(
    builder: DiagramBuilder,
    scenario: Scenario,
    meshcat: Meshcat,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
) -> None:
    """Adds Drake's visualiser of the robot; nothing goes to a network."""
    config = scenario.visualization
    draw_collision_shapes(plant, scene_graph)
    ApplyVisualizationConfig(
        config,
        builder,
        # A bus that goes nowhere. (A DrakeLcm of our own would have to outlive the
        # diagram, which does not keep it.)
        lcm_buses=ApplyLcmBusConfig({config.lcm_bus: None}, builder),
        plant=plant,
        scene_graph=scene_graph,
        meshcat=meshcat,
    )
    set_surroundings(meshcat)
