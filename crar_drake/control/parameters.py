"""The controller's parameters: the paper's gains, and constraints that hold."""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from crar_drake.control.checks import check_choice, check_numbers
from crar_drake.control.lookahead_parameters import (
    LookaheadParameters,
    planned_braking_time,
    usual,
)
from crar_drake.errors import ModelError, ScenarioError
from crar_drake.robot.collision_pairs import DISTANCES
from crar_drake.robot.description import find_joint, is_speed_limit

if TYPE_CHECKING:
    from crar_drake.robot.model import ControlModel

CONSTRAINTS = ["none", "paper", "lookahead"]
LEVELS = ("velocity", "acceleration")
METRICS = ("identity", "inertia")

# A torque loop of 1 kHz is usual, and enough [s].
_TORQUE_PERIOD = 1e-3

# The braking horizon, in time constants of the velocity loop, unless it is given. A
# short one asks of motors what they do not have; a long one stops far from obstacles.
_BRAKING_TIMES = 2.5


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


@dataclass
class CrarParameters:
    """Parameters of the control law; Section IV of the paper gives the gains.

    Attributes:
        level: where alpha comes from: "velocity" (Eq. 10) or "acceleration"
            (Eq. 35).
        constraints: "lookahead" (hold where the robot would come to rest),
            "paper" (W of Eq. 27) or "none" (W = I).
        period: control period [s]; the accelerations are held in between.
        latency: from a state of the robot until a command that answers it acts on the
            robot [s]; the law predicts the state then, by what it has commanded since.
            By default 0.
        K: velocity-level task gain, Eq. (15) [1/s].
        Kp: acceleration-level position gain, Eq. (14) [1/s^2].
        Kv: acceleration-level velocity gain [1/s]; by default 2 sqrt(Kp).
        Gv: joint velocity gain, Eq. (30) [1/s].
        GvN: null-space gain, Eq. (33) [1/s]; by default Gv, and with a preview 20, or
            3 where there are as many task rows as joints or more.
        metric: of the joint velocities that W weighs, for constraints "paper" and
            "none": "identity", or "inertia" for the dynamically consistent inverse,
            see `equations.composite_weight.inertia_weight`.
        damping: lambda of Eq. (34) [m].
        rho, alpha, beta: amplitude, decay [1/m] and exponent of the collision
            potential, Eq. (24), for every pair.
        limit_share: a of Eq. (27); by default 1 / (Nc + 1), Eq. (28).
        blend_time: time over which the targets are blended in from the measured
            pose [s].
        nominal_posture_gain: stiffness towards a nominal posture in the null space
            [1/s^2], with damping of its own besides GvN's: where fewer task rows than
            joints leave a choice, elbows stay bent and joints off their limits. The
            posture is the input port "nominal_posture", or where nothing is connected
            the robot's rest posture, with a preview only where a joint nears its limit;
            0 leaves the port out. By default 30 with constraints "lookahead", 40 with a
            preview, or 1 where there are as many task rows as joints or more, and 0
            with the others, which are the paper to the letter.
        respect_effort_limits: whether the commanded torque stays within the effort
            limits of the controlled joints, see `equations.torque_limit`; by default
            with constraints "lookahead" alone, for the others are the paper to the
            letter. Without finite limits in the robot's file it changes nothing.
        velocity_scale: share of the robot's velocity limits that may be used; infinite
            lifts them. Constraints "lookahead" respects them; by the others' runs
            they are only judged.
        velocity_limits: joint to its largest speed [rad/s or m/s], instead of the
            robot's times `velocity_scale`; infinite for none.
        distances: "closed_form" for all but cylinders and such, or "scene_graph" for
            all shapes.
        lookahead: what the mode "lookahead" needs besides.
        balance: of a robot that stands on its soles, what it may ask of the ground, see
            `equations.balance`; by default nobody asks. It needs constraints
            "lookahead", and a description with soles whose base is fixed.
    """

    level: str = "acceleration"
    constraints: str = "lookahead"
    period: float = 1e-3  # [s]
    latency: float = 0.0  # [s]
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
    blend_time: float = 0.5  # [s]
    nominal_posture_gain: float | None = None  # [1/s^2]
    respect_effort_limits: bool | None = None
    velocity_scale: float = 1.0
    velocity_limits: dict[str, float] = field(default_factory=dict)
    distances: str = "closed_form"
    lookahead: LookaheadParameters = field(default_factory=LookaheadParameters)
    balance: BalanceParameters | None = None

    def validate(self) -> None:
        """Checks every field; YAML loading does not.

        Raises:
            ScenarioError: names the field, its value and what it may be.
        """
        check_choice("controller", self, "constraints", tuple(CONSTRAINTS))
        check_choice("controller", self, "level", LEVELS)
        check_choice("controller", self, "distances", DISTANCES)
        check_choice("controller", self, "metric", METRICS)
        check_numbers(
            "controller",
            self,
            may_be_zero={
                "nominal_posture_gain",
                "blend_time",
                "limit_share",
                "latency",
            },
            may_be_infinite={"velocity_scale"},
        )
        for joint, limit in self.velocity_limits.items():
            if not is_speed_limit(limit):
                raise ScenarioError(
                    f"controller.velocity_limits.{joint}: {limit!r} must be positive "
                    "(.inf for no limit)"
                )
        if self.limit_share is not None and self.limit_share > 1.0:
            raise ScenarioError(
                f"controller.limit_share: {self.limit_share} must be at most 1"
            )
        self.lookahead.validate()
        if self.constraints == "lookahead":
            self.check_lookahead()
        if self.balance is not None:
            self.balance.validate()
            if self.constraints != "lookahead":
                raise ScenarioError(
                    f"controller.balance: constraints {self.constraints!r} look at no "
                    "braking path; use lookahead"
                )
        self._check_gains()

    def _check_gains(self) -> None:
        """Raises ScenarioError where the feedback diverges in discrete time.

        A task's error obeys x'' = -P x - D x', with D = Kv + Gv and P = Kp + Gv K
        (Eqs. 14, 30 at the acceleration level). The acceleration is held for a period
        h, by a plant whose steps d are at most that long; then the two eigenvalues of
        (x, h x') are inside the unit circle (Jury's criterion) if and only if

            D h + P h d / 2 < 2    and    D > P (h - d) / 2.

        The worst of d between 0 and h counts.
        """
        if self.level == "velocity":
            return
        h = self.period
        D = self.velocity_gain + self.Gv
        P = self.Kp + self.Gv * self.K
        if D * h + 0.5 * P * h * h < 2.0 and D > 0.5 * P * h:
            return
        longest = min(2.0 * D / P, (math.sqrt(D * D + 4.0 * P) - D) / P)
        raise ScenarioError(
            f"controller: with a velocity gain Kv + Gv = {D:g}/s and a position gain "
            f"Kp + Gv K = {P:g}/s^2 the feedback diverges at a control period of {h:g} "
            f"s; lower the gains, or choose a period below {longest:.2g} s"
        )

    def torque_ticks(self, plant_step: float) -> int:
        """How often the torque of the held accelerations is computed in a control
        period: every millisecond, or every step of a plant whose steps are longer; of
        what divides the period, the longest such time that is not longer.

        Args:
            plant_step: time step of the discrete plant [s]; 0 for a continuous one.
        """
        longest = max(plant_step, _TORQUE_PERIOD) * (1.0 + 1e-6)
        if not plant_step:
            return math.ceil(self.period / longest)
        steps = max(1, round(self.period / plant_step))
        return next(
            ticks
            for ticks in range(1, steps + 1)
            if steps % ticks == 0 and steps // ticks * plant_step <= longest
        )

    def torque_period_for(self, plant_step: float) -> float:
        """The time between two computations of the torque [s].

        Args:
            plant_step: as of `torque_ticks`.
        """
        ticks = self.torque_ticks(plant_step)
        period = self.period / ticks
        # With the plant's own number the events of both come at the same instants.
        rounding = ticks > 1 and abs(period - plant_step) <= 1e-12 * plant_step
        return plant_step if rounding else period

    @property
    def velocity_gain(self) -> float:
        """Kv of Eq. (14) [1/s]."""
        return 2.0 * math.sqrt(self.Kp) if self.Kv is None else self.Kv

    def null_space_gains(self, crowded: bool = False) -> tuple[float, float]:
        """GvN of Eq. (33) [1/s], and the stiffness towards the nominal posture [1/s^2],
        0 for none.

        Args:
            crowded: as of `lookahead_parameters.usual`.
        """
        plans = self.plans
        damping, stiffness = self.GvN, self.nominal_posture_gain
        if damping is None:
            damping = usual("GvN", plans, crowded) or self.Gv
        if stiffness is None:
            stiffness = 0.0
            if self.constraints == "lookahead":
                stiffness = usual("nominal_posture_gain", plans, crowded)
        return damping, stiffness

    @property
    def null_space_gain(self) -> float:
        """GvN of Eq. (33), where tasks leave a choice [1/s]."""
        return self.null_space_gains()[0]

    @property
    def posture_gain(self) -> float:
        """Stiffness towards the nominal posture, there [1/s^2]; 0 for none."""
        return self.null_space_gains()[1]

    @property
    def limits_efforts(self) -> bool:
        """Whether commanded torques stay within the effort limits that there are."""
        if self.respect_effort_limits is None:
            return self.constraints == "lookahead"
        return self.respect_effort_limits

    def effort_limits(self, model: "ControlModel") -> np.ndarray:
        """The largest effort of each actuator of a robot's plant that is commanded.

        Returns:
            (nu,) [Nm or N], infinite where there is none or it is not respected, and
            for the prescribed joints, whose acceleration is the motion's.
        """
        if not self.limits_efforts:
            return np.full_like(model.actuator_limits, np.inf)
        limits = model.actuator_limits.copy()
        for index in model.plant.GetJointActuatorIndices():
            actuator = model.plant.get_joint_actuator(index)
            if actuator.joint().velocity_start() in model.prescribed:
                start = actuator.input_start()
                limits[start : start + actuator.num_inputs()] = np.inf
        return limits

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
            start = joint.velocity_start()
            columns = range(start, start + joint.num_velocities())
            if not set(columns) & set(model.controlled.tolist()):
                why = "prescribed: the motion moves it" if columns else "fixed"
                raise ScenarioError(f"{where}: the joint is {why}; leave it out")
            limits[columns] = limit
        limits[model.prescribed] = np.inf
        return limits

    @property
    def plans(self) -> bool:
        """Whether the nominal is a plan."""
        return self.constraints == "lookahead" and self.lookahead.plans

    @property
    def braking_horizon(self) -> float:
        """T of the lookahead [s]."""
        if self.lookahead.horizon is not None:
            return self.lookahead.horizon
        if self.plans and self.balance is None:
            return planned_braking_time(self.period)
        return _BRAKING_TIMES / self.Gv

    @property
    def longest_braking_horizon(self) -> float:
        """Over which the lookahead may brake where motors are weak [s]."""
        if self.lookahead.longest_horizon is not None:
            return self.lookahead.longest_horizon
        longest = _BRAKING_TIMES / self.Gv if self.plans else 0.0
        return max(self.braking_horizon, longest)

    def check_lookahead(self) -> None:
        """Raises ScenarioError where a parameter does not go with the lookahead."""
        if self.level == "velocity":
            raise ScenarioError(
                "controller.level: the lookahead constraints choose accelerations; "
                "use level acceleration, or constraints paper"
            )
        T = self.braking_horizon
        if self.period > T:
            raise ScenarioError(
                f"controller.period: {self.period:g} s must be at most the "
                f"braking horizon, {T:g} s (controller.lookahead.horizon)"
            )
        ahead = self.lookahead
        if ahead.longest_horizon is not None and ahead.longest_horizon < T:
            raise ScenarioError(
                f"controller.lookahead.longest_horizon: {ahead.longest_horizon:g} s "
                f"must be at least the braking horizon, {T:g} s "
                "(controller.lookahead.horizon)"
            )
        for name in ("approach_rate", "limit_approach_rate"):
            rate = getattr(ahead, name) or 0.0
            if math.isfinite(rate) and rate * self.period > 1.0 + 1e-9:
                raise ScenarioError(
                    f"controller.lookahead.{name}: at a control period of "
                    f"{self.period:g} s {rate:g}/s would lead beyond the margin "
                    f"within a period; choose at most {1.0 / self.period:g}/s"
                )
        if self.metric != "identity" and self.plans:
            raise ScenarioError(
                f"controller.metric: {self.metric!r} belongs to the paper's law "
                "(constraints paper or none, or lookahead.nominal: paper)"
            )

    def among_obstacles(self) -> "CrarParameters":
        """These, with one braking horizon, as obstacles that move ask for.

        It is 2.5 / Gv, over which motors can brake most of the time, unless one of the
        two horizons is given.
        """
        ahead = self.lookahead
        horizon, longest = ahead.horizon, ahead.longest_horizon
        if longest is None:
            horizon = longest = horizon or self.longest_braking_horizon
        ahead = replace(
            ahead, horizon=horizon or self.braking_horizon, longest_horizon=longest
        )
        return replace(self, lookahead=ahead)
