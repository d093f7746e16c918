"""The lookahead: constraints act where the robot would come to rest.

The paper's W looks at the present configuration, per joint, and lets a joint go
free as soon as its share of a gradient shrinks; it asks for a more rigorous W, an
adaptive Gv and less damping. Here the constraints are imposed where the robot would
come to rest, and only along their gradients. `docs/lookahead.md` has the derivation.

Let T be a braking horizon. Under q_ddot = -q_dot/T the robot comes to rest at

    q_s = q + T q_dot,       and     s = q_dot + T q_ddot

is the velocity of q_s: choosing an acceleration is choosing s, a first-order
problem in q_s. Each watched pair gives two rows (h, g): a distance that must stay
positive, and its gradient, so that h changes by g s per second. Prescribed joints
move it by a known drift as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.equations.admission import (
    AS_WISHED,
    CORRECTED,
    SCALED,
    AdmissionGains,
    Checked,
    Present,
    check_step,
    examine_present,
    gradients_at,
    scale_step,
    velocity_bounds,
)
from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.free_joints import displaced
from crar_drake.equations.handover import take_over
from crar_drake.equations.joint_limits import (
    LimitPotential,
    limit_gradient,
    limit_potential,
)
from crar_drake.equations.kinematics import (
    Measured,
    Robot,
    find_state,
    join_joints,
    row_distances,
)
from crar_drake.equations.one_sided import one_sided_minimum
from crar_drake.equations.references import (
    Answer,
    TaskGains,
    Wanted,
    find_references,
)
from crar_drake.equations.vectors import (
    add_to_diagonal,
    cholesky,
    cholesky_solve,
    gram,
    identity,
    largest,
    smallest,
    times,
    transposed_times,
)

# A margin of a row smaller than this [m] weighs as this: weights stay finite.
SMALLEST_MARGIN = 1e-4

# A joint with one limit is weighted as if the other were so far away [rad or m].
ONE_SIDED_RANGE = 2.0 * np.pi

# q_s is not asked to move by more than this in a period unless it is given [rad or m].
LONGEST_MOVE = 0.15

# A step is corrected so often before it is scaled.
_CORRECTIONS = 4
# and then to be so far above the level that a pair must keep [m].
_SPARE = 3e-4
# Shares of the wish for which the guard is asked anew, where not even the first of them
# would be left: the far end of a long step says little about its beginning.
_LESS = (0.25, 0.0625, 0.015625, 0.0)


class LookaheadGains(NamedTuple):
    """The numbers of the mode, see `LookaheadParameters` and `CrarParameters`."""

    T: float  # braking horizon [s]
    Gv: float  # [1/s]
    damping: float  # lambda [m]
    rho: float
    alpha: float  # [1/m]
    beta: float
    rho_limits: float
    distance_margin: float  # d_min [m]
    limit_margin: float  # [rad]
    retreat_rate: float  # gamma [1/s]
    retreat_speed: float  # [m/s]
    joint_retreat_speed: float  # [rad/s]
    influence_distance: float  # [m]
    period: float  # of the controller [s]
    slip_share: float  # of what was seen last, in the slip's low-pass
    longest_move: float = LONGEST_MOVE  # of q_s in a period [rad or m]
    task_norm: bool = False  # whether the guard's norm is that of the tasks


class Limits(NamedTuple):
    """Limits of the n controlled joints, made by `find_limits`; nl of them finite."""

    lower: np.ndarray  # (n,) [rad], infinite where there is none
    upper: np.ndarray
    fastest: np.ndarray  # (n,) speed limits [rad/s], infinite where there is none
    joints: np.ndarray  # (nl,) the joint of each finite limit
    inward: np.ndarray  # (nl,) 1 for a lower, -1 for an upper limit
    at: np.ndarray  # (nl,) [rad]
    potential: LimitPotential  # (nl,) of their joints


class Constraints(NamedTuple):
    """Margins h that should stay positive and change by g s + drift per second.

    Rows of pairs and of joint limits alike: of a limit, g is a signed unit vector.

    Attributes:
        h: (C,) margins where the robot will come to rest: distances of pairs [m],
            or from a joint to a limit [rad], negative beyond it.
        g: (C, n) their gradients by the controlled joints [m/rad or 1].
        drift: (C,) their change other than by s: by the prescribed joints, and by
            what of the slip goes towards the constraint [m/s or rad/s].
        weight: (C,) omega of a pair, `row_weights`, or rho_JL |grad h_i| of a limit.
        retreat: (C,) r, the speed at which a violated one must recede [m/s or
            rad/s].
    """

    h: np.ndarray
    g: np.ndarray
    drift: np.ndarray
    weight: np.ndarray
    retreat: np.ndarray


@compiled
def resting_configuration(q: np.ndarray, qdot: np.ndarray, T: float) -> np.ndarray:
    """(L1): q_s = q + T q_dot: where q_ddot = -q_dot/T leads.

    Args:
        q, qdot: (nq,), (nv,) state, free joints last.
        T: [s].
    """
    return displaced(q, T * qdot)


@compiled
def with_resting(q: np.ndarray, v: np.ndarray, r: Robot, T: float) -> np.ndarray:
    """A configuration, and where the robot would come to rest from it: (2, nq).

    Args:
        q, v: (nq,), (nv,) state in the plant's order.
        r: of the robot.
        T: [s].
    """
    q_s = resting_configuration(q[r.positions], v[r.order], T)
    both = np.empty((2, len(q)))
    for i in range(len(q)):
        both[0, i] = q[i]
        both[1, r.positions[i]] = q_s[i]
    return both


@compiled
def resting_velocity(qdot: np.ndarray, qddot: np.ndarray, T: float) -> np.ndarray:
    """(L2): s = d q_s/dt = q_dot + T q_ddot, (n,) [rad/s]."""
    return qdot + T * qddot


@compiled
def pair_margins(
    d: np.ndarray, dd_dv: np.ndarray, v: np.ndarray, T: float
) -> np.ndarray:
    """(L3), (L4): h of two rows a pair, where it is told that the robot comes to rest.

    At the state by its velocity, d(q) + T dd/dq q_dot, and at q_s itself, d(q_s).

    Args:
        d: (2, Nc) signed distances at q and at q_s [m].
        dd_dv: (2, Nc, nv) their gradients by all joints.
        v: (nv,) velocities [rad/s, m/s].
        T: braking horizon [s].

    Returns:
        (2 Nc,) [m]: first those told at q, and then those at q_s.
    """
    return np.concatenate((d[0] + T * times(dd_dv[0], v), d[1]))


@compiled
def margin_curvature(dd_dv: np.ndarray, v: np.ndarray) -> np.ndarray:
    """What (L4) leaves out of its rows' rate, T q_dot^T hess(d) q_dot: (2 Nr,) [m/s].

    Estimated by the secant, for q_s is T q_dot away: (g_1 - g_2) q_dot. Of the rows
    (L3), which are exact, 0.

    Args:
        dd_dv: (2, Nr, nv) gradients at q and at q_s.
        v: (nv,) velocities.
    """
    secant = times(dd_dv[1], v) - times(dd_dv[0], v)
    return np.concatenate((secant, np.zeros(len(secant))))


@compiled
def row_weights(
    h: np.ndarray, d_min: float, rho: float, alpha: float, beta: float
) -> np.ndarray:
    """(L5): omega, the magnitude of Eq. (23) at the margin eta = h - d_min.

    Args:
        h: (R,) distances at rest [m].
        d_min: distance to keep [m].
        rho, alpha, beta: amplitude, decay [1/m] and exponent of Eq. (22).

    Returns:
        (R,) finite: eta counts as at least SMALLEST_MARGIN.
    """
    eta = np.maximum(h - d_min, SMALLEST_MARGIN)
    return rho * np.exp(-alpha * eta) * eta**-beta * (beta / eta + alpha)


@compiled
def retreat_speed(
    h: np.ndarray, margin: float, gamma: float, fastest: float
) -> np.ndarray:
    """r of (L7): gamma max(0, margin - h), but at most `fastest`; (C,) [m/s, rad/s].

    Args:
        h: (C,) margins [m or rad].
        margin: to be kept [m or rad].
        gamma: [1/s].
        fastest: [m/s or rad/s].
    """
    return np.minimum(gamma * np.maximum(margin - h, 0.0), fastest)


@compiled
def pair_constraints(
    h: np.ndarray,
    g: np.ndarray,
    drift: np.ndarray,
    slip: np.ndarray,
    gains: LookaheadGains,
) -> Constraints:
    """The rows of pairs within the influence distance.

    Args:
        h, g, drift: (R,), (R, n), (R,) of all rows, see `Constraints`.
        slip: (n,) velocity of q_s that is not commanded, see `slip_velocity`; only
            what approaches counts [rad/s].
        gains: of the mode.
    """
    near = np.flatnonzero(h < gains.influence_distance)
    h, g = h[near], g[near]
    return Constraints(
        h,
        g,
        drift[near] + np.minimum(times(g, slip), 0.0),
        row_weights(h, gains.distance_margin, gains.rho, gains.alpha, gains.beta),
        retreat_speed(
            h, gains.distance_margin, gains.retreat_rate, gains.retreat_speed
        ),
    )


def find_limits(lower: np.ndarray, upper: np.ndarray, fastest: np.ndarray) -> Limits:
    """The finite limits of joints, each by itself.

    Args:
        lower, upper: (n,) limits [rad], infinite where there is none.
        fastest: (n,) speed limits [rad/s], infinite where there is none.
    """
    has_lower, has_upper = np.isfinite(lower), np.isfinite(upper)
    joints = np.concatenate((np.flatnonzero(has_lower), np.flatnonzero(has_upper)))
    count = has_lower.sum()
    inward = np.concatenate((np.ones(count), -np.ones(len(joints) - count)))
    low = np.where(has_lower, lower, upper - ONE_SIDED_RANGE)
    high = np.where(has_upper, upper, lower + ONE_SIDED_RANGE)
    potential = limit_potential(low[joints], high[joints])
    at = np.where(inward > 0.0, lower[joints], upper[joints])
    return Limits(lower, upper, fastest, joints, inward, at, potential)


@compiled
def limit_constraints(
    q_s: np.ndarray, slip: np.ndarray, limits: Limits, gains: LookaheadGains
) -> Constraints:
    """A row of each limit, with the weight Eq. (17) at q_s, 0 on its far half.

    Args:
        q_s: (n,) resting configuration [rad].
        slip: (n,) velocity of q_s that is not commanded, see `slip_velocity`;
            only what goes towards the limit counts [rad/s].
        limits: of the joints.
        gains: of the mode.
    """
    joints, inward = limits.joints, limits.inward
    nl, at = len(joints), q_s[joints]
    h = inward * (at - limits.at)
    g = np.zeros((nl, len(q_s)))
    for i in range(nl):
        g[i, joints[i]] = inward[i]
    towards = -inward * limit_gradient(at, limits.potential)
    return Constraints(
        h,
        g,
        np.minimum(inward * slip[joints], 0.0),
        gains.rho_limits * np.maximum(towards, 0.0),
        retreat_speed(
            h, gains.limit_margin, gains.retreat_rate, gains.joint_retreat_speed
        ),
    )


@compiled
def join_constraints(a: Constraints, b: Constraints) -> Constraints:
    """Both, as one set."""
    return Constraints(
        np.concatenate((a.h, b.h)),
        np.concatenate((a.g, b.g)),
        np.concatenate((a.drift, b.drift)),
        np.concatenate((a.weight, b.weight)),
        np.concatenate((a.retreat, b.retreat)),
    )


@compiled
def slip_velocity(
    previous: np.ndarray,
    qdot: np.ndarray,
    qdot_before: np.ndarray,
    qddot_before: np.ndarray,
    T: float,
    period: float,
    share: float,
) -> np.ndarray:
    """(L9): how fast q_s moves besides s: T times what the plant did other than told.

    A torque that is held is not an acceleration that is held, models are wrong, and
    somebody may push. What the last control period showed of it is taken, through a
    first-order low-pass, as what the next will bring.

    Args:
        previous: (n,) this function's value one period ago [rad/s].
        qdot, qdot_before: (n,) velocities now and one period ago [rad/s].
        qddot_before: (n,) commanded one period ago [rad/s^2].
        T: braking horizon [s].
        period: of the controller [s].
        share: of what was seen last, period / time constant, at most 1.

    Returns:
        (n,) [rad/s].
    """
    seen = T * ((qdot - qdot_before) / period - qddot_before)
    return previous + share * (seen - previous)


class LookaheadNumbers(NamedTuple):
    """What the mode is made with."""

    tasks: TaskGains
    limits: Held  # of `Limits`
    gains: LookaheadGains
    admission: AdmissionGains
    reaches: Held  # of `Reaches`
    members: np.ndarray  # (Nc, most) the rows of each watched pair; the first fills up


@compiled
def wish_velocity(
    J: np.ndarray,
    v_r: np.ndarray,
    a_r: np.ndarray,
    qdot: np.ndarray,
    posture: np.ndarray,
    constraints: Constraints,
    gains: LookaheadGains,
    longest: float,
    qdot_0: np.ndarray,
    qddot_0: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """(L6): the paper's law with W = I + sum omega_j g_j g_j^T; it always exists.

    Eqs. (15), (30), (34), (35) as least squares, with the push-through identity of
    (34): of the rows that are approached,

        q_dot_c = argmin |J x - v_r|^2 + lambda^2 (|x|^2
                  + sum omega_j min(0, g_j x + drift_j)^2)
        z = Gv (q_dot_c - q_dot)
        alpha = argmin |J x - a_r|^2 + lambda^2 (|x|^2 - 2 z^T x if m < n
                + sum omega_j min(0, g_j s_0(x) + drift_j)^2 / T^2)
        s_0 = q_dot + T (alpha + z), at most longest_move / period.

    Where tasks are joints, |x - x_0|^2 stands for |x|^2 (`undamped_preference`).

    Args:
        J: (m, n) task Jacobian.
        v_r: (m,) v_d + K e less the prescribed joints' share.
        a_r: (m,) Eq. (14) less bias and the prescribed joints' share.
        qdot: (n,) present velocity [rad/s].
        posture: (n,) a null-space acceleration, added to z where m < n [rad/s^2].
        constraints: rows and limits.
        gains: of the mode.
        longest: the largest |s_0| of a joint [rad/s].
        qdot_0, qddot_0: (n,) x_0 of both levels; (0,) for 0.

    Returns:
        (n,) s_0; (n,) q_dot_c; (n,) the diagonal of W at alpha; passes.
    """
    m, n = J.shape
    T, damping2 = gains.T, gains.damping**2
    g, drift = constraints.g, constraints.drift
    root = gains.damping * np.sqrt(constraints.weight)
    rows = root[:, np.newaxis] * g
    normal = gram(J)
    add_to_diagonal(normal, np.full(n, damping2))
    factor = cholesky(normal)

    right = transposed_times(J, v_r)
    if len(qdot_0):
        right = right + damping2 * qdot_0
    qdot_c, _, first = one_sided_minimum(
        normal, right, rows, -root * drift, cholesky_solve(factor, right)
    )
    z = gains.Gv * (qdot_c - qdot)
    right = transposed_times(J, a_r)
    if m < n:
        right = right + damping2 * (z + posture)
    if len(qddot_0):
        right = right + damping2 * qddot_0
    towards = times(g, qdot + T * z) + drift
    alpha, active, second = one_sided_minimum(
        normal, right, rows, -root * towards / T, cholesky_solve(factor, right)
    )
    s_0 = resting_velocity(qdot, alpha + z, T)
    fastest = largest(s_0)
    if fastest > longest:
        s_0 *= longest / fastest
    W = np.ones(n)
    for row in np.flatnonzero(active):
        W += constraints.weight[row] * g[row] * g[row]
    return s_0, qdot_c, W, first + second


@compiled
def guard_norm(J: np.ndarray, gains: LookaheadGains) -> np.ndarray:
    """N of (L7), (n, n): the identity, or the norm of (L6) itself,

        J^T J + lambda^2 I,

    by which a change is small where it is so for the tasks, by their weights: what
    evades then moves a task of high weight the least.

    Args:
        J: (m, n) task Jacobian, weighted.
        gains: of the mode.
    """
    N = identity(J.shape[1])
    if gains.task_norm:
        N = gains.damping**2 * N + gram(J)
    return N


@compiled
def guard(
    s_0: np.ndarray, constraints: Constraints, norm: np.ndarray
) -> tuple[np.ndarray, int]:
    """(L7): the velocity nearest to the wish that the constraints allow, (n,).

        s = argmin (s - s_0)^T N (s - s_0) + sum omega_j max(0, r_j - g_j s - drift_j)^2

    Args:
        s_0: (n,) the wish.
        constraints: rows and limits.
        norm: (n, n) N, `guard_norm`.

    Returns:
        (n,) s; the passes.
    """
    root = np.sqrt(constraints.weight)
    s, _, passes = one_sided_minimum(
        norm,
        times(norm, s_0),
        root[:, np.newaxis] * constraints.g,
        root * (constraints.retreat - constraints.drift),
        s_0,
    )
    return s, passes


@compiled
def correction(
    checked: Checked,
    s: np.ndarray,
    n: int,
    present: Present,
    r: Robot,
    reaches: Held,
    gains: LookaheadGains,
    admission: AdmissionGains,
) -> Constraints:
    """A row for each pair that the next braking path does not keep clear of.

    Where the path comes to q_f, it changes with s by k = dq_f/ds, of `next_path`:
    d(q_f) is linear in s with the gradient k g, and is to reach the level.

    Args:
        checked: of s.
        s: (nv,) velocity of q_s that was checked.
        n: number of controlled joints.
        present, r, reaches: of the state.
        gains, admission: of the mode.
    """
    period = admission.period
    failed, g = gradients_at(checked.start, checked.x, checked.bounds, r, reaches)
    k = 0.5 * period * (period + admission.step) / admission.T
    k = k + checked.bounds.at[failed] * period
    missing = (present.level[failed] + _SPARE - checked.bounds.d[failed]) / k
    count = len(failed)
    hardest = row_weights(
        np.full(count, gains.distance_margin),
        gains.distance_margin,
        gains.rho,
        gains.alpha,
        gains.beta,
    )
    return Constraints(
        np.zeros(count),
        np.ascontiguousarray(g[:, :n]),
        times(np.ascontiguousarray(g[:, n:]), s[n:]),
        hardest,
        times(g, s) + missing,
    )


@compiled
def step_bounds(
    q: np.ndarray, v: np.ndarray, n: int, limits: Limits, admission: AdmissionGains
) -> tuple[np.ndarray, np.ndarray]:
    """`velocity_bounds` of the controlled joints, the first n: (n,), (n,) [rad/s]."""
    return velocity_bounds(
        q[:n],
        v[:n],
        limits.lower,
        limits.upper,
        limits.fastest,
        admission.T,
        admission.period,
        admission.step,
    )


@compiled
def share_within(s: np.ndarray, lowest: np.ndarray, highest: np.ndarray) -> float:
    """The largest share of s that is within bounds with 0 between them.

    Args:
        s: (nv,) [rad/s].
        lowest, highest: (n,) bounds of the first n [rad/s].

    Returns:
        in [0, 1].
    """
    share = 1.0
    for i in range(len(lowest)):
        bound = highest[i] if s[i] > 0.0 else lowest[i]
        if abs(s[i]) > abs(bound):
            share = min(share, bound / s[i])
    return share


@compiled
def admit(
    s_0: np.ndarray,
    s_p: np.ndarray,
    s_1: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    d: np.ndarray,
    constraints: Constraints,
    norm: np.ndarray,
    r: Robot,
    numbers: LookaheadNumbers,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(L8): the velocity of q_s whose step is clear; it always exists.

    As the guard wishes it, else corrected by rows for what would not be clear, else
    scaled towards braking, with the prescribed joints; or what the guard makes of a
    share of the wish, if hardly any of that would be left.

    Args:
        s_0: (n,) the wish before the guard.
        s_p: (n_p,) velocity of q_s of the prescribed joints.
        s_1: (n,) the guard's wish.
        q, v: (nq,), (nv,) state.
        d: (2, Nr) distances of all rows at q and at q_s [m].
        constraints, norm: of the guard.
        r, numbers: of the robot and the mode.

    Returns:
        (n,), (n_p,) s of the controlled and the prescribed joints; (4,) how it was
        admitted (AS_WISHED, CORRECTED, SCALED), the share of s, the clearance of the
        next braking path [m], and 1 if the present one was clear, else 0.
    """
    n, given = len(s_0), constraints
    limits, reaches = numbers.limits.value, numbers.reaches
    admission = numbers.admission
    lowest, highest = step_bounds(q, v, n, limits, admission)
    s = np.concatenate((np.minimum(np.maximum(s_1, lowest), highest), s_p))
    how, share = AS_WISHED, 1.0
    present = examine_present(q, v, s, d, r, reaches, admission)
    checked = check_step(q, v, s, present, r, reaches, admission)
    clearance = checked.clearance
    if not checked.clear:
        how = CORRECTED
        for _ in range(_CORRECTIONS):
            if not (checked.bounds.at >= 0.0).any():
                break  # the way there is not clear: nothing to be corrected
            constraints = join_constraints(
                constraints,
                correction(
                    checked, s, n, present, r, reaches, numbers.gains, admission
                ),
            )
            s_1, _ = guard(s_0, constraints, norm)
            s = np.concatenate((np.minimum(np.maximum(s_1, lowest), highest), s_p))
            checked = check_step(q, v, s, present, r, reaches, admission)
            if checked.clear:
                break
        clearance = checked.clearance
        if not checked.clear:
            how = SCALED
            share, clearance = scale_step(q, v, s, present, r, reaches, admission)
            scaled = share * s
            if share < _LESS[0]:
                # What the guard asks for, a way out among it, would be scaled as well.
                for less in _LESS:
                    s_1, _ = guard(less * s_0, given, norm)
                    s_1 = np.minimum(np.maximum(s_1, lowest), highest)
                    s = np.concatenate((s_1, less * s_p))
                    checked = check_step(q, v, s, present, r, reaches, admission)
                    if checked.clear:
                        share, clearance, scaled = less, checked.clearance, s
                        break
            s = scaled
    clearance = min(clearance, present.low.min()) if len(present.low) else np.inf
    told = np.array([how, share, clearance, 1.0 if present.held else 0.0])
    return s[:n], s[n:], told


class LookaheadMemory(NamedTuple):
    """What one step of the mode leaves to the next, all (n,)."""

    qdot: np.ndarray  # measured [rad/s]
    qddot: np.ndarray  # commanded [rad/s^2]
    slip: np.ndarray  # `slip_velocity` [rad/s]


@compiled
def lookahead_step(
    measured: Measured,
    wanted: Wanted,
    robot: Held,
    mode: Held,
    before: LookaheadMemory,
) -> tuple[Answer, np.ndarray, np.ndarray, np.ndarray]:
    """(L3)-(L9) in their order: one control step of the mode.

    Args:
        measured: the state, and q_s.
        wanted: the targets.
        robot: holds a `Robot` with a row for each pair of shapes.
        mode: holds `LookaheadNumbers`.
        before: of the step before; at the first, with q_dot itself and zeros, so that
            nothing slipped.

    Returns:
        The answer; (n,) slip; (2,) the smallest distance [m] and the smallest margin
        to a limit [rad] at q_s; (4,) of `admit`.
    """
    r, numbers = robot.value, mode.value
    limits, gains = numbers.limits.value, numbers.gains
    n, T = r.n, gains.T
    state = find_state(measured, r)
    references = find_references(state, wanted, r.rows.value, numbers.tasks)
    v, qdot = state.v, state.v[:n]
    slip = slip_velocity(
        before.slip, qdot, before.qdot, before.qddot, T, gains.period, gains.slip_share
    )
    h = pair_margins(state.d, state.dd_dv, v, T)
    by_joint = state.dd_dv.reshape(len(h), len(v))
    s_p = resting_velocity(v[n:], references.qddot_p, T)
    pairs = pair_constraints(
        h,
        np.ascontiguousarray(by_joint[:, :n]),
        times(by_joint[:, n:], s_p) + margin_curvature(state.dd_dv, v),
        slip,
        gains,
    )
    at_limits = limit_constraints(state.q[:n] + T * qdot, slip, limits, gains)
    constraints = join_constraints(pairs, at_limits)
    s_0, qdot_c, W, _ = wish_velocity(
        references.J,
        references.v_r,
        references.a_r,
        qdot,
        references.posture,
        constraints,
        gains,
        gains.longest_move / gains.period,
        references.qdot_0,
        references.qddot_0,
    )
    norm = guard_norm(references.J, gains)
    s_1, _ = guard(s_0, constraints, norm)
    s, s_p, admission = admit(
        s_0, s_p, s_1, state.q, v, state.d, constraints, norm, r, numbers
    )
    margins = np.full(2, np.inf)
    if len(h):
        margins[0] = state.d[1].min()
    if len(at_limits.h):
        margins[1] = at_limits.h.min()
    d = state.d[0]
    if len(numbers.members) < len(d):
        d = d[smallest(d, numbers.members)]
    qddot_p = references.qddot_p
    if admission[1] < 1.0:
        qddot_p = (s_p - v[n:]) / T
    answer = Answer(
        join_joints((s - qdot) / T, qddot_p, r.order), references.error, d, W, qdot_c
    )
    return answer, slip, margins, admission


@compiled
def acceleration_bounds(
    measured: Measured, robot: Held, mode: Held
) -> tuple[np.ndarray, np.ndarray]:
    """`step_bounds` as accelerations, (n,), (n,) [rad/s^2]; arguments as below."""
    r, numbers = robot.value, mode.value
    q, v = measured.q[0][r.positions], measured.v[r.order]
    lowest, highest = step_bounds(q, v, r.n, numbers.limits.value, numbers.admission)
    qdot, T = v[: r.n], numbers.admission.T
    return (lowest - qdot) / T, (highest - qdot) / T


@compiled
def scale_acceleration(
    measured: Measured, vdot: np.ndarray, robot: Held, mode: Held
) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations whose step is clear, between the given ones and braking.

    For what the effort limits have changed after `admit`.

    Args:
        measured: the state, and q_s.
        vdot: (nv,) accelerations in the plant's order.
        robot, mode: as in `lookahead_step`.

    Returns:
        (nv,) accelerations; (4,) of `admit`.
    """
    r, numbers = robot.value, mode.value
    admission, reaches = numbers.admission, numbers.reaches
    T, v = admission.T, measured.v[r.order]
    q, s = measured.q[0][r.positions], resting_velocity(v, vdot[r.order], admission.T)
    limits = numbers.limits.value
    inside = share_within(s, *step_bounds(q, v, r.n, limits, admission))
    s = inside * s
    d = row_distances(measured, r)
    present = examine_present(q, v, s, d, r, reaches, admission)
    checked = check_step(q, v, s, present, r, reaches, admission)
    how, share, clearance = AS_WISHED, 1.0, checked.clearance
    if not checked.clear:
        share, clearance = scale_step(q, v, s, present, r, reaches, admission)
        s = share * s
    share *= inside
    if share < 1.0:
        how = SCALED
        qddot = (s - v) / T
        vdot = join_joints(qddot[: r.n], qddot[r.n :], r.order)
    clearance = min(clearance, present.low.min()) if len(present.low) else np.inf
    return vdot, np.array([how, share, clearance, 1.0 if present.held else 0.0])


@compiled
def lookahead_or_scaled(
    given: np.ndarray,
    asked: np.ndarray,
    accelerations: np.ndarray,
    robot: Held,
    mode: Held,
) -> np.ndarray:
    """`lookahead_step`, from one vector to one; or `scale_acceleration`, which is next
    to nothing to compile beside it and would else be half as much again.

    Args:
        given: of `handover.hand_over`, with (3 n,) of `LookaheadMemory`; of the
            present state alone where there are accelerations.
        asked: of `Measured`, in both configurations.
        accelerations: (nv,) that are to be scaled; (0,) for a step.
        robot, mode: of `lookahead_step`.

    Returns:
        One after the other: of a step (nv,) accelerations, (m,) errors, (n,) W, (n,)
        q_dot_c, (n,) slip, (2,) margins, (4,) how it was admitted, and the distances;
        else (nv,) accelerations and (4,) of `admit`.
    """
    r = robot.value
    nq, nv, n = len(r.positions), len(r.order), r.n
    q, v = given[:nq], given[nq : nq + nv]
    both = with_resting(q, v, r, mode.value.gains.T)
    measured = Measured(both, v, asked)
    if len(accelerations):
        return np.concatenate(scale_acceleration(measured, accelerations, robot, mode))
    wanted, kept = take_over(given, r, 3 * n)
    before = LookaheadMemory(kept[:n], kept[n : 2 * n], kept[2 * n :])
    answer, slip, margins, admission = lookahead_step(
        measured, wanted, robot, mode, before
    )
    return np.concatenate(
        (
            answer.vdot,
            answer.error,
            answer.W,
            answer.qdot_c,
            slip,
            margins,
            admission,
            answer.d,
        )
    )
