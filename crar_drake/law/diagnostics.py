"""What a control step reports: each part declared once, for the ports and logs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from crar_drake.robot.model import ControlModel


class Diagnostic(NamedTuple):
    """One part of the controller's port `diagnostics`."""

    name: str  # of the part
    size: Callable[[ControlModel], int]  # of it, for a model
    meaning: str  # for people, with units
    field: str = ""  # of `Solution`; by default the name
    logged: bool = True  # whether `SimulationLog` keeps it
    connected: bool = False  # whether it has a port of its own, too

    @property
    def key(self) -> str:
        """What holds the value."""
        return self.field or self.name


# All, in their order in the port.
ALL = (
    Diagnostic(
        "actuation",
        lambda model: model.plant.num_actuated_dofs(),
        "efforts in the plant's actuator order [Nm or N]",
        connected=True,
    ),
    Diagnostic(
        "desired_acceleration",
        lambda model: model.plant.num_velocities(),
        "commanded accelerations of all joints [rad/s^2 or m/s^2]",
        field="acceleration",
        connected=True,
    ),
    Diagnostic(
        "task_error",
        lambda model: model.m,
        "Eq. (11) against desired_tasks [rad, m]",
    ),
    Diagnostic(
        "signed_distances",
        lambda model: len(model.pairs),
        "per watched pair [m]",
    ),
    Diagnostic(
        "constraint_weights",
        lambda model: model.n,
        "diagonal of W, Eq. (27)",
    ),
    Diagnostic(
        "position_command",
        lambda model: model.plant.num_positions() + model.plant.num_velocities(),
        "[q; v] one control period on",
        logged=False,
        connected=True,
    ),
    Diagnostic(
        "status",
        lambda model: 1,
        "0 tracking, 1 blending in, 2 braking because a target is NaN",
    ),
    Diagnostic(
        "torque_limit",
        lambda model: 2,
        "share of the nominal accelerations that the effort limits allowed, and by "
        "which share of its limit the worst actuator was beyond it before clipping",
    ),
    Diagnostic(
        "admission",
        lambda model: 4,
        "how the step was found (0 nominal, 1 corrected, 2 scaled), "
        "the share of the nominal step, the clearance of the next braking path "
        "[m], and whether the present one was clear (1) or not (0)",
    ),
    Diagnostic(
        "balance",
        lambda model: 3,
        "how the step was found where the ground objected (0 nominal, 1 corrected, 2 "
        "scaled), the share of it, and what the ground has left on the next braking "
        "path [m of the weight's arm]; NaN without controller.balance",
    ),
    Diagnostic("T", lambda model: 1, "braking time constant of the step [s]"),
)

# What is missing of the promise that watched pairs stay apart and joints within their
# limits, in a control step; the words of the part "promise", by its number.
GUARANTEED = 0
PROMISES = (
    "guaranteed",
    "law",  # the paper's constraints promise nothing
    "set-up",  # something was warned of when the controller was made
    "locked",  # a joint that counts as locked is elsewhere
    "state",  # no robot has the measured state
    "path",  # the path on which the robot would brake is not clear
    "torque",  # a motor is too weak for what was commanded
)
