"""What a control step tells: each declared once, for ports, loggers and logs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from crar_drake.robot.model import ControlModel


class Diagnostic(NamedTuple):
    """One output of the control law.

    Attributes:
        port: of `CrarController`.
        size: of the port, for a model.
        meaning: for people, with units.
        field: of `Solution`, or of a mode's diagnostics; by default the port's name.
        logged: whether `SimulationLog` keeps it.
    """

    port: str
    size: Callable[[ControlModel], int]
    meaning: str
    field: str = ""
    logged: bool = True

    @property
    def name(self) -> str:
        """The field that holds the value."""
        return self.field or self.port


# Those of every mode, in the order of the controller's ports.
OF_LAW = (
    Diagnostic(
        "actuation",
        lambda model: model.plant.num_actuated_dofs(),
        "efforts in the plant's actuator order [Nm or N]",
    ),
    Diagnostic(
        "desired_acceleration",
        lambda model: model.plant.num_velocities(),
        "commanded accelerations of all joints [rad/s^2 or m/s^2]",
        field="acceleration",
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
    ),
    Diagnostic(
        "status",
        lambda model: 1,
        "0 tracking, 1 blending in, 2 braking because a target is NaN",
    ),
    Diagnostic(
        "torque_limit",
        lambda model: 2,
        "share of the wish that the effort limits allowed, and by which share of its "
        "limit the worst actuator was beyond it before clipping",
    ),
)
