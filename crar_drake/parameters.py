"""The controller's parameters: the paper's gains, and the lookahead constraints."""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from dataclasses import dataclass, field, fields

from crar_drake.errors import ScenarioError
from crar_drake.watched_pairs import DISTANCES

LEVELS = ("velocity", "acceleration")
CONSTRAINTS = ("none", "paper", "lookahead")
METRICS = ("identity", "inertia")
ARITHMETICS = ("numpy", "compiled")
LOST_TARGET = ("brake", "error")


@dataclass
class LookaheadParameters:
    """Parameters of the constraint mode "lookahead", see `equations.lookahead`.

    Attributes:
        horizon: T, over which the robot could brake [s]; by default 1 / Gv.
        rho: amplitude of the collision weight; its decay and exponent are the
            controller's alpha and beta.
        rho_limits: rho_JL, amplitude of the joint-limit weight.
        distance_margin: d_min, the distance that pairs keep [m].
        limit_margin: what joints keep from their limits [rad].
        retreat_rate: gamma, how fast a violation is left [1/s], but at most at
        retreat_speed: of a pair [m/s], and
        joint_retreat_speed: of a joint [rad/s].
        slip_time_constant: of the low-pass on what the plant did other than told,
            which the constraints then expect to go on [s].
        influence_distance: pairs farther apart than this do not count [m].
        lost_target: what a NaN in the targets at run time does: "brake" comes to
            rest and blends in again when they are back, "error" raises.
    """

    horizon: float | None = None  # [s]
    rho: float = 1e-4
    rho_limits: float = 0.01
    distance_margin: float = 5e-3  # [m]
    limit_margin: float = 0.02  # [rad]
    retreat_rate: float = 30.0  # [1/s]
    retreat_speed: float = 0.5  # [m/s]
    joint_retreat_speed: float = 2.0  # [rad/s]
    slip_time_constant: float = 0.01  # [s]
    influence_distance: float = 0.3  # [m]
    lost_target: str = "brake"

    def validate(self) -> None:
        """Raises ScenarioError, naming the field and what it may be."""
        _check_choice("controller.lookahead", self, "lost_target", LOST_TARGET)
        _check_numbers("controller.lookahead", self, may_be_zero=set())
        if self.influence_distance <= self.distance_margin:
            raise ScenarioError(
                f"controller.lookahead.influence_distance: {self.influence_distance} "
                f"must be more than distance_margin, {self.distance_margin}"
            )


@dataclass
class CrarParameters:
    """Parameters of the control law; Section IV of the paper gives the gains.

    Attributes:
        level: where alpha comes from: "velocity" (Eq. 10) or "acceleration"
            (Eq. 35).
        constraints: "lookahead" (act where the robot would come to rest),
            "paper" (W of Eq. 27) or "none" (W = I).
        period: control period [s]; the torque is held in between.
        K: velocity-level task gain, Eq. (15) [1/s].
        Kp: acceleration-level position gain, Eq. (14) [1/s^2].
        Kv: acceleration-level velocity gain [1/s]; by default 2 sqrt(Kp).
        Gv: joint velocity gain, Eq. (30) [1/s].
        GvN: null-space gain, Eq. (33) [1/s]; by default Gv.
        Gv_near: adaptive gains, for constraints "paper": Gv then holds away from
            the constraints and this near them, joint by joint, see
            `equations.adaptive_gain` [1/s]; GvN goes along unless it is given.
        metric: of the joint velocities that W weighs, for constraints "paper" and
            "none": "identity", or "inertia" for the dynamically consistent inverse,
            see `equations.composite_weight.inertia_weight`.
        damping: lambda of Eq. (34) [m].
        rho, alpha, beta: amplitude, decay [1/m] and exponent of the collision
            potential, Eq. (24), for every pair.
        limit_share: a of Eq. (27); by default 1 / (Nc + 1), Eq. (28).
        blend_time: time over which the targets are blended in from the measured
            pose [s].
        nominal_posture_gain: stiffness towards the input port "nominal_posture"
            in the null space [1/s^2], with damping of its own besides GvN's; 0 leaves
            the port out.
        respect_effort_limits: whether the commanded torque stays within the
            actuators' effort limits, see `equations.torque_limit`.
        distances: "closed_form" for capsules and spheres, or "scene_graph" for
            all shapes.
        arithmetic: "numpy", or "compiled": a third of the time, needs Numba, and
            covers position tasks, capsules and spheres at the acceleration level.
        lookahead: what the mode "lookahead" needs besides.
    """

    level: str = "acceleration"
    constraints: str = "lookahead"
    period: float = 1e-3  # [s]
    K: float = 30.0  # [1/s]
    Kp: float = 300.0  # [1/s^2]
    Kv: float | None = None  # [1/s]
    Gv: float = 30.0  # [1/s]
    GvN: float | None = None  # [1/s]
    Gv_near: float | None = None  # [1/s]
    metric: str = "identity"
    damping: float = 0.1  # [m]
    rho: float = 1.0
    alpha: float = 50.0  # [1/m]
    beta: float = 2.0
    limit_share: float | None = None
    blend_time: float = 0.5  # [s]
    nominal_posture_gain: float = 0.0  # [1/s^2]
    respect_effort_limits: bool = False
    distances: str = "closed_form"
    arithmetic: str = "numpy"
    lookahead: LookaheadParameters = field(default_factory=LookaheadParameters)

    def validate(self) -> None:
        """Checks every field; YAML loading does not.

        Raises:
            ScenarioError: names the field, its value and what it may be.
        """
        _check_choice("controller", self, "level", LEVELS)
        _check_choice("controller", self, "constraints", CONSTRAINTS)
        _check_choice("controller", self, "distances", DISTANCES)
        _check_choice("controller", self, "arithmetic", ARITHMETICS)
        _check_choice("controller", self, "metric", METRICS)
        _check_numbers(
            "controller",
            self,
            may_be_zero={"nominal_posture_gain", "blend_time", "limit_share"},
        )
        if self.limit_share is not None and self.limit_share > 1.0:
            raise ScenarioError(
                f"controller.limit_share: {self.limit_share} must be at most 1"
            )
        self.lookahead.validate()
        if self.constraints == "lookahead" and self.level == "velocity":
            raise ScenarioError(
                "controller.level: the lookahead constraints choose accelerations; "
                "use level acceleration, or constraints paper"
            )
        if self.constraints == "lookahead" and self.metric != "identity":
            raise ScenarioError(
                f"controller.metric: {self.metric!r} belongs to constraints paper or "
                "none; the lookahead constraints have a weight of their own"
            )
        if self.constraints != "paper" and self.Gv_near is not None:
            raise ScenarioError(
                f"controller.Gv_near: {self.Gv_near} belongs to constraints paper, "
                f"whose weights say what is near; they are {self.constraints!r}"
            )

    @property
    def velocity_gain(self) -> float:
        """Kv of Eq. (14) [1/s]."""
        return 2.0 * math.sqrt(self.Kp) if self.Kv is None else self.Kv

    @property
    def null_space_gain(self) -> float:
        """GvN of Eq. (33) [1/s]."""
        return self.Gv if self.GvN is None else self.GvN

    @property
    def braking_horizon(self) -> float:
        """T of the lookahead [s]."""
        return (
            1.0 / self.Gv
            if self.lookahead.horizon is None
            else (self.lookahead.horizon)
        )


def _check_choice(where: str, parameters, name: str, choices: tuple[str, ...]) -> None:
    value = getattr(parameters, name)
    if value not in choices:
        raise ScenarioError(
            f"{where}.{name}: {value!r} is none of {', '.join(choices)}"
        )


def _check_numbers(where: str, parameters, may_be_zero: set[str]) -> None:
    """Every number positive and finite; zero only where it means "off"."""
    for entry in fields(parameters):
        value = getattr(parameters, entry.name)
        if not isinstance(value, int | float) or isinstance(value, bool):
            continue
        zero = entry.name in may_be_zero
        if not math.isfinite(value) or value < 0.0 or (value == 0.0 and not zero):
            raise ScenarioError(
                f"{where}.{entry.name}: {value} must be "
                f"{'not negative' if zero else 'positive'} and finite"
            )
