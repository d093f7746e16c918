"""The standing law as a Drake system."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    InputPort,
    LeafSystem,
    OutputPort,
    ValueProducer,
)

from crar_drake.errors import ModelError
from crar_drake.law.records import check_finite
from crar_drake.law.standing_law import StandingLaw, StandingStep


@dataclass
class _Solve:
    """What is cached: contexts to compute in, which no copy shares, and the answer."""

    contexts: list[Context]
    answer: StandingStep | None = None


class StandingController(LeafSystem):
    """Keeps a robot on its soles while its upper body follows a command.

                                  ┌────────────────────┐
        estimated_state ─────────►│                    ├──► actuation
        commanded_state ─────────►│ StandingController ├──► acceleration
        commanded_acceleration ──►│                    ├──► ground_forces
                                  │                    ├──► status
                                  └────────────────────┘

    Control law and notation: `StandingLaw`.

    Input ports:
        estimated_state: (nq + nv,) [q; v] of the plant, whose root floats.
        commanded_state: (2 n,) [q; v] of the joints alone, in the order that
            `commanded_names` gave; legs rest.
        commanded_acceleration: (n,) of the same joints.

    Output ports, all of one solve on the inputs as they are, and without state:
        actuation: (nu,) efforts in the plant's actuator order [Nm or N]; those of a
            robot that has fallen just brake its joints.
        acceleration: (nv,) of the plant, as planned [rad/s^2, m/s^2].
        ground_forces: (3 C,) planned at each corner of the soles, in the world [N].
        status: (2,) what effort limits took off at most [Nm or N]; 1 once the robot has
            fallen, else 0.

    Limits: all joints have one velocity and a motor; legs with fewer than six joints
    hold their soles as well as they can; the floor is level; q and v are measured.
    """

    def __init__(self, law: StandingLaw, commanded_names: Sequence[str]) -> None:
        """
        Args:
            law: of the plant.
            commanded_names: (n,) joints of the two inputs with the command.

        Raises:
            ModelError: the command lacks a joint of the plant.
        """
        super().__init__()
        self.set_name("standing_controller")
        self.law = law
        missing = [name for name in law.joint_names if name not in commanded_names]
        if missing:
            raise ModelError(
                f"the command of a robot that stands lacks {', '.join(missing)}; it "
                "needs all joints of the plant"
            )
        names = list(commanded_names)
        self._places = [names.index(name) for name in law.joint_names]
        plant, n = law.plant, len(names)
        nq, nv = plant.num_positions(), plant.num_velocities()
        self._state_port = self.DeclareVectorInputPort("estimated_state", nq + nv)
        self._command_port = self.DeclareVectorInputPort("commanded_state", 2 * n)
        self._acceleration_port = self.DeclareVectorInputPort(
            "commanded_acceleration", n
        )

        def allocate() -> AbstractValue:
            contexts = [plant.CreateDefaultContext() for _ in range(2)]
            return AbstractValue.Make(_Solve(contexts))

        self._cache = self.DeclareCacheEntry(
            "solve",
            ValueProducer(allocate=allocate, calc=self._Solve),
            {self.all_input_ports_ticket()},
        )
        corners = sum(len(corners) for corners in law.corners_at_rest)
        self._outputs = {
            name: self.DeclareVectorOutputPort(
                name, size, self._MakeCalc(values), {self.all_input_ports_ticket()}
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

    def get_input_port_commanded_state(self) -> InputPort:
        """Port (2 n,): commanded [q; v] of the joints."""
        return self._command_port

    def get_input_port_commanded_acceleration(self) -> InputPort:
        """Port (n,): their commanded accelerations."""
        return self._acceleration_port

    def get_output_port_actuation(self) -> OutputPort:
        """Port (nu,): efforts [Nm or N]."""
        return self._outputs["actuation"]

    def get_output_port_acceleration(self) -> OutputPort:
        """Port (nv,): accelerations of the plant, as planned."""
        return self._outputs["acceleration"]

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
        q, v = np.split(self._command_port.Eval(context), 2)
        a = self._acceleration_port.Eval(context)
        command = tuple(x[self._places] for x in (q, v, a))
        solve = value.get_mutable_value()
        solve.answer = self.law.step(*solve.contexts, state, command)
