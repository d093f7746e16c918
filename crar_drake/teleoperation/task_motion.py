"""The robot that `crar-drake serve` moves, by what the control law says."""

from collections.abc import Mapping

import numpy as np

from crar_drake.errors import ScenarioError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.safety_filter import HOW, NOMINAL
from crar_drake.law.solution import STATUS_WORDS, Solution
from crar_drake.robot.model import ControlModel
from crar_drake.teleoperation.safe_motion import Moved, SafeMotion, because_of


class TaskMotion(SafeMotion):
    """A control law in a loop with its own prediction; prescribed joints stand still.

    Attributes:
        law: of the robot.
    """

    def __init__(
        self,
        model: ControlModel,
        parameters: LookaheadParameters,
        start: Mapping[str, float] | None = None,
    ) -> None:
        """
        Args:
            model: of a plant whose time step is the control period.
            parameters: gains; the constraints must be those that hold by proof.
            start: as of `begin`.

        Raises:
            ScenarioError: the constraints are others, or a parameter is out of range;
                or as `begin`.
        """
        if parameters.constraints != "lookahead":
            raise ScenarioError(
                f"controller.constraints: {parameters.constraints!r} lets violations "
                "happen; what moves a robot by hand needs lookahead"
            )
        # Anybody may send obstacles, at any time.
        self.parameters = parameters.among_obstacles()
        self.model, self.law = model, ControlLaw(model, self.parameters)
        self.layout, self.period = model.layout, parameters.period
        try:
            self.law.among  # noqa: B018 (made here, since it takes a while)
        except ScenarioError as error:
            self.no_obstacles = str(error)
        self.law.compile(obstacles=not self.no_obstacles)
        self.begin(start)

    def _stand(self, q: np.ndarray) -> None:
        self.q, self.v = q, np.zeros(self.model.plant.num_velocities())
        self._still = self.model.prescribed_at(q)
        self.law.reset()

    def where(self) -> np.ndarray:
        return self.model.tasks_at(self.q)

    def move(self, tasks: np.ndarray, obstacles: Obstacles | None = None) -> Moved:
        solution = self._step(tasks, obstacles)
        self.q, self.v = np.split(solution.position_command, [len(self.q)])
        return Moved(
            STATUS_WORDS[float(solution.status[0])],
            HOW.get(float(solution.admission[0]), NOMINAL),
            float(solution.signed_distances.min(initial=np.inf)),
            solution.actuation,
            because_of(solution.obstacle),
        )

    def _step(self, tasks: np.ndarray, obstacles: Obstacles | None = None) -> Solution:
        still = self._still
        return self.law.step(self.q, self.v, tasks, still, obstacles=obstacles)

    def _is_clear(self) -> bool:
        solution = self._step(self.where())
        self.law.reset()
        return solution.admission[3] != 0.0
