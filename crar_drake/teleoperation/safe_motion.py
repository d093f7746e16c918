"""The robot that `crar-drake serve` moves: what a safe law says, done."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from crar_drake.errors import ScenarioError, nearest
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.safety_filter import OBSTACLE
from crar_drake.law.tasks import TaskLayout
from crar_drake.robot.description import LIMIT_TOLERANCE
from crar_drake.robot.model import ControlModel

# Slower than this in all joints the robot is at rest [rad/s or m/s].
_AT_REST = 1e-3


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


class SafeMotion(ABC):
    """A law or a filter in a loop with its own command.

    The state is the one that was commanded last, so that what
    [the theorem](docs/theory/theorem.md) says of the exact model holds of the commands,
    whatever the targets are.

    Attributes:
        model: of the robot.
        parameters: of the law.
        layout: of the tasks.
        period: [s].
        no_obstacles: why it keeps off no obstacles that move; "" if it does.
        q, v: (nq,), (nv,) the state.
    """

    model: ControlModel
    parameters: LookaheadParameters
    layout: TaskLayout
    period: float
    no_obstacles: str = ""
    q: np.ndarray
    v: np.ndarray

    @property
    def at_rest(self) -> bool:
        """Whether no joint moves."""
        return bool(np.abs(self.v).max(initial=0.0) < _AT_REST)

    def begin(self, start: Mapping[str, float] | None = None) -> None:
        """Begins, or begins anew, at rest.

        Args:
            start: joint to where it is [rad or m]; the others are as at rest.

        Raises:
            ScenarioError: the robot cannot start there: a joint is not known or beyond
                its limits, or its links are nearer than the floor.
        """
        q = start_positions(self.model, start or {})
        self._stand(q)
        if not start or self._is_clear():
            return
        distances = self.model.signed_distances(q)
        nearest = int(distances.argmin())
        a, b = self.model.pairs.names[nearest]
        raise ScenarioError(
            f"start: {a} - {b} are {1e3 * distances[nearest]:.1f} mm apart there, and "
            f"the floor is {1e3 * self.parameters.safety_distance:.1f} mm"
        )

    def stop_here(self) -> None:
        """The robot is where it is, at rest: nobody has commanded it to move for
        long."""
        self._stand(self.q)

    @abstractmethod
    def where(self) -> np.ndarray:
        """(layout.size,) [x; 0; 0] of the tasks' points, or of the joints, now."""

    @abstractmethod
    def move(self, tasks: np.ndarray, obstacles: Obstacles | None = None) -> Moved:
        """One step.

        Args:
            tasks: (layout.size,) targets; NaN where there are none.
            obstacles: that move by themselves, as they are now.
        """

    @abstractmethod
    def _stand(self, q: np.ndarray) -> None:
        """Forgets all, and is at rest at (nq,) positions."""

    @abstractmethod
    def _is_clear(self) -> bool:
        """Whether no links are nearer than the floor here, where it rests."""


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
