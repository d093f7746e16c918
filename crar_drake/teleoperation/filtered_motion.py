"""The robot that `crar-drake serve --joints` moves, by what the safety filter says."""

from collections.abc import Mapping

import numpy as np

from crar_drake.law.blending import blend_vectors, smooth_step
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.safety_filter import (
    BRAKING,
    NO_NUMBER,
    NOMINAL,
    OBSTACLE,
    FilterMemory,
    SafetyFilter,
)
from crar_drake.law.tasks import TaskLayout
from crar_drake.teleoperation.safe_motion import (
    Moved,
    SafeMotion,
    because_of,
)


class FilteredMotion(SafeMotion):
    """A safety filter of joint commands in a loop with its own command.

    Targets are positions of joints, each a task of its name. At first, and after a time
    without any, they are blended in from where the joints are.

    Attributes:
        filter: of the robot.
    """

    def __init__(
        self,
        safety_filter: SafetyFilter,
        start: Mapping[str, float] | None = None,
        blend_time: float = 0.0,
    ) -> None:
        """
        Args:
            start: as of `begin`.
            blend_time: how long targets are blended in [s].

        Raises:
            ScenarioError: as `begin`.
        """
        self.filter, self.model = safety_filter, safety_filter.model
        self.parameters = safety_filter.parameters
        self.period, self._blend_time = safety_filter.period, blend_time
        names = safety_filter.joint_names
        self.layout = TaskLayout(names, ("joint",) * len(names))
        self._workspace = self.model.MakeWorkspace()
        safety_filter.compile(obstacles=True)
        self.begin(start)

    def _stand(self, q: np.ndarray) -> None:
        self._remember(self.filter.start(q))
        self._start, self._blended = q, 0.0  # from where, and how long [s]

    def _remember(self, memory: FilterMemory) -> None:
        self._memory, self.q, self.v = memory, memory.q, memory.v

    def _is_clear(self) -> bool:
        return self.filter.solve(self._memory, self.q).command.report.clear

    def where(self) -> np.ndarray:
        return np.concatenate([self.q, np.zeros(2 * len(self.q))])

    def move(self, tasks: np.ndarray, obstacles: Obstacles | None = None) -> Moved:
        n, (q, v) = len(self.q), (self.q, self.v)
        wanted, rate = tasks[:n], tasks[n : 2 * n]
        wanted = wanted + self.period * rate  # at the end of the period
        if self._blended == 0.0:
            self._start = q
        self._blended = 0.0 if np.isnan(wanted).any() else self._blended + self.period
        blends = self._blended < self._blend_time
        if blends:
            step = smooth_step.py_func(self._blended, self._blend_time)
            blended = blend_vectors.py_func(self._start, wanted, rate, 0.0, step)
            wanted, rate, _ = blended
        self._remember(
            self.filter.solve(self._memory, wanted, rate, obstacles=obstacles)
        )
        command = self._memory.command
        report = command.report
        self.model.plant.SetPositionsAndVelocities(
            self._workspace.plant_context, np.concatenate((q, v))
        )
        brakes = report.how == BRAKING
        return Moved(
            status="braking" if brakes else "blending" if blends else "tracking",
            admitted=NOMINAL if brakes else report.how,
            distance=report.clearance,
            torques=self.model.inverse_dynamics(self._workspace, command.a),
            why=_in_words(report),
        )


def _in_words(report) -> str | None:
    """What holds a command back."""
    if report.why == NO_NUMBER:  # there are no targets, so that nothing is held back
        return None
    if report.why == OBSTACLE:
        return because_of(report.obstacle)
    of = " - ".join(report.pair) if report.why == "pair" else report.joint
    return f"{report.why}: {of}" if of else report.why or None
