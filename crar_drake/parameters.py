"""The controller's parameters, with the paper's values as defaults."""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from dataclasses import dataclass, fields

from crar_drake.errors import ScenarioError
from crar_drake.watched_pairs import DISTANCES

LEVELS = ("velocity", "acceleration")
CONSTRAINTS = ("none", "paper")


@dataclass
class CrarParameters:
    """Parameters of the control law; Section IV of the paper gives the defaults.

    Attributes:
        level: where alpha comes from: "velocity" (Eq. 10) or "acceleration"
            (Eq. 35).
        constraints: "paper" (W of Eq. 27) or "none" (W = I).
        period: control period [s]; the torque is held in between.
        K: velocity-level task gain, Eq. (15) [1/s].
        Kp: acceleration-level position gain, Eq. (14) [1/s^2].
        Kv: acceleration-level velocity gain [1/s]; by default 2 sqrt(Kp).
        Gv: joint velocity gain, Eq. (30) [1/s].
        GvN: null-space gain, Eq. (33) [1/s]; by default Gv.
        damping: lambda of Eq. (34) [m].
        rho, alpha, beta: amplitude, decay [1/m] and exponent of the collision
            potential, Eq. (24), for every pair.
        limit_share: a of Eq. (27); by default 1 / (Nc + 1), Eq. (28).
        blend_time: time over which the targets are blended in from the measured
            pose [s].
        nominal_posture_gain: stiffness towards the input port "nominal_posture"
            in the null space [1/s^2], critically damped; 0 leaves the port out.
        distances: "closed_form" for capsules and spheres, or "scene_graph" for
            all shapes.
    """

    level: str = "acceleration"
    constraints: str = "paper"
    period: float = 1e-3  # [s]
    K: float = 30.0  # [1/s]
    Kp: float = 300.0  # [1/s^2]
    Kv: float | None = None  # [1/s]
    Gv: float = 30.0  # [1/s]
    GvN: float | None = None  # [1/s]
    damping: float = 0.1  # [m]
    rho: float = 1.0
    alpha: float = 50.0  # [1/m]
    beta: float = 2.0
    limit_share: float | None = None
    blend_time: float = 0.5  # [s]
    nominal_posture_gain: float = 0.0  # [1/s^2]
    distances: str = "closed_form"

    def validate(self) -> None:
        """Checks every field; YAML loading does not.

        Raises:
            ScenarioError: names the field, its value and what it may be.
        """
        for name, choices in (
            ("level", LEVELS),
            ("constraints", CONSTRAINTS),
            ("distances", DISTANCES),
        ):
            if getattr(self, name) not in choices:
                raise ScenarioError(
                    f"controller.{name}: {getattr(self, name)!r} is none of "
                    f"{', '.join(choices)}"
                )
        may_be_zero = {"nominal_posture_gain", "blend_time", "limit_share"}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, str) or value is None:
                continue
            allowed = value >= 0.0 if field.name in may_be_zero else value > 0.0
            if not allowed or not math.isfinite(value):
                sign = "not negative" if field.name in may_be_zero else "positive"
                raise ScenarioError(
                    f"controller.{field.name}: {value} must be {sign} and finite"
                )
        if self.limit_share is not None and self.limit_share > 1.0:
            raise ScenarioError(
                f"controller.limit_share: {self.limit_share} must be at most 1"
            )

    @property
    def velocity_gain(self) -> float:
        """Kv of Eq. (14) [1/s]."""
        return 2.0 * math.sqrt(self.Kp) if self.Kv is None else self.Kv

    @property
    def null_space_gain(self) -> float:
        """GvN of Eq. (33) [1/s]."""
        return self.Gv if self.GvN is None else self.GvN
