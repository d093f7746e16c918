"""The safety filter as a Drake system."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    Context,
    InputPort,
    LeafSystem,
    OutputPort,
    State,
)

from crar_drake.errors import InputError
from crar_drake.law.obstacles import NO_PORT, Obstacles, checked_speeds
from crar_drake.law.safety_filter import (
    BRAKING,
    HOW,
    FilterMemory,
    SafetyFilter,
)

_HOW = [*HOW.values(), BRAKING]

# Ports of what is wanted, to the keyword of the filter.
_WANTED = {
    "desired_position": "q",
    "desired_velocity": "v",
    "desired_acceleration": "a",
}


class SafetyFilterSystem(LeafSystem):
    """Wanted joint commands in, safe ones out: `SafetyFilter` in a diagram.

                                ┌────────────────────┐
        desired_position ──────►│                    ├──► command
        desired_velocity ──────►│                    ├──► position_command
        desired_acceleration ──►│ SafetyFilterSystem ├──► acceleration_command
        desired_state ─────────►│                    ├──► diagnostics
        measured_state ────────►│                    │
        obstacles (if any) ────►│                    │
                                └────────────────────┘

    Notation: n joints, those of `filter.joint_names`, in that order: the plant's, of a
    robot whose base is fixed.

    Input ports:
        desired_position: (n,) at the end of the period [rad or m]. Of what is wanted
            connect one, or position and velocity.
        desired_velocity: (n,) [rad/s or m/s]; beside a position only where that is
            going.
        desired_acceleration: (n,) [rad/s^2 or m/s^2].
        desired_state: (2 n,) [q; v], the same as position and velocity.
        measured_state: (2 n,) [q; v] of the robot. Where it is connected, the filter
            begins there at its first step; later it is compared, see `SafetyFilter`.
        obstacles: (4 N,) [x; y; z; radius] of each of N spheres that move by
            themselves, now, in the world [m]. Only there if their speeds are given, and
            connected or not: where it is not, there are none.

    Output ports:
        command: (2 n,) [q; v] for the robot to be at a period after the step.
        position_command: (n,) its q.
        acceleration_command: (n,) held for the period.
        diagnostics: (7,) of the last step: how (0 nominal, 1 corrected, 2 scaled, 3
            braking), the share of the corrected step, the clearance of the braking
            path [m], whether the path it began with was clear (1) or not (0), the
            tracking error [rad or m], and which pair of links (in the order of the
            model's pairs) and which joint the wanted command ran into, -1 for none.
            `report(context)` has all of it by name.

    The filter steps once a period, at t = 0, period, 2 period, ..., on what is wanted
    at that instant, and its outputs hold until the next: no input is fed through. A
    robot that is to be at `command` when its period is over may interpolate from the
    one before, on a straight line. Before the first step the outputs are the start.

    All state is in the Context. The start is the rest posture, or what `SetStart` says.

    Attributes:
        filter: the `SafetyFilter` that computes; nothing of it changes.
    """

    def __init__(
        self, filter: SafetyFilter, obstacle_speeds: Sequence[float] = ()
    ) -> None:
        """
        Args:
            filter: of the robot, its period and limits.
            obstacle_speeds: (N,) bounds of the speeds of obstacles [m/s].

        Raises:
            InputError: `filter` is not a SafetyFilter, or a speed is not a number or
                negative.
        """
        super().__init__()
        if not isinstance(filter, SafetyFilter):
            raise InputError(f"give a SafetyFilter, not {type(filter).__name__}")
        self.set_name("safety_filter")
        self.filter = filter
        n = len(filter.joint_names)
        self._speeds = checked_speeds(self.get_name(), obstacle_speeds)
        self._inputs = {
            name: self.DeclareVectorInputPort(name, size)
            for name, size in (
                *((name, n) for name in _WANTED),
                ("desired_state", 2 * n),
                ("measured_state", 2 * n),
                ("obstacles", 4 * len(self._speeds)),
            )
            if size
        }
        memory = self.DeclareAbstractState(AbstractValue.Make(filter.start()))
        self._memory_index = int(memory)
        held = {self.abstract_state_ticket(memory)}
        self._outputs = {
            name: self.DeclareVectorOutputPort(name, size, self._MakeCalc(of), held)
            for name, size, of in (
                ("command", 2 * n, lambda memory: np.concatenate((memory.q, memory.v))),
                ("position_command", n, lambda memory: memory.q),
                ("acceleration_command", n, self._acceleration),
                ("diagnostics", 7, self._diagnostics),
            )
        }
        self._joints = {name: i for i, name in enumerate(filter.joint_names)}
        self._pairs = {pair: i for i, pair in enumerate(filter.model.pairs.names)}
        self.DeclarePeriodicUnrestrictedUpdateEvent(filter.period, 0.0, self._Update)

    def get_input_port_desired_position(self) -> InputPort:
        """Port (n,): wanted positions at the end of the period."""
        return self._inputs["desired_position"]

    def get_input_port_desired_velocity(self) -> InputPort:
        """Port (n,): wanted velocities."""
        return self._inputs["desired_velocity"]

    def get_input_port_desired_acceleration(self) -> InputPort:
        """Port (n,): wanted accelerations."""
        return self._inputs["desired_acceleration"]

    def get_input_port_desired_state(self) -> InputPort:
        """Port (2 n,): wanted [q; v] at the end of the period."""
        return self._inputs["desired_state"]

    def get_input_port_measured_state(self) -> InputPort:
        """Port (2 n,), may be left open: [q; v] of the robot now."""
        return self._inputs["measured_state"]

    def get_input_port_obstacles(self) -> InputPort:
        """Port (4 N,), may be left open: [x; y; z; radius] of each obstacle now.

        Raises:
            InputError: the system was made without `obstacle_speeds`.
        """
        if "obstacles" not in self._inputs:
            raise InputError(f"{self.get_name()}: {NO_PORT}")
        return self._inputs["obstacles"]

    def get_output_port_command(self) -> OutputPort:
        """Port (2 n,): [q; v] a period after the step."""
        return self._outputs["command"]

    def get_output_port_position_command(self) -> OutputPort:
        """Port (n,): positions a period after the step."""
        return self._outputs["position_command"]

    def get_output_port_acceleration_command(self) -> OutputPort:
        """Port (n,): accelerations, held for the period."""
        return self._outputs["acceleration_command"]

    def get_output_port_diagnostics(self) -> OutputPort:
        """Port (7,): see the class documentation."""
        return self._outputs["diagnostics"]

    def SetStart(self, context: Context, q, v=None) -> None:
        """Makes the filter begin at another state; as of `SafetyFilter.reset`.

        Args:
            context: of this system, `GetMyMutableContextFromRoot` of a diagram's.
            q: (n,) positions, or by name.
            v: (n,) velocities, or by name; by default none.

        Raises:
            InputError: a size is wrong, a joint unknown or a number none.
        """
        self._keep(context.get_mutable_state(), self.filter.start(q, v))

    def report(self, context: Context):
        """The `FilterReport` of the last step; None before the first.

        Args:
            context: of this system, `GetMyContextFromRoot` of a diagram's.
        """
        command = self._memory(context).command
        return None if command is None else command.report

    def _memory(self, context: Context) -> FilterMemory:
        return context.get_abstract_state(self._memory_index).get_value()

    def _keep(self, state: State, memory: FilterMemory) -> None:
        state.get_mutable_abstract_state(self._memory_index).set_value(memory)

    def _Update(self, context: Context, state: State) -> None:
        memory, n = self._memory(context), len(self._joints)
        given = {
            name: port.Eval(context)
            for name, port in self._inputs.items()
            if port.HasValue(context)
        }
        measured = given.pop("measured_state", None)
        obstacles = given.pop("obstacles", None)
        if obstacles is not None:
            obstacles = Obstacles.of_port(obstacles, self._speeds)
        if measured is not None:
            measured = measured[:n], measured[n:]
            if memory.command is None:
                memory = self.filter.start(*measured)
        wanted = {
            _WANTED[name]: value for name, value in given.items() if name in _WANTED
        }
        if "desired_state" in given:
            if wanted:
                raise InputError(
                    f"{self.get_name()}: desired_state is connected, and so are "
                    f"{', '.join(name for name in given if name in _WANTED)}: leave "
                    "one out"
                )
            wanted = {"q": given["desired_state"][:n], "v": given["desired_state"][n:]}
        if not wanted:
            raise InputError(
                f"{self.get_name()}: nothing is wanted: connect desired_position, "
                "desired_velocity, desired_acceleration or desired_state"
            )
        stepped = self.filter.solve(
            memory, **wanted, measured=measured, obstacles=obstacles
        )
        self._keep(state, stepped)

    def _MakeCalc(self, values: Callable[[FilterMemory], ArrayLike]):
        return lambda context, output: output.SetFromVector(
            values(self._memory(context))
        )

    def _acceleration(self, memory: FilterMemory) -> np.ndarray:
        return np.zeros(len(memory.q)) if memory.command is None else memory.command.a

    def _diagnostics(self, memory: FilterMemory) -> ArrayLike:
        if memory.command is None:
            return np.full(7, np.nan)
        report = memory.command.report
        return [
            _HOW.index(report.how),
            report.share,
            report.clearance,
            report.clear,
            report.tracking_error,
            self._pairs.get(report.pair, -1),
            self._joints.get(report.joint, -1),
        ]
