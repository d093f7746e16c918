"""One control step, from state and targets to accelerations and torque.

This is the order of the paper: error, references, weights, inverse, velocity level,
acceleration level, resolved acceleration, inverse dynamics. There is no Drake system
here: `CrarController` wraps it for diagrams, and `ControlLaw.step` serves a user's
own loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from crar_drake.equations.adaptive_gain import adaptive_gain
from crar_drake.equations.blending import blend_tasks, blend_vectors, smooth_step
from crar_drake.equations.collisions import (
    collision_gradient,
    collision_potential_slope,
    collision_proximity,
    collision_weights,
    pair_weights,
)
from crar_drake.equations.composite_weight import (
    composite_index,
    composite_weights,
    inertia_weight,
)
from crar_drake.equations.joint_limits import LimitPotential, joint_limit_weights
from crar_drake.equations.lookahead import (
    JointLimits,
    make_rows,
    resting_configuration,
    slip_velocity,
    solve_lookahead,
)
from crar_drake.equations.references import reference_acceleration, reference_velocity
from crar_drake.equations.resolved_acceleration import (
    acceleration_level_acceleration,
    constrained_resolved_acceleration,
    constrained_velocity,
    null_space_motion,
    velocity_level_acceleration,
)
from crar_drake.equations.tasks import DesiredTasks, task_error
from crar_drake.equations.torque_limit import torque_scale
from crar_drake.equations.weighted_inverse import damped_weighted_pseudo_inverse
from crar_drake.errors import CrarError
from crar_drake.parameters import CrarParameters
from crar_drake.robot import ControlModel, Distances, ModelState, Workspace

# Values of the controller's output port "status".
STATUS_TRACKING = 0.0  # the targets as given
STATUS_BLENDING = 1.0  # on the way onto the targets
STATUS_BRAKING = 2.0  # a target is NaN: coming to rest


UNLIMITED = np.array([1.0, 0.0])  # Solution.torque_limit
_NO_MARGINS = np.full(2, np.nan)


class InputError(CrarError):
    """A value that reached the controller at run time cannot be used."""


@dataclass(slots=True)
class Targets:
    """What one control step is asked to do.

    Attributes:
        tasks: (layout.size,) [x_d; v_d; a_d], see `TaskLayout`.
        prescribed: (3 n_p,) [q_p; q_dot_p; q_ddot_p] of the prescribed joints.
        nominal_posture: (n,) positions that the null space is drawn to; only if
            the parameter `nominal_posture_gain` is set.
    """

    tasks: np.ndarray
    prescribed: np.ndarray
    nominal_posture: np.ndarray | None = None

    def finite(self) -> bool:
        """Whether there is no NaN or infinite value among the targets."""
        posture = self.nominal_posture
        return (
            is_finite(self.tasks)
            and is_finite(self.prescribed)
            and (posture is None or is_finite(posture))
        )


@dataclass(slots=True)
class Memory:
    """What one control step leaves to the next; never changed in place.

    Attributes:
        tick: number of the control step that wrote it; -1 before the first.
        start_time: when blending began [s], None if it has yet to; with the
            measured task orientations R_start, positions p_start and prescribed
            joints q_p_start of then.
        limit_proximity, pair_proximity: |grad h_i| and |grad f_ji| of that step,
            which Eqs. (18) and (21) compare with.
        qdot_c: Eq. (15) of that step, for Eq. (10).
        qdot, qddot, slip: measured velocity, commanded acceleration and slip of the
            controlled joints in that step, for `slip_velocity`.
    """

    tick: int = -1
    start_time: float | None = None
    R_start: np.ndarray | None = None
    p_start: np.ndarray | None = None
    q_p_start: np.ndarray | None = None
    limit_proximity: np.ndarray | None = None
    pair_proximity: np.ndarray | None = None
    qdot_c: np.ndarray | None = None
    qdot: np.ndarray | None = None
    qddot: np.ndarray | None = None
    slip: np.ndarray | None = None


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
        resting_margins: (2,) where the robot would come to rest: the smallest
            distance [m] and the smallest margin to a joint limit [rad]; NaN
            unless constraints are "lookahead".
        status: (1,) STATUS_TRACKING, STATUS_BLENDING or STATUS_BRAKING.
        torque_limit: (2,) share theta of the wish that the effort limits allowed,
            1 where they are not active or not respected, and by which share of its
            limit the worst actuator was beyond it before clipping, see
            `equations.torque_limit`.
    """

    actuation: np.ndarray
    acceleration: np.ndarray
    task_error: np.ndarray
    signed_distances: np.ndarray
    constraint_weights: np.ndarray
    position_command: np.ndarray
    constrained_velocity: np.ndarray
    resting_margins: np.ndarray
    status: np.ndarray
    torque_limit: np.ndarray


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


@dataclass(slots=True)
class References:
    """What the targets ask for, with task weights applied to every row.

    Attributes:
        J: (m, n) task Jacobian of the controlled joints.
        v_r: (m,) v_d + K e less the prescribed joints' share.
        a_r: (m,) Eq. (14) less the prescribed joints' share.
        Jdot_qdot: (m,) bias acceleration.
        posture: (n,) acceleration towards the nominal posture; None if off.
        qddot_p: (n_p,) accelerations of the prescribed joints.
    """

    J: np.ndarray
    v_r: np.ndarray
    a_r: np.ndarray
    Jdot_qdot: np.ndarray
    posture: np.ndarray | None
    qddot_p: np.ndarray


@dataclass(slots=True)
class Resolved:
    """What a constraint mode makes of the references.

    Attributes:
        qddot: (n,) alpha_c.
        qdot_c: (n,) Eq. (15).
        W: (n,) diagonal of the weight matrix.
        limit_proximity, pair_proximity: for the next step's Eqs. (18), (21).
        slip: (n,) for the next step's `slip_velocity`.
        resting_margins: (2,) see `Solution`; None for NaN.
    """

    qddot: np.ndarray
    qdot_c: np.ndarray
    W: np.ndarray
    limit_proximity: np.ndarray | None = None
    pair_proximity: np.ndarray | None = None
    slip: np.ndarray | None = None
    resting_margins: np.ndarray | None = None


@dataclass(slots=True)
class ConstraintWeights:
    """The diagonal of W, and what its next evaluation compares with.

    Attributes:
        W: (n,).
        nearness: (n,) what W would be if everything were being approached.
        limit_proximity, pair_proximity: see `Memory`.
    """

    W: np.ndarray
    nearness: np.ndarray
    limit_proximity: np.ndarray | None = None
    pair_proximity: np.ndarray | None = None


class ControlLaw:
    """The constrained resolved acceleration of a robot model and its torque.

    Attributes:
        model: kinematics, distances, dynamics.
        parameters: gains and modes.
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
        self._limit_potential = LimitPotential(model.lower, model.upper)
        ahead = self.parameters.lookahead
        self._joint_limits = JointLimits(
            model.lower,
            model.upper,
            margin=ahead.limit_margin,
            gamma=ahead.retreat_rate,
            fastest=ahead.joint_retreat_speed,
            rho=ahead.rho_limits,
        )
        self.reset()

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
        if prescribed is None:
            prescribed = np.zeros(0)
        nq, nv = self.model.plant.num_positions(), self.model.plant.num_velocities()
        expected = [
            ("q", q, nq),
            ("v", v, nv),
            ("tasks", tasks, self.model.layout.size),
            ("prescribed", prescribed, 3 * self.model.n_p),
        ]
        if self.parameters.nominal_posture_gain:
            expected.append(("nominal_posture", nominal_posture, self.model.n))
        tick = self._memory.tick + 1
        for name, value, size in expected:
            if np.shape(value) != (size,):
                raise InputError(
                    f"{name} has shape {np.shape(value)}; it must be ({size},)"
                )
            if name in ("q", "v") or not self.brakes_without_targets:
                check_finite(name, value, tick * self.parameters.period)
        step = self.solve(
            self._workspace,
            self._memory,
            tick,
            tick * self.parameters.period,
            np.asarray(q, dtype=float),
            np.asarray(v, dtype=float),
            Targets(
                np.asarray(tasks, dtype=float),
                np.asarray(prescribed, dtype=float),
                None
                if nominal_posture is None
                else np.asarray(nominal_posture, dtype=float),
            ),
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
            InputError: a desired orientation is a quaternion of zero length.
        """
        model, gains = self.model, self.parameters
        near = None
        if gains.constraints == "lookahead":
            q_s = resting_configuration(q, v, gains.braking_horizon)
            state, near = model.evaluate_with_ahead(workspace, q, v, q_s)
        else:
            state = model.evaluate(workspace, q, v)
        desired = model.layout.unpack(targets.tasks)
        # A quaternion of zero length is a number, but no orientation.
        oriented = not len(desired.R) or np.isfinite(desired.R).all()
        if self.brakes_without_targets and not (oriented and targets.finite()):
            return self._brake(workspace, memory, tick, q, v, state)
        if not oriented:
            raise InputError(
                f"desired_tasks has a quaternion of zero length at t = {time:g} s; "
                "give unit quaternions (w, x, y, z), see TaskLayout"
            )
        if memory.start_time is None:
            memory = replace(
                memory,
                start_time=time,
                R_start=state.R,
                p_start=state.p,
                q_p_start=state.q_p,
            )
        blend = smooth_step(time - memory.start_time, gains.blend_time)
        error = task_error(model.layout, state.R, state.p, desired.R, desired.p)
        references = self._references(state, memory, targets, desired, error, blend)
        if near is not None:
            slip = self._slip(memory, tick, state)
            resolved = self._resolve_lookahead(state, q_s, near, references, slip)
        else:
            resolved = self._resolve_paper(workspace, state, references, memory)

        vdot = model.join(resolved.qddot, references.qddot_p)
        status = STATUS_TRACKING if blend[0] == 1.0 else STATUS_BLENDING
        solution = self._solution(workspace, q, v, vdot, state, error, resolved, status)
        return ControlStep(
            solution,
            Memory(
                tick=tick,
                start_time=memory.start_time,
                R_start=memory.R_start,
                p_start=memory.p_start,
                q_p_start=memory.q_p_start,
                limit_proximity=resolved.limit_proximity,
                pair_proximity=resolved.pair_proximity,
                qdot_c=resolved.qdot_c,
                qdot=state.qdot,
                qddot=solution.acceleration[model.controlled],
                slip=resolved.slip,
            ),
        )

    @property
    def brakes_without_targets(self) -> bool:
        """Whether a NaN in the targets makes the robot brake, not raise."""
        return (
            self.parameters.constraints == "lookahead"
            and self.parameters.lookahead.lost_target == "brake"
        )

    def _references(
        self,
        state: ModelState,
        memory: Memory,
        targets: Targets,
        desired: DesiredTasks,
        e: np.ndarray,
        blend: tuple[float, float, float],
    ) -> References:
        """Eqs. (9), (14): what the blended targets ask for, weighted.

        `e` is the error of Eq. (11) against `desired`.
        """
        model, gains = self.model, self.parameters
        layout, S = model.layout, model.row_weights
        q_d, v_d, a_d = targets.prescribed.reshape(3, -1)
        if blend[0] < 1.0:
            desired = blend_tasks(
                layout, memory.R_start, memory.p_start, desired, blend
            )
            q_d, v_d, a_d = blend_vectors(memory.q_p_start, q_d, v_d, a_d, blend)
            e = task_error(layout, state.R, state.p, desired.R, desired.p)
        # Prescribed joints: the desired acceleration, with Eq. (14)'s feedback.
        Kp, Kv = gains.Kp, gains.velocity_gain
        qddot_p = reference_acceleration(
            a_d, v_d, state.qdot_p, q_d - state.q_p, Kp, Kv
        )
        v_r = reference_velocity(desired.v, e, gains.K)
        a_r = reference_acceleration(desired.a, desired.v, state.v, e, Kp, Kv)
        posture = None
        if gains.nominal_posture_gain:
            # A damped pull, for the null space.
            stiffness = gains.nominal_posture_gain
            posture = (
                stiffness * (targets.nominal_posture - state.q)
                - 2.0 * np.sqrt(stiffness) * state.qdot
            )
        J, Jdot_qdot = state.J, state.Jdot_qdot
        v_r = v_r - state.J_p @ state.qdot_p
        a_r = a_r - state.J_p @ qddot_p
        if model.weighs_rows:
            J, Jdot_qdot = S[:, None] * J, S * Jdot_qdot
            v_r, a_r = S * v_r, S * a_r
        return References(J, v_r, a_r, Jdot_qdot, posture, qddot_p)

    def _resolve_paper(
        self,
        workspace: Workspace,
        state: ModelState,
        references: References,
        memory: Memory,
    ) -> Resolved:
        """Eqs. (10), (15)-(35); W = I where constraints are "none"."""
        gains = self.parameters
        weights = self._constraint_weights(state, memory)
        J, W = references.J, weights.W
        if gains.metric == "inertia":
            W = inertia_weight(self.model.inertia_matrix(workspace), W)
        Gv, GvN = gains.Gv, gains.null_space_gain
        if gains.Gv_near is not None:
            Gv = adaptive_gain(gains.Gv, gains.Gv_near, weights.nearness)
            GvN = Gv if gains.GvN is None else GvN
        J_star = damped_weighted_pseudo_inverse(J, W, gains.damping)
        qdot_c = constrained_velocity(J_star, references.v_r)
        if gains.level == "velocity":
            alpha = velocity_level_acceleration(qdot_c, memory.qdot_c, gains.period)
        else:
            zeta = null_space_motion(qdot_c, state.qdot, GvN)
            if references.posture is not None:
                zeta = zeta + references.posture
            alpha = acceleration_level_acceleration(
                J, J_star, references.a_r, references.Jdot_qdot, zeta
            )
        return Resolved(
            qddot=constrained_resolved_acceleration(alpha, qdot_c, state.qdot, Gv),
            qdot_c=qdot_c,
            W=weights.W if W.ndim == 1 else np.diag(W),
            limit_proximity=weights.limit_proximity,
            pair_proximity=weights.pair_proximity,
        )

    def _resolve_lookahead(
        self,
        state: ModelState,
        q_s: np.ndarray,
        near: Distances,
        references: References,
        slip: np.ndarray,
    ) -> Resolved:
        """The mode of `equations.lookahead`: constraints where q + T q_dot rests."""
        model, gains = self.model, self.parameters
        ahead, T = gains.lookahead, gains.braking_horizon
        # Two rows a pair: at the state, told T ahead by its velocity; and at q_s.
        h = near.d.copy()
        h[0] += T * (state.dd_dq @ state.qdot + state.dd_dq_p @ state.qdot_p)
        s_p = state.qdot_p + T * references.qddot_p
        rows = make_rows(
            h.ravel(),
            near.dd_dq.reshape(-1, model.n),
            (near.dd_dq_p @ s_p).ravel(),
            d_min=ahead.distance_margin,
            influence=ahead.influence_distance,
            gamma=ahead.retreat_rate,
            fastest=ahead.retreat_speed,
            rho=ahead.rho,
            alpha=gains.alpha,
            beta=gains.beta,
            slip=slip,
        )
        limits = self._joint_limits(q_s[model.controlled], slip)
        chosen = solve_lookahead(
            references.J,
            references.v_r,
            references.a_r - references.Jdot_qdot,
            state.qdot,
            rows.with_(limits),
            T=T,
            Gv=gains.Gv,
            damping=gains.damping,
            posture=references.posture,
        )
        return Resolved(
            qddot=chosen.qddot,
            qdot_c=chosen.qdot_c,
            W=chosen.W.diagonal(),
            slip=slip,
            resting_margins=np.array(
                [h.min(initial=np.inf), limits.h.min(initial=np.inf)]
            ),
        )

    def _slip(self, memory: Memory, tick: int, state: ModelState) -> np.ndarray:
        """What q_s did besides s; 0 without a step before."""
        gains = self.parameters
        if memory.slip is None or tick != memory.tick + 1:
            return np.zeros(self.model.n)
        return slip_velocity(
            memory.slip,
            state.qdot,
            memory.qdot,
            memory.qddot,
            T=gains.braking_horizon,
            period=gains.period,
            time_constant=gains.lookahead.slip_time_constant,
        )

    def _brake(
        self,
        workspace: Workspace,
        memory: Memory,
        tick: int,
        q: np.ndarray,
        v: np.ndarray,
        state: ModelState,
    ) -> ControlStep:
        """Without targets: q_ddot = -q_dot / T, and blend in when they are back."""
        model = self.model
        vdot = -v / self.parameters.braking_horizon
        resolved = Resolved(
            qddot=vdot[model.controlled],
            qdot_c=np.zeros(model.n),
            W=np.ones(model.n),
        )
        error = np.full(model.m, np.nan)
        return ControlStep(
            self._solution(
                workspace, q, v, vdot, state, error, resolved, STATUS_BRAKING
            ),
            Memory(tick=tick),
        )

    def _solution(
        self,
        workspace: Workspace,
        q: np.ndarray,
        v: np.ndarray,
        vdot: np.ndarray,
        state: ModelState,
        error: np.ndarray,
        resolved: Resolved,
        status: float,
    ) -> Solution:
        period = self.parameters.period
        actuation = self.model.inverse_dynamics(workspace, vdot)
        torque_limit = UNLIMITED
        if self.parameters.respect_effort_limits:
            vdot, actuation, torque_limit = self._limit_torque(
                workspace, vdot, actuation, state
            )
        v_next = v + period * vdot
        return Solution(
            actuation=actuation,
            acceleration=vdot,
            task_error=error,
            signed_distances=state.d,
            constraint_weights=resolved.W,
            position_command=np.concatenate([q + period * v_next, v_next]),
            constrained_velocity=resolved.qdot_c,
            resting_margins=_NO_MARGINS
            if resolved.resting_margins is None
            else resolved.resting_margins,
            status=np.array([status]),
            torque_limit=torque_limit,
        )

    def _limit_torque(
        self,
        workspace: Workspace,
        vdot: np.ndarray,
        actuation: np.ndarray,
        state: ModelState,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Accelerations and torque within the effort limits, see
        `equations.torque_limit`; and `Solution.torque_limit`."""
        model, T = self.model, self.parameters.braking_horizon
        limits = model.actuator_limits
        brake, still = vdot.copy(), vdot.copy()
        brake[model.controlled] = -state.qdot / T
        still[model.controlled] = 0.0
        tau_brake = model.inverse_dynamics(workspace, brake)
        scale = torque_scale(
            actuation,
            tau_brake,
            model.inverse_dynamics(workspace, still),
            limits,
            period_over_horizon=self.parameters.period / T,
        )
        if scale.theta == 1.0:
            return vdot, np.clip(actuation, -limits, limits), UNLIMITED
        tau = tau_brake + scale.theta * (actuation - tau_brake)
        return (
            brake + scale.theta * (vdot - brake),
            np.clip(tau, -limits, limits),
            np.array([scale.theta, scale.excess]),
        )

    def _constraint_weights(
        self, state: ModelState, memory: Memory
    ) -> ConstraintWeights:
        """Eqs. (17)-(28) at a state; W = I where constraints are "none"."""
        model, gains = self.model, self.parameters
        if gains.constraints == "none":
            return ConstraintWeights(np.ones(model.n), np.ones(model.n))
        limit_gradient, limit_proximity = self._limit_potential.gradient_and_proximity(
            state.q
        )
        W_JL = joint_limit_weights(
            limit_gradient, limit_proximity, memory.limit_proximity
        )
        slope = collision_potential_slope(state.d, gains.rho, gains.alpha, gains.beta)
        gradient = collision_gradient(slope, state.dd_dq)
        pair_proximity = collision_proximity(gradient, state.d)
        W_COL = collision_weights(
            pair_weights(gradient, pair_proximity, memory.pair_proximity)
        )
        a = gains.limit_share
        if a is None:
            a = composite_index(len(model.pairs))
        W = composite_weights(W_JL, W_COL, a)
        nearness = W
        if gains.Gv_near is not None:
            nearness = composite_weights(
                1.0 + limit_proximity, collision_weights(1.0 + pair_proximity), a
            )
        return ConstraintWeights(W, nearness, limit_proximity, pair_proximity)


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
