"""The controller's parameters: the paper's gains, and constraints that hold."""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from dataclasses import dataclass, field

from crar_drake.control.checks import check_choice, check_numbers
from crar_drake.control.modes import MODES
from crar_drake.control.modes.lookahead import LookaheadParameters
from crar_drake.errors import ScenarioError
from crar_drake.robot.collision_pairs import DISTANCES

LEVELS = ("velocity", "acceleration")
CONSTRAINTS = tuple(MODES)
METRICS = ("identity", "inertia")


@dataclass
class CrarParameters:
    """Parameters of the control law; Section IV of the paper gives the gains.

    Attributes:
        level: where alpha comes from: "velocity" (Eq. 10) or "acceleration"
            (Eq. 35).
        constraints: "lookahead" (hold where the robot would come to rest),
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
    lookahead: LookaheadParameters = field(default_factory=LookaheadParameters)

    def validate(self) -> None:
        """Checks every field; YAML loading does not.

        Raises:
            ScenarioError: names the field, its value and what it may be.
        """
        check_choice("controller", self, "level", LEVELS)
        check_choice("controller", self, "constraints", tuple(MODES))
        check_choice("controller", self, "distances", DISTANCES)
        check_choice("controller", self, "metric", METRICS)
        check_numbers(
            "controller",
            self,
            may_be_zero={"nominal_posture_gain", "blend_time", "limit_share"},
        )
        if self.limit_share is not None and self.limit_share > 1.0:
            raise ScenarioError(
                f"controller.limit_share: {self.limit_share} must be at most 1"
            )
        self.lookahead.validate()
        MODES[self.constraints].check(self)

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
