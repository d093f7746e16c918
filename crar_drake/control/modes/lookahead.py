"""Constraints that hold where the robot would come to rest:
`docs/theory/theorem.md`."""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from crar_drake.control.diagnostics import Diagnostic
from crar_drake.control.modes.mode import Mode
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.plausible import fastest_asked
from crar_drake.control.records import Memory, Solution
from crar_drake.control.tracking_error import (
    check_rest_posture,
    check_slides,
    distance_losses,
    joint_errors,
    narrowed_limits,
    thickened,
)
from crar_drake.equations.admission import AdmissionGains
from crar_drake.equations.compilation import hold
from crar_drake.equations.handover import hand_over
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.lookahead import LookaheadLaw, lookahead_or_scaled
from crar_drake.equations.lookahead_guard import LookaheadNumbers
from crar_drake.equations.lookahead_rows import (
    LookaheadGains,
    find_limits,
)
from crar_drake.equations.preview import make_preview
from crar_drake.equations.references import Targets, TaskGains
from crar_drake.equations.within_efforts import NOT_ASKED, acceleration_bounds
from crar_drake.errors import ScenarioError
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import find_reaches
from crar_drake.robot.workspace import Workspace

_NOT_GIVEN = np.zeros(0)
_NO_EFFORTS = np.zeros((0, 0))
_NO_TARGETS = Targets(_NOT_GIVEN, _NOT_GIVEN, _NOT_GIVEN)

# A longer horizon is at most so many times the next shorter one. With 2.6, a torso can
# find the path of one not clear and motors too weak for the one before, and lags.
_HORIZON_RATIO = 1.7


def longer_horizons(horizon: float, longest: float) -> list[float]:
    """What a horizon may be instead where motors are weak [s]: in equal ratios of at
    most `_HORIZON_RATIO`, the last one the longest; none if that is T itself.

    Args:
        horizon: T [s].
        longest: the longest one [s].
    """
    ratio = longest / horizon
    count = math.ceil(math.log(ratio) / math.log(_HORIZON_RATIO))
    return [horizon * ratio ** (k / count) for k in range(1, count + 1)]


class LookaheadMode(Mode):
    """(L1)-(L13) of `equations.lookahead`.

    Attributes:
        robot: holds the `Robot` with a row for each pair of shapes, in two
            configurations.
        reaches: holds the `Reaches` of the watched pairs, for other paths than braking
            ones.
        lower, upper: (n,) limits that commands keep [rad].
        losses: (Np,) by how much the pairs of `robot` are nearer than they are, for
            tracking errors [m].
        admission: its numbers.
        numbers: holds the `LookaheadNumbers`.
    """

    diagnostics = (
        Diagnostic(
            "resting_margins",
            lambda model: 2,
            "where the robot would come to rest: the smallest distance [m] and the "
            "smallest margin to a joint limit [rad]",
        ),
        Diagnostic(
            "admission",
            lambda model: 4,
            "how the step was admitted (0 nominal, 1 corrected, 2 scaled), "
            "the share of the nominal step, the clearance of the next braking path "
            "[m], and whether the present one was clear (1) or not (0); the last two "
            "NaN where a watched pair is not examined",
        ),
        Diagnostic(
            "balance",
            lambda model: 3,
            "how the step was admitted for balance (0 nominal, 1 corrected, 2 scaled), "
            "the share of it, and what the ground has left on the next braking path "
            "[m of the weight's arm]; NaN without controller.balance",
        ),
    )

    keeps_off_obstacles = True

    def __init__(
        self,
        model: ControlModel,
        parameters: CrarParameters,
        gains: TaskGains,
        step: float | None = None,
    ) -> None:
        """
        Args:
            model, parameters, gains: as of `Mode`.
            step: of what does as commanded [s]; by default that of the model's plant.
        """
        crowded = model.m >= model.n
        ahead = parameters.lookahead.filled(
            parameters.period, parameters.plans, crowded
        )
        if step is None:
            step = model.plant.time_step()
        self.horizon = parameters.braking_horizon
        self.brakes_without_targets = ahead.lost_target == "brake"
        longest = parameters.longest_braking_horizon
        self.slower = tuple(longer_horizons(self.horizon, longest))
        self._model = model
        fastest = np.minimum(
            parameters.speed_limits(model)[model.controlled], fastest_asked(model)
        )
        errors = joint_errors(ahead, model)
        self.lower, self.upper = narrowed_limits(errors, model)
        limits = find_limits(self.lower, self.upper, fastest)
        self.robot = model.robot_ahead
        num_rows = len(self.robot.value.pairs.value.members) + len(limits.joints)
        self._still = np.zeros(model.n + model.n_p)
        self._examines_all = not model.pairs.not_examined
        n, nv = model.n, model.n + model.n_p
        preview = make_preview(
            ahead.preview,
            ahead.smoothness,
            *parameters.null_space_gains(crowded),
            parameters.period,
            ahead.farthest_pull,
            ahead.null_space_damping,
        )
        planned = n * len(preview.times)
        self.plans = planned > 0
        self._kept_first = np.concatenate(
            (np.zeros(n), np.full(num_rows, np.inf), np.zeros(planned))
        )
        # Of what `lookahead_or_scaled` returns, but for the distances at its end.
        kept = len(self._kept_first)
        ends = np.cumsum([0, nv, model.m, n, n, kept, 2, 4]).tolist()
        self._parts = [slice(start, end) for start, end in pairwise(ends)]
        self._distances = slice(ends[-1], None)
        share = min(1.0, parameters.period / ahead.slip_time_constant)
        numbers = LookaheadGains(
            T=float(self.horizon),
            Gv=float(parameters.Gv),
            damping=float(parameters.damping),
            rho=float(ahead.rho),
            alpha=float(parameters.alpha),
            beta=float(parameters.beta),
            rho_limits=float(ahead.rho_limits),
            distance_margin=float(ahead.distance_margin),
            limit_margin=float(ahead.limit_margin),
            retreat_rate=float(ahead.retreat_rate),
            retreat_speed=float(ahead.retreat_speed),
            joint_retreat_speed=float(ahead.joint_retreat_speed),
            influence_distance=float(ahead.influence_distance),
            period=float(parameters.period),
            slip_share=float(share),
            nominal_speed_limit=float(ahead.nominal_speed_limit),
            task_norm=ahead.guard_norm == "tasks",
            guard_damping=float(ahead.guard_damping or parameters.damping),
            approach_rate=float(ahead.approach_rate),
            limit_approach_rate=float(ahead.limit_approach_rate),
        )
        plant = model.plant
        reaches = find_reaches(
            model.joints,
            model.pairs,
            model.order,
            plant.GetPositionLowerLimits(),
            plant.GetPositionUpperLimits(),
        )
        self.admission = AdmissionGains(
            T=float(self.horizon),
            period=float(parameters.period),
            step=min(float(step), float(parameters.period)),
            floor=float(ahead.floor),
        )
        self.losses = np.zeros(len(model.pairs.closed_rows))
        if errors.any():
            check_slides(errors, reaches, model)
            self.losses = distance_losses(errors, reaches)
            check_rest_posture(self.robot, self.losses, self.admission.floor, model)
            self.robot = thickened(self.robot, self.losses)
        self.reaches = hold(reaches)
        self.numbers = hold(
            LookaheadNumbers(
                gains,
                hold(limits),
                numbers,
                self.admission,
                self.reaches,
                model.pairs.shape_pairs,
                hold(preview),
                np.array([self.horizon, *self.slower], dtype=float),
            )
        )
        self._law = hold(LookaheadLaw(self.robot, self.numbers))

    @staticmethod
    def check(parameters: CrarParameters) -> None:
        """Raises ScenarioError: the mode chooses accelerations, with a W of its own."""
        if parameters.level == "velocity":
            raise ScenarioError(
                "controller.level: the lookahead constraints choose accelerations; "
                "use level acceleration, or constraints paper"
            )
        T = parameters.braking_horizon
        if parameters.period > T:
            raise ScenarioError(
                f"controller.period: {parameters.period:g} s must be at most the "
                f"braking horizon, {T:g} s (controller.lookahead.horizon)"
            )
        ahead = parameters.lookahead
        if ahead.longest_horizon is not None and ahead.longest_horizon < T:
            raise ScenarioError(
                f"controller.lookahead.longest_horizon: {ahead.longest_horizon:g} s "
                f"must be at least the braking horizon, {T:g} s "
                "(controller.lookahead.horizon)"
            )
        for name in ("approach_rate", "limit_approach_rate"):
            rate = getattr(ahead, name) or 0.0
            if rate * parameters.period > 1.0 + 1e-9:
                raise ScenarioError(
                    f"controller.lookahead.{name}: at a control period of "
                    f"{parameters.period:g} s {rate:g}/s would lead beyond the margin "
                    f"within a period; choose at most {1.0 / parameters.period:g}/s"
                )
        bounds = ahead.approach_rate is not None or parameters.plans
        if ahead.limit_approach_rate is not None and not bounds:
            raise ScenarioError(
                "controller.lookahead.limit_approach_rate: without approach_rate or "
                "preview limits weigh by their margins (rho_limits)"
            )
        if parameters.metric != "identity":
            raise ScenarioError(
                f"controller.metric: {parameters.metric!r} belongs to constraints "
                "paper or none; the lookahead constraints have a weight of their own"
            )

    def resolve(
        self,
        workspace: Workspace,
        measured: Measured,
        targets: Targets,
        before: Memory | None,
        efforts: np.ndarray = _NO_EFFORTS,
    ) -> Solution:
        if before is None:
            last = (measured.v, self._still, self._kept_first)
        else:
            solution = before.solution
            last = (before.v, solution.acceleration, solution.kept)
        found = lookahead_or_scaled(
            *hand_over(measured, targets), *last, efforts, _NOT_GIVEN, self._law
        )
        vdot, error, W, qdot_c, kept, margins, admission = map(
            found.__getitem__, self._parts
        )
        return Solution(
            acceleration=vdot,
            task_error=error,
            signed_distances=found[self._distances],
            constraint_weights=W,
            constrained_velocity=qdot_c,
            of_mode={
                "resting_margins": margins,
                "admission": self._reported(admission),
            },
            kept=kept,
        )

    def acceleration_bounds(self, measured: Measured) -> tuple[np.ndarray, np.ndarray]:
        return acceleration_bounds(measured, self.robot, self.numbers)

    def admit_again(
        self, measured: Measured, vdot: np.ndarray
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        found = self._ask_again(measured, vdot, _NO_EFFORTS)
        return found[: len(vdot)], {"admission": self._reported(found[len(vdot) :])}

    def limited(
        self, measured: Measured, vdot: np.ndarray, efforts: np.ndarray
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        found = self._ask_again(measured, vdot, efforts)
        found, admission = found[:-4], found[-4:]
        if admission[0] == NOT_ASKED:
            return found, {}
        return found, {"admission": self._reported(admission)}

    def _ask_again(
        self, measured: Measured, vdot: np.ndarray, efforts: np.ndarray
    ) -> np.ndarray:
        last = (measured.v, self._still, self._kept_first)
        return lookahead_or_scaled(
            *hand_over(measured, _NO_TARGETS), *last, efforts, vdot, self._law
        )

    def _reported(self, admission: np.ndarray) -> np.ndarray:
        """What is reported of braking paths: nothing, if a watched pair is not
        examined."""
        if not self._examines_all:
            admission[2:] = np.nan
        return admission
