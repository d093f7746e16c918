"""What a real robot does to a controller: wrong masses, noise, delay, pushes."""

# YAML loading reads the types of the fields, so no postponed annotations here.
from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, SpatialInertia
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    LeafSystem,
    OutputPort,
    State,
)

from crar_drake.errors import ScenarioError, check_vector
from crar_drake.law.tasks import TaskLayout
from crar_drake.robot.description import find_frame, quaternion_starts


@dataclass
class Push:
    """A constant force on a frame's origin, for a while."""

    frame: str = ""  # task frame of the description, or any frame of the plant
    force: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # in W [N]
    start: float = 0.0  # when it begins [s]
    duration: float = 0.0  # how long it lasts [s]

    def acts(self, time: float) -> bool:
        """Whether it does at a time [s]."""
        return self.start <= time < self.start + self.duration


@dataclass
class TargetJump:
    """All task positions are displaced by a step, for a while."""

    offset: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # in W [m]
    start: float = 0.0  # when it begins [s]
    duration: float = 0.0  # how long it lasts [s]; 0 means there is no jump


@dataclass
class Disturbances:
    """How the simulated robot differs from what the controller believes."""

    mass_scale: float = 1.0  # factor on all masses and inertias of the simulated plant
    position_noise: float = 0.0  # standard deviation of measured positions [rad or m]
    velocity_noise: float = 0.0  # of measured velocities [rad/s or m/s]
    noise_seed: int = 0  # of both noises
    delay_periods: int = 0  # control periods by which the measured state is late
    pushes: list[Push] = field(default_factory=list)  # forces on the robot
    target_jump: TargetJump = field(default_factory=TargetJump)  # a step of targets

    def validate(self) -> None:
        """Raises ScenarioError where a field is out of its range."""
        if not 0.0 < self.mass_scale < np.inf:
            raise ScenarioError(
                f"disturbances.mass_scale: {self.mass_scale} must be positive"
            )
        numbers = {
            name: getattr(self, name) for name in ("position_noise", "velocity_noise")
        }
        numbers |= {
            f"{what}.{name}": getattr(event, name)
            for what, event in [
                ("target_jump", self.target_jump),
                *((f"push on {push.frame}", push) for push in self.pushes),
            ]
            for name in ("start", "duration")
        }
        for name, value in numbers.items():
            if not 0.0 <= value < np.inf:
                raise ScenarioError(
                    f"disturbances.{name}: {value} must be finite and not negative"
                )
        for name in ("noise_seed", "delay_periods"):
            value = getattr(self, name)
            if value != int(value) or value < 0:
                raise ScenarioError(
                    f"disturbances.{name}: {value} must be a whole number, not negative"
                )
        vectors = [("target_jump.offset", self.target_jump.offset)]
        vectors += [
            (f"push on {push.frame}: force", push.force) for push in self.pushes
        ]
        for name, vector in vectors:
            check_vector(f"disturbances.{name}", vector)


def applied_force(
    plant: MultibodyPlant, task_frames: dict[str, str], push: Push
) -> ExternallyAppliedSpatialForce:
    """The force of a push, for a plant's applied_spatial_force port.

    Args:
        plant: finalized.
        push: whose frame is in the plant.

    Raises:
        ModelError: there is no such frame.
    """
    frame = find_frame(plant, task_frames.get(push.frame, push.frame))
    force = ExternallyAppliedSpatialForce()
    force.body_index = frame.body().index()
    force.p_BoBq_B = frame.GetFixedPoseInBodyFrame().translation()
    force.F_Bq_W = SpatialForce(np.zeros(3), np.array(push.force))
    return force


class PushSource(LeafSystem):
    """Emits the pushes that act now, for a plant's applied_spatial_force port.

    They are a parameter of the context, to which more can be added.
    """

    def __init__(
        self, plant: MultibodyPlant, task_frames: dict[str, str], pushes: list[Push]
    ) -> None:
        """
        Raises:
            ModelError: there is no such frame.
        """
        super().__init__()
        self.set_name("pushes")
        forces = [(push, applied_force(plant, task_frames, push)) for push in pushes]
        self._pushes = self.DeclareAbstractParameter(AbstractValue.Make(forces))
        self.DeclareAbstractOutputPort(
            "applied_spatial_force",
            lambda: Value[list[ExternallyAppliedSpatialForce]](),
            self._Calc,
            {self.time_ticket(), self.all_parameters_ticket()},
        )

    def add(
        self, context: Context, push: Push, force: ExternallyAppliedSpatialForce
    ) -> None:
        """Lets one more push act, in a context of the system.

        Args:
            push: when it acts; those that were over before it are dropped.
            force: of `applied_force`.
        """
        pushes = context.get_mutable_abstract_parameter(int(self._pushes))
        kept = [
            (each, its)
            for each, its in pushes.get_value()
            if each.start + each.duration > push.start
        ]
        pushes.set_value([*kept, (push, force)])

    def _Calc(self, context: Context, output: AbstractValue) -> None:
        time = context.get_time()
        pushes = context.get_abstract_parameter(int(self._pushes)).get_value()
        output.set_value([force for push, force in pushes if push.acts(time)])


class TargetStep(LeafSystem):
    """Adds a TargetJump to [x_d; v_d; a_d]: input and output (layout.size,)."""

    def __init__(self, layout: TaskLayout, jump: TargetJump) -> None:
        super().__init__()
        self.set_name("target_jump")
        self._jump = jump
        self._offset = np.zeros(layout.size)
        self._offset[layout.position_entries] = jump.offset
        port = self.DeclareVectorInputPort("desired_tasks", layout.size)
        self.DeclareVectorOutputPort(
            "displaced_tasks",
            layout.size,
            self._Calc,
            {self.time_ticket(), self.input_port_ticket(port.get_index())},
        )

    def _Calc(self, context: Context, output: BasicVector) -> None:
        since = context.get_time() - self._jump.start
        active = 0.0 <= since < self._jump.duration
        output.SetFromVector(
            self.EvalVectorInput(context, 0).value() + (active * self._offset)
        )


class Measurement(LeafSystem):
    """A plant's state as it is measured: some periods late, and noisy.

    Input port "state" and output port "measured_state", (size,) each. The state is
    stored in an unrestricted update, simultaneously with a discrete plant's step:
    a discrete update would come after it and store the next state.
    """

    def __init__(
        self, deviations: np.ndarray, delay_periods: int, period: float, seed: int
    ) -> None:
        """
        Args:
            deviations: (size,) standard deviations of the noise.
            delay_periods: how late the output is, in these periods.
            period: between measurements [s].
            seed: of the noise, which is a function of seed and time.
        """
        super().__init__()
        self.set_name("measurement")
        self._deviations, self._period, self._seed = deviations, period, seed
        size = len(deviations)
        self._input = self.DeclareVectorInputPort("state", size)
        sources = {self.time_ticket(), self._input.ticket()}
        self._buffer = None
        if delay_periods:
            self._buffer = self.DeclareDiscreteState(delay_periods * size)
            sources = {self.time_ticket(), self.discrete_state_ticket(self._buffer)}
            self.DeclareInitializationUnrestrictedUpdateEvent(self._Fill)
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._Store)
        self.DeclareVectorOutputPort("measured_state", size, self._Calc, sources)

    def _Fill(self, context: Context, state: State) -> None:
        buffer = state.get_mutable_discrete_state().get_mutable_vector(self._buffer)
        x = self._input.Eval(context)
        buffer.SetFromVector(np.tile(x, buffer.size() // len(x)))

    def _Store(self, context: Context, state: State) -> None:
        buffer = state.get_mutable_discrete_state().get_mutable_vector(self._buffer)
        x = self._input.Eval(context)
        buffer.SetFromVector(np.concatenate([buffer.value()[len(x) :], x]))

    def _Calc(self, context: Context, output: BasicVector) -> None:
        if self._buffer is None:
            x = self._input.Eval(context)
        else:
            buffer = context.get_discrete_state(self._buffer).value()
            x = buffer[: len(self._deviations)]
        tick = round(context.get_time() / self._period)
        noise = np.random.default_rng([self._seed, tick]).normal(size=len(x))
        output.SetFromVector(x + self._deviations * noise)


def AddMeasurement(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    disturbances: Disturbances,
    period: float,
    per_control_period: int = 1,
) -> OutputPort:
    """Adds what lies between the plant's state and the controller; the port of that.

    Args:
        builder: of the diagram that owns the plant.
        plant: finalized.
        period: between measurements [s].
        per_control_period: measurements in a control period, the delay's unit.
    """
    time_step = plant.time_step()
    if time_step and period != time_step:
        # As the controller does: a tick just after the plant's step, by rounding,
        # would store the next state.
        period *= 1.0 - 4e-15
    port = plant.get_state_output_port()
    of_positions = np.full(plant.num_positions(), disturbances.position_noise)
    for start in quaternion_starts(plant):
        # A turn by an angle changes a quaternion by half of it.
        of_positions[start : start + 4] *= 0.5
    deviations = np.concatenate(
        [of_positions, np.full(plant.num_velocities(), disturbances.velocity_noise)]
    )
    delay = disturbances.delay_periods * per_control_period
    if not deviations.any() and not delay:
        return port
    measurement = builder.AddSystem(
        Measurement(deviations, delay, period, disturbances.noise_seed)
    )
    builder.Connect(port, measurement.get_input_port())
    return measurement.get_output_port()


def ScaleMasses(plant: MultibodyPlant, context: Context, scale: float) -> None:
    """Multiplies all masses and inertias of a plant, in one context.

    Args:
        plant: finalized.
        scale: factor; the centres of mass stay.
    """
    for instance in range(plant.num_model_instances()):
        for index in plant.GetBodyIndices(ModelInstanceIndex(instance)):
            body = plant.get_body(index)
            if index == plant.world_body().index():
                continue
            M_B = body.CalcSpatialInertiaInBodyFrame(context)
            if M_B.get_mass() > 0.0:
                body.SetSpatialInertiaInBodyFrame(
                    context,
                    SpatialInertia(
                        scale * M_B.get_mass(), M_B.get_com(), M_B.get_unit_inertia()
                    ),
                )
