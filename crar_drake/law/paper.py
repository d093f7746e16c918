"""The nominal of the paper: weights (17)-(28), inverse (16), (34), and the levels (10),
(35).

By itself, without a projection, it is the paper to the letter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.kinematics import find_state, watched_distances
from crar_drake.law.parameters import PaperGains
from crar_drake.law.references import (
    Nominal,
    References,
    Targets,
    TaskGains,
    find_references,
)
from crar_drake.law.vectors import (
    add_to_diagonal,
    cholesky,
    cholesky_solve,
    cholesky_solve_matrix,
    gram,
    product,
    times,
    transposed_times,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

# Nearer than this to a limit [rad or m] the gradient is taken at this distance:
# at the limit it is infinite, and beyond it the printed formula shrinks again.
LIMIT_CLAMP = 1e-4

# Below this distance [m] the magnitude of Eq. (23) is taken at this distance: at
# d = 0 it is infinite, and for d < 0 the printed formula shrinks again.
DISTANCE_CLAMP = 1e-3
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
        """Those of parameters, for a control period [s] and Nc watched pairs, with
        Eq. (28), a = 1 / (Nc + 1), where a is not given."""
        GvN, share = given.GvN, given.limit_share
        return Gains(
            *(float(given.damping), float(given.Gv)),
            math.nan if GvN is None else float(GvN),
            *(float(given.rho), float(given.alpha), float(given.beta)),
            1.0 / (num_pairs + 1) if share is None else float(share),
            *(float(period), given.level == "velocity"),
        )


class LimitPotential(NamedTuple):
    """One set of limits, made ready for Eq. (17) by `limit_potential`; all (n,)."""

    lower: np.ndarray  # finite, and not equal [rad or m]
    upper: np.ndarray
    first: np.ndarray  # where the gradient is taken at the least
    last: np.ndarray  # and at the most
    factor: np.ndarray  # a quarter of the squared range; 0 for unlimited joints


def limit_potential(lower: np.ndarray, upper: np.ndarray) -> LimitPotential:
    """The joint-limit potential, Eq. (17), for one set of limits.

    Inside by less than LIMIT_CLAMP, or outside, its gradient is taken at LIMIT_CLAMP
    inside (for a range narrower than four clamps, at a quarter of the range; a locked
    joint has a range as wide as one clamp). Where a limit is infinite the joint
    counts as unlimited and the gradient is 0.

    Args:
        lower, upper: (n,) limits [rad or m], +-inf where there is none.
    """
    limited = np.isfinite(lower) & np.isfinite(upper)
    lower = np.where(limited, lower, -1.0)
    upper = np.where(limited, upper, 1.0)
    # Equal limits would give 0/0.
    widening = 0.5 * np.maximum(LIMIT_CLAMP - (upper - lower), 0.0)
    lower, upper = lower - widening, upper + widening
    span = upper - lower
    clamp = np.minimum(LIMIT_CLAMP, 0.25 * span)
    factor = np.where(limited, 0.25 * span**2, 0.0)
    return LimitPotential(lower, upper, lower + clamp, upper - clamp, factor)


@compiled
def limit_gradient(q: np.ndarray, limits: LimitPotential) -> np.ndarray:
    """Eq. (17): dh/dq_i = (u-l)^2 (2q-u-l) / (4 (u-q)^2 (q-l)^2), clamped, (n,).

    Args:
        q: (n,) positions [rad or m].
    """
    q = np.minimum(np.maximum(q, limits.first), limits.last)
    to_upper, to_lower = limits.upper - q, q - limits.lower
    return limits.factor * (to_lower - to_upper) / np.square(to_upper * to_lower)


@compiled
def limit_proximity(
    q: np.ndarray, gradient: np.ndarray, limits: LimitPotential
) -> np.ndarray:
    """The |grad h_i| that Eq. (18) compares between steps, (n,); 0 without limits.

    Inside the clamp that is the magnitude of Eq. (17). From there outwards the
    printed formula jumps to infinity and then shrinks, so it would take going
    further out for coming back; here it goes on growing linearly with q instead.

    Args:
        q: (n,) positions, not clamped [rad or m].
        gradient: (n,) Eq. (17) there.
    """
    beyond = np.abs(q - np.minimum(np.maximum(q, limits.first), limits.last))
    return np.abs(gradient) * (1.0 + beyond / LIMIT_CLAMP)


@compiled
def collision_potential_slope(
    d: np.ndarray,
    rho: float | np.ndarray,
    alpha: float | np.ndarray,
    beta: float | np.ndarray,
) -> np.ndarray:
    """Eq. (23): df/dd = -rho exp(-alpha d) d^-beta (beta/d + alpha), (Nc,) [1/m].

    Below DISTANCE_CLAMP, in contact and in penetration it is taken there.

    Args:
        d: (Nc,) signed distances [m].
        rho, alpha, beta: scalars or (Nc,); amplitude, decay [1/m], exponent.
    """
    d = np.maximum(d, DISTANCE_CLAMP)
    return -rho * np.exp(-alpha * d) * d**-beta * (beta / d + alpha)


@compiled
def collision_proximity(gradient: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The |grad f_i| that Eq. (21) compares between steps, (Nc, n).

    Down to DISTANCE_CLAMP it is the magnitude of Eq. (25); below, where the slope
    is clamped, it goes on growing linearly with the depth, so that going deeper
    is distinguished from coming out.

    Args:
        gradient: (Nc, n) Eq. (25).
        d: (Nc,) signed distances, not clamped [m].
    """
    depth = np.maximum(DISTANCE_CLAMP - d, 0.0) / DISTANCE_CLAMP
    return np.abs(gradient) * (1.0 + depth)[:, np.newaxis]


@compiled
def approach_weights(
    gradient: np.ndarray, proximity: np.ndarray, previous: np.ndarray
) -> np.ndarray:
    """Eqs. (18), (21): the diagonal of W_JL (n,), and those of W_COL_j, (Nc, n).

    Args:
        gradient: Eq. (17) or (25) at the present step.
        proximity: `limit_proximity` or `collision_proximity` at the present step.
        previous: the same at the previous step; zeros at the first step, where the
            change counts as 0, that is as approaching.

    Returns:
        1 + |gradient| where the constraint is approached, else 1.
    """
    return 1.0 + np.abs(gradient) * (proximity >= previous)


@compiled
def inertia_weight(H: np.ndarray, W: np.ndarray) -> np.ndarray:
    """The paper's "dynamically consistent weight matrix" (end of Section IV).

    W of Eq. (27) is the identity, plus a penalty for joints near constraints. Here
    the joint-space inertia takes the identity's place:

        W_H = H / det(H)^(1/n) + (W - I).

    Far from constraints the inverse of Eq. (16) is then the dynamically consistent
    one, H^-1 J^T (J H^-1 J^T)^-1 (Khatib 1987): of all velocities that do the
    tasks it has the least kinetic energy. A joint whose weight goes to infinity
    stops, and the others do the least for the robot with that joint locked. (The
    congruence W^1/2 H W^1/2 would also stop it, but the others would then move as
    if it were free.) Dividing by the geometric mean of H's eigenvalues takes out the
    unit and leaves the determinant that the identity has, so that the damping
    factor of Eq. (34) stays comparable. The sum is positive definite, because H is,
    and no weight is below 1.

    Args:
        H: (n, n) joint-space inertia matrix, symmetric positive definite [kg m^2].
        W: (n,) diagonal of Eq. (27), at least 1.

    Returns:
        (n, n) symmetric positive definite.
    """
    logdet = 2.0 * np.log(np.diag(cholesky(H))).sum()
    W_H = H * np.exp(-logdet / len(H))
    add_to_diagonal(W_H, W - 1.0)
    return W_H


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


class DampedInverse(NamedTuple):
    """J* of Eq. (34), ready to be multiplied; made by `damped_inverse`."""

    B: np.ndarray  # (n, m) W^-1 J^T if m < n, else J^T
    # lower Cholesky factor: if m < n (m, m) of J W^-1 J^T + lambda^2 I, else (n, n) of
    # J^T J + lambda^2 W
    L: np.ndarray


@compiled
def damped_inverse(J: np.ndarray, W: np.ndarray, damping: float) -> DampedInverse:
    """Eq. (34): J* = W^-1 J^T (J W^-1 J^T + lambda^2 I)^-1.

    Always exists for lambda > 0. By the push-through identity it is also
    (J^T J + lambda^2 W)^-1 J^T: of the two the smaller system is factorised. What is
    needed of J* are its products, `inverse_times`.

    Args:
        J: (m, n) task Jacobian, any rank.
        W: (n,) diagonal of the weight matrix, positive, or the whole matrix (n, n),
            symmetric positive definite.
        damping: lambda [m], positive.
    """
    m, n = J.shape
    J_T = np.ascontiguousarray(J.T)
    if m < n:
        if W.ndim == 1:
            B = J_T / W[:, np.newaxis]
        else:
            B = cholesky_solve_matrix(cholesky(W), J_T)
        core = product(J, B)
        add_to_diagonal(core, np.full(m, damping**2))
        return DampedInverse(B, cholesky(core))
    M = gram(J)
    if W.ndim == 1:
        add_to_diagonal(M, damping**2 * W)
    else:
        M += damping**2 * W
    return DampedInverse(J_T, cholesky(M))


@compiled
def inverse_times(J_star: DampedInverse, x: np.ndarray) -> np.ndarray:
    """Eq. (34) at work: J* x (n,) of x (m,)."""
    n, m = J_star.B.shape
    if m < n:
        return times(J_star.B, cholesky_solve(J_star.L, x))
    return cholesky_solve(J_star.L, times(J_star.B, x))


@compiled
def project_to_null_space(
    J_star: DampedInverse, J: np.ndarray, zeta: np.ndarray
) -> np.ndarray:
    """Eq. (31), below: N zeta = zeta - J* J zeta, (n,) of zeta (n,)."""
    return zeta - inverse_times(J_star, times(J, zeta))


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
    blend: tuple[float, float, float],
    kept: np.ndarray,
    inertia: np.ndarray,
    law: Held,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One control step of the paper's law; see the functions above.

    Args:
        q, v: (nq,), (nv,) state in the plant's order.
        asked: of `watched_distances`.
        tasks, ..., blend: the targets, taken apart.
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
    targets = Targets(tasks, prescribed, posture, start, blend)
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
    vdot = np.concatenate((qddot, references.qddot_p))
    kept = np.concatenate((of_limits, of_pairs.ravel(), qdot_c))
    return vdot, references.error, W, qdot_c, kept


class PaperLaw:
    """The diagonal W of Eqs. (17)-(28) in the inverse of Eq. (34); or W = I."""

    def __init__(
        self,
        model: ControlModel,
        tasks: TaskGains,
        given: PaperGains,
        period: float,
        constrained: bool,
    ) -> None:
        """
        Args:
            model: of the robot, its tasks and pairs.
            tasks: gains.
            given: the paper's parameters.
            period: of the controller [s].
            constrained: else W = I: the raw motion, whose violations Fig. 2 counts.
        """
        limits = limit_potential(model.lower, model.upper)
        gains = Gains.of(given, period, len(model.pairs))
        self._law = hold(PaperNumbers(model.robot, tasks, limits, gains, constrained))
        self._model, self._with_inertia = model, given.metric == "inertia"
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
        """The nominal of a step.

        Args:
            workspace: of the model, at the state.
            q, v: (nq,), (nv,) the state.
            targets: what to do.
            before: `Nominal.kept` of the step one period ago; None at a start.
        """
        model, inertia = self._model, _NO_MATRIX
        if self._with_inertia:
            inertia = model.inertia_matrix(workspace)
        return Nominal(
            *paper_step(
                *(q, v, model.asked_here(workspace), *targets),
                *(self._first if before is None else before, inertia, self._law),
            )
        )
