"""The parameters of a controller: those of the paper, and those of the lookahead.

Two classes, for what a law does not use cannot be written. They share `Shared`.
"""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from crar_drake.errors import ModelError, ScenarioError
from crar_drake.law.approach import Approach
from crar_drake.law.checks import check_choice, check_numbers
from crar_drake.robot.description import find_joint, is_speed_limit

if TYPE_CHECKING:
    from crar_drake.robot.model import ControlModel

LEVELS = ("velocity", "acceleration")
METRICS = ("identity", "inertia")

# A torque loop of 1 kHz is usual, and enough [s].
_TORQUE_PERIOD = 1e-3
# T in time constants 1 / Gv of the paper's velocity loop, where no plan sees obstacles
# coming. A short one asks of motors what they do not have; a long one stops far from
# obstacles.
_BRAKING_TIMES = 2.5
# T of a filter of joint commands [s].
T_OF_COMMANDS = _BRAKING_TIMES / 30.0
# T with a plan [s], but so many periods at least, for the theorem asks for one. It is
# short since a plan sees obstacles coming: a robot may be near them at speed.
_PLANNED_T, LEAST_PERIODS = 0.012, 1.6
# A longer T is at most so many times the next shorter one. With 2.6, a torso can find
# the path of one not clear and motors too weak for the one before, and lags.
_RATIO = 1.7

# A step keeps so much less than the margin [m].
SLACK = 1e-3
# Rows of pairs and of limits: gamma [1/s], but at most at [m/s], [rad/s].
_RETREAT, _RETREAT_SPEED, _JOINT_RETREAT_SPEED = 30.0, 0.5, 2.0
# kappa of pairs [1/s]: a plan sees them coming; a command is changed only where it
# would not be safe, so late. No margin is used up by more than there is in a period, of
# commands than half of it.
_APPROACH, _APPROACH_OF_COMMANDS = 200.0, 100.0
# Pairs farther apart have no row [m].
_INFLUENCE, _INFLUENCE_OF_COMMANDS = 0.3, 0.1
# How fast q_s is asked to move [rad/s or m/s]. A plan asks for no jumps as feedback
# does; 16 would be faster, and no closer. Half of 16 misses fast motions without one.
_PLANNED_SPEED, _SPEED = 9.0, 16.0

# How smoothly is planned [m s^2].
_SMOOTHNESS = {"closest": 5.7e-5, "balanced": 8e-5, "calm": 2.3e-4}
# With less rounding hides what joints count: at 3e-9 to 1e-8 laws of two wrists find no
# plan. With this and more an adversary's do (docs/measurements/adversary.md).
_LEAST_SMOOTHNESS = 1e-6  # [m s^2]
# How far ahead is planned [s], and how smoothly; and with control periods of more than
# 10 ms, with which such a plan would shake.
_PLAN, _LONG_PLAN, _LONG_PERIOD = (0.1, "balanced"), (0.16, "calm"), 0.01


@dataclass
class Shared:
    """What all laws share.

    Attributes:
        period: control period [s]; the accelerations are held in between.
        latency: from a state of the robot until a command that answers it acts on the
            robot [s]; the law predicts the state then, by what it has commanded since.
        effort_limits: whether the commanded torque stays within the effort limits of
            the controlled joints, see `law.motors`. Without finite limits in the
            robot's file it changes nothing.
        blend_time: time over which the targets are blended in from the measured
            pose [s].
    """

    period: float = 1e-3  # [s]
    latency: float = 0.0  # [s]
    effort_limits: bool = False
    blend_time: float = 0.5  # [s]

    def torque_ticks(self, plant_step: float) -> tuple[int, float]:
        """How often the torque of the held accelerations is computed in a control
        period, and the time between two: a millisecond, or a step of a plant whose
        steps are longer; of what divides the period, the longest time that is not
        longer.

        Args:
            plant_step: time step of the discrete plant [s]; 0 for a continuous one.

        Returns:
            (how often, the time between two [s]).
        """
        longest = max(plant_step, _TORQUE_PERIOD) * (1.0 + 1e-6)
        if not plant_step:
            ticks = math.ceil(self.period / longest)
            return ticks, self.period / ticks
        steps = max(1, round(self.period / plant_step))
        ticks = next(
            ticks
            for ticks in range(1, steps + 1)
            if steps % ticks == 0 and steps // ticks * plant_step <= longest
        )
        period = self.period / ticks
        # With the plant's own number the events of both come at the same instants.
        rounding = ticks > 1 and abs(period - plant_step) <= 1e-12 * plant_step
        return ticks, plant_step if rounding else period

    def limits_of_efforts(self, model: "ControlModel") -> np.ndarray:
        """The largest effort of each actuator of a robot's plant that is commanded.

        Returns:
            (nu,) [Nm or N], infinite where there is none or it is not respected, and
            for the prescribed joints, whose acceleration is the motion's.
        """
        if not self.effort_limits:
            return np.full_like(model.actuator_limits, np.inf)
        limits = model.actuator_limits.copy()
        limits[model.effort_of_joints[:, model.prescribed].any(axis=1)] = np.inf
        return limits


_SHARED = tuple(entry.name for entry in fields(Shared))
_MAY_BE_ZERO = {"blend_time", "latency", "posture_gain", "tracking_error"}


@dataclass
class PaperGains:
    """The paper's own parameters; Section IV gives the gains.

    Attributes:
        level: where alpha comes from: "velocity" (Eq. 10) or "acceleration"
            (Eq. 35).
        K: velocity-level task gain, Eq. (15) [1/s].
        Kp: acceleration-level position gain, Eq. (14) [1/s^2].
        Kv: acceleration-level velocity gain [1/s]; by default 2 sqrt(Kp).
        Gv: joint velocity gain, Eq. (30) [1/s].
        GvN: null-space gain, Eq. (33) [1/s]; by default Gv.
        metric: of the joint velocities that W weighs: "identity", or "inertia" for the
            dynamically consistent inverse, see `law.paper.inertia_weight`.
        damping: lambda of Eq. (34) [m].
        rho, alpha, beta: amplitude, decay [1/m] and exponent of the collision
            potential, Eq. (24), for every pair.
        limit_share: a of Eq. (27); by default 1 / (Nc + 1), Eq. (28).
    """

    level: str = "acceleration"
    K: float = 30.0  # [1/s]
    Kp: float = 300.0  # [1/s^2]
    Kv: float | None = None  # [1/s]
    Gv: float = 30.0  # [1/s]
    GvN: float | None = None  # [1/s]
    metric: str = "identity"
    damping: float = 0.1  # [m]
    rho: float = 1.0
    alpha: float = 50.0  # [1/m]
    beta: float = 2.0
    limit_share: float | None = None

    @property
    def longest_period(self) -> float:
        """At which the feedback does not diverge [s].

        A task's error obeys x'' = -P x - D x', with D = Kv + Gv and P = Kp + Gv K
        (Eqs. 14, 30 at the acceleration level). The acceleration is held for a period
        h, by a plant whose steps d are at most that long; then the two eigenvalues of
        (x, h x') are inside the unit circle (Jury's criterion) if and only if

            D h + P h d / 2 < 2    and    D > P (h - d) / 2.

        The worst of d between 0 and h counts.
        """
        if self.level == "velocity":
            return math.inf
        D, P = self._feedback
        return min(2.0 * D / P, (math.sqrt(D * D + 4.0 * P) - D) / P)

    def check_gains(self, where: str, period: float) -> None:
        """Raises ScenarioError, which begins with `where`: a gain is out of range, or
        the feedback diverges at a control period [s]."""
        check_choice(where, self, "level", LEVELS)
        check_choice(where, self, "metric", METRICS)
        check_numbers(where, self, _GAINS, may_be_zero={"limit_share"})
        if self.limit_share is not None and self.limit_share > 1.0:
            raise ScenarioError(
                f"{where}.limit_share: {self.limit_share} must be at most 1"
            )
        if period >= self.longest_period:
            D, P = self._feedback
            raise ScenarioError(
                f"{where}: with a velocity gain Kv + Gv = {D:g}/s and a position gain "
                f"Kp + Gv K = {P:g}/s^2 the feedback diverges at a control period of "
                f"{period:g} s; lower the gains, or choose a period below "
                f"{self.longest_period:.2g} s"
            )

    @property
    def _feedback(self) -> tuple[float, float]:
        """D and P of `longest_period`."""
        return self.velocity_gain + self.Gv, self.Kp + self.Gv * self.K

    @property
    def velocity_gain(self) -> float:
        """Kv of Eq. (14) [1/s]."""
        return 2.0 * math.sqrt(self.Kp) if self.Kv is None else self.Kv


_GAINS = tuple(entry.name for entry in fields(PaperGains))


@dataclass
class PaperParameters(PaperGains, Shared):
    """The paper to the letter: both levels, and its own constraints.

    Attributes:
        constraints: "paper" (W of Eq. 27) or "none" (W = I: the raw motion).

    The others are those of `Shared` and `PaperGains`.
    """

    constraints: str = "paper"

    plans: ClassVar[bool] = False
    balance: ClassVar[None] = None
    # By which runs are judged, as those of the lookahead by default [m], [m/s].
    safety_distance: ClassVar[float] = 4e-3
    contact_speed: ClassVar[float] = 0.05

    def validate(self) -> None:
        """Checks every field; YAML loading does not.

        Raises:
            ScenarioError: names the field, its value and what it may be.
        """
        check_choice("controller", self, "constraints", ("paper", "none"))
        check_numbers("controller", self, _SHARED, _MAY_BE_ZERO)
        self.check_gains("controller", self.period)

    @property
    def T(self) -> float:
        """Over which motors are to be able to brake, where their limits count [s]."""
        return _BRAKING_TIMES / self.Gv

    def speed_limits(self, model: "ControlModel") -> np.ndarray:
        """(nv,) the largest speed of each joint of a robot's plant [rad/s or m/s], by
        which a run is judged: what `LookaheadParameters()` allow."""
        return LookaheadParameters().speed_limits(model)


@dataclass
class BalanceParameters:
    """What a robot that stands may ask of the ground.

    Attributes:
        margin: that the hull of all soles is taken smaller by at each edge [m].
        friction: coefficient between soles and ground that may be used.
    """

    margin: float = 0.02  # [m]
    friction: float = 0.5

    def validate(self) -> None:
        """Raises ScenarioError, naming the field and what it may be."""
        check_numbers("controller.balance", self, may_be_zero={"margin"})


class Resolved(NamedTuple):
    """The parameters of the lookahead with a number for each that is not given."""

    T: float  # braking time constant [s]
    others: tuple[float, ...]  # longer ones, for weak motors [s]
    approach: Approach
    preview: float  # [s]
    smoothness: float  # [m s^2]
    damping: float  # of the null space [1/s]
    stiffness: float  # towards the nominal posture [1/s^2]
    null_space_damping: float  # lambda of the null space's projection [m]
    farthest_pull: float  # the error from which on a task pulls no more [rad or m]


@dataclass
class SafetyParameters:
    """What the control law and the safety filter keep.

    Attributes:
        margin: d_min, the distance that pairs are to keep [m]; what they keep for
            certain is 1 mm less.
        braking_time: T, over which the robot could brake [s]. By default 2.5 / Gv =
            83 ms for a filter, for the paper's law and on soles; with a plan 12 ms or
            1.6 periods, whichever is longer, and up to 83 ms where motors have not the
            torque. A law never exceeds what is given; a filter does for weak motors.
        velocity_scale: share of the robot's velocity limits that may be used; infinite
            lifts them.
        velocity_limits: joint to its largest speed [rad/s or m/s], instead of the
            robot's times `velocity_scale`; infinite for none.
        tracking_error: E, how far each joint of a robot that follows commanded
            positions may be from its command [rad or m]: pairs and limits are kept so
            much farther that the robot keeps them, see `law.tracking_error`; and
        tracking_errors: joint to its own instead. With an error all distances that are
            bounded are those that are left for the robot.
        contact_speed: v_ok, slower than which a link may be touched by an obstacle that
            moves by itself [m/s].
        evade: whether links get out of the way of obstacles that move by themselves,
            see `law.moving_obstacles.evading_rows`.
    """

    margin: float = 5e-3  # [m]
    braking_time: float | None = None  # [s]
    velocity_scale: float = 1.0
    velocity_limits: dict[str, float] = field(default_factory=dict)
    tracking_error: float = 0.0  # [rad or m]
    tracking_errors: dict[str, float] = field(default_factory=dict)  # [rad or m]
    contact_speed: float = 0.05  # [m/s]
    evade: bool = False


@dataclass
class LookaheadParameters(SafetyParameters, Shared):
    """The lookahead: each step is the nearest to a nominal after which the robot could
    still brake, see `law.step`.

    Attributes:
        nominal: None for the receding-horizon plan of `law.plan`; or gains of the
            paper's law, which follows less closely and is calm.
        limit_margin: what joints keep from their limits, each at most a tenth of its
            range [rad or m].
        preview: how far ahead accelerations are planned [s]; by default 0.1, and 0.16
            with periods of more than 10 ms.
        smoothness: of the plan, what an acceleration of 1 rad/s^2 of a joint counts
            beside a task error of 1 m [m s^2]: the less, the more closely targets are
            followed. "closest", "balanced" or "calm", or a number of at least 1e-6; by
            default "balanced", and "calm" with periods of more than 10 ms.
        posture_gain: stiffness towards a nominal posture in the null space [1/s^2]:
            where fewer task rows than joints leave a choice, elbows stay bent and
            joints off their limits. The posture is the input port "nominal_posture", or
            where nothing is connected the robot's rest posture, with a plan only where
            a joint nears its limit. 0 leaves the port out. By default 40, 30 for the
            paper's law, or 1 where there are as many task rows as joints or more.
        balance: of a robot that stands on its soles, what it may ask of the ground, see
            `law.ground`; by default nobody asks.

    The others are those of `Shared` and `SafetyParameters`.
    """

    effort_limits: bool = True
    nominal: PaperGains | None = None
    limit_margin: float = 0.02  # [rad or m]
    preview: float | None = None  # [s]
    smoothness: float | str | None = None  # [m s^2]
    posture_gain: float | None = None  # [1/s^2]
    balance: BalanceParameters | None = None

    constraints: ClassVar[str] = "lookahead"

    def validate(self) -> None:
        """Checks every field; YAML loading does not.

        Raises:
            ScenarioError: names the field, its value and what it may be.
        """
        self.check_safety()
        if not self.plans:
            self.gains.check_gains("controller.nominal", self.period)
        elif self.period >= (longest := self.gains.longest_period):
            raise ScenarioError(
                f"controller.period: {self.period:g} s is too long: choose one below "
                f"{longest:.2g} s"
            )
        _ = self._smoothness
        if self.balance is not None:
            self.balance.validate()
        for name in ("preview", "smoothness"):
            if self.nominal is not None and getattr(self, name) is not None:
                raise ScenarioError(
                    f"controller.{name}: there is a plan only without controller."
                    "nominal; leave one of them out"
                )

    def check_safety(self) -> None:
        """Checks what does not follow tasks; raises as `validate`."""
        check_numbers(
            "controller",
            self,
            _NUMBERS,
            may_be_zero=_MAY_BE_ZERO,
            may_be_infinite={"velocity_scale"},
        )
        for name in ("velocity_limits", "tracking_errors"):
            if not isinstance(getattr(self, name), Mapping):
                raise ScenarioError(f"controller.{name}: give names and their values")
        for joint, limit in self.velocity_limits.items():
            if not is_speed_limit(limit):
                raise ScenarioError(
                    f"controller.velocity_limits.{joint}: {limit!r} must be positive "
                    "(.inf for no limit)"
                )
        for joint, error in self.tracking_errors.items():
            if not 0.0 <= error < math.inf:
                raise ScenarioError(
                    f"controller.tracking_errors.{joint}: {error} must be finite, and "
                    "not negative"
                )
        if self.margin <= SLACK:
            raise ScenarioError(
                f"controller.margin: {self.margin} m must be more than {SLACK} m, "
                "which a step may use up"
            )
        if self.margin >= _INFLUENCE:
            raise ScenarioError(
                f"controller.margin: {self.margin} m must be less than {_INFLUENCE} m: "
                "pairs that are farther apart hold nothing back"
            )
        if self.period > self.T:
            raise ScenarioError(
                f"controller.period: {self.period:g} s must be at most the braking "
                f"time constant, {self.T:g} s (controller.braking_time)"
            )

    @property
    def plans(self) -> bool:
        """Whether the nominal is a plan."""
        return self.nominal is None

    @property
    def safety_distance(self) -> float:
        """d_0, the distance that pairs keep on every braking path [m]."""
        return self.margin - SLACK

    @property
    def gains(self) -> PaperGains:
        """Of the paper's law, and of prescribed joints."""
        return self.nominal or PaperGains()

    @property
    def level(self) -> str:
        """At which accelerations are computed, see `PaperGains`."""
        return self.gains.level

    @property
    def T(self) -> float:
        """Braking time constant wherever nothing asks for another [s]."""
        if self.braking_time is None and self.plans and self.balance is None:
            return max(_PLANNED_T, LEAST_PERIODS * self.period)
        return self.longest_T

    @property
    def longest_T(self) -> float:
        """Over which a robot whose motors are weak may brake [s]."""
        if self.braking_time is not None:
            return self.braking_time
        longest = _BRAKING_TIMES / self.gains.Gv
        return max(longest, LEAST_PERIODS * self.period) if self.plans else longest

    @property
    def _plan_by_default(self) -> tuple[float, str]:
        """How far ahead is planned [s], and how smoothly."""
        long = self.period > _LONG_PERIOD * (1.0 + 1e-9)
        return _LONG_PLAN if long else _PLAN

    @property
    def _smoothness(self) -> float:
        value = self._plan_by_default[1] if self.smoothness is None else self.smoothness
        if value in _SMOOTHNESS:
            return _SMOOTHNESS[value]
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if number >= _LEAST_SMOOTHNESS and math.isfinite(number):
            return number
        raise ScenarioError(
            f"controller.smoothness: {value} must be {', '.join(_SMOOTHNESS)} or a "
            f"number of at least {_LEAST_SMOOTHNESS:g} m s^2: with less a plan drowns "
            "in rounding"
        )

    def resolved(self, crowded: bool = False) -> Resolved:
        """A number for each that is not given.

        Args:
            crowded: whether there are as many task rows as joints, or more, so that
                targets cannot all be had, and errors of centimetres are usual.
        """
        T, longest, plans = self.T, self.longest_T, self.plans
        others = ()
        if plans and self.balance is None and longest > T:
            count = math.ceil(math.log(longest / T) / math.log(_RATIO))
            others = tuple(
                T * (longest / T) ** (k / count) for k in range(1, count + 1)
            )
        damping, stiffness = self.gains.GvN or self.gains.Gv, 30.0
        if plans:
            # More damping holds arms back that go around each other. As many rows leave
            # next to nothing free, and what they need the least is pulled aside
            # (docs/measurements/crossings.md).
            damping, stiffness = (3.0, 1.0) if crowded else (20.0, 40.0)
        most = 1.0 / self.period
        approach = self._approach(
            float(self.limit_margin),
            min(_APPROACH, most),
            # Slower where motions of others run into limits again and again. Where
            # tasks leave no choice, hands would fall behind at limits: by 82 mm instead
            # of 63 in cmu:02_06.
            min(50.0 if crowded else 20.0, most),
            *(_INFLUENCE, _PLANNED_SPEED if plans else _SPEED),
        )
        return Resolved(
            *(float(T), others, approach),
            float(self._plan_by_default[0] if self.preview is None else self.preview),
            self._smoothness,
            float(damping),
            float(stiffness if self.posture_gain is None else self.posture_gain),
            *((0.1, 0.05) if crowded else (0.04, 0.01)),
        )

    def approach_of_commands(self) -> Approach:
        """The numbers of rows where the nominal is a joint command."""
        rate = min(_APPROACH_OF_COMMANDS, 0.5 / self.period)
        influence = max(_INFLUENCE_OF_COMMANDS, 2.0 * self.margin)
        return self._approach(0.0, rate, math.inf, influence, _SPEED)

    def _approach(self, limit_margin: float, *others: float) -> Approach:
        retreat = _RETREAT, _RETREAT_SPEED, _JOINT_RETREAT_SPEED
        return Approach(float(self.margin), limit_margin, *retreat, *others)

    def among_obstacles(self) -> "LookaheadParameters":
        """These, with one braking time constant, as obstacles that move ask for: that
        over which motors can brake most of the time, unless it is given."""
        return replace(self, braking_time=self.longest_T)

    def speed_limits(self, model: "ControlModel") -> np.ndarray:
        """The largest speed of each joint of a robot's plant.

        Returns:
            (nv,) [rad/s or m/s], infinite where there is none and for the prescribed
            joints, whose speed is the motion's.

        Raises:
            ScenarioError: `velocity_limits` names a joint that the robot does not have,
                or that is not controlled.
        """
        limits = self.velocity_scale * model.velocity_limits
        for name, limit in self.velocity_limits.items():
            where = f"controller.velocity_limits.{name}"
            try:
                joint = find_joint(model.plant, name)
            except ModelError as error:
                raise ScenarioError(f"{where}: {error}") from error
            at = joint.velocity_start()
            if not joint.num_velocities() or at not in model.controlled:
                moves = joint.num_velocities() > 0
                why = "prescribed: the motion moves it" if moves else "fixed"
                raise ScenarioError(f"{where}: the joint is {why}; leave it out")
            limits[at] = limit
        limits[model.prescribed] = np.inf
        return limits


_NUMBERS = tuple(
    entry.name for entry in fields(LookaheadParameters) if entry.name != "smoothness"
)

Parameters = PaperParameters | LookaheadParameters
# What scenarios call them.
CONSTRAINTS: Mapping[str, type] = {
    "none": PaperParameters,
    "paper": PaperParameters,
    "lookahead": LookaheadParameters,
}


def with_constraints(parameters: Parameters, constraints: str) -> Parameters:
    """The parameters of another word of `CONSTRAINTS`, which keep what is shared."""
    if parameters.constraints == constraints:
        return parameters
    kind = CONSTRAINTS[constraints]
    if isinstance(parameters, kind):
        return replace(parameters, constraints=constraints)
    names = [name for name in _SHARED if name != "effort_limits"]
    given = {name: getattr(parameters, name) for name in names}
    if kind is PaperParameters:
        given["constraints"] = constraints
    return kind(**given)
