"""Parameters of the constraint mode "lookahead"."""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from dataclasses import dataclass, field, replace

from crar_drake.control.checks import check_choice, check_numbers
from crar_drake.equations.approach import Approach
from crar_drake.errors import ScenarioError

LOST_TARGET = ("brake", "error")
NOMINALS = ("plan", "paper")

# How smoothly is planned [m s^2].
_SMOOTHNESS = {"closest": 5.7e-5, "balanced": 8e-5, "calm": 2.3e-4}
PRESETS = tuple(_SMOOTHNESS)
# With less rounding hides what joints count: at 3e-9 to 1e-8 laws of two wrists find no
# plan. With this and more an adversary's do (docs/measurements/adversary.md).
LEAST_SMOOTHNESS = 1e-6  # [m s^2]

# What a parameter is that is not given: with the paper's law as the nominal; with a
# plan; and with one where there are as many task rows as joints, so that targets cannot
# all be had, and errors of centimetres are usual.
_USUAL = {
    # A plan asks for no jumps as feedback does; 16 would be faster, and no closer.
    "nominal_speed_limit": (16.0, 9.0, 9.0),  # [rad/s]
    # Slower where motions of others run into limits again and again. Where tasks leave
    # no choice, hands would fall behind at limits: by 82 mm instead of 63 in cmu:02_06.
    "limit_approach_rate": (20.0, 20.0, 50.0),  # [1/s]
    "farthest_pull": (0.01, 0.01, 0.05),  # [m or rad]
    "null_space_damping": (0.04, 0.04, 0.1),  # [m]
    # Of `CrarParameters`. Without a plan a tenth of Kp, so that tasks come first.
    # With one they do anyway; more damping holds arms back that go around each other.
    # As many rows leave next to nothing free, and what
    # they need the least is pulled aside (docs/measurements/crossings.md).
    "nominal_posture_gain": (30.0, 40.0, 1.0),  # [1/s^2]
    "GvN": (None, 20.0, 3.0),  # [1/s], None for Gv
}
# Of pairs [1/s]: a plan sees them coming.
_APPROACH = 200.0
# How far ahead is planned [s], and with control periods of more than 10 ms, with which
# such a plan would shake, together with the smoothness [m s^2].
_PREVIEW, _LONG_PREVIEW, _LONG_SMOOTHNESS = 0.1, 0.16, 2.3e-4
_LONG_PERIOD = 0.01
# T with a plan [s], but so many periods at least, for the theorem asks for one. It is
# short since a plan sees obstacles coming: a robot may be near them at speed.
_PLANNED_T, _PLANNED_PERIODS = 0.012, 1.6


# A longer T is at most so many times the next shorter one. With 2.6, a torso can find
# the path of one not clear and motors too weak for the one before, and lags.
_RATIO = 1.7


def longer_braking_times(T: float, longest: float) -> list[float]:
    """What T may be instead where motors are weak [s]: in equal ratios of at most
    `_RATIO`, the last one the longest; none if that is T itself.

    Args:
        T, longest: the usual one, and the longest [s].
    """
    ratio = longest / T
    count = math.ceil(math.log(ratio) / math.log(_RATIO))
    return [T * ratio ** (k / count) for k in range(1, count + 1)]


def usual(name: str, plans: bool, crowded: bool = False) -> float | None:
    """What a parameter is that is not given.

    Args:
        name: of it.
        plans: whether the nominal is a plan.
        crowded: whether there are as many task rows as joints, or more.
    """
    return _USUAL[name][1 + crowded if plans else 0]


def planned_braking_time(period: float) -> float:
    """T with a plan, unless it is given [s], for a control period [s]."""
    return max(_PLANNED_T, _PLANNED_PERIODS * period)


@dataclass
class LookaheadParameters:
    """Parameters of the constraint mode "lookahead", see `law.step`.

    Attributes:
        nominal: of which law a step is the nearest that is safe: "plan", the
            receding-horizon plan of `law.plan`; or "paper", the paper's law, calm, with
            the controller's gains.
        horizon: T, over which the robot could brake [s]; by default 12 ms or 1.6
            control periods, whichever is longer, and 2.5 / Gv with the nominal "paper",
            or on soles.
        longest_horizon: over which it may brake where motors have not the torque to
            brake within `horizon`, as long as that path is clear, too [s], and over
            some in between, see `longer_braking_times`; by default 2.5 / Gv if that is
            longer. Obstacles that move and soles ask for one T, see
            `CrarParameters.among_obstacles`.
        distance_margin: d_min, the distance that pairs are to keep [m].
        admission_slack: a step is taken only if every pair keeps the safety distance
            d_0 = d_min - admission_slack on all of its braking path [m].
        limit_margin: what joints keep from their limits [rad].
        retreat_rate: gamma, how fast a violation is left [1/s], but at most at
        retreat_speed: of a pair [m/s], and
        joint_retreat_speed: of a joint [rad/s].
        influence_distance: pairs farther apart than this do not count [m].
        nominal_speed_limit: how fast q_s is asked to move at most, in any joint
            [rad/s]; by default 9, and 16 with the nominal "paper".
        approach_rate: kappa, the share of what is left of a margin that the robot may
            come nearer by in a second [1/s]; by default 200/s, or 1 / period if that is
            less.
        limit_approach_rate: the same of joint limits alone [1/s]; by default 20/s, 50/s
            where there are as many task rows as joints or more.
        preset: "closest", "balanced" or "calm": by name how smoothly is planned; by
            default "balanced".
        preview: how far ahead accelerations are planned [s], see `law.plan`; by default
            0.1, and 0.16 with control periods of more than 10 ms. With a plan K, Kp and
            Kv are the gains of prescribed joints alone, and GvN damps what tasks leave
            free, with
        null_space_damping: lambda of the projection on that [m]; by default 0.04, and
            0.1 where there are as many task rows as joints or more.
        smoothness: of the plan, what an acceleration of 1 rad/s^2 of a joint counts
            beside a task error of 1 m [m s^2]: the less, the more closely targets are
            followed; by default that of the preset, 2.3e-4 with control periods of more
            than 10 ms, and at least 1e-6.
        farthest_pull: of the plan, the error from which on a task pulls no more than
            from there [m or rad]; by default 0.01, and 0.05 with as many rows.
        tracking_error: E, how far each joint of a robot that follows commanded
            positions may be from its command [rad or m]: pairs and limits are kept so
            much farther that the robot keeps them, see `control.tracking_error`; by
            default 0, and
        tracking_errors: joint to its own instead. With an error all distances that the
            law bounds are those that are left for the robot.
        contact_speed: v_ok, slower than which a link may be touched by an obstacle that
            moves by itself [m/s].
        evade: whether links get out of the way of obstacles that move by themselves,
            see `equations.moving_obstacles.evading_rows`.
        lost_target: what a NaN in the targets at run time does: "brake" comes to
            rest and blends in again when they are back, "error" raises.
    """

    nominal: str = "plan"
    horizon: float | None = None  # [s]
    longest_horizon: float | None = None  # [s]
    distance_margin: float = 5e-3  # [m]
    admission_slack: float = 1e-3  # [m]
    limit_margin: float = 0.02  # [rad]
    retreat_rate: float = 30.0  # [1/s]
    retreat_speed: float = 0.5  # [m/s]
    joint_retreat_speed: float = 2.0  # [rad/s]
    influence_distance: float = 0.3  # [m]
    lost_target: str = "brake"
    contact_speed: float = 0.05  # [m/s]
    evade: bool = False
    nominal_speed_limit: float | None = None  # [rad/s]
    approach_rate: float | None = None  # [1/s]
    limit_approach_rate: float | None = None  # [1/s]
    preset: str | None = None
    preview: float | None = None  # [s]
    null_space_damping: float | None = None  # [m]
    smoothness: float | None = None  # [m s^2]
    farthest_pull: float | None = None  # [m or rad]
    tracking_error: float | None = None  # [rad or m]
    tracking_errors: dict[str, float] = field(default_factory=dict)  # [rad or m]

    def validate(self) -> None:
        """Raises ScenarioError, naming the field and what it may be."""
        check_choice("controller.lookahead", self, "lost_target", LOST_TARGET)
        check_choice("controller.lookahead", self, "nominal", NOMINALS)
        if self.preset is not None:
            check_choice("controller.lookahead", self, "preset", PRESETS)
        check_numbers(
            "controller.lookahead",
            self,
            may_be_zero={"tracking_error"},
            may_be_infinite={"limit_approach_rate"},
        )
        for joint, error in self.tracking_errors.items():
            if not 0.0 <= error < math.inf:
                raise ScenarioError(
                    f"controller.lookahead.tracking_errors.{joint}: {error} must be "
                    "finite, and not negative"
                )
        if self.smoothness is not None and self.smoothness < LEAST_SMOOTHNESS:
            raise ScenarioError(
                f"controller.lookahead.smoothness: {self.smoothness:g} m s^2 must be "
                f"at least {LEAST_SMOOTHNESS:g}: with less a plan drowns in rounding"
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
    def floor(self) -> float:
        """d_0, the distance that admitted paths keep [m]."""
        return self.distance_margin - self.admission_slack

    @property
    def plans(self) -> bool:
        """Whether the nominal is a plan."""
        return self.nominal == "plan"

    def filled(self, period: float, crowded: bool = False) -> "LookaheadParameters":
        """These, with what is usual in the place of what is not given.

        Args:
            period: of the controller [s], in which no margin is used up by more than
                there is.
            crowded: as of `usual`.
        """
        plans, long = self.plans, period > _LONG_PERIOD * (1.0 + 1e-9)
        most = 1.0 / period
        smoothness = _SMOOTHNESS[self.preset or "balanced"]
        if long and self.preset is None:
            smoothness = _LONG_SMOOTHNESS
        default = {
            "nominal_speed_limit": usual("nominal_speed_limit", plans, crowded),
            "farthest_pull": usual("farthest_pull", plans, crowded),
            "null_space_damping": usual("null_space_damping", plans, crowded),
            "preview": _LONG_PREVIEW if long else _PREVIEW,
            "smoothness": smoothness,
            "approach_rate": min(_APPROACH, most),
            "limit_approach_rate": min(
                usual("limit_approach_rate", plans, crowded), most
            ),
        }
        missing = {n: x for n, x in default.items() if getattr(self, n) is None}
        return replace(self, **missing)

    def approach(self) -> Approach:
        """The numbers of rows, of `filled` parameters."""
        return Approach(
            float(self.distance_margin),
            float(self.limit_margin),
            float(self.retreat_rate),
            float(self.retreat_speed),
            float(self.joint_retreat_speed),
            float(self.approach_rate),
            float(self.limit_approach_rate),
            float(self.influence_distance),
            float(self.nominal_speed_limit),
        )
