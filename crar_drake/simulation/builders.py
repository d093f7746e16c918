"""Builders: a robot and its controller in anybody's diagram."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain

from crar_drake.errors import ModelError, tell
from crar_drake.law.controller import CrarController
from crar_drake.law.parameters import LookaheadParameters, Parameters
from crar_drake.law.standing_controller import StandingController
from crar_drake.law.standing_law import StandingLaw
from crar_drake.robot.beside import add_robot_beside
from crar_drake.robot.description import (
    RobotDescription,
    find_frame,
    find_joint,
    load_robot_description,
)
from crar_drake.robot.joints import check_described_joints
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.simulation.border import Border, Instances
from crar_drake.simulation.scenario import check_multiple

# With Drake's default contact a robot stands at steps up to this; at twice it contact
# shakes it, and a heavier one is thrown to infinity [s].
LONGEST_STANDING_STEP = 2.5e-3


def AddRobot(
    plant: MultibodyPlant,
    robot: str | os.PathLike[str] | RobotDescription,
    *,
    prefix: str = "",
    X_WB: RigidTransform | None = None,
) -> Instances:
    """Adds a robot to a plant that is not finalized yet.

    All that its description says of it then is in the plant: its base is welded to the
    world (or, if it floats, placed there), the rest posture and the speed limits are
    those of its joints, its points are frames, and links that it does not watch against
    each other are left out of contact. The plant may hold other things, too, and the
    same robot once more, with another prefix.

    Args:
        plant: of `AddMultibodyPlantSceneGraph`; call `Finalize` afterwards.
        robot: the name of a shipped robot (`crar-drake show` tells them) or of one
            that `crar-drake import-robot` made, the path of a robot.yaml or of its
            folder, or a description made in Python.
        prefix: of its model instances' names: "left" makes "left::arm".
        X_WB: pose of its base in the world; by default that of the description.

    Returns:
        The robot's model instance, which `AddCrarController` asks for; a list of them
        where its model is several that move.

    Raises:
        ModelError: the plant is finalized or has no SceneGraph, there is no such
            robot, it is not imported yet, or its model cannot be parsed; there is a
            model instance of that name; or a rest posture cannot be in radians.
    """
    if plant.is_finalized():
        raise ModelError("the plant is finalized already; call AddRobot before it")
    if not plant.geometry_source_is_registered():
        raise ModelError(
            "the plant has no SceneGraph; make it by AddMultibodyPlantSceneGraph"
        )
    if X_WB is not None and not isinstance(X_WB, RigidTransform):
        raise ModelError(f"X_WB is a RigidTransform, not {type(X_WB).__name__}")
    if not isinstance(robot, RobotDescription):
        robot = load_robot_description(robot)
    robot, instances = add_robot_beside(plant, robot, prefix, X_WB)
    check_described_joints(plant, robot)
    for name, position in robot.rest_posture.items():
        find_joint(plant, name).set_default_positions([position])
    for name, limit in robot.velocity_limits.items():
        find_joint(plant, name).set_velocity_limits([-limit], [limit])
    for point, name in robot.task_frames.items():
        frame = find_frame(plant, name)
        instance = frame.model_instance()
        if not plant.HasFrameNamed(point, instance):
            placed = FixedOffsetFrame(point, frame, RigidTransform(), instance)
            plant.AddFrame(placed)
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    actuated = {actuator.model_instance() for actuator in actuators}
    moving = [i for i in instances if i in actuated]
    return moving[0] if len(moving) == 1 else moving


def AddCrarController(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    tasks: Sequence[Task],
    parameters: Parameters | None = None,
    *,
    model_instance: Instances | None = None,
    watch: Sequence[Sequence[str]] | None = None,
    prescribed: Sequence[str] = (),
    estimated_state: OutputPort | None = None,
    obstacle_speeds: Sequence[float] = (),
    strict: bool = False,
) -> CrarController:
    """Adds a controller of a robot in a plant and connects state and actuation.

    It computes with a plant of its own, made from `plant` as it is now: the robot, what
    hangs on it (joints of a gripper count as locked at their default positions, and
    while one is elsewhere, nothing is promised), what is welded to the world; the same
    gravity and time step. Its nominal posture is that of the default positions.

    What remains to be connected are `desired_tasks` and, if there are prescribed
    joints, `desired_prescribed`; see `CrarController` for what they carry.

    Names of links, frames and joints may be scoped ("arm::hand"); those that are not
    are looked for in the robot first.

    Args:
        builder: of the diagram that owns the plant.
        plant: finalized.
        scene_graph: where the plant's geometry is registered.
        tasks: what is tracked: `position_tasks` and the like.
        parameters: `PaperParameters` or `LookaheadParameters`; by default these.
        model_instance: the robot, from `AddRobot` or `Parser.AddModels`; several for
            one controller of them all. By default what alone has actuators.
        watch: pairs of links to keep apart, [["hand", "table"], ...]. By default all
            whose shapes may touch by the plant's collision filters, of the robot with
            itself and with what stands in the world, less those that meet at rest, in
            the plant's order of links; `model.pairs.names` tells them.
        prescribed: joints of the robot that something else moves, as
            `desired_prescribed` says.
        estimated_state: port of the measured [q; v]; by default that of the plant, or
            of the model instance.
        obstacle_speeds: see `CrarController`.
        strict: whether what is warned of is an error.

    Raises:
        ModelError: the plant is not finalized, a name is not in it, or an argument of
            another type; its actuation is connected already; or the robot cannot be
            taken: its base floats, something that moves carries it, a joint has no
            actuator, or there are constraints between joints; or no pair is watched.
        ScenarioError: a parameter is out of range, or the control period is not a
            multiple of the plant's time step.

    Warns:
        CrarWarning: of what a user has to know, each once: pairs that meet at rest,
            shapes that can touch and are not watched, pairs that cannot be examined,
            another controller's robot within reach, arguments without effect.
    """
    parameters = LookaheadParameters() if parameters is None else parameters
    for name, given, kind in (
        ("builder", builder, DiagramBuilder),
        ("parameters", parameters, Parameters),
    ):
        if not isinstance(given, kind):
            raise ModelError(f"{name} cannot be a {type(given).__name__}")
    parameters.validate()
    border = Border(plant, scene_graph, model_instance, strict)
    model = border.model(tasks, watch, prescribed)
    if np.size(obstacle_speeds) and not isinstance(parameters, LookaheadParameters):
        border.tell(
            "obstacle_speeds have no effect: the paper's law takes no notice of "
            "obstacles that move; take LookaheadParameters, or leave them out"
        )
    for other in builder.GetSystems():
        theirs = getattr(other, "border", None)
        if theirs is not None and border.can_touch(theirs):
            line = (
                f"{theirs.name} and {border.name} can touch, and their controllers do "
                "not see each other: give both to one controller as model_instance, or "
                "exclude their contact by a collision filter"
            )
            border.tell(line)
            theirs.said.append(line)
    return connect_controller(
        *(builder, plant, model, parameters),
        estimated_state=estimated_state,
        obstacle_speeds=obstacle_speeds,
        strict=strict,
    )


def MakeControlModel(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    tasks: Sequence[Task] = (),
    *,
    model_instance: Instances | None = None,
    watch: Sequence[Sequence[str]] | None = None,
    prescribed: Sequence[str] = (),
    strict: bool = False,
) -> ControlModel:
    """What `AddCrarController` computes with; of a `SafetyFilter` it needs no tasks.

    Args:
        plant, scene_graph, tasks, model_instance, watch, prescribed, strict: as of
            `AddCrarController`; so are errors and warnings.
    """
    border = Border(plant, scene_graph, model_instance, strict)
    return border.model(tasks, watch, prescribed)


def connect_controller(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    model: ControlModel,
    parameters: Parameters,
    *,
    estimated_state: OutputPort | None = None,
    obstacle_speeds: Sequence[float] = (),
    strict: bool = False,
) -> CrarController:
    """Adds a controller that computes with a model, and connects it to a plant.

    Args:
        model: of the robot in the plant, its time step included.
        estimated_state, obstacle_speeds, strict: as of `AddCrarController`.

    Raises:
        ModelError: the robot's actuation is connected already, or the model has
            another time step than the plant.
        ScenarioError: as of `AddCrarController`.
    """
    _check_time_step(model, plant.time_step(), "that of the plant")
    check_multiple("controller.period", parameters.period, plant.time_step())
    instances = () if model.border is None else model.border.instances
    every = map(ModelInstanceIndex, range(plant.num_model_instances()))
    alone = not any(plant.num_positions(i) and i not in instances for i in every)
    parts = [(i,) for i in instances if plant.num_actuators(i) and not alone] or [()]
    ports = [plant.get_actuation_input_port(*of) for of in parts]
    if any(map(builder.IsConnectedOrExported, ports)):
        raise ModelError(
            "the robot's actuation is connected already, to another controller perhaps"
        )
    controller = CrarController(
        model,
        parameters,
        obstacle_speeds=obstacle_speeds,
        strict=strict,
    )
    # A diagram's systems have names of their own; so a second robot can have one.
    name, number = controller.get_name(), 1
    while builder.HasSubsystemNamed(controller.get_name()):
        number += 1
        controller.set_name(f"{name}_{number}")
    builder.AddSystem(controller)
    if controller.HasInputPort("locked_positions"):
        of = builder, [*model.border.locked], plant.get_state_output_port()
        builder.Connect(_picked(*of), controller.GetInputPort("locked_positions"))
    torque = controller.get_output_port_actuation()
    if len(parts) == 1:
        state = plant.get_state_output_port(*parts[0])
        builder.Connect(torque, ports[0])
    else:
        # In the plant's order, which is the control plant's, too.
        u, x = np.arange(plant.num_actuators()), np.arange(plant.num_multibody_states())
        q, v = np.split(x, [plant.num_positions()])
        of_x = [plant.GetPositionsFromArray(*of, q) for of in parts]
        of_x += [plant.GetVelocitiesFromArray(*of, v) for of in parts]
        of_u = [plant.GetActuationFromArray(*of, u) for of in parts]
        ours, torques = (np.sort(np.concatenate(each)) for each in (of_x, of_u))
        state = _picked(builder, ours, plant.get_state_output_port())
        for places, port in zip(of_u, ports, strict=True):
            own = np.searchsorted(torques, places)
            builder.Connect(_picked(builder, own, torque), port)
    builder.Connect(
        estimated_state or state, controller.get_input_port_estimated_state()
    )
    return controller


def _check_time_step(model: ControlModel, needed: float, why: str) -> None:
    if (given := model.plant.time_step()) != needed:
        raise ModelError(
            f"the control model has a time step of {given:g} s; make it with "
            f"time_step={needed:g}, {why}"
        )


def _picked(
    builder: DiagramBuilder, places: Sequence[int], port: OutputPort
) -> OutputPort:
    """The port of some entries of another one."""
    gain = builder.AddSystem(MatrixGain(np.eye(port.size())[np.array(places, int)]))
    builder.Connect(port, gain.get_input_port())
    return gain.get_output_port()


def AddStandingController(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    law: StandingLaw,
    model: ControlModel,
    parameters: Parameters | None = None,
    *,
    model_instance: ModelInstanceIndex | None = None,
    estimated_state: OutputPort | None = None,
    strict: bool = False,
) -> tuple[CrarController, StandingController]:
    """Adds what keeps a plant's robot on its soles while its upper body follows tasks,
    and connects it.

    A `CrarController` moves a command, from the rest posture on, and takes that for the
    robot's state. A `StandingController` lets the robot on the floor follow the
    command. What remains to be connected are the first one's `desired_tasks` and
    `desired_prescribed`.

    Args:
        builder: of the diagram that owns the plant.
        plant: finalized, with the robot on a floor (`add_contact_ground`).
        law: of that robot.
        model: of the robot that stands still (`standing_description`), continuous.
        parameters: of the controller; by default `LookaheadParameters()`.
        model_instance: the robot, if other things in the plant move.
        estimated_state: port of the measured [q; v]; by default that of the plant, or
            of the model instance.
        strict: whether what is warned of is an error.

    Raises:
        ModelError: the plant's joints are not those of the law or the model, or the
            model is not continuous.
        ScenarioError: as of `AddCrarController`.

    Warns:
        CrarWarning: the plant's time step is longer than contact is known to bear.
    """
    parameters = parameters or LookaheadParameters()
    parameters.validate()
    _check_time_step(model, 0.0, "continuous, for a command has no time step")
    check_multiple("controller.period", parameters.period, plant.time_step())
    part = () if model_instance is None else (model_instance,)
    ours, theirs = (
        each.GetPositionNames(*of, add_model_instance_prefix=False)
        for each, of in ((law.plant, ()), (plant, part))
    )
    if ours != theirs:
        raise ModelError(
            f"the plant has positions {', '.join(theirs)} but the standing law "
            f"{', '.join(ours)}; they must be the same robot (model_instance names it "
            "in a plant with more)"
        )
    if plant.time_step() > LONGEST_STANDING_STEP:
        tell(
            f"the plant's time step of {plant.time_step():g} s: contact under a robot "
            f"that stands may explode; take at most {LONGEST_STANDING_STEP:g} s",
            strict,
        )
    controller = builder.AddSystem(CrarController(model, parameters, strict=strict))
    standing = builder.AddSystem(StandingController(law, model, parameters.period))
    command = standing.get_output_port_commanded_state()
    acceleration = controller.get_output_port_desired_acceleration()
    state = estimated_state or plant.get_state_output_port(*part)
    torque = standing.get_output_port_actuation()
    for source, port in (
        (command, controller.get_input_port_estimated_state()),
        (state, standing.get_input_port_estimated_state()),
        (acceleration, standing.get_input_port_commanded_acceleration()),
        (torque, plant.get_actuation_input_port(*part)),
    ):
        builder.Connect(source, port)
    return controller, standing
