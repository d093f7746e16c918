"""The motion that a law commands, as it would be: the law runs on its own command."""

import numpy as np
from pydrake.systems.framework import (
    Context,
    DiscreteValues,
    InputPort,
    LeafSystem,
    OutputPort,
)


class CommandedMotion(LeafSystem):
    """Joints that do exactly what is commanded.

                        ┌─────────────────┐
        acceleration ──►│ CommandedMotion ├──► state
                        └─────────────────┘

    Input ports:
        acceleration: (n,) commanded, held for a period, as
            `CrarController.desired_acceleration` is [rad/s^2 or m/s^2].

    Output ports:
        state: (2 n,) [q; v] now. With a of the last tick, t seconds ago,
            q + t v + t^2 / 2 a and v + t a: a continuous plant under accelerations
            that are held.

    No input is fed through. At a tick a controller that takes this state as
    `estimated_state` solves at its unrestricted update, on the motion up to there; this
    system's discrete update comes after it, and takes the new accelerations. So the
    controller reads, at each tick, what assumption 2 of its theorem says
    (docs/theory/theorem.md) with a plant's step of 0: give it a control model with
    `time_step=0.0`, and make it with `plant_is_discrete=False`.
    """

    def __init__(self, start: np.ndarray, period: float) -> None:
        """
        Args:
            start: (n,) positions at first, at rest [rad or m].
            period: of the controller [s].
        """
        super().__init__()
        self.set_name("commanded_motion")
        self._n = n = len(start)
        self._port = self.DeclareVectorInputPort("acceleration", n)
        # q, v, a and the time of the last tick.
        state = self.DeclareDiscreteState(np.concatenate([start, np.zeros(2 * n + 1)]))
        self._output = self.DeclareVectorOutputPort(
            "state",
            2 * n,
            lambda context, output: output.SetFromVector(self._now(context)),
            {self.time_ticket(), self.discrete_state_ticket(state)},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._Update)

    def get_input_port_acceleration(self) -> InputPort:
        """Port (n,): commanded accelerations, held."""
        return self._port

    def get_output_port_state(self) -> OutputPort:
        """Port (2 n,): [q; v] now."""
        return self._output

    def SetStart(self, context: Context, positions: np.ndarray) -> None:
        """Puts the motion to rest at (n,) positions [rad or m]."""
        rest = np.zeros(2 * self._n)
        at = [positions, rest, [context.get_time()]]
        context.SetDiscreteState(np.concatenate(at))

    def _now(self, context: Context) -> np.ndarray:
        state = context.get_discrete_state_vector().value()
        q, v, a, then = np.split(state, [self._n, 2 * self._n, 3 * self._n])
        t = context.get_time() - then[0]
        return np.concatenate([q + t * v + 0.5 * t * t * a, v + t * a])

    def _Update(self, context: Context, values: DiscreteValues) -> None:
        next_state = [self._now(context), self._port.Eval(context)]
        values.set_value(np.concatenate([*next_state, [context.get_time()]]))
