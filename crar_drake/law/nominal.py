"""What a nominal of tasks answers: accelerations to be as near to as is safe."""

from typing import NamedTuple, Protocol

import numpy as np

from crar_drake.law.references import Targets
from crar_drake.robot.workspace import Workspace


class Nominal(NamedTuple):
    """The nominal of one step, in the plant's order."""

    vdot: np.ndarray  # (nv,) accelerations [rad/s^2 or m/s^2]
    task_error: np.ndarray  # (m,) Eq. (11) against the targets as given [rad, m]
    weights: np.ndarray  # (n,) diagonal of W, Eq. (27); ones where nothing is weighed
    qdot_c: np.ndarray  # (n,) where the velocities are to go, of Eq. (15) [rad/s]
    kept: np.ndarray  # for the next step


class TaskLaw(Protocol):
    """A law that follows tasks; `paper.PaperLaw` and `plan.Plan` are two."""

    def __call__(
        self,
        workspace: Workspace,
        q: np.ndarray,
        v: np.ndarray,
        targets: Targets,
        before: np.ndarray | None,
        efforts: np.ndarray,
    ) -> Nominal:
        """The nominal of a step.

        Args:
            workspace: of the model, at the state.
            q, v: (nq,), (nv,) the state.
            targets: what to do.
            before: `Nominal.kept` of the step one period ago; None at a start.
            efforts: (k, nv + 2) of each motor with a limit A, in the robot's order, b
                and the limit of |A q_ddot + b|.
        """
