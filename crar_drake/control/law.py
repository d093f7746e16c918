"""One control step, from state and targets to accelerations and torque.

This is the order of the paper: error, references, weights, inverse, velocity level,
acceleration level, resolved acceleration, inverse dynamics. There is no Drake system
here: `CrarController` wraps it for diagrams, and `ControlLaw.step` serves a user's
own loop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from crar_drake.control.modes import MODES
from crar_drake.control.modes.mode import Before, Resolved
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations.blending import smooth_step
from crar_drake.equations.kinematics import FromDrake, evaluate_state
from crar_drake.equations.lookahead import resting_configuration
from crar_drake.equations.references import Answer, BlendStart, TaskGains, Wanted
from crar_drake.equations.torque_limit import limit_torque
from crar_drake.errors import CrarError
from crar_drake.robot.model import ControlModel, Workspace

# Values of the controller's output port "status".
STATUS_TRACKING = 0.0  # the targets as given
STATUS_BLENDING = 1.0  # on the way onto the targets
STATUS_BRAKING = 2.0  # a target is NaN: coming to rest


UNLIMITED = np.array([1.0, 0.0])  # Solution.torque_limit
_NOTHING = np.zeros(0)


class InputError(CrarError):
    """A value that reached the controller at run time cannot be used."""


@dataclass(slots=True)
class Targets:
    """What one control step is asked to do.

    Attributes:
        tasks: (layout.size,) [x_d; v_d; a_d], see `TaskLayout`.
        prescribed: (3 n_p,) [q_p; q_dot_p; q_ddot_p] of the prescribed joints.
        nominal_posture: (n,) positions that the null space is drawn to; (0,) unless
            the parameter `nominal_posture_gain` is set.
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
        qdot, qddot: (n,) measured velocity and commanded acceleration of the
            controlled joints in that step; None where the targets were lost.
        kept: the constraint mode's own.
    """

    tick: int = -1
    start_time: float | None = None
    start: BlendStart | None = None
    qdot: np.ndarray | None = None
    qddot: np.ndarray | None = None
    kept: Any = None


@dataclass(slots=True)
class Solution:
    """The results of one control step.

    Attributes:
        actuation: (nu,) efforts, in the order of the plant's actuators [Nm or N].
        acceleration: (nv,) commanded accelerations of all joints: alpha_c of
            Eq. (30) for the controlled, the desired motion's for the prescribed.
        task_error: (m,) Eq. (11) against the targets as given, before blending
            and task weights [rad, m].
        signed_distances: (Nc,) per watched pair [m].
        constraint_weights: (n,) diagonal of W.
        position_command: (nq + nv,) the q and v that the accelerations lead to
            in one control period.
        constrained_velocity: (n,) q_dot_c of Eq. (15) [rad/s].
        status: (1,) STATUS_TRACKING, STATUS_BLENDING or STATUS_BRAKING.
        torque_limit: (2,) share theta of the wish that the effort limits allowed,
            1 where they are not active or not respected, and by which share of its
            limit the worst actuator was beyond it before clipping, see
            `equations.torque_limit`.
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
    of_mode: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def resting_margins(self) -> np.ndarray:
        """(2,) where the robot would come to rest: the smallest distance [m] and the
        smallest margin to a joint limit [rad]; NaN unless constraints are
        "lookahead"."""
        return self.of_mode.get("resting_margins", np.full(2, np.nan))


@dataclass(slots=True)
class ControlStep:
    """A control step's results and what it leaves to the next.

    Attributes:
        solution: the results; None before the first step.
        memory: for the next step.
    """

    solution: Solution | None
    memory: Memory

    def __deepcopy__(self, memo: dict) -> ControlStep:
        return self  # Drake copies states often; nothing here is ever changed.


class ControlLaw:
    """The constrained resolved acceleration of a robot model and its torque.

    Attributes:
        model: kinematics, distances, dynamics.
        parameters: gains and modes.
        mode: of the constraints.
    """

    def __init__(
        self, model: ControlModel, parameters: CrarParameters | None = None
    ) -> None:
        """
        Raises:
            ScenarioError: a parameter is out of range.
        """
        self.model = model
        self.parameters = parameters or CrarParameters()
        self.parameters.validate()
        gains = self.parameters
        # Always of one type, lest functions be compiled for another.
        self._blend_time = float(gains.blend_time)
        self._braking_horizon = float(gains.braking_horizon)
        self._period = float(gains.period)
        self._with_posture = gains.nominal_posture_gain > 0.0
        task_gains = TaskGains(
            float(gains.K),
            float(gains.Kp),
            float(gains.velocity_gain),
            float(gains.nominal_posture_gain),
            model.row_weights if model.weighs_rows else _NOTHING,
        )
        self.mode = MODES[gains.constraints](model, gains, task_gains)
        self.reset()

    def compile(self) -> None:
        """Compiles what has yet to be, by a step at rest that leaves nothing behind."""
        model = self.model
        q = model.rest_positions()
        v = np.zeros(model.plant.num_velocities())
        posture = q[model.controlled] if self._with_posture else _NOTHING
        prescribed = np.concatenate((q[model.prescribed], np.zeros(2 * model.n_p)))
        targets = Targets(model.tasks_at(q), prescribed, posture)
        self.solve(model.MakeWorkspace(), Memory(), 0, 0.0, q, v, targets)

    def reset(self) -> None:
        """Makes `step` forget its past: the next call is a first step."""
        self._workspace = self.model.MakeWorkspace()
        self._memory = Memory()

    def step(
        self,
        q: np.ndarray,
        v: np.ndarray,
        tasks: np.ndarray,
        prescribed: np.ndarray | None = None,
        nominal_posture: np.ndarray | None = None,
    ) -> Solution:
        """The next control step, for a loop without a simulator.

        Call it once a control period; it counts the periods and remembers the
        previous step.

        Args:
            q: (nq,) measured positions of the whole plant.
            v: (nv,) measured velocities.
            tasks: (layout.size,) [x_d; v_d; a_d]; `model.layout.pack` makes one.
            prescribed: (3 n_p,) [q_p; q_dot_p; q_ddot_p], if there are any.
            nominal_posture: (n,) if `nominal_posture_gain` is set.

        Raises:
            InputError: an argument has a NaN or the wrong size; it is named.
        """
        nq, nv = self.model.plant.num_positions(), self.model.plant.num_velocities()
        given = []
        for name, value, size in (
            ("q", q, nq),
            ("v", v, nv),
            ("tasks", tasks, self.model.layout.size),
            ("prescribed", prescribed, 3 * self.model.n_p),
            ("nominal_posture", nominal_posture, self.model.n * self._with_posture),
        ):
            value = _NOTHING if value is None or not size else value
            if np.shape(value) != (size,):
                raise InputError(
                    f"{name} has shape {np.shape(value)}; it must be ({size},)"
                )
            given.append(np.ascontiguousarray(value, dtype=float))
        tick = self._memory.tick + 1
        time = tick * self.parameters.period
        check_finite("q", given[0], time)
        check_finite("v", given[1], time)
        step = self.solve(
            self._workspace, self._memory, tick, time, *given[:2], Targets(*given[2:])
        )
        self._memory = step.memory
        return step.solution

    def solve(
        self,
        workspace: Workspace,
        memory: Memory,
        tick: int,
        time: float,
        q: np.ndarray,
        v: np.ndarray,
        targets: Targets,
    ) -> ControlStep:
        """One control step, without side effects but on the workspace.

        Args:
            workspace: of the model; left at the state (q, v).
            memory: of the previous step; `Memory()` for the first.
            tick: number of this control step.
            time: of this step [s].
            q, v: (nq,), (nv,) state of the whole plant.
            targets: what to do.

        Raises:
            InputError: a target is not finite or a desired orientation a quaternion
                of zero length, unless that makes the robot brake.
            FloatingPointError: an overflow.
        """
        model, mode = self.model, self.mode
        q_s = None
        if mode.horizon is not None:
            q_s = resting_configuration(q, v, mode.horizon)
        drake = model.ask(workspace, q, v, q_s)
        if not targets.finite():
            if mode.brakes_without_targets:
                return self._brake(workspace, tick, drake)
            targets.check(time)
        start_time, start = memory.start_time, memory.start
        if start is None:
            state = evaluate_state(drake, model.numbers(drake))
            start_time = time
            start = BlendStart(state.R, state.p, q[model.prescribed])
        blend = smooth_step(time - start_time, self._blend_time)
        wanted = Wanted(
            targets.tasks, targets.prescribed, targets.nominal_posture, start, blend
        )
        before = None
        if memory.qdot is not None:
            follows = tick == memory.tick + 1
            before = Before(follows, memory.qdot, memory.qddot, memory.kept)
        resolved = mode.resolve(workspace, drake, wanted, before)
        if not is_finite(resolved.answer.vdot):
            # A quaternion of zero length is a number, but no orientation.
            if is_finite(resolved.answer.error):
                raise FloatingPointError(
                    "the commanded acceleration is not finite: an overflow reached the "
                    "solver; are positions, velocities or targets beyond all sense?"
                )
            if mode.brakes_without_targets:
                return self._brake(workspace, tick, drake)
            raise InputError(
                f"desired_tasks has a quaternion of zero length at t = {time:g} s; "
                "give unit quaternions (w, x, y, z), see TaskLayout"
            )
        status = STATUS_TRACKING if blend[0] == 1.0 else STATUS_BLENDING
        solution = self._solution(workspace, drake, resolved, status)
        return ControlStep(
            solution,
            Memory(
                tick,
                start_time,
                start,
                qdot=v[model.controlled],
                qddot=solution.acceleration[model.controlled],
                kept=resolved.kept,
            ),
        )

    @property
    def brakes_without_targets(self) -> bool:
        """Whether a NaN in the targets makes the robot brake, not raise."""
        return self.mode.brakes_without_targets

    def _brake(self, workspace: Workspace, tick: int, drake: FromDrake) -> ControlStep:
        """Without targets: q_ddot = -q_dot / T, and blend in when they are back."""
        model = self.model
        answer = Answer(
            vdot=-drake.v / self.parameters.braking_horizon,
            error=np.full(model.m, np.nan),
            d=evaluate_state(drake, model.numbers(drake)).d[0],
            W=np.ones(model.n),
            qdot_c=np.zeros(model.n),
        )
        solution = self._solution(workspace, drake, Resolved(answer), STATUS_BRAKING)
        return ControlStep(solution, Memory(tick=tick))

    def _solution(
        self, workspace: Workspace, drake: FromDrake, resolved: Resolved, status: float
    ) -> Solution:
        model, answer, period = self.model, resolved.answer, self._period
        vdot, torque_limit = answer.vdot, UNLIMITED
        actuation = model.inverse_dynamics(workspace, vdot)
        if self.parameters.respect_effort_limits:
            vdot, actuation, torque_limit = limit_torque(
                vdot,
                actuation,
                model.effort_per_acceleration(workspace),
                drake.v,
                model.controlled,
                model.actuator_limits,
                self._braking_horizon,
                period,
            )
        v_next = drake.v + period * vdot
        return Solution(
            actuation=actuation,
            acceleration=vdot,
            task_error=answer.error,
            signed_distances=answer.d,
            constraint_weights=answer.W,
            position_command=np.concatenate((drake.q + period * v_next, v_next)),
            constrained_velocity=answer.qdot_c,
            status=np.array([status]),
            torque_limit=torque_limit,
            of_mode=resolved.diagnostics,
        )


def is_finite(value: np.ndarray) -> bool:
    """Whether no entry is NaN or infinite; half the time of asking each."""
    # A sum is finite unless an entry is not, or entries are beyond all sense.
    return math.isfinite(value.sum())


def check_finite(name: str, value: np.ndarray, time: float) -> None:
    """Raises InputError, with the port or argument and the time, on NaN or inf."""
    if not np.isfinite(value).all():
        bad = np.flatnonzero(~np.isfinite(value))
        raise InputError(
            f"{name} has a NaN or infinite value at t = {time:g} s "
            f"(entries {', '.join(map(str, bad[:8]))}"
            f"{', ...' if len(bad) > 8 else ''}); check what is connected to it"
        )


def make_control_law(
    model: ControlModel, parameters: CrarParameters | None = None
) -> ControlLaw:
    """`ControlLaw(model, parameters)`, under the name that older code knows."""
    return ControlLaw(model, parameters)
