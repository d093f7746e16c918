"""The robot that a filter for teleoperation moves: what the control law says, done."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from crar_drake.errors import ScenarioError, nearest
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.records import (
    STATUS_BLENDING,
    STATUS_BRAKING,
    STATUS_IMPLAUSIBLE,
    Solution,
)
from crar_drake.law.safety_filter import OBSTACLE
from crar_drake.law.step import CORRECTED, SCALED
from crar_drake.robot.description import LIMIT_TOLERANCE
from crar_drake.robot.model import ControlModel

# Slower than this in all joints the robot is at rest [rad/s or m/s].
AT_REST = 1e-3

_STATUS = dict.fromkeys((STATUS_BRAKING, STATUS_IMPLAUSIBLE), "braking")
_STATUS[STATUS_BLENDING] = "blending"
_ADMITTED = {CORRECTED: "corrected", SCALED: "scaled"}


@dataclass(frozen=True)
class Moved:
    """What one step of a motion was like."""

    status: str  # "tracking", "blending" or "braking"
    admitted: str  # "nominal", "corrected", or "scaled", see docs/theory/theorem.md
    # of the nearest watched pair; of a filter of joints, no distance on the braking
    # path is smaller; infinite or NaN without any [m]
    distance: float
    torques: np.ndarray  # (nu,) of the step, at the state that it began in [Nm or N]
    why: str | None = None  # what held it back, in words; None if nothing, or not known


class SafeMotion:
    """A control law in a loop with its own prediction.

    The state is the one that the law commanded last, so that what
    [the theorem](docs/theory/theorem.md) says of the exact model holds of the commands,
    whatever the targets are. Prescribed joints stand still.

    Attributes:
        model, law: of the robot.
        layout: of the tasks.
        period: [s].
        no_obstacles: why it keeps off no obstacles that move; "" if it does.
        q, v: (nq,), (nv,) the state.
        at_rest: whether no joint moves.
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
            start: joint to where it is at first [rad or m]; the others are as at rest.

        Raises:
            ScenarioError: the constraints are others, or a parameter is out of range;
                or the robot cannot start there: a joint is not known or beyond its
                limits, or its links are nearer than the floor.
        """
        if parameters.constraints != "lookahead":
            raise ScenarioError(
                f"controller.constraints: {parameters.constraints!r} lets violations "
                "happen; what moves a robot by hand needs lookahead"
            )
        # Anybody may send obstacles, at any time.
        self.model, self.law = model, ControlLaw(model, parameters.among_obstacles())
        self.layout, self.period = model.layout, parameters.period
        self.no_obstacles = ""
        try:
            self.law.among  # noqa: B018 (made here, since it takes a while)
        except ScenarioError as error:
            self.no_obstacles = str(error)
        self._stand(start_positions(model, {}))
        self._warm_up()
        if start:
            self.begin(start)

    def begin(self, start: Mapping[str, float]) -> None:
        """Begins anew, at rest.

        Args:
            start: as of `__init__`.

        Raises:
            ScenarioError: the robot cannot start there.
        """
        self._stand(start_positions(self.model, start))
        self._check_start(self.law.parameters)

    def _stand(self, q: np.ndarray) -> None:
        self.q, self.v = q, np.zeros(self.model.plant.num_velocities())
        self._still = self.model.prescribed_at(q)
        self.law.reset()

    def where(self) -> np.ndarray:
        """(layout.size,) [x; 0; 0] of the tasks' points now."""
        return self.model.tasks_at(self.q)

    @property
    def at_rest(self) -> bool:
        return bool(np.abs(self.v).max(initial=0.0) < AT_REST)

    def stop_here(self) -> None:
        """The robot is where it is, at rest: nobody has commanded it to move for
        long."""
        self.v = np.zeros_like(self.v)
        self.law.reset()

    def move(self, tasks: np.ndarray, obstacles: Obstacles | None = None) -> Moved:
        """`advance`, and what it was like."""
        solution = self.advance(tasks, obstacles)
        distances = solution.signed_distances
        return Moved(
            _STATUS.get(float(solution.status[0]), "tracking"),
            _ADMITTED.get(float(solution.admission[0]), "nominal"),
            float(distances.min()) if len(distances) else float("inf"),
            solution.actuation,
            because_of(solution.obstacle),
        )

    def advance(
        self, tasks: np.ndarray, obstacles: Obstacles | None = None
    ) -> Solution:
        """One control step; the state is then that of its `position_command`.

        Args:
            tasks: (layout.size,) targets; NaN where there are none.
            obstacles: that move by themselves, as they are now.
        """
        solution = self.law.step(
            self.q, self.v, tasks, self._still, obstacles=obstacles
        )
        self.q, self.v = np.split(solution.position_command, [len(self.q)])
        return solution

    def _check_start(self, parameters: LookaheadParameters) -> None:
        """Raises ScenarioError: braking there is not clear."""
        state = self.q, self.v
        solution = self.advance(self.where())
        self.q, self.v = state
        self.law.reset()
        if solution.admission[3] == 0.0:
            nearest = int(solution.signed_distances.argmin())
            a, b = self.model.pairs.names[nearest]
            floor = parameters.safety_distance
            raise ScenarioError(
                f"start: {a} - {b} are {1e3 * solution.signed_distances[nearest]:.1f} "
                f"mm apart there, and the floor is {1e3 * floor:.1f} mm"
            )

    def _warm_up(self) -> None:
        """Some steps that leave nothing behind: whatever is compiled, or read from the
        cache, at its first call, is so before somebody waits for it."""
        self.law.compile(obstacles=not self.no_obstacles)
        state = self.q, self.v
        there = self.where()
        there[: self.model.layout.size_x] += 0.01
        for tasks in (there, there, np.full_like(there, np.nan), there):
            self.advance(tasks)
        self.q, self.v = state
        self.law.reset()


def because_of(obstacle: tuple[str, str] | None) -> str | None:
    """Why a command is held back: the obstacle, and the link; None of none."""
    return None if obstacle is None else f"{OBSTACLE}: {' - '.join(obstacle)}"


def start_positions(model: ControlModel, start: Mapping[str, float]) -> np.ndarray:
    """(nq,) the rest posture, but for the joints of `start`.

    Raises:
        ScenarioError: a joint is not known, or beyond its limits.
    """
    q, names = model.rest_positions(), list(model.position_names)
    for joint, position in start.items():
        if names.count(joint) != 1:
            raise ScenarioError(
                f"start: no joint {joint!r} with one position"
                f"{nearest(joint, dict.fromkeys(names))}"
            )
        q[names.index(joint)] = position
    at, lower, upper = q[model.controlled_positions], model.lower, model.upper
    beyond = np.flatnonzero(
        ~((at >= lower - LIMIT_TOLERANCE) & (at <= upper + LIMIT_TOLERANCE))
    )
    if len(beyond):
        i = int(beyond[0])
        raise ScenarioError(
            f"start: {model.joint_names[i]} at {at[i]:g} is beyond its limits, "
            f"{lower[i]:g} to {upper[i]:g}"
        )
    return q
