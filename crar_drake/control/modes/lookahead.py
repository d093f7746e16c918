"""Constraints that hold where the robot would come to rest: `docs/lookahead.md`."""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from crar_drake.control.checks import check_choice, check_numbers
from crar_drake.control.diagnostics import Diagnostic
from crar_drake.control.modes.mode import Before, Mode, Resolved
from crar_drake.control.modes.paper import refuse_adaptive_gain
from crar_drake.equations.admission import AdmissionGains
from crar_drake.equations.compilation import hold
from crar_drake.equations.handover import hand_over
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.lookahead import (
    LookaheadLaw,
    acceleration_bounds,
    lookahead_or_scaled,
)
from crar_drake.equations.lookahead_guard import LookaheadNumbers
from crar_drake.equations.lookahead_rows import (
    FASTEST_WISH,
    LookaheadGains,
    find_limits,
)
from crar_drake.equations.preview import make_preview
from crar_drake.equations.references import Answer, BlendStart, TaskGains, Wanted
from crar_drake.errors import ScenarioError
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import find_reaches
from crar_drake.robot.workspace import Workspace

if TYPE_CHECKING:
    from crar_drake.control.parameters import CrarParameters

LOST_TARGET = ("brake", "error")
GUARD_NORMS = ("joints", "tasks")

_NOT_GIVEN = np.zeros(0)
_NOTHING_WANTED = Wanted(
    _NOT_GIVEN,
    _NOT_GIVEN,
    _NOT_GIVEN,
    BlendStart(np.zeros((0, 3, 3)), np.zeros((0, 3)), _NOT_GIVEN, _NOT_GIVEN),
    (1.0, 0.0, 0.0),
)

# A pair's weight is then up to 1e12, and a double has 16 digits.
LARGEST_RHO = 1.0

# How fast margins may be used up where there is a preview [1/s]: of pairs, which it
# sees coming, and of limits, which motions of others run into again and again.
_PREVIEW_APPROACH = 200.0
_PREVIEW_LIMIT_APPROACH = 10.0
# What else is so unless it is given. A plan sees obstacles coming, so that the robot
# may be near them at speed: T [s], but so many periods at least. Its wishes are slower
# than feedback's may be [rad/s].
_PREVIEW_HORIZON = 0.012
_PREVIEW_PERIODS = 1.6
_PREVIEW_FASTEST_WISH = 9.0


# A longer way to brake is at most so many times as long as the next shorter one.
_HORIZON_RATIO = 1.7


def preview_horizon(period: float) -> float:
    """T with a preview, unless it is given [s], for a control period [s]."""
    return max(_PREVIEW_HORIZON, _PREVIEW_PERIODS * period)


@dataclass
class LookaheadParameters:
    """Parameters of the constraint mode "lookahead", see `equations.lookahead`.

    Attributes:
        horizon: T, over which the robot could brake [s]; a law with a longer one that
            takes over in mid-motion has yet to find its path clear; by default 2.5 /
            Gv, and with a preview 12 ms or 1.6 control periods, whichever is longer.
        longest_horizon: over which it may brake where motors have not the torque to
            brake within `horizon`, as long as that path is clear, too [s], and over
            some in between, see `longer_horizons`; by default the horizon, and with a
            preview 2.5 / Gv if that is longer.
        rho: amplitude of the collision weight; its decay and exponent are the
            controller's alpha and beta.
        rho_limits: rho_JL, amplitude of the joint-limit weight.
        distance_margin: d_min, the distance that pairs are to keep [m].
        admission_slack: a step is admitted only if every pair keeps the floor
            d_min - admission_slack on all of its braking path [m].
        limit_margin: what joints keep from their limits [rad].
        retreat_rate: gamma, how fast a violation is left [1/s], but at most at
        retreat_speed: of a pair [m/s], and
        joint_retreat_speed: of a joint [rad/s]; the margins by which pairs and limits
            weigh grow at most as fast, too.
        slip_time_constant: of the low-pass on what the plant did other than told,
            which the constraints then expect to go on [s].
        influence_distance: pairs farther apart than this do not count [m].
        fastest_wish: how fast q_s is asked to move at most, in any joint [rad/s]; by
            default 16, and 9 with a preview.
        guard_norm: in which the guard changes the wish the least: "joints", where all
            joints weigh the same, or "tasks", where tasks do by their weights, and
        guard_damping: nu, what joints count beside them [m]; by default the
            controller's damping.
        approach_rate: kappa, the share of what is left of a margin that the robot may
            come nearer by in a second [1/s]. Pairs and limits are then bounds of the
            guard, and have no weight in stage 1; by default it is the other way round:
            they weigh by their margins (rho, rho_limits), in both. With a preview they
            are bounds always, by default with 200/s, or 1 / period if that is less.
        limit_approach_rate: the same of joint limits alone [1/s]; by default the
            approach rate, and with a preview 10/s.
        preview: how far ahead accelerations are planned [s], see `equations.preview`;
            by default not at all. K, Kp and Kv are then the gains of prescribed joints
            alone, and GvN damps what tasks leave free, with
        null_space_damping: lambda of the projection on that [m].
        smoothness: of the preview, what an acceleration of 1 rad/s^2 of a joint counts
            beside a task error of 1 m [m s^2]: the less, the more closely targets are
            followed.
        farthest_pull: of the preview, the error from which on a task pulls no more than
            from there [m or rad].
        lost_target: what a NaN in the targets at run time does: "brake" comes to
            rest and blends in again when they are back, "error" raises.
    """

    horizon: float | None = None  # [s]
    longest_horizon: float | None = None  # [s]
    rho: float = 1e-4
    rho_limits: float = 0.01
    distance_margin: float = 5e-3  # [m]
    admission_slack: float = 1e-3  # [m]
    limit_margin: float = 0.02  # [rad]
    retreat_rate: float = 30.0  # [1/s]
    retreat_speed: float = 0.5  # [m/s]
    joint_retreat_speed: float = 2.0  # [rad/s]
    slip_time_constant: float = 0.01  # [s]
    influence_distance: float = 0.3  # [m]
    lost_target: str = "brake"
    fastest_wish: float | None = None  # [rad/s]
    guard_norm: str = "joints"
    guard_damping: float | None = None  # [m]
    approach_rate: float | None = None  # [1/s]
    limit_approach_rate: float | None = None  # [1/s]
    preview: float | None = None  # [s]
    null_space_damping: float = 0.02  # [m]
    smoothness: float = 5.7e-5  # [m s^2]
    farthest_pull: float = 0.002  # [m or rad]

    def validate(self) -> None:
        """Raises ScenarioError, naming the field and what it may be."""
        check_choice("controller.lookahead", self, "lost_target", LOST_TARGET)
        check_choice("controller.lookahead", self, "guard_norm", GUARD_NORMS)
        check_numbers("controller.lookahead", self, may_be_zero=set())
        if self.rho > LARGEST_RHO:
            raise ScenarioError(
                f"controller.lookahead.rho: {self.rho:g} must be at most "
                f"{LARGEST_RHO:g}: larger weights drown all else in rounding"
            )
        if self.admission_slack >= self.distance_margin:
            raise ScenarioError(
                f"controller.lookahead.admission_slack: {self.admission_slack} must be "
                f"less than distance_margin, {self.distance_margin}"
            )
        if self.influence_distance <= self.distance_margin:
            raise ScenarioError(
                f"controller.lookahead.influence_distance: {self.influence_distance} "
                f"must be more than distance_margin, {self.distance_margin}"
            )

    @property
    def wish_bound(self) -> float:
        """How fast q_s is asked to move at most [rad/s]."""
        if self.fastest_wish is not None:
            return self.fastest_wish
        return FASTEST_WISH if self.preview is None else _PREVIEW_FASTEST_WISH

    def approach_rates(self, period: float) -> tuple[float, float]:
        """kappa of pairs and of limits [1/s]; 0 where they weigh by their margins.

        Args:
            period: of the controller [s].
        """
        of_pairs, of_limits = self.approach_rate, self.limit_approach_rate
        if self.preview is not None:
            fastest = 1.0 / period
            of_pairs = of_pairs or min(_PREVIEW_APPROACH, fastest)
            of_limits = of_limits or min(_PREVIEW_LIMIT_APPROACH, fastest)
        return float(of_pairs or 0.0), float(of_limits or of_pairs or 0.0)


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
            "how the step was admitted (0 as wished, 1 corrected, 2 scaled), the share "
            "of the wish, the clearance of the next braking path [m], and whether the "
            "present one was clear (1) or not (0); the last two NaN where a watched "
            "pair is not examined",
        ),
    )

    def __init__(
        self, model: ControlModel, parameters: "CrarParameters", gains: TaskGains
    ) -> None:
        ahead = parameters.lookahead
        self.horizon = parameters.braking_horizon
        self.brakes_without_targets = ahead.lost_target == "brake"
        longest = parameters.longest_braking_horizon
        self.slower = tuple(
            LookaheadMode(
                model,
                replace(
                    parameters,
                    lookahead=replace(ahead, horizon=T, longest_horizon=T),
                ),
                gains,
            )
            for T in longer_horizons(self.horizon, longest)
        )
        self._model = model
        fastest = parameters.speed_limits(model)[model.controlled]
        limits = find_limits(model.lower, model.upper, fastest)
        self.robot = model.robot_ahead
        num_rows = len(self.robot.value.pairs.value.members) + len(limits.joints)
        self._still = np.zeros(model.n + model.n_p)
        self._examines_all = not model.pairs.not_examined
        n, nv = model.n, model.n + model.n_p
        preview = make_preview(
            ahead.preview or 0.0,
            ahead.smoothness,
            parameters.null_space_gain,
            parameters.posture_gain,
            parameters.period,
            ahead.farthest_pull,
            ahead.null_space_damping,
        )
        planned = n * len(preview.times)
        self._kept_first = np.concatenate(
            (np.zeros(n), np.full(num_rows, np.inf), np.zeros(planned))
        )
        # Of what `lookahead_or_scaled` returns, but for the distances at its end.
        kept = len(self._kept_first)
        ends = np.cumsum([0, nv, model.m, n, n, kept, 2, 4]).tolist()
        self._parts = [slice(start, end) for start, end in pairwise(ends)]
        self._distances = slice(ends[-1], None)
        share = min(1.0, parameters.period / ahead.slip_time_constant)
        of_pairs, of_limits = ahead.approach_rates(parameters.period)
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
            fastest_wish=float(ahead.wish_bound),
            task_norm=ahead.guard_norm == "tasks",
            guard_damping=float(ahead.guard_damping or parameters.damping),
            approach_rate=of_pairs,
            limit_approach_rate=of_limits,
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
            step=min(float(plant.time_step()), float(parameters.period)),
            floor=float(ahead.distance_margin - ahead.admission_slack),
        )
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
            )
        )
        self._law = hold(LookaheadLaw(self.robot, self.numbers))

    @staticmethod
    def check(parameters: "CrarParameters") -> None:
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
        bounds = ahead.approach_rate is not None or ahead.preview is not None
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
        refuse_adaptive_gain(parameters)

    def resolve(
        self,
        workspace: Workspace,
        measured: Measured,
        wanted: Wanted,
        before: Before | None,
    ) -> Resolved:
        if before is None or not before.follows:
            last = (measured.v, self._still, self._kept_first)
        else:
            last = (before.v, before.vdot, before.kept)
        found = lookahead_or_scaled(
            *hand_over(measured, wanted), *last, _NOT_GIVEN, self._law
        )
        vdot, error, W, qdot_c, kept, margins, admission = map(
            found.__getitem__, self._parts
        )
        told = {"resting_margins": margins, "admission": self._told(admission)}
        answer = Answer(vdot, error, found[self._distances], W, qdot_c)
        return Resolved(answer, kept, told)

    def acceleration_bounds(self, measured: Measured) -> tuple[np.ndarray, np.ndarray]:
        return acceleration_bounds(measured, self.robot, self.numbers)

    def may_brake(self, measured: Measured, told: Mapping[str, np.ndarray]) -> bool:
        model = self._model
        q, v = measured.q[0], measured.v[model.controlled]
        ends = q[model.controlled_positions] + self.horizon * v
        inside = (ends >= model.lower) & (ends <= model.upper)
        return bool(inside.all() and told["admission"][3] == 1.0)

    def admit_again(
        self, measured: Measured, vdot: np.ndarray
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        last = (measured.v, self._still, self._kept_first)
        found = lookahead_or_scaled(
            *hand_over(measured, _NOTHING_WANTED), *last, vdot, self._law
        )
        return found[: len(vdot)], {"admission": self._told(found[len(vdot) :])}

    def _told(self, admission: np.ndarray) -> np.ndarray:
        """What is said of braking paths: nothing, if a watched pair is not examined."""
        if not self._examines_all:
            admission[2:] = np.nan
        return admission
