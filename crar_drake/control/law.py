"""One control step, from state and targets to accelerations and torque.

This is the order of the paper: error, references, weights, inverse, velocity level,
acceleration level, resolved acceleration, inverse dynamics. There is no Drake system
here: `CrarController` wraps it for diagrams, and `ControlLaw.step` serves a user's
own loop. Between control steps the accelerations are held, and the inverse dynamics
goes on: `ControlLaw.hold`, or `ControlLaw.torque` in a user's own loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from crar_drake.control.balance import Balance
from crar_drake.control.effort_limits import EffortLimits
from crar_drake.control.lateness import LATEST, Lateness, watch_lateness
from crar_drake.control.law_among import LawAmong
from crar_drake.control.modes import MODES, validate
from crar_drake.control.obstacles import Obstacles, Regions
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.plausible import PlausibleStates
from crar_drake.control.records import (
    STATUS_BLENDING,
    STATUS_BRAKING,
    STATUS_IMPLAUSIBLE,
    STATUS_TRACKING,
    InputError,
    Memory,
    Solution,
    check_finite,
)
from crar_drake.equations.blending import smooth_step
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.lookahead_rows import resting_configuration
from crar_drake.equations.prediction import state_ahead
from crar_drake.equations.preview import posture_near_limits
from crar_drake.equations.references import (
    BlendStart,
    Targets,
    TaskGains,
)
from crar_drake.equations.vectors import is_finite
from crar_drake.errors import ModelError
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

_NOTHING = np.zeros(0)
# Of a period: so little more is none.
_ROUNDING = 1e-9
_STATUS = {
    status: np.array([status])
    for status in (
        *(STATUS_TRACKING, STATUS_BLENDING),
        *(STATUS_BRAKING, STATUS_IMPLAUSIBLE),
    )
}


class ControlLaw:
    """The constrained resolved acceleration of a robot model and its torque.

    Attributes:
        model: kinematics, distances, dynamics.
        parameters: gains and modes.
        mode: of the constraints.
        effort_limits: (nu,) see `CrarParameters.effort_limits` [Nm or N].
        speed_limits: (nv,) see `CrarParameters.speed_limits` [rad/s or m/s].
        target_names: what errors call tasks, prescribed positions and nominal posture.
    """

    target_names = ("tasks", "prescribed", "nominal_posture")

    def __init__(
        self, model: ControlModel, parameters: CrarParameters | None = None
    ) -> None:
        """
        Raises:
            ModelError: the model has no task, or its base floats.
            ScenarioError: a parameter is out of range, or names no joint of the robot.
        """
        if not model.tasks:
            raise ModelError("give the control model at least one task")
        model.description.refuse_floating()
        self.model = model
        self.parameters = parameters or CrarParameters()
        validate(self.parameters)
        gains = self.parameters
        # Always of one type, lest functions be compiled for another.
        self._blend_time = float(gains.blend_time)
        self._period = float(gains.period)
        self._latency = float(gains.latency)
        self._plant_step = float(model.plant.time_step())
        self._torque_period = float(gains.torque_period_for(self._plant_step))
        # The oldest commands whose effect a late state does not show yet.
        late = self._latency / self._period * (1.0 - _ROUNDING)
        self._num_sent = math.ceil(late) + 1 if late else 0
        self._rest = model.rest_positions()
        self._rest_posture = self._rest[model.controlled_positions]
        self._has_limits = np.isfinite(model.upper - model.lower)
        self._with_posture = gains.posture_gain > 0.0
        self.speed_limits = gains.speed_limits(model)
        task_gains = TaskGains(
            float(gains.K),
            float(gains.Kp),
            float(gains.velocity_gain),
            float(gains.posture_gain),
            model.row_weights if model.weighs_rows else _NOTHING,
        )
        self.mode = MODES[gains.constraints](model, gains, task_gains)
        if self.mode.plans:
            # A plan is stiff: a lag that nobody has told of is looked for.
            self._num_sent = math.ceil(late) + round(LATEST / self._period) + 2
        self._plausible = PlausibleStates(model, self._period)
        self._efforts = EffortLimits(model, self.mode, gains)
        self.effort_limits = self._efforts.limits
        self._balance = None
        if gains.balance is not None:
            self._balance = Balance(model, gains.balance, self.mode, self._period)
        self.reset()

    @cached_property
    def among(self) -> LawAmong:
        """What keeps the robot from obstacles that move.

        Raises:
            ScenarioError: the robot or the parameters do not go with them.
        """
        return LawAmong(self.model, self.parameters)

    def compile(self, obstacles: bool = False) -> None:
        """Compiles what has yet to be, by a step at rest that leaves nothing behind.

        What only some steps need is among it, lest the first of these stop the robot's
        control for a fifth of a second.

        Args:
            obstacles: whether there will be any that move.
        """
        if obstacles and self.mode.keeps_off_obstacles:
            self.among.compile()
        model = self.model
        q = self._rest
        v = np.zeros(model.plant.num_velocities())
        targets = Targets(model.tasks_at(q), model.prescribed_at(q), _NOTHING)
        workspace = model.MakeWorkspace()
        memory = self.solve(workspace, Memory(), 0, 0.0, q, v, targets)
        if self._efforts.finite:
            measured = self._measure(workspace, q, v)
            self._efforts.compile(workspace, measured, np.ones_like(v))
        if self._balance is not None:
            self._balance.compile(self._measure(workspace, q, v))
        self.hold(workspace, memory, 1, q, v)

    def default_posture(self, q: np.ndarray) -> np.ndarray:
        """The nominal posture where none is given: the robot's rest posture, and with a
        preview (L14), `equations.preview.posture_near_limits`.

        A joint without limits, which may have turned round, has none.

        Args:
            q: (nq,) measured positions of the whole plant.

        Returns:
            (n,) positions of the controlled joints [rad or m]; (0,) if the parameter
            `nominal_posture_gain` is 0.
        """
        if not self._with_posture:
            return _NOTHING
        model = self.model
        here = q[model.controlled_positions]
        posture = np.where(self._has_limits, self._rest_posture, here)
        if self.mode.plans:
            posture = posture_near_limits(here, posture, model.lower, model.upper)
        return posture

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
        obstacles: Obstacles | None = None,
    ) -> Solution:
        """The next control step, for a loop without a simulator.

        Call it once a control period; it counts the periods and remembers the
        previous step.

        Args:
            q: (nq,) measured positions of the whole plant.
            v: (nv,) measured velocities.
            tasks: (layout.size,) [x_d; v_d; a_d]; `model.layout.pack` makes one.
            prescribed: (3 n_p,) [q_p; q_dot_p; q_ddot_p], if there are any;
                `model.prescribed_at` makes one.
            nominal_posture: (n,) that the null space is drawn to, unless
                `nominal_posture_gain` is 0; by default `default_posture`.
            obstacles: as of `solve`.

        Raises:
            InputError: an argument has a NaN or the wrong size; it is named.
        """
        model, memory = self.model, self._memory
        q, v = _of_sizes(
            ("q", q, model.plant.num_positions()),
            ("v", v, model.plant.num_velocities()),
        )
        given = self._with_posture and nominal_posture is not None
        targets = _of_sizes(
            ("tasks", tasks, model.layout.size),
            ("prescribed", prescribed, 3 * model.n_p),
            ("nominal_posture", nominal_posture, model.n * given),
        )
        tick = memory.tick + 1
        time = tick * self.parameters.period
        check_finite("q", q, time)
        check_finite("v", v, time)
        self._memory = self.solve(
            self._workspace, memory, tick, time, q, v, Targets(*targets), obstacles
        )
        return self._memory.solution

    def torque(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The torque of the last step's accelerations at a new state.

        For a loop that sends torques more often than it calls `step`: an acceleration
        takes another torque where the robot has moved.

        Args:
            q: (nq,) positions measured now.
            v: (nv,) velocities measured now.

        Returns:
            (nu,) efforts, within the effort limits if these are respected [Nm or N].

        Raises:
            InputError: there was no step yet, or an argument has a NaN or the wrong
                size; it is named.
        """
        if self._memory.solution is None:
            raise InputError("there is no acceleration to hold yet: call step first")
        q, v = _of_sizes(
            ("q", q, self.model.plant.num_positions()),
            ("v", v, self.model.plant.num_velocities()),
        )
        time = self._memory.tick * self.parameters.period
        check_finite("q", q, time)
        check_finite("v", v, time)
        tick = self._memory.torque_tick + 1
        self._memory = self.hold(self._workspace, self._memory, tick, q, v)
        return self._memory.solution.actuation

    def solve(
        self,
        workspace: Workspace,
        memory: Memory,
        tick: int,
        time: float,
        q: np.ndarray,
        v: np.ndarray,
        targets: Targets,
        obstacles: Obstacles | None = None,
    ) -> Memory:
        """One control step, without side effects but on the workspace.

        Args:
            workspace: of the model; left at the state (q, v).
            memory: of the previous step; `Memory()` for the first.
            tick: number of this control step.
            time: of this step [s].
            q, v: (nq,), (nv,) state of the whole plant.
            targets: what to do; without a nominal posture (0,) it is the default one.
                Where blending begins is the law's to say.
            obstacles: that move by themselves, where they are now; they replace all
                before. Where none are given, those before may be anywhere that their
                speeds let them be since. Constraints "lookahead" alone keep off them.

        Returns:
            The results, in `solution`, and what the next step is to be given.

        Raises:
            InputError: a target is not finite or a desired orientation a quaternion
                of zero length, unless that makes the robot brake.
            ScenarioError: the robot or the parameters do not go with obstacles.
            FloatingPointError: an overflow.
        """
        model, mode = self.model, self.mode
        before = memory if tick == memory.tick + 1 else Memory()
        lateness = None
        if mode.plans:
            told = self._latency / self._period
            # One glitch would outweigh all else for seconds.
            seen = self._plausible.believed(v, before.v)
            lateness = watch_lateness(
                before.lateness, seen, before.sent, told, self._period
            )
        q, v = self._predict(before.sent, lateness, self._period, q, v)
        if not len(targets.posture):
            targets = targets._replace(posture=self.default_posture(q))
        believed = v
        if mode.brakes_without_targets:
            believed = self._plausible.believed(v, before.v)
        measured = self._measure(workspace, q, believed)
        regions = None
        none = before.regions is None if obstacles is None else not len(obstacles)
        if mode.keeps_off_obstacles and not none:
            regions = self.among.regions(before, obstacles, q, believed)
        if believed is not v or not self._came(before, q, v):
            return self._brake(
                workspace, before, tick, measured, regions, STATUS_IMPLAUSIBLE, lateness
            )
        if not self._usable(targets, time):
            return self._brake(
                workspace, before, tick, measured, regions, lateness=lateness
            )
        start_time, start = memory.start_time, memory.start
        if start is None:
            start_time, start = time, self._start(measured)
        blend = smooth_step(time - start_time, self._blend_time)
        posture = targets.posture
        if self._with_posture and blend[0] < 1.0:
            # As the targets, lest the first step be a jerk.
            here = q[model.controlled_positions]
            posture = here + blend[0] * (posture - here)
        rows = self._efforts.rows(workspace) if mode.plans else None
        solution = mode.resolve(
            workspace,
            measured,
            Targets(targets.tasks, targets.prescribed, posture, start, blend),
            before if before.continues else None,
            **({"efforts": rows} if mode.plans else {}),
        )
        if not is_finite(solution.acceleration):
            # A quaternion of zero length is a number, but no orientation.
            if is_finite(solution.task_error):
                raise FloatingPointError(
                    "the commanded acceleration is not finite: an overflow reached the "
                    "solver; are positions, velocities or targets beyond all sense?"
                )
            if mode.brakes_without_targets:
                return self._brake(
                    workspace, before, tick, measured, regions, lateness=lateness
                )
            raise _no_orientation("desired_tasks", time)
        status = STATUS_TRACKING if blend[0] == 1.0 else STATUS_BLENDING
        regions = self._complete(solution, workspace, measured, status, regions, rows)
        return Memory(
            tick,
            solution=solution,
            q=q,
            v=v,
            continues=True,
            start_time=start_time,
            start=start,
            regions=regions,
            sent=self._sent(before, solution),
            lateness=lateness,
        )

    def _usable(self, targets: Targets, time: float) -> bool:
        """Whether targets are finite; raises InputError where that is an error."""
        tasks, prescribed, posture = targets[:3]
        finite = is_finite(tasks) and is_finite(prescribed) and is_finite(posture)
        if not finite and not self.mode.brakes_without_targets:
            for name, value in zip(self.target_names, targets[:3], strict=True):
                check_finite(name, value, time)
        return finite

    def _start(self, measured: Measured) -> BlendStart:
        """What is measured, to blend from."""
        model = self.model
        state = model.state_here(measured)
        return BlendStart(
            state.R,
            state.p,
            measured.q[0][model.prescribed_positions],
            state.q[model.layout.rows.joints],
        )

    def _came(self, before: Memory, q: np.ndarray, v: np.ndarray) -> bool:
        """Whether a robot may have come here from the state a period ago."""
        if before.q is None or not self.mode.brakes_without_targets:
            return True
        return self._plausible.way(before.q, before.v, q, v)

    def hold(
        self,
        workspace: Workspace,
        memory: Memory,
        torque_tick: int,
        q: np.ndarray,
        v: np.ndarray,
    ) -> Memory:
        """The control step with the torque that it takes at a later state.

        Where effort limits are respected, the torque is clipped: what the limits allow
        was decided in the control step.

        Args:
            workspace: of the model; left at the state (q, v).
            memory: of the control step whose accelerations are held.
            torque_tick: for the result.
            q, v: (nq,), (nv,) state of the whole plant.
        """
        model, solved = self.model, memory.solution
        held = torque_tick * self._torque_period
        q, v = self._predict(memory.sent, memory.lateness, held, q, v)
        if self.mode.brakes_without_targets and memory.q is not None:
            v = self._plausible.believed(v, memory.v)
        model.plant.SetPositionsAndVelocities(
            workspace.plant_context, np.concatenate((q, v))
        )
        actuation = model.inverse_dynamics(workspace, solved.acceleration)
        torque_limit = solved.torque_limit
        if self._efforts.finite:
            actuation, excess = self._efforts.clipped(actuation)
            torque_limit = np.array([torque_limit[0], excess])
        solution = replace(solved, actuation=actuation, torque_limit=torque_limit)
        return memory.at_torque_tick(torque_tick, solution)

    def _predict(
        self,
        sent: Sequence[np.ndarray],
        lateness: Lateness | None,
        held: float,
        q: np.ndarray,
        v: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state now, if q, v was that a latency ago and the robot did as told: by
        the accelerations `sent`, the newest of them first, and `held` for so long [s].
        """
        model, left, since = self.model, self._latency, []
        if lateness is not None:
            left += lateness.periods * self._period
        for vdot in sent:
            if left <= _ROUNDING * self._period:
                break
            time = min(held, left)
            since.append((vdot, time))
            left, held = left - time, self._period
        for vdot, time in reversed(since):
            x = state_ahead(
                q, v, vdot, time, self._plant_step, model.positions, model.order
            )
            q, v = x[: len(q)], x[len(q) :]
        return q, v

    def _sent(self, before: Memory, solution: Solution) -> tuple[np.ndarray, ...]:
        """`Memory.sent` after a step with this solution."""
        return (solution.acceleration, *before.sent)[: self._num_sent]

    @property
    def brakes_without_targets(self) -> bool:
        """Whether a NaN in the targets makes the robot brake, not raise."""
        return self.mode.brakes_without_targets

    def _brake(
        self,
        workspace: Workspace,
        before: Memory,
        tick: int,
        measured: Measured,
        regions: Regions | None,
        status: float = STATUS_BRAKING,
        lateness: Lateness | None = None,
    ) -> Memory:
        """q_ddot = -q_dot / T, and blend in when the targets are back, or the state."""
        model = self.model
        solution = Solution(
            acceleration=-measured.v / self.parameters.braking_horizon,
            task_error=np.full(model.m, np.nan),
            signed_distances=model.state_here(measured).d[0],
            constraint_weights=np.ones(model.n),
            constrained_velocity=np.zeros(model.n),
        )
        regions = self._complete(solution, workspace, measured, status, regions)
        after = measured.v + self._period * solution.acceleration
        return Memory(
            tick,
            solution=solution,
            q=measured.q[0],
            v=after,
            regions=regions,
            sent=self._sent(before, solution),
            lateness=lateness,
        )

    def _complete(
        self,
        solution: Solution,
        workspace: Workspace,
        measured: Measured,
        status: float,
        regions: Regions | None,
        rows: np.ndarray | None = None,
    ) -> Regions | None:
        """Adds what follows from the accelerations, which effort limits and obstacles
        may change; gives where these are a period on at most."""
        self._efforts.limit(workspace, measured, solution, rows)
        if regions is not None:
            q, v = measured.q[0], measured.v
            changed, regions = self.among.limit(regions, q, v, solution)
            if changed:
                vdot = solution.acceleration
                self._efforts.take(workspace, measured, vdot, solution)
        if self._balance is not None:
            self._keep_balance(workspace, measured, solution)
        solution.status = _STATUS[status]
        return regions

    def _keep_balance(
        self, workspace: Workspace, measured: Measured, solution: Solution
    ) -> None:
        """Leaves of a solution what is balanced."""

        def admit(vdot: np.ndarray):
            if not self._efforts.within(workspace, vdot):
                return None
            found, reported = self.mode.admit_again(measured, vdot)
            if np.array_equal(found, vdot) or self._efforts.within(workspace, found):
                return found, reported
            return None

        vdot, reported = self._balance.limit(measured, solution.acceleration, admit)
        solution.of_mode = {**solution.of_mode, **reported}
        if vdot is not solution.acceleration:
            self._efforts.take(workspace, measured, vdot, solution)

    def _measure(self, workspace: Workspace, q: np.ndarray, v: np.ndarray) -> Measured:
        """The state; and where the robot would come to rest, if the mode looks there
        and SceneGraph has to be asked for distances."""
        model, T = self.model, self.mode.horizon
        if T is None or not model.pairs.needs_query:
            return model.measure(workspace, q, v)
        in_order = resting_configuration(*model.in_order(q, v), T)
        return model.measure(workspace, q, v, *model.in_plant(in_order))


def _of_sizes(*given: tuple[str, np.ndarray | None, int]) -> list[np.ndarray]:
    """The values of (name, value, size), as arrays; raises InputError with the name.

    Copied, since what may not be written to is compiled for anew.
    """
    arrays = []
    for name, value, size in given:
        value = _NOTHING if value is None or not size else value
        if np.shape(value) != (size,):
            raise InputError(
                f"{name} has shape {np.shape(value)}; it must be ({size},)"
            )
        arrays.append(np.array(value, dtype=float, order="C"))
    return arrays


def _no_orientation(what: str, time: float) -> InputError:
    return InputError(
        f"{what} has a quaternion of zero length at t = {time:g} s; give unit "
        "quaternions (w, x, y, z), see TaskLayout"
    )
