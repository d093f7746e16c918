"""What a control step is asked, what it answers, and what it leaves to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from crar_drake.equations.references import BlendStart
from crar_drake.equations.vectors import is_finite
from crar_drake.errors import CrarError

# Values of the controller's output port "status".
STATUS_TRACKING = 0.0  # the targets as given
STATUS_BLENDING = 1.0  # on the way onto the targets
STATUS_BRAKING = 2.0  # a target is NaN: coming to rest
STATUS_IMPLAUSIBLE = 3.0  # no robot has the measured state: coming to rest


class InputError(CrarError):
    """A value that reached the controller at run time cannot be used."""


@dataclass(slots=True)
class Targets:
    """What one control step is asked to do.

    Attributes:
        tasks: (layout.size,) [x_d; v_d; a_d], see `TaskLayout`.
        prescribed: (model.prescribed_size,) [q_p; q_dot_p; q_ddot_p] of the prescribed
            joints.
        nominal_posture: (n,) positions that the null space is drawn to; (0,) if the
            parameter `nominal_posture_gain` is 0.
        names: of the three, for errors.
    """

    tasks: np.ndarray
    prescribed: np.ndarray
    nominal_posture: np.ndarray
    names: tuple[str, str, str] = ("tasks", "prescribed", "nominal_posture")

    def finite(self) -> bool:
        """Whether there is no NaN or infinite value among the targets."""
        return (
            is_finite(self.tasks)
            and is_finite(self.prescribed)
            and is_finite(self.nominal_posture)
        )

    def check(self, time: float) -> None:
        """Raises InputError that names the target with a NaN or infinite value."""
        values = (self.tasks, self.prescribed, self.nominal_posture)
        for name, value in zip(self.names, values, strict=True):
            check_finite(name, value, time)


@dataclass(slots=True)
class Memory:
    """What one control step leaves to the next; never changed in place.

    Attributes:
        tick: number of the control step that wrote it; -1 before the first.
        start_time: when blending began [s], None if it has yet to.
        start: what was measured then; None if it has yet to begin.
        v, vdot: (nv,) measured velocities and commanded accelerations of that step;
            None where the robot braked.
        state: (nq,), (nv,) what was measured, with velocities that were believed; None
            before the first step.
        kept: the constraint mode's own.
        governed: (layout.size,) the targets as they were governed; None without a
            governor, and where the targets were lost.
    """

    tick: int = -1
    start_time: float | None = None
    start: BlendStart | None = None
    v: np.ndarray | None = None
    vdot: np.ndarray | None = None
    kept: Any = None
    governed: np.ndarray | None = None
    state: tuple[np.ndarray, np.ndarray] | None = None


@dataclass(slots=True)
class Solution:
    """The results of one control step.

    Attributes:
        actuation: (nu,) efforts of the accelerations at the state that they were last
            computed for, in the order of the plant's actuators [Nm or N].
        acceleration: (nv,) commanded accelerations of all joints: alpha_c of
            Eq. (30) for the controlled, the desired motion's for the prescribed. They
            are held for a control period.
        task_error: (m,) Eq. (11) against the targets as given, before the governor,
            blending and task weights [rad, m].
        signed_distances: (Nc,) per watched pair [m].
        constraint_weights: (n,) diagonal of W.
        position_command: (nq + nv,) the q and v that the accelerations lead to
            in one control period, see `equations.prediction`; of unit quaternions.
        constrained_velocity: (n,) q_dot_c of Eq. (15) [rad/s].
        status: (1,) STATUS_TRACKING, STATUS_BLENDING, STATUS_BRAKING or
            STATUS_IMPLAUSIBLE.
        torque_limit: (2,) how much the effort limits left of the way from braking to
            the wish, 1 where they are not active or not respected; and by which share
            of its limit the worst actuator was beyond it before clipping, see
            `equations.torque_limit`. The share is decided in the control step; the
            excess is that of `actuation`.
        root_force: (nv,) generalized forces that a free root must be pushed with, at
            the state of `actuation`, 0 for all other joints [Nm, N]; (0,) if nothing is
            free.
        of_mode: the constraint mode's own diagnostics, by name.
    """

    actuation: np.ndarray
    acceleration: np.ndarray
    task_error: np.ndarray
    signed_distances: np.ndarray
    constraint_weights: np.ndarray
    position_command: np.ndarray
    constrained_velocity: np.ndarray
    status: np.ndarray
    torque_limit: np.ndarray
    root_force: np.ndarray = field(default_factory=lambda: np.zeros(0))
    of_mode: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def resting_margins(self) -> np.ndarray:
        """(2,) where the robot would come to rest: the smallest distance [m] and the
        smallest margin to a joint limit [rad]; NaN unless constraints are
        "lookahead"."""
        return self.of_mode.get("resting_margins", np.full(2, np.nan))

    @property
    def admission(self) -> np.ndarray:
        """(4,) how the step was admitted (0 as wished, 1 corrected, 2 scaled towards
        braking), the share of the wish, a bound from below for all distances on the
        next braking path [m], and 1 if the present one is clear, else 0, the last two
        NaN if a watched pair is not examined; all NaN unless constraints are
        "lookahead"."""
        return self.of_mode.get("admission", np.full(4, np.nan))


@dataclass(slots=True)
class ControlStep:
    """A control step's results and what it leaves to the next.

    Attributes:
        solution: the results; None before the first step.
        memory: for the next step.
        torque_tick: which torque tick of the control period its torque is of; 0 is
            the control step itself.
    """

    solution: Solution | None
    memory: Memory
    torque_tick: int = 0

    def __deepcopy__(self, memo: dict) -> ControlStep:
        return self  # Drake copies states often; nothing here is ever changed.


def check_finite(name: str, value: np.ndarray, time: float) -> None:
    """Raises InputError, with the port or argument and the time, on NaN or inf."""
    if not np.isfinite(value).all():
        bad = np.flatnonzero(~np.isfinite(value))
        raise InputError(
            f"{name} has a NaN or infinite value at t = {time:g} s "
            f"(entries {', '.join(map(str, bad[:8]))}"
            f"{', ...' if len(bad) > 8 else ''}); check what is connected to it"
        )
