"""The paper's constraints, to the letter, and none: Eqs. (10), (15)-(35)."""

import math

import numpy as np

from crar_drake.control.modes.mode import Mode
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.records import Memory, Solution
from crar_drake.equations.compilation import hold
from crar_drake.equations.composite_weight import composite_index
from crar_drake.equations.handover import hand_over
from crar_drake.equations.joint_limits import limit_potential
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.paper import (
    PaperGains,
    PaperLaw,
    PaperNumbers,
    paper_control,
)
from crar_drake.equations.references import Targets, TaskGains
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

_NO_MATRIX = np.zeros((0, 0))


class PaperMode(Mode):
    """The diagonal W of Eqs. (17)-(28) in the inverse of Eq. (34)."""

    _constrained = True

    def __init__(
        self, model: ControlModel, parameters: CrarParameters, gains: TaskGains
    ) -> None:
        self._model = model
        self._with_inertia = parameters.metric == "inertia"
        limits = limit_potential(model.lower, model.upper)
        numbers = paper_gains(parameters, len(model.pairs))
        mode = hold(PaperNumbers(gains, limits, numbers, self._constrained))
        self._law = hold(PaperLaw(model.robot_by_pair, mode))
        # Of what `paper_control` returns, but for the distances at its end.
        n, nv = model.n, model.n + model.n_p
        kept = n + len(model.pairs) * n
        self._ends = np.cumsum([0, nv, model.m, n, kept, n]).tolist()
        self._first = np.concatenate((np.zeros(kept), np.full(n, np.nan)))

    @staticmethod
    def check(parameters: CrarParameters) -> None:
        """All parameters go with this mode."""

    def resolve(
        self,
        workspace: Workspace,
        measured: Measured,
        targets: Targets,
        before: Memory | None,
    ) -> Solution:
        model = self._model
        found = paper_control(
            *hand_over(measured, targets),
            self._first if before is None else before.solution.kept,
            model.inertia_matrix(workspace) if self._with_inertia else _NO_MATRIX,
            self._law,
        )
        _, a, b, c, d, end = self._ends
        return Solution(
            acceleration=found[:a],
            task_error=found[a:b],
            signed_distances=found[end:],
            constraint_weights=found[b:c],
            constrained_velocity=found[d:end],
            kept=found[c:end],
        )


class NoneMode(PaperMode):
    """W = I: the raw motion, whose violations Fig. 2 of the paper counts."""

    _constrained = False


def paper_gains(parameters: CrarParameters, num_pairs: int) -> PaperGains:
    """The numbers of the paper's law; what is not given is NaN, or as the paper has
    it."""
    share = parameters.limit_share
    return PaperGains(
        damping=float(parameters.damping),
        Gv=float(parameters.Gv),
        GvN=math.nan if parameters.GvN is None else float(parameters.GvN),
        rho=float(parameters.rho),
        alpha=float(parameters.alpha),
        beta=float(parameters.beta),
        limit_share=composite_index(num_pairs) if share is None else float(share),
        period=float(parameters.period),
        velocity_level=parameters.level == "velocity",
    )
