"""The nominal velocity, its guard and what of it is admitted: (L6)-(L8).

`equations.lookahead` says what they mean, `equations.admission` what is clear.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.equations.admission import (
    AS_NOMINAL,
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
from crar_drake.equations.kinematics import Robot
from crar_drake.equations.lookahead_rows import (
    Constraints,
    Limits,
    LookaheadGains,
    join_constraints,
    resting_velocity,
    row_weights,
)
from crar_drake.equations.one_sided import one_sided_minimum
from crar_drake.equations.references import TaskGains
from crar_drake.equations.vectors import (
    add_to_diagonal,
    cholesky,
    cholesky_solve,
    gram,
    identity,
    largest,
    times,
    transposed_times,
)

# A step is corrected so often before it is scaled. Each costs a guard; of the steps of
# the recordings these leave 0.03 to 0.13 % to be scaled (docs/measurements/sweep.md).
CORRECTIONS = 4
# A correction aims so far above the level that a pair must keep [m], since a row is
# linear and the distance is not; it is a part of the 1 mm between floor and margin.
SPARE = 3e-4
# Shares of the nominal step for which the guard is asked anew, where not even the first
# of them would be left: the far end of a long step says little about its beginning.
LESS = (0.25, 0.0625, 0.015625, 0.0)


class LookaheadNumbers(NamedTuple):
    """What the mode is made with."""

    tasks: TaskGains
    limits: Held  # of `Limits`
    gains: LookaheadGains
    admission: AdmissionGains
    reaches: Held  # of `Reaches`
    members: np.ndarray  # (Nc, most) the rows of each watched pair; the first fills up
    preview: Held  # of `Preview`
    horizons: np.ndarray  # (K,) T, and longer ones where motors are weak [s]


@compiled
def damped_gram(J: np.ndarray, gains: LookaheadGains) -> np.ndarray:
    """J^T J + lambda^2 I (n, n) of the weighted task Jacobian J (m, n)."""
    normal = gram(J)
    add_to_diagonal(normal, np.full(len(normal), gains.damping**2))
    return normal


@compiled
def guard_norm(normal: np.ndarray, gains: LookaheadGains) -> np.ndarray:
    """N of (L7), (n, n): the identity, or

        J^T J + nu^2 I,

    with nu = lambda the norm of (L6) itself, by which a change is small where it is so
    for the tasks, by their weights: what evades then moves a task of high weight the
    least.

    Args:
        normal: (n, n) `damped_gram`.
    """
    if not gains.task_norm:
        return identity(len(normal))
    if gains.guard_damping == gains.damping:
        return normal
    N = normal.copy()
    add_to_diagonal(N, np.full(len(N), gains.guard_damping**2 - gains.damping**2))
    return N


@compiled
def bounded_velocity(
    qdot: np.ndarray, qddot: np.ndarray, gains: LookaheadGains
) -> np.ndarray:
    """s_0 of a nominal acceleration (n,), scaled to the nominal speed limit; (n,)."""
    s_0 = resting_velocity(qdot, qddot, gains.T)
    fastest = largest(s_0)
    if fastest > gains.nominal_speed_limit:
        s_0 *= gains.nominal_speed_limit / fastest
    return s_0


@compiled
def nominal_velocity(
    J: np.ndarray,
    normal: np.ndarray,
    v_r: np.ndarray,
    a_r: np.ndarray,
    qdot: np.ndarray,
    posture: np.ndarray,
    constraints: Constraints,
    gains: LookaheadGains,
    qdot_0: np.ndarray,
    qddot_0: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(L6): the paper's law with W = I + sum omega_j g_j g_j^T; it always exists.

    Eqs. (15), (30), (34), (35) as least squares, with the push-through identity of
    (34): of the rows that are approached,

        q_dot_c = argmin |J x - v_r|^2 + lambda^2 (|x|^2
                  + sum omega_j min(0, g_j x + drift_j)^2)
        z = Gv (q_dot_c - q_dot)
        alpha = argmin |J x - a_r|^2 + lambda^2 (|x|^2 - 2 z^T x if m < n
                + sum omega_j min(0, g_j s_0(x) + drift_j)^2 / T^2)
        s_0 = q_dot + T (alpha + z), all of it scaled so that no joint's share is
              more than nominal_speed_limit.

    Where tasks are joints, |x - x_0|^2 stands for |x|^2 (`undamped_preference`).

    Args:
        J: (m, n) task Jacobian.
        normal: (n, n) of it, `damped_gram`.
        v_r: (m,) v_d + K e less the prescribed joints' share.
        a_r: (m,) Eq. (14) less bias and the prescribed joints' share.
        qdot: (n,) present velocity [rad/s].
        posture: (n,) a null-space acceleration, added to z where m < n [rad/s^2].
        qdot_0, qddot_0: (n,) x_0 of both levels; (0,) for 0.

    Returns:
        (n,) s_0; (n,) q_dot_c; (n,) the diagonal of W at alpha.
    """
    m, n = J.shape
    T, damping2 = gains.T, gains.damping**2
    g, drift = constraints.g, constraints.drift
    root = gains.damping * np.sqrt(constraints.weight)
    rows = root[:, np.newaxis] * g
    factor = cholesky(normal)

    right = transposed_times(J, v_r)
    if len(qdot_0):
        right = right + damping2 * qdot_0
    qdot_c, _, _ = one_sided_minimum(
        normal, right, rows, -root * drift, cholesky_solve(factor, right)
    )
    z = gains.Gv * (qdot_c - qdot)
    right = transposed_times(J, a_r)
    if m < n:
        right = right + damping2 * (z + posture)
    if len(qddot_0):
        right = right + damping2 * qddot_0
    towards = times(g, qdot + T * z) + drift
    alpha, active, _ = one_sided_minimum(
        normal, right, rows, -root * towards / T, cholesky_solve(factor, right)
    )
    s_0 = bounded_velocity(qdot, alpha + z, gains)
    W = np.ones(n)
    for row in np.flatnonzero(active):
        W += constraints.weight[row] * g[row] * g[row]
    return s_0, qdot_c, W


@compiled
def guard(s_0: np.ndarray, constraints: Constraints, norm: np.ndarray) -> np.ndarray:
    """(L7): the velocity nearest to the nominal one that the constraints allow, (n,).

        s = argmin (s - s_0)^T N (s - s_0) + sum omega_j max(0, r_j - g_j s - drift_j)^2

    Args:
        s_0: (n,) the nominal velocity.
        norm: (n, n) N, `guard_norm`.
    """
    root = np.sqrt(constraints.weight)
    s, _, _ = one_sided_minimum(
        norm,
        times(norm, s_0),
        root[:, np.newaxis] * constraints.g,
        root * (constraints.retreat - constraints.drift),
        s_0,
    )
    return s


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
        s: (nv,) velocity of q_s that was checked.
    """
    period = admission.period
    failed, g = gradients_at(checked.start, checked.x, checked.bounds, r, reaches)
    k = 0.5 * period * (period + admission.step) / admission.T
    k = k + checked.bounds.at[failed] * period
    missing = (present.level[failed] + SPARE - checked.bounds.d[failed]) / k
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
    """The largest share of s, in [0, 1], that is within bounds with 0 between them.

    Args:
        s: (nv,) [rad/s].
        lowest, highest: (n,) bounds of the first n [rad/s].
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

    As the guard has it, else corrected by rows for what would not be clear, else
    scaled towards braking, with the prescribed joints; or what the guard makes of a
    share of the nominal step, if hardly any of that would be left.

    Args:
        s_0: (n,) the nominal velocity, before the guard.
        s_p: (n_p,) velocity of q_s of the prescribed joints.
        s_1: (n,) of the guard.
        q, v: (nq,), (nv,) state.
        d: (2, Nr) distances of all rows at q and at q_s [m].

    Returns:
        (n,), (n_p,) s of the controlled and the prescribed joints; (4,) how it was
        admitted (AS_NOMINAL, CORRECTED, SCALED), the share of s, the clearance of the
        next braking path [m], and 1 if the present one was clear, else 0.
    """
    n, given = len(s_0), constraints
    limits, reaches = numbers.limits.value, numbers.reaches
    admission = numbers.admission
    lowest, highest = step_bounds(q, v, n, limits, admission)
    s = np.concatenate((np.minimum(np.maximum(s_1, lowest), highest), s_p))
    how, share = AS_NOMINAL, 1.0
    present = examine_present(q, v, s, d, r, reaches, admission)
    checked = check_step(q, v, s, present, r, reaches, admission)
    clearance = checked.clearance
    if not checked.clear:
        how = CORRECTED
        for _ in range(CORRECTIONS):
            if not (checked.bounds.at >= 0.0).any():
                break  # the way there is not clear: nothing to be corrected
            constraints = join_constraints(
                constraints,
                correction(
                    checked, s, n, present, r, reaches, numbers.gains, admission
                ),
            )
            s_1 = guard(s_0, constraints, norm)
            s = np.concatenate((np.minimum(np.maximum(s_1, lowest), highest), s_p))
            checked = check_step(q, v, s, present, r, reaches, admission)
            if checked.clear:
                break
        clearance = checked.clearance
        if not checked.clear:
            how = SCALED
            share, clearance = scale_step(q, v, s, present, r, reaches, admission)
            scaled = share * s
            if share < LESS[0]:
                # What the guard asks for, a way out among it, would be scaled as well.
                for less in LESS:
                    s_1 = guard(less * s_0, given, norm)
                    s_1 = np.minimum(np.maximum(s_1, lowest), highest)
                    s = np.concatenate((s_1, less * s_p))
                    checked = check_step(q, v, s, present, r, reaches, admission)
                    if checked.clear:
                        share, clearance, scaled = less, checked.clearance, s
                        break
            s = scaled
    clearance = min(clearance, present.low.min()) if len(present.low) else np.inf
    reported = np.array([how, share, clearance, 1.0 if present.held else 0.0])
    return s[:n], s[n:], reported
