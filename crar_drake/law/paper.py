"""The nominal of the paper: weights (17)-(28), inverse (34), levels (10), (35).

By itself, without a projection, it is the paper to the letter.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.collisions import (
    collision_gradient,
    collision_potential_slope,
    collision_proximity,
    collision_weights,
    pair_weights,
)
from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.composite_weight import composite_weights, inertia_weight
from crar_drake.law.handover import hand_over, take_over
from crar_drake.law.joint_limits import (
    LimitPotential,
    joint_limit_weights,
    limit_gradient,
    limit_potential,
    limit_proximity,
)
from crar_drake.law.kinematics import Measured, find_state, join_joints
from crar_drake.law.nominal import Nominal
from crar_drake.law.references import (
    References,
    Targets,
    TaskGains,
    find_references,
)
from crar_drake.law.resolved_acceleration import (
    acceleration_level_acceleration,
    constrained_resolved_acceleration,
    constrained_velocity,
    null_space_motion,
    velocity_level_acceleration,
)
from crar_drake.law.vectors import times
from crar_drake.law.weighted_inverse import damped_inverse, inverse_times
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

_NO_MATRIX = np.zeros((0, 0))


class Gains(NamedTuple):
    """The paper's numbers, see `law.parameters.PaperGains`."""

    damping: float  # lambda [m]
    Gv: float  # [1/s]
    GvN: float  # [1/s]; NaN: as Gv
    rho: float
    alpha: float  # [1/m]
    beta: float
    limit_share: float  # a of Eq. (27)
    period: float  # of the controller [s]
    velocity_level: bool


class ConstraintWeights(NamedTuple):
    """The diagonal of W, and what its next evaluation compares with."""

    W: np.ndarray  # (n,)
    limit_proximity: np.ndarray  # (n,) for the next step's Eq. (18).
    pair_proximity: np.ndarray  # (Nc, n) for the next step's Eq. (21).


@compiled
def constraint_weights(
    q: np.ndarray,
    d: np.ndarray,
    dd_dq: np.ndarray,
    limit_before: np.ndarray,
    pair_before: np.ndarray,
    limits: LimitPotential,
    gains: Gains,
) -> ConstraintWeights:
    """Eqs. (17)-(28) in their order.

    Args:
        q: (n,) positions of the controlled joints [rad].
        d: (Nc,) signed distances [m].
        dd_dq: (Nc, n) Eq. (20).
        limit_before, pair_before: (n,), (Nc, n) the proximities of the step before;
            zeros at the first.
    """
    near_limit = limit_gradient(q, limits)
    of_limits = limit_proximity(q, near_limit, limits)
    W_JL = joint_limit_weights(near_limit, of_limits, limit_before)
    slope = collision_potential_slope(d, gains.rho, gains.alpha, gains.beta)
    gradient = collision_gradient(slope, dd_dq)
    of_pairs = collision_proximity(gradient, d)
    W_COL = collision_weights(pair_weights(gradient, of_pairs, pair_before))
    W = composite_weights(W_JL, W_COL, gains.limit_share)
    return ConstraintWeights(W, of_limits, of_pairs)


@compiled
def weighted_acceleration(
    references: References,
    qdot: np.ndarray,
    W: np.ndarray,
    inertia: np.ndarray,
    qdot_c_before: np.ndarray,
    gains: Gains,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eqs. (10), (15), (30)-(35) in their order, with a given W.

    Args:
        qdot: (n,) velocities of the controlled joints [rad/s].
        W: (n,) diagonal of the weight.
        inertia: (n, n) for the metric "inertia"; (0, 0) for the identity.
        qdot_c_before: (n,) Eq. (15) of the step before; (0,) at the first step.

    Returns:
        (n,) q_ddot [rad/s^2]; (n,) q_dot_c [rad/s]; (n,) diagonal of the weight.
    """
    J = references.J
    if len(inertia):
        W_H = inertia_weight(inertia, W)
        J_star = damped_inverse(J, W_H, gains.damping)
        W = np.diag(W_H).copy()
    else:
        J_star = damped_inverse(J, W, gains.damping)
    GvN = gains.Gv if np.isnan(gains.GvN) else gains.GvN
    v_r, a_r = references.v_r, references.a_r
    qdot_0, qddot_0 = references.qdot_0, references.qddot_0
    if len(qdot_0):  # tasks that are joints: `references.undamped_preference`
        v_r, a_r = v_r - times(J, qdot_0), a_r - times(J, qddot_0)
    qdot_c = constrained_velocity(J_star, v_r)
    if len(qdot_0):
        qdot_c = qdot_0 + qdot_c
    if gains.velocity_level:
        before = qdot_c_before if len(qdot_c_before) else qdot_c
        alpha = velocity_level_acceleration(qdot_c, before, gains.period)
    else:
        zeta = null_space_motion(qdot_c, qdot, GvN) + references.posture
        alpha = acceleration_level_acceleration(J_star, J, a_r, zeta)
        if len(qddot_0):
            alpha = qddot_0 + alpha
    qddot = constrained_resolved_acceleration(alpha, qdot_c, qdot, gains.Gv)
    return qddot, qdot_c, W


class PaperNumbers(NamedTuple):
    """What the law is made with."""

    tasks: TaskGains
    limits: LimitPotential
    gains: Gains
    constrained: bool  # else W = I


class PaperMemory(NamedTuple):
    """What one step leaves to the next."""

    limit_proximity: np.ndarray  # (n,) |grad h_i|, which Eq. (18) compares with
    pair_proximity: np.ndarray  # (Nc, n) |grad f_ji|, which Eq. (21) compares with
    qdot_c: np.ndarray  # (n,) Eq. (15), for Eq. (10); (0,) before the first step


@compiled
def paper_step(
    measured: Measured,
    targets: Targets,
    inertia: np.ndarray,
    robot: Held,
    mode: Held,
    before: PaperMemory,
) -> tuple[np.ndarray, ...]:
    """One control step of the paper's law; see the functions above.

    Args:
        inertia: (n, n) for the metric "inertia"; (0, 0) for the identity.
        robot: holds a `Robot`.
        mode: holds `PaperNumbers`.
        before: of the step before; zeros, and no q_dot_c, at the first.

    Returns:
        (nv,) accelerations in the plant's order; (m,) Eq. (11) against the targets as
        given; (n,) diagonal of W; `PaperMemory` for the next step, of which (Nc n,) the
        second; (Nc,) signed distances [m].
    """
    r, numbers = robot.value, mode.value
    n, gains = r.n, numbers.gains
    state = find_state(measured, r)
    references = find_references(state, targets, r.rows.value, numbers.tasks)
    if numbers.constrained:
        weights = constraint_weights(
            state.q[:n],
            state.d[0],
            np.ascontiguousarray(state.dd_dv[0][:, :n]),
            before.limit_proximity,
            before.pair_proximity,
            numbers.limits,
            gains,
        )
    else:
        weights = ConstraintWeights(
            np.ones(n), before.limit_proximity, before.pair_proximity
        )
    qddot, qdot_c, W = weighted_acceleration(
        references,
        state.v[:n],
        weights.W,
        inertia,
        before.qdot_c,
        gains,
    )
    return (
        join_joints(qddot, references.qddot_p, r.order),
        references.error,
        W,
        weights.limit_proximity,
        weights.pair_proximity.ravel(),
        qdot_c,
        state.d[0],
    )


class Numbers(NamedTuple):
    """All that stays from step to step."""

    robot: Held  # of a `Robot`
    mode: Held  # of `PaperNumbers`


@compiled
def paper_control(
    q: np.ndarray,
    v: np.ndarray,
    asked: np.ndarray,
    tasks: np.ndarray,
    prescribed: np.ndarray,
    posture: np.ndarray,
    R: np.ndarray,
    p: np.ndarray,
    q_p: np.ndarray,
    q_t: np.ndarray,
    s: float,
    s_dot: float,
    s_ddot: float,
    kept: np.ndarray,
    inertia: np.ndarray,
    law: Held,
) -> np.ndarray:
    """`paper_step`, from arrays to one.

    Args:
        q, v, asked, tasks, prescribed, posture, R, p, q_p, q_t, s, s_dot, s_ddot: state
            and targets, of `handover.hand_over`.
        kept: (2 n + Nc n,) `PaperMemory`, whose q_dot_c is NaN before the first step.
        inertia: of `paper_step`.
        law: holds `Numbers`.

    Returns:
        What `paper_step` returns, one after the other.
    """
    robot, mode = law.value.robot, law.value.mode
    r, n = robot.value, robot.value.n
    Nc = len(r.pairs.value.moves)
    pairs = n + Nc * n
    qdot_c = kept[pairs:]
    if np.isnan(qdot_c[0]):
        qdot_c = qdot_c[:0]
    return np.concatenate(
        paper_step(
            Measured(q.reshape(1, -1), v, asked),
            take_over(tasks, prescribed, posture, R, p, q_p, q_t, s, s_dot, s_ddot),
            inertia,
            robot,
            mode,
            PaperMemory(kept[:n], kept[n:pairs].reshape(Nc, n), qdot_c),
        )
    )


class PaperLaw:
    """The diagonal W of Eqs. (17)-(28) in the inverse of Eq. (34); or W = I."""

    def __init__(
        self,
        model: ControlModel,
        tasks: TaskGains,
        gains: Gains,
        constrained: bool = True,
        with_inertia: bool = False,
    ) -> None:
        """
        Args:
            model: of the robot, its tasks and pairs.
            tasks: gains.
            gains: the paper's numbers.
            constrained: else W = I: the raw motion, whose violations Fig. 2 counts.
            with_inertia: whether W weighs by the inertia, too, see
                `composite_weight.inertia_weight`.
        """
        limits = limit_potential(model.lower, model.upper)
        mode = hold(PaperNumbers(tasks, limits, gains, constrained))
        self._model, self._with_inertia = model, with_inertia
        self._law = hold(Numbers(model.robot_by_pair, mode))
        # Of what `paper_control` returns, but for the distances at its end.
        n, nv = model.n, model.n + model.n_p
        kept = n + len(model.pairs) * n
        self._ends = np.cumsum([0, nv, model.m, n, kept, n]).tolist()
        self._first = np.concatenate((np.zeros(kept), np.full(n, np.nan)))

    def __call__(
        self,
        workspace: Workspace,
        q: np.ndarray,
        v: np.ndarray,
        targets: Targets,
        before: np.ndarray | None,
        efforts: np.ndarray,
    ) -> Nominal:
        model, inertia = self._model, _NO_MATRIX
        if self._with_inertia:
            inertia = model.inertia_matrix(workspace)
        found = paper_control(
            *(q, v, model.asked_here(workspace), *hand_over(targets)),
            *(self._first if before is None else before, inertia, self._law),
        )
        _, a, b, c, d, end = self._ends
        vdot, error, W, kept = found[:a], found[a:b], found[b:c], found[c:end]
        return Nominal(vdot, error, W, found[d:end], kept)


_STOPPED = 1e9  # the weight of a joint that may go no farther


@compiled
def start_step(
    q: np.ndarray,
    J: np.ndarray,
    error: np.ndarray,
    d: np.ndarray,
    dd_dq: np.ndarray,
    room: tuple[np.ndarray, np.ndarray],
    limits: LimitPotential,
    gains: Gains,
) -> np.ndarray:
    """J* e, by the inverse of Eq. (34): (n,) displacements [rad or m].

    W is that of Eq. (27) with every constraint counted as being approached; joints
    that the first such step takes out of their room are stopped in a second one, so
    that the others do what they cannot.

    Args:
        q: (n,) positions of the controlled joints [rad or m].
        J: (m, n) task Jacobian, with the rows' weights.
        error: (m,) Eq. (11), with the same.
        d: (Nc,) signed distances [m].
        dd_dq: (Nc, n) Eq. (20).
        room: (n,), (n,) from where and to where joints may go.
        gains: damping, rho, alpha, beta and limit_share count.
    """
    lower, upper = room
    # Before, nothing was near.
    W = constraint_weights(
        q, d, dd_dq, np.zeros(len(q)), np.zeros(dd_dq.shape), limits, gains
    ).W
    step = inverse_times(damped_inverse(J, W, gains.damping), error)
    for i in range(len(q)):
        if (q[i] <= lower[i] and step[i] < 0.0) or (q[i] >= upper[i] and step[i] > 0.0):
            W[i] = _STOPPED
    return inverse_times(damped_inverse(J, W, gains.damping), error)
