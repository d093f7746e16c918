"""Parameters of the constraint mode "lookahead"."""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from dataclasses import dataclass, field, replace

from crar_drake.control.checks import check_choice, check_numbers
from crar_drake.equations.lookahead_rows import NOMINAL_SPEED_LIMIT
from crar_drake.errors import ScenarioError

LOST_TARGET = ("brake", "error")
GUARD_NORMS = ("joints", "tasks")

# How smoothly is planned [m s^2].
_SMOOTHNESS = {"closest": 5.7e-5, "balanced": 8e-5, "calm": 2.3e-4}
PRESETS = tuple(_SMOOTHNESS)
# With less rounding hides what joints count: at 3e-9 to 1e-8 laws of two wrists find no
# plan. With this and more an adversary's do (docs/measurements/adversary.md).
LEAST_SMOOTHNESS = 1e-6  # [m s^2]
# With longer control periods a plan shakes: by default there is none [s].
LONGEST_PLANNED_PERIOD = 0.01

# A pair's weight is then up to 1e12, and a double has 16 digits.
LARGEST_RHO = 1.0

# What a parameter is that is not given: without a preview; with one; and with one where
# there are as many task rows as joints, so that targets cannot all be had, and errors
# of centimetres are usual.
_USUAL = {
    "preview": (0.0, 0.1, 0.1),  # [s], how far ahead is planned
    # A plan asks for no jumps as feedback does; 16 would be faster, and no closer.
    "nominal_speed_limit": (NOMINAL_SPEED_LIMIT, 9.0, 9.0),  # [rad/s]
    "approach_rate": (0.0, 200.0, 200.0),  # [1/s], pairs it sees coming
    # Slower where motions of others run into limits again and again. Where tasks leave
    # no choice, hands would fall behind at limits: by 82 mm instead of 63 in cmu:02_06.
    "limit_approach_rate": (0.0, 20.0, 50.0),  # [1/s]
    "farthest_pull": (0.01, 0.01, 0.05),  # [m or rad]
    "null_space_damping": (0.04, 0.04, 0.1),  # [m]
    # Of `CrarParameters`. Without a preview a tenth of Kp, so that tasks come first.
    # With one they do anyway; more damping holds arms back that go around each other.
    # As many rows leave next to nothing free, and what
    # they need the least is pulled aside (docs/measurements/crossings.md).
    "nominal_posture_gain": (30.0, 40.0, 1.0),  # [1/s^2]
    "GvN": (None, 20.0, 3.0),  # [1/s], None for Gv
}
# T with a preview [s], but so many periods at least, for the theorem asks for one. It
# is short since a plan sees obstacles coming: a robot may be near them at speed.
_PREVIEW_HORIZON = 0.012
_PREVIEW_PERIODS = 1.6


def usual(name: str, plans: bool, crowded: bool = False) -> float | None:
    """What a parameter is that is not given.

    Args:
        name: of it.
        plans: whether there is a preview.
        crowded: whether there are as many task rows as joints, or more.
    """
    return _USUAL[name][1 + crowded if plans else 0]


def preview_horizon(period: float) -> float:
    """T with a preview, unless it is given [s], for a control period [s]."""
    return max(_PREVIEW_HORIZON, _PREVIEW_PERIODS * period)


@dataclass
class LookaheadParameters:
    """Parameters of the constraint mode "lookahead", see `equations.lookahead`.

    Attributes:
        horizon: T, over which the robot could brake [s]; by default 12 ms or 1.6
            control periods, whichever is longer, and without a preview 2.5 / Gv.
        longest_horizon: over which it may brake where motors have not the torque to
            brake within `horizon`, as long as that path is clear, too [s], and over
            some in between, see `longer_horizons`; by default 2.5 / Gv if that is
            longer, and without a preview the horizon. Obstacles that move ask for one
            horizon, see `CrarParameters.among_obstacles`.
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
        slip_time_constant: of the low-pass on what the plant did other than commanded,
            which the constraints then expect to go on [s].
        influence_distance: pairs farther apart than this do not count [m].
        nominal_speed_limit: how fast q_s is asked to move at most, in any joint
            [rad/s]; by default 9, and 16 without a preview.
        guard_norm: in which the guard changes the nominal step the least: "joints",
            where all joints weigh the same, or "tasks", where tasks do by their
            weights, and
        guard_damping: nu, what joints count beside them [m]; by default the
            controller's damping.
        approach_rate: kappa, the share of what is left of a margin that the robot may
            come nearer by in a second [1/s]. Pairs and limits are then bounds of the
            guard, and have no weight in stage 1; by default 200/s, or 1 / period if
            that is less. Without a preview it is by default the other way round: they
            weigh by their margins (rho, rho_limits), in both.
        limit_approach_rate: the same of joint limits alone [1/s]; by default 20/s, 50/s
            where there are as many task rows as joints or more, and without a preview
            the approach rate.
        preset: "closest", "balanced" or "calm": by name how smoothly is planned; by
            default "balanced".
        preview: how far ahead accelerations are planned [s], see `equations.preview`; 0
            for not at all: the law is then a feedback of the present error. By default
            0.1, unless there is no preset, and the control period is longer than 10 ms
            or there is `CrarParameters.balance`. With a preview K, Kp and Kv are the
            gains of prescribed joints alone, and GvN damps what tasks leave free, with
        null_space_damping: lambda of the projection on that [m]; by default 0.04, and
            0.1 where there are as many task rows as joints or more.
        smoothness: of the preview, what an acceleration of 1 rad/s^2 of a joint counts
            beside a task error of 1 m [m s^2]: the less, the more closely targets are
            followed; by default that of the preset, and at least 1e-6.
        farthest_pull: of the preview, the error from which on a task pulls no more than
            from there [m or rad]; by default 0.01, and 0.05 with as many rows.
        tracking_error: E, how far each joint of a robot that follows commanded
            positions may be from its command [rad or m]: pairs and limits are kept so
            much farther that the robot keeps them, see `control.tracking_error`; by
            default 0, and
        tracking_errors: joint to its own instead. With an error all distances that the
            mode reports are those that are left for the robot.
        contact_speed: v_ok, slower than which a link may be touched by an obstacle that
            moves by itself [m/s].
        evade: whether links get out of the way of obstacles that move by themselves,
            see `equations.moving_obstacles.evading_rows`.
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
    contact_speed: float = 0.05  # [m/s]
    evade: bool = False
    nominal_speed_limit: float | None = None  # [rad/s]
    guard_norm: str = "joints"
    guard_damping: float | None = None  # [m]
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
        check_choice("controller.lookahead", self, "guard_norm", GUARD_NORMS)
        if self.preset is not None:
            check_choice("controller.lookahead", self, "preset", PRESETS)
        check_numbers(
            "controller.lookahead", self, may_be_zero={"tracking_error", "preview"}
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
    def floor(self) -> float:
        """d_0, the distance that admitted paths keep [m]."""
        return self.distance_margin - self.admission_slack

    @property
    def planned_smoothness(self) -> float:
        """rho of the plan [m s^2]."""
        if self.smoothness is not None:
            return self.smoothness
        return _SMOOTHNESS[self.preset or "balanced"]

    def filled(
        self, period: float, plans: bool, crowded: bool = False
    ) -> "LookaheadParameters":
        """These, with what is usual in the place of what is not given.

        Args:
            period: of the controller [s], in which no margin is used up by more than
                there is.
            plans, crowded: as of `usual`.

        Returns:
            Approach rates are 0 where pairs and limits weigh by their margins.
        """
        names = (
            "preview",
            "nominal_speed_limit",
            "farthest_pull",
            "null_space_damping",
        )
        filled = {
            name: usual(name, plans, crowded)
            for name in names
            if getattr(self, name) is None
        }
        of_pairs, of_limits = self.approach_rate, self.limit_approach_rate
        most = 1.0 / period
        if of_pairs is None:
            of_pairs = min(usual("approach_rate", plans), most)
        if of_limits is None and plans:
            of_limits = min(usual("limit_approach_rate", plans, crowded), most)
        return replace(
            self,
            approach_rate=of_pairs,
            limit_approach_rate=of_pairs if of_limits is None else of_limits,
            smoothness=self.planned_smoothness,
            **filled,
        )
