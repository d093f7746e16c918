"""What a control step answers, and what is reported of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from crar_drake.robot.model import ControlModel

# Values of the diagnostic "status".
STATUS_TRACKING = 0.0  # the targets as given
STATUS_BLENDING = 1.0  # on the way onto the targets
STATUS_BRAKING = 2.0  # a target is NaN: coming to rest
STATUS_IMPLAUSIBLE = 3.0  # no robot has the measured state: coming to rest
STATUS_WORDS = {
    STATUS_TRACKING: "tracking",
    STATUS_BLENDING: "blending",
    STATUS_BRAKING: "braking",
    STATUS_IMPLAUSIBLE: "braking",
}

# The parts of the port `diagnostics` in their order, and their sizes for a model: as
# the attributes of `Solution`, but "desired_acceleration" is `acceleration`.
PARTS: dict[str, Callable[[ControlModel], int]] = {
    "actuation": lambda model: model.plant.num_actuated_dofs(),
    "desired_acceleration": lambda model: model.plant.num_velocities(),
    "task_error": lambda model: model.m,
    "signed_distances": lambda model: len(model.pairs),
    "constraint_weights": lambda model: model.n,
    "position_command": lambda model: model.plant.num_multibody_states(),
    "status": lambda model: 1,
    "torque_limit": lambda model: 2,
    "admission": lambda model: 4,
    "balance": lambda model: 3,
    "T": lambda model: 1,
}

# What is missing of the promise that watched pairs stay apart and joints within their
# limits, in a control step; the words of the part "promise", by its number.
PROMISES = (
    "guaranteed",
    "law",  # the paper's constraints promise nothing
    "set-up",  # something was warned of when the controller was made
    "locked",  # a joint that counts as locked is elsewhere
    "state",  # no robot has the measured state
    "path",  # the path on which the robot would brake is not clear
    "torque",  # a motor is too weak for what was commanded
)
GUARANTEED = 0

_NAN = np.full(4, np.nan)


@dataclass(slots=True)
class Solution:
    """The results of one control step.

    Attributes:
        acceleration: (nv,) commanded accelerations of all joints: alpha_c of
            Eq. (30) for the controlled, the desired motion's for the prescribed. They
            are held for a control period.
        task_error: (m,) Eq. (11) against the targets as given, before blending and task
            weights [rad, m].
        constraint_weights: (n,) diagonal of W, Eq. (27).
        constrained_velocity: (n,) q_dot_c of Eq. (15) [rad/s].
        admission: (4,) how the step was found (0 nominal, 1 corrected, 2 scaled towards
            braking), the share of the nominal step, a bound from below for all
            distances on the next braking path [m], and 1 if joints are within their
            limits and the present one is clear, else 0, see `docs/theory/theorem.md`.
            This and the next two are NaN unless constraints are "lookahead".
        balance: (3,) the same where the ground objected, without the last, and what it
            has left [m of the weight's arm]; NaN without `controller.balance`.
        T: (1,) braking time constant of the step [s].
        actuation: (nu,) efforts of the accelerations at the state that they were last
            computed for, in the order of the plant's actuators [Nm or N].
        position_command: (nq + nv,) the q and v that the accelerations lead to
            in one control period, see `law.prediction`.
        status: (1,) 0 tracking, 1 blending in, 2 braking without targets, 3 braking
            since no robot has the measured state: STATUS_TRACKING, STATUS_BLENDING,
            STATUS_BRAKING, STATUS_IMPLAUSIBLE.
        torque_limit: (2,) how much the step left of the way from braking to the
            nominal accelerations where motors had not the torque for these, else 1; and
            by which share of its limit the worst actuator was beyond it before
            clipping. The share is decided in the control step; the excess is that of
            `actuation`.
        obstacle: that moves by itself, and the link that it holds back; None of none.
        measured: the model, and (nq,) where the robot was in the control step.
    """

    acceleration: np.ndarray
    task_error: np.ndarray
    constraint_weights: np.ndarray
    constrained_velocity: np.ndarray
    admission: np.ndarray = field(default_factory=lambda: _NAN[:4])
    balance: np.ndarray = field(default_factory=lambda: _NAN[:3])
    T: np.ndarray = field(default_factory=lambda: _NAN[:1])
    actuation: np.ndarray | None = None
    position_command: np.ndarray | None = None
    status: np.ndarray | None = None
    torque_limit: np.ndarray | None = None
    obstacle: tuple[str, str] | None = None
    measured: tuple[ControlModel, np.ndarray] | None = None

    @property
    def signed_distances(self) -> np.ndarray:
        """(Nc,) per watched pair, where the robot was in the control step [m]."""
        model, q = self.measured
        return model.signed_distances(q)
