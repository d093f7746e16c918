"""One control step, from state and targets to accelerations and torque.

This is the order of the paper: error, references, weights, inverse, velocity level,
acceleration level, resolved acceleration, inverse dynamics. There is no Drake system
here: `CrarController` wraps it for diagrams, and `ControlLaw.step` serves a user's
own loop. Between control steps the accelerations are held, and the inverse dynamics
goes on: `ControlLaw.hold`, or `ControlLaw.torque` in a user's own loop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from crar_drake.errors import InputError, ModelError, ScenarioError
from crar_drake.law.blending import smooth_step
from crar_drake.law.constraints import Braking, RobotConstraints
from crar_drake.law.measured import (
    Lateness,
    MeasuredStates,
    check_finite,
    is_finite,
    watch_lateness,
)
from crar_drake.law.motors import Motors, clip_torque, share_of_nominal
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.paper import PaperLaw
from crar_drake.law.parameters import LookaheadParameters, Parameters
from crar_drake.law.plan import Plan, posture_near_limits
from crar_drake.law.prediction import state_ahead
from crar_drake.law.references import Nominal, Targets, TaskGains
from crar_drake.law.solution import (
    STATUS_BLENDING,
    STATUS_BRAKING,
    STATUS_IMPLAUSIBLE,
    STATUS_TRACKING,
    Solution,
)
from crar_drake.law.spheres import MovingSpheres
from crar_drake.law.step import AS_NOMINAL, State, step
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

_NOTHING = np.zeros(0)
_BLENDED = 1.0, 0.0, 0.0  # of `smooth_step`, once it is over
# A robot that is off its command by less is where it was told to be [rad or m, per
# second]: what was shown of the command holds, for the safety distance has it to spare.
_AS_TOLD = 1e-6


@dataclass(slots=True)
class Memory:
    """What one control step leaves to the next; never changed in place."""

    tick: int = -1  # number of the control step; -1 before the first
    # which torque tick of the control period the solution's torque is of; 0 is the
    # control step itself
    torque_tick: int = 0
    # its results, whose accelerations are held; None before the first
    solution: Solution | None = None
    # what was measured, with velocities that were believed; where the robot brakes
    # without targets, those that it should have a period on. None before the first
    # step.
    q: np.ndarray | None = None  # (nq,)
    v: np.ndarray | None = None  # (nv,)
    # `Nominal.kept`, for the next step; None where that may not build on this one's
    # accelerations: the robot braked without targets, or a run began between two
    # control ticks
    kept: np.ndarray | None = None
    start_time: float | None = None  # when blending began [s], None if it has yet to
    # what was measured then, as `Targets.start`; None if it has yet to begin
    start: np.ndarray | None = None
    braking: Braking = Braking()  # what is known of the next state's braking path
    # accelerations (nv,) that were commanded, the newest first; as many as
    # `Shared.latency` and `lateness` need
    sent: tuple[np.ndarray, ...] = ()
    # how late states are; None where nobody looks for it
    lateness: Lateness | None = None

    def __deepcopy__(self, memo: dict) -> Memory:
        return self  # Drake copies states often; nothing here is ever changed.


class ControlLaw:
    """The constrained resolved acceleration of a robot model and its torque.

    Attributes:
        model: kinematics, distances, dynamics.
        parameters: of the law.
        effort_limits: (nu,) see `Shared.limits_of_efforts` [Nm or N].
        speed_limits: (nv,) see `LookaheadParameters.speed_limits` [rad/s or m/s].
        has_posture: whether the null space is drawn to a nominal posture.
        target_names: what errors call tasks, prescribed positions and nominal posture.
    """

    target_names = ("tasks", "prescribed", "nominal_posture")

    def __init__(
        self, model: ControlModel, parameters: Parameters | None = None
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
        self.parameters = gains = parameters or LookaheadParameters()
        gains.validate()
        # Always of one type, lest functions be compiled for another.
        self._blend_time, self._period = float(gains.blend_time), float(gains.period)
        self._plant_step = float(model.plant.time_step())
        self._torque_period = float(gains.torque_ticks(self._plant_step)[1])
        self._rest = model.rest_positions()
        self.speed_limits = gains.speed_limits(model)
        self.effort_limits = gains.limits_of_efforts(model)
        self._safe, self._plans = gains.constraints == "lookahead", gains.plans
        self._constraints = self._motors = None
        crowded = model.m >= model.n
        of_paper, stiffness = gains, 0.0
        if self._safe:
            of_paper, ahead = gains.gains, gains.resolved(crowded)
            stiffness = ahead.stiffness
            self._constraints = RobotConstraints(
                *(model, gains, ahead.approach, ahead.T, ahead.others),
                self._plant_step,
            )
            self._motors = self._constraints.motors
        elif np.isfinite(self.effort_limits).any():
            times = self._period, min(self._plant_step, self._period)
            self._motors = Motors(model, self.effort_limits, *times)
        self.has_posture = stiffness > 0.0
        weights = model.row_weights if model.weighs_rows else _NOTHING
        tasks = TaskGains(
            *(float(of_paper.K), float(of_paper.Kp), float(of_paper.velocity_gain)),
            *(stiffness, weights),
        )
        of = model, self._period, float(gains.latency)
        self._measured = MeasuredStates(*of, self._plans)
        self._nominal: PaperLaw | Plan
        if self._plans:
            self._nominal = Plan(model, self._constraints, ahead, tasks)
        else:
            constrained = gains.constraints != "none"
            self._nominal = PaperLaw(model, tasks, of_paper, self._period, constrained)
        self.reset()

    @cached_property
    def among(self) -> MovingSpheres:
        """What keeps the robot from obstacles that move.

        Raises:
            ScenarioError: the robot or the parameters do not go with them.
        """
        gains, period = self.parameters, self._period
        if abs(self._plant_step - period) > 1e-9 * period:
            raise ScenarioError(
                f"obstacles: the plant's time step, {self._plant_step:g} s, must be "
                f"the control period, {period:g} s: make plant_config.time_step or "
                "controller.period the other"
            )
        if gains.longest_T > gains.T and gains.balance is None:
            raise ScenarioError(
                "controller.braking_time: with moving obstacles there is one braking "
                "time constant; give it, or take LookaheadParameters.among_obstacles()"
            )
        return self._constraints.among

    def compile(self, obstacles: bool = False) -> None:
        """Compiles what has yet to be, by a step at rest that leaves nothing behind.

        What only some steps need is among it, lest the first of these stop the robot's
        control for a fifth of a second.

        Args:
            obstacles: whether there will be any that move.
        """
        model = self.model
        q = self._rest
        v = np.zeros(model.plant.num_velocities())
        targets = Targets(model.tasks_at(q), model.prescribed_at(q), _NOTHING)
        workspace = model.MakeWorkspace()
        around = None
        if obstacles and self._safe:
            around = Obstacles(np.zeros((1, 3)), 1.0, 1.0, ("all",))
        memory = self.solve(workspace, Memory(), 0, 0.0, q, v, targets, around)
        self.solve(workspace, memory, 1, self._period, q, v, targets, around)
        if self._safe:
            self._constraints.compile(*model.in_order(q, v))
        self.hold(workspace, memory, 1, q, v)

    def default_posture(self, q: np.ndarray) -> np.ndarray:
        """The nominal posture where none is given: the robot's rest posture, and with a
        plan (L14), `law.plan.posture_near_limits`.

        A joint without limits, which may have turned round, has none.

        Args:
            q: (nq,) measured positions of the whole plant.

        Returns:
            (n,) positions of the controlled joints [rad or m]; (0,) if the parameter
            the posture gain is 0.
        """
        if not self.has_posture:
            return _NOTHING
        model = self.model
        here = q[model.controlled_positions]
        rest = self._rest[model.controlled_positions]
        posture = np.where(np.isfinite(model.upper - model.lower), rest, here)
        if self._plans:
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
            nominal_posture: (n,) that the null space is drawn to, by default
                `default_posture`; left out where the posture gain is 0.
            obstacles: as of `solve`.

        Raises:
            InputError: an argument has a NaN or the wrong size; it is named.
        """
        model, memory = self.model, self._memory
        tick = memory.tick + 1
        q, v, time = self._given(q, v, tick)
        given = self.has_posture and nominal_posture is not None
        targets = _of_sizes(
            ("tasks", tasks, model.layout.size),
            ("prescribed", prescribed, 3 * model.n_p),
            ("nominal_posture", nominal_posture, model.n * given),
        )
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
        q, v, _ = self._given(q, v, self._memory.tick)
        tick = self._memory.torque_tick + 1
        self._memory = self.hold(self._workspace, self._memory, tick, q, v)
        return self._memory.solution.actuation

    def _given(
        self, q: np.ndarray, v: np.ndarray, tick: int
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """A state from a user, and the time of a step [s]; raises InputError."""
        plant, time = self.model.plant, tick * self.parameters.period
        given = ("q", q, plant.num_positions()), ("v", v, plant.num_velocities())
        q, v = _of_sizes(*given)
        check_finite("q", q, time)
        check_finite("v", v, time)
        return q, v, time

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
        model, measured = self.model, self._measured
        before = memory if tick == memory.tick + 1 else Memory()
        lateness = None
        if self._plans:  # which is stiff; one glitch would outweigh all else for long
            seen = measured.believed(v, before.v)
            of = before.sent, measured.told, self._period
            lateness = watch_lateness(before.lateness, seen, *of)
        q, v = measured.now(before.sent, lateness, self._period, q, v)
        believed = measured.believed(v, before.v) if self._safe else v
        model.plant.SetPositionsAndVelocities(
            workspace.plant_context, np.concatenate((q, believed))
        )
        braking = self._known(before, obstacles, q, believed)
        status, nominal = STATUS_TRACKING, None
        start_time, start = memory.start_time, memory.start
        came = before.q is None or not self._safe
        came = came or measured.way(before.q, before.v, q, v)
        finite = all(map(is_finite, targets[:3]))
        if believed is not v or not came:
            status = STATUS_IMPLAUSIBLE
        elif not finite:
            if not self._safe:
                for name, value in zip(self.target_names, targets[:3], strict=True):
                    check_finite(name, value, time)
            status = STATUS_BRAKING
        else:
            if start is None:
                here = model.tasks_at(q)[: model.layout.size_x]
                start = np.concatenate((here, q[model.prescribed_positions]))
                start_time = time
            since, blend, posture = time - start_time, _BLENDED, targets.posture
            if not len(posture):
                posture = self.default_posture(q)
            if since < self._blend_time:
                status, blend = STATUS_BLENDING, smooth_step(since, self._blend_time)
                if self.has_posture:  # as the targets, lest the first step be a jerk
                    here = q[model.controlled_positions]
                    posture = here + blend[0] * (posture - here)
            targets = Targets(*targets[:2], posture, start, blend)
            nominal = self._nominal(workspace, q, v, targets, before.kept)
            if not is_finite(nominal.vdot):
                # A quaternion of zero length is a number, but no orientation.
                if is_finite(nominal.task_error):
                    raise FloatingPointError(
                        "the commanded acceleration is not finite: an overflow reached "
                        "the solver; are positions, velocities or targets beyond all "
                        "sense?"
                    )
                if not self._safe:
                    raise InputError(
                        "desired_tasks has a quaternion of zero length at t = "
                        f"{time:g} s; give unit quaternions (w, x, y, z), see "
                        "TaskLayout"
                    )
                status, nominal = STATUS_BRAKING, None
        going_on = nominal is not None
        if not going_on:
            vdot = -believed[model.order] / (braking.T or self._constraints.T)
            unknown, nothing = np.full(model.m, np.nan), np.zeros(model.n)
            nominal = Nominal(vdot, unknown, np.ones(model.n), nothing, _NOTHING)
        solution, braking = self._solved(
            workspace, q, believed, nominal, braking, going_on
        )
        solution.status = np.array([status])
        return Memory(
            tick,
            solution=solution,
            q=q,
            v=v if going_on else believed + self._period * solution.acceleration,
            kept=nominal.kept if going_on else None,
            start_time=start_time if going_on else None,
            start=start if going_on else None,
            braking=braking,
            sent=(solution.acceleration, *before.sent)[: measured.num_sent],
            lateness=lateness,
        )

    def _known(
        self, before: Memory, obstacles: Obstacles | None, q: np.ndarray, v: np.ndarray
    ) -> Braking:
        """What is known of the braking path from a state (nq,), (nv,)."""
        if not self._safe:
            return before.braking
        known, regions = before.braking, before.braking.regions
        told = before.solution is not None
        if told:
            off = before.solution.position_command - np.concatenate((q, v))
            told = bool(np.abs(off).max() <= _AS_TOLD)
        if not told:
            known = Braking(known.T)
            if regions is not None:
                regions = replace(regions, clear=np.zeros_like(regions.clear))
                obstacles = regions.spheres if obstacles is None else obstacles
        if obstacles is not None and (regions is not None or len(obstacles)):
            at = self.model.in_order(q, v)
            regions = self.among.regions(regions, obstacles, *at)
        return replace(known, regions=regions)

    def _solved(
        self,
        workspace: Workspace,
        q: np.ndarray,
        v: np.ndarray,
        nominal: Nominal,
        before: Braking,
        going_on: bool,
    ) -> tuple[Solution, Braking]:
        """The step nearest to a nominal that is safe, and what follows from it.

        Args:
            workspace: at the state (nq,), (nv,).
            before: what is known of its braking path.
            going_on: else the nominal is braking, over whatever T will do.
        """
        model, n = self.model, self.model.n
        taken = asked = nominal.vdot
        how, found, braking = {}, None, before
        at, rate = model.in_order(q, v)

        def s_0(T: float) -> np.ndarray:
            if not going_on:
                return np.zeros(n)
            s = rate[:n] + T * asked[:n]
            if self._plans or not self._safe:
                return s
            # Feedback may ask for more than the speed that q_s is to move at most.
            fastest, limit = np.abs(s).max(), self._constraints.fastest
            return s if fastest <= limit else (limit / fastest) * s

        if self._safe:
            state = self._constraints.state(
                *(at, rate, before, s_0),
                prescribed_acceleration=asked[n:],
                keep_rows=True,
                along=not going_on,
            )
            found, clear, clearance, braking = self._constraints.step(state, before)
            admitted = found.how, found.share
            how["admission"] = np.array([*admitted, clearance, float(clear)])
            how["T"] = np.array([state.T])
            if (ground := self._constraints.ground) is not None:
                if ground.name not in found.objections:
                    admitted = AS_NOMINAL, 1.0
                left = found.clearances.get(ground.name, 0.0)
                how["balance"] = np.array([*admitted, left])
        elif self._motors is not None:
            times = self.parameters.T, self._period, min(self._plant_step, self._period)
            state = State(at, rate, n, *times, s_0, False, asked[n:])
            state.desired = state.whole(state.nominal)
            found = step(state, [self._motors])
        share = 1.0
        if found is not None and (self._safe or found.how != AS_NOMINAL):
            taken = (found.s - rate) / state.T
            if self._motors is not None and self._motors.name in found.objections:
                share = share_of_nominal(taken, asked, rate[:n], state.T)
        vdot = np.empty_like(taken)
        vdot[model.order] = taken
        actuation, excess = clip_torque(
            model.inverse_dynamics(workspace, vdot), self.effort_limits
        )
        obstacle = None
        if before.regions is not None:
            obstacle = self.among.ran_into(before.regions, found)
        solution = Solution(
            acceleration=vdot,
            task_error=nominal.task_error,
            constraint_weights=nominal.weights,
            constrained_velocity=nominal.qdot_c,
            **how,
            actuation=actuation,
            position_command=state_ahead(
                *(q, v, vdot, self._period, self._plant_step),
                *(model.positions, model.order),
            ),
            torque_limit=np.array([share, excess]),
            obstacle=obstacle,
            measured=(model, q),
        )
        return solution, braking

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
        q, v = self._measured.now(memory.sent, memory.lateness, held, q, v)
        if self._safe and memory.q is not None:
            v = self._measured.believed(v, memory.v)
        model.plant.SetPositionsAndVelocities(
            workspace.plant_context, np.concatenate((q, v))
        )
        actuation, excess = clip_torque(
            model.inverse_dynamics(workspace, solved.acceleration), self.effort_limits
        )
        torque_limit = np.array([solved.torque_limit[0], excess])
        solution = replace(solved, actuation=actuation, torque_limit=torque_limit)
        return replace(memory, torque_tick=torque_tick, solution=solution)


def _of_sizes(*given: tuple[str, np.ndarray | None, int]) -> list[np.ndarray]:
    """The values of (name, value, size), as arrays; raises InputError with the name.

    Copied, since what may not be written to is compiled for anew.
    """
    arrays = []
    for name, value, size in given:
        value = _NOTHING if value is None else value
        if np.shape(value) != (size,):
            must = f"it must be ({size},)" if size else "nothing takes it: leave it out"
            raise InputError(f"{name} has shape {np.shape(value)}; {must}")
        arrays.append(np.array(value, dtype=float, order="C"))
    return arrays
