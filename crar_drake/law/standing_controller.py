"""The standing law as a Drake system, with the command that its robot follows."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    InputPort,
    LeafSystem,
    OutputPort,
    ValueProducer,
)

from crar_drake.errors import ModelError
from crar_drake.law.measured import check_finite
from crar_drake.law.standing_law import StandingLaw, StandingStep
from crar_drake.robot.model import ControlModel


@dataclass
class _Solve:
    """What is cached: contexts to compute in, which no copy shares, and the answer."""

    contexts: list[Context]
    answer: StandingStep | None = None


class StandingController(LeafSystem):
    """Keeps a robot on its soles while its upper body follows a command.

                                  ┌────────────────────┐
        estimated_state ─────────►│                    ├──► commanded_state
        commanded_acceleration ──►│ StandingController ├──► actuation
                                  │                    ├──► acceleration
                                  │                    ├──► ground_forces
                                  │                    ├──► status
                                  └────────────────────┘

    The command is a motion of the n joints that does exactly what the accelerations
    say, from the rest posture on; `StandingLaw` has the law by which the robot follows.

    Input ports:
        estimated_state: (nq + nv,) [q; v] of the plant, whose root floats.
        commanded_acceleration: (n,) of the joints, in the order of the control model,
            held for a period, as `CrarController.desired_acceleration` is; legs rest.

    Output ports:
        commanded_state: (2 n,) [q; v] of the command now. With a of the last tick, t
            seconds ago, q + t v + t^2 / 2 a and v + t a: a continuous plant under
            accelerations that are held. No input is fed through to it. At a tick a
            controller that takes it as `estimated_state` solves at its unrestricted
            update, on the motion up to there; the discrete update here comes after
            that, and takes the new accelerations. So the controller reads, at each
            tick, what assumption 2 of its theorem says (docs/theory/theorem.md) with a
            plant's step of 0: give it a control model with `time_step=0.0`.
        actuation: (nu,) efforts in the plant's actuator order [Nm or N]; those of a
            robot that has fallen just brake its joints.
        acceleration: (nv,) of the plant, as planned [rad/s^2, m/s^2].
        ground_forces: (3 C,) planned at each corner of the soles, in the world [N].
        status: (2,) what effort limits took off at most [Nm or N]; 1 once the robot has
            fallen, else 0.

    Limits: all joints have one velocity and a motor; legs with fewer than six joints
    hold their soles as well as they can; the floor is level; q and v are measured.
    """

    def __init__(self, law: StandingLaw, model: ControlModel, period: float) -> None:
        """
        Args:
            law: of the plant.
            model: of the robot that stands still, by which its command is controlled.
            period: in which accelerations are held [s].

        Raises:
            ModelError: the command lacks a joint of the plant.
        """
        super().__init__()
        self.set_name("standing_controller")
        self.law = law
        names = list(model.velocity_names)
        missing = [name for name in law.joint_names if name not in names]
        if missing:
            raise ModelError(
                f"the command of a robot that stands lacks {', '.join(missing)}; it "
                "needs all joints of the plant"
            )
        self._places = [names.index(name) for name in law.joint_names]
        plant, self._n = law.plant, len(names)
        nq, nv = plant.num_positions(), plant.num_velocities()
        self._state_port = self.DeclareVectorInputPort("estimated_state", nq + nv)
        self._acceleration_port = self.DeclareVectorInputPort(
            "commanded_acceleration", self._n
        )
        # q, v, a and the time of the last tick.
        start = [model.rest_positions(), np.zeros(2 * self._n + 1)]
        command = self.DeclareDiscreteState(np.concatenate(start))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._Update)

        def allocate() -> AbstractValue:
            contexts = [plant.CreateDefaultContext() for _ in range(2)]
            return AbstractValue.Make(_Solve(contexts))

        of_command = {self.time_ticket(), self.discrete_state_ticket(command)}
        of_all = of_command | {self.all_input_ports_ticket()}
        self._cache = self.DeclareCacheEntry(
            "solve", ValueProducer(allocate=allocate, calc=self._Solve), of_all
        )
        self._commanded = self.DeclareVectorOutputPort(
            "commanded_state",
            2 * self._n,
            lambda context, output: output.SetFromVector(self._Command(context)),
            of_command,
        )
        corners = sum(len(corners) for corners in law.corners_at_rest)
        self._outputs = {
            name: self.DeclareVectorOutputPort(
                name, size, self._MakeCalc(values), of_all
            )
            for name, size, values in (
                ("actuation", plant.num_actuated_dofs(), lambda x: x.efforts),
                ("acceleration", nv, lambda x: x.acceleration),
                ("ground_forces", 3 * corners, lambda x: x.forces.ravel()),
                ("status", 2, lambda x: [x.clipped, float(x.fell)]),
            )
        }

    def get_input_port_estimated_state(self) -> InputPort:
        """Port (nq + nv,): measured [q; v]."""
        return self._state_port

    def get_input_port_commanded_acceleration(self) -> InputPort:
        """Port (n,): commanded accelerations of the joints, held."""
        return self._acceleration_port

    def get_output_port_commanded_state(self) -> OutputPort:
        """Port (2 n,): commanded [q; v] of the joints now."""
        return self._commanded

    def get_output_port_actuation(self) -> OutputPort:
        """Port (nu,): efforts [Nm or N]."""
        return self._outputs["actuation"]

    def get_output_port_acceleration(self) -> OutputPort:
        """Port (nv,): accelerations of the plant, as planned."""
        return self._outputs["acceleration"]

    def _Command(self, context: Context) -> np.ndarray:
        n, state = self._n, context.get_discrete_state_vector().value()
        q, v, a, then = np.split(state, [n, 2 * n, 3 * n])
        t = context.get_time() - then[0]
        return np.concatenate([q + t * v + 0.5 * t * t * a, v + t * a])

    def _Update(self, context: Context, values: DiscreteValues) -> None:
        next_state = [self._Command(context), self._acceleration_port.Eval(context)]
        values.set_value(np.concatenate([*next_state, [context.get_time()]]))

    def _MakeCalc(self, values: Callable[[StandingStep], np.ndarray]):
        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(values(self._cache.Eval(context).answer))

        return calc

    def _Solve(self, context: Context, value: AbstractValue) -> None:
        state = self._state_port.Eval(context)
        check_finite(
            f"input port estimated_state of {self.get_name()}",
            state,
            context.get_time(),
        )
        q, v = np.split(self._Command(context), 2)
        a = self._acceleration_port.Eval(context)
        command = tuple(x[self._places] for x in (q, v, a))
        solve = value.get_mutable_value()
        solve.answer = self.law.step(*solve.contexts, state, command)
