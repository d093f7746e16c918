"""The robot that a filter for teleoperation moves: what the control law says, done."""

from __future__ import annotations

import numpy as np

from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.step import Solution
from crar_drake.errors import ScenarioError
from crar_drake.robot.model import ControlModel


class SafeMotion:
    """A control law in a loop with its own prediction.

    The state is the one that the law commanded last, so that what
    [the theorem](docs/lookahead.md) says of the exact model holds of the commands,
    whatever the targets are. Prescribed joints stand still.

    Attributes:
        model, law: of the robot.
        q, v: (nq,), (nv,) the state.
    """

    def __init__(self, model: ControlModel, parameters: CrarParameters) -> None:
        """
        Args:
            model: of a plant whose time step is the control period.
            parameters: gains; the constraints must be those that hold by proof.

        Raises:
            ScenarioError: they are others, or a parameter is out of range.
        """
        if parameters.constraints != "lookahead":
            raise ScenarioError(
                f"controller.constraints: {parameters.constraints!r} lets violations "
                "happen; what moves a robot by hand needs lookahead"
            )
        if parameters.lookahead.lost_target != "brake":
            raise ScenarioError(
                "controller.lookahead.lost_target: "
                f"{parameters.lookahead.lost_target!r}: targets that come over a "
                "network get lost, and then the robot is to brake"
            )
        self.model, self.law = model, ControlLaw(model, parameters)
        self.q = model.rest_positions()
        self.v = np.zeros(model.plant.num_velocities())
        self._still = model.prescribed_at(self.q)
        self._workspace = model.MakeWorkspace()
        self._warm_up()

    def where(self) -> np.ndarray:
        """(layout.size,) [x; 0; 0] of the tasks' points now."""
        return self.model.tasks_at(self.q, self._workspace)

    def advance(self, tasks: np.ndarray) -> Solution:
        """One control step; the state is then that of its `position_command`.

        Args:
            tasks: (layout.size,) targets; NaN where there are none.
        """
        solution = self.law.step(self.q, self.v, tasks, self._still)
        self.q, self.v = np.split(solution.position_command, [len(self.q)])
        return solution

    def _warm_up(self) -> None:
        """Some steps that leave nothing behind: whatever is compiled, or read from the
        cache, at its first call, is so before somebody waits for it."""
        self.law.compile()
        state = self.q, self.v
        there = self.where()
        there[: self.model.layout.size_x] += 0.01
        for tasks in (there, there, np.full_like(there, np.nan), there):
            self.advance(tasks)
        self.q, self.v = state
        self.law.reset()
