"""What the control law knows of a constraint mode."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from crar_drake.control.diagnostics import Diagnostic
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.records import Memory, Solution
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.references import Targets, TaskGains
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace


class Mode(ABC):
    """A way to keep constraints: from a state and its targets to accelerations.

    A mode is made once for a model and parameters, and holds nothing that changes:
    what one step leaves to the next is in `Solution.kept`.

    Attributes:
        diagnostics: what the mode reports besides, as parts of the port `diagnostics`.
        horizon: T, if the distances are also wanted where the robot comes to rest,
            q + T q_dot [s]; else None.
        brakes_without_targets: whether a NaN in the targets makes the robot brake;
            else it is an error.
        keeps_off_obstacles: whether obstacles that move are kept off.
        plans: whether `resolve` is also to be given `efforts`, (k, nv + 2) of
            `EffortLimits.rows`.
        slower: longer horizons, for states in which motors have not the torque to brake
            within the short one [s]; a mode that has any limits its own accelerations.
    """

    diagnostics: ClassVar[tuple[Diagnostic, ...]] = ()
    horizon: float | None = None
    plans: bool = False
    brakes_without_targets: bool = False
    keeps_off_obstacles: bool = False
    slower: tuple[float, ...] = ()

    @abstractmethod
    def __init__(
        self, model: ControlModel, parameters: CrarParameters, gains: TaskGains
    ) -> None:
        """
        Args:
            model: the robot.
            parameters: validated, `check` included.
            gains: on tasks and prescribed joints.
        """

    @staticmethod
    @abstractmethod
    def check(parameters: CrarParameters) -> None:
        """Raises ScenarioError where a parameter does not go with this mode."""

    def acceleration_bounds(
        self, measured: Measured
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """What the effort limits may not change an acceleration beyond.

        Args:
            measured: the state, as in `resolve`.

        Returns:
            (n,), (n,) smallest and largest of the controlled joints [rad/s^2]; None if
            the mode has no such bounds.
        """
        return None

    def admit_again(
        self, measured: Measured, vdot: np.ndarray
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        """Accelerations that the effort limits have changed, if the mode allows them.

        Args:
            measured: the state, as in `resolve`.
            vdot: (nv,) accelerations within the effort limits [rad/s^2].

        Returns:
            (nv,) accelerations between these and braking; and the diagnostics that
            change, none if the accelerations stay.
        """
        return vdot, {}

    def limited(
        self, measured: Measured, vdot: np.ndarray, efforts: np.ndarray
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        """Accelerations within the effort limits and the constraints, over whichever
        horizon leaves the most of the given ones; of modes with a `slower` one.

        Args:
            measured: the state, as in `resolve`.
            vdot: (nv,) accelerations of `resolve` [rad/s^2].
            efforts: (nu, nv + 2) of `EffortLimits.rows`.

        Returns:
            As `equations.within_efforts.limited_acceleration`, one after the other but
            for the last: (nv,) accelerations; (nu,) torque; (2,) share and excess;
            (nq + nv,) where they lead. And the diagnostics that change.
        """
        raise NotImplementedError

    @abstractmethod
    def resolve(
        self,
        workspace: Workspace,
        measured: Measured,
        targets: Targets,
        before: Memory | None,
    ) -> Solution:
        """The accelerations that follow the targets under the constraints.

        Args:
            workspace: of the model, at the state.
            measured: the state, and where the robot comes to rest, q + T q_dot, if
                there is a `horizon`.
            targets: what to do.
            before: of the control step one period ago; None at the first step, after
                braking without targets and after a gap in time.

        Returns:
            A new one, with `acceleration` and what stands before `actuation`.
        """
