"""The nominal of the paper: weights (17)-(28), inverse (34), levels (10), (35).

By itself, without a projection, it is the paper to the letter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.constraint_weights import (
    LimitPotential,
    approach_weights,
    collision_potential_slope,
    collision_proximity,
    composite_index,
    inertia_weight,
    limit_gradient,
    limit_potential,
    limit_proximity,
)
from crar_drake.law.kinematics import find_state, watched_distances
from crar_drake.law.parameters import PaperGains
from crar_drake.law.references import (
    Nominal,
    References,
    Targets,
    TaskGains,
    find_references,
)
from crar_drake.law.vectors import times, transposed_times
from crar_drake.law.weighted_inverse import (
    damped_inverse,
    inverse_times,
    project_to_null_space,
)
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

    @staticmethod
    def of(given: PaperGains, period: float, num_pairs: int) -> Gains:
        """Those of parameters, for a control period [s] and so many watched pairs."""
        GvN, share = given.GvN, given.limit_share
        return Gains(
            *(float(given.damping), float(given.Gv)),
            math.nan if GvN is None else float(GvN),
            *(float(given.rho), float(given.alpha), float(given.beta)),
            composite_index(num_pairs) if share is None else float(share),
            *(float(period), given.level == "velocity"),
        )


@compiled
def constraint_weights(
    q: np.ndarray,
    d: np.ndarray,
    dd_dq: np.ndarray,
    limit_before: np.ndarray,
    pair_before: np.ndarray,
    limits: LimitPotential,
    gains: Gains,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eqs. (17)-(28) in their order.

    Args:
        q: (n,) positions of the controlled joints [rad].
        d: (Nc,) signed distances [m].
        dd_dq: (Nc, n) Eq. (20).
        limit_before, pair_before: (n,), (Nc, n) the proximities of the step before;
            zeros at the first.

    Returns:
        (n,) the diagonal of W; and the proximities (n,), (Nc, n) for the next step.
    """
    near_limit = limit_gradient(q, limits)  # (17)
    of_limits = limit_proximity(q, near_limit, limits)
    W_JL = approach_weights(near_limit, of_limits, limit_before)  # (18)
    slope = collision_potential_slope(d, gains.rho, gains.alpha, gains.beta)  # (23)
    gradient = slope[:, np.newaxis] * dd_dq  # (19), (25)
    of_pairs = collision_proximity(gradient, d)
    W_COL = np.ones(len(q))
    if len(d):
        W_COL_j = approach_weights(gradient, of_pairs, pair_before)  # (21)
        W_COL = transposed_times(W_COL_j, np.ones(len(d))) / len(d)  # (26)
    W = gains.limit_share * W_JL + (1.0 - gains.limit_share) * W_COL  # (27)
    return W, of_limits, of_pairs


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
        qdot_c_before: (n,) Eq. (15) of the step before; NaN at the first step.

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
    # Of tasks that are joints what they ask for is not damped.
    qdot_0, qddot_0 = references.qdot_0, references.qddot_0
    qdot_c = qdot_0 + inverse_times(J_star, references.v_r - times(J, qdot_0))  # (15)
    if gains.velocity_level:  # (3), (10); 0 where there is no difference to take
        before = qdot_c if np.isnan(qdot_c_before[0]) else qdot_c_before
        alpha = (qdot_c - before) / gains.period
    else:
        a_r = references.a_r - times(J, qddot_0)
        alpha = qddot_0 + inverse_times(J_star, a_r)  # (13)
        if J.shape[0] < J.shape[1]:
            zeta = GvN * (qdot_c - qdot) + references.posture  # (33)
            alpha += project_to_null_space(J_star, J, zeta)  # (31), (35)
    # (12), (30): (12) with K_qv = H Gv, so that both levels differ in alpha only.
    qddot = alpha + gains.Gv * (qdot_c - qdot)
    return qddot, qdot_c, W


class PaperNumbers(NamedTuple):
    """What the law is made with."""

    robot: Held  # of a `Robot`
    tasks: TaskGains
    limits: LimitPotential
    gains: Gains
    constrained: bool  # else W = I


@compiled
def paper_step(
    q: np.ndarray,
    v: np.ndarray,
    asked: np.ndarray,
    tasks: np.ndarray,
    prescribed: np.ndarray,
    posture: np.ndarray,
    start: np.ndarray,
    s: float,
    s_dot: float,
    s_ddot: float,
    kept: np.ndarray,
    inertia: np.ndarray,
    law: Held,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One control step of the paper's law; see the functions above.

    Args:
        q, v: (nq,), (nv,) state in the plant's order.
        asked: of `watched_distances`.
        tasks, ..., s_ddot: the targets, taken apart.
        kept: (n + Nc n + n,) of the step before: the proximities that Eqs. (18) and
            (21) compare with, and q_dot_c of Eq. (15). At the first step the former are
            0, and the latter NaN.
        inertia: (n, n) for the metric "inertia"; (0, 0) for the identity.
        law: holds `PaperNumbers`.

    Returns:
        The parts of `Nominal`, in their order.
    """
    numbers = law.value
    r, gains = numbers.robot.value, numbers.gains
    n, Nc = r.n, len(r.watched.value.moves)
    of_limits, of_pairs = kept[:n], kept[n : n + Nc * n].reshape(Nc, n)
    state = find_state(q, v, numbers.robot)
    targets = Targets(tasks, prescribed, posture, start, (s, s_dot, s_ddot))
    references = find_references(state, targets, r.rows.value, numbers.tasks)
    W = np.ones(n)
    if numbers.constrained:
        d, dd_dv = watched_distances(state, asked, numbers.robot)
        dd_dq, limits = np.ascontiguousarray(dd_dv[:, :n]), numbers.limits
        W, of_limits, of_pairs = constraint_weights(
            state.q[:n], d, dd_dq, of_limits, of_pairs, limits, gains
        )
    qddot, qdot_c, W = weighted_acceleration(
        references, state.v[:n], W, inertia, kept[n + Nc * n :], gains
    )
    in_order, vdot = np.concatenate((qddot, references.qddot_p)), np.empty(len(v))
    for i in range(len(v)):
        vdot[r.order[i]] = in_order[i]
    kept = np.concatenate((of_limits, of_pairs.ravel(), qdot_c))
    return vdot, references.error, W, qdot_c, kept


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
                `constraint_weights.inertia_weight`.
        """
        limits = limit_potential(model.lower, model.upper)
        self._law = hold(PaperNumbers(model.robot, tasks, limits, gains, constrained))
        self._model, self._with_inertia = model, with_inertia
        near = np.zeros((1 + len(model.pairs)) * model.n)
        self._first = np.concatenate((near, np.full(model.n, np.nan)))

    def __call__(
        self,
        workspace: Workspace,
        q: np.ndarray,
        v: np.ndarray,
        targets: Targets,
        before: np.ndarray | None,
    ) -> Nominal:
        model, inertia = self._model, _NO_MATRIX
        if self._with_inertia:
            inertia = model.inertia_matrix(workspace)
        return Nominal(
            *paper_step(
                *(q, v, model.asked_here(workspace), *targets[:4], *targets.blend),
                *(self._first if before is None else before, inertia, self._law),
            )
        )


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
    before = np.zeros(len(q)), np.zeros(dd_dq.shape)
    W, _, _ = constraint_weights(q, d, dd_dq, *before, limits, gains)
    step = inverse_times(damped_inverse(J, W, gains.damping), error)
    for i in range(len(q)):
        if (q[i] <= lower[i] and step[i] < 0.0) or (q[i] >= upper[i] and step[i] > 0.0):
            W[i] = _STOPPED
    return inverse_times(damped_inverse(J, W, gains.damping), error)
