"""Constraints that hold: the lookahead mode, this project's answer to the paper.

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

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from crar_drake.equations.joint_limits import joint_limit_gradient

# A margin of a row smaller than this [m] weighs as this: weights stay finite.
SMALLEST_MARGIN = 1e-4


@dataclass(frozen=True)
class Rows:
    """Constraints h >= d_min that change by g s + drift per second.

    Attributes:
        h: (R,) where the distances will come to rest [m].
        g: (R, n) their gradients by the controlled joints [m/rad].
        drift: (R,) their change by the prescribed joints' motion [m/s].
        weight: (R,) omega, `row_weights` [s^2/m^2 per (rad/s)^2].
        retreat: (R,) r, the speed at which a violated row must recede [m/s].
    """

    h: np.ndarray
    g: np.ndarray
    drift: np.ndarray
    weight: np.ndarray
    retreat: np.ndarray


@dataclass(frozen=True)
class Limits:
    """Joint limits seen from q_s, per controlled joint.

    Attributes:
        margin: (n,) from q_s to the nearer limit [rad], negative beyond it,
            infinite where there is none.
        outward: (n,) +1 where the nearer limit is the upper one, -1 where it is
            the lower one.
        weight: (n,) rho_JL |grad h_i| of Eq. (17) at q_s; 0 without limits.
        retreat: (n,) speed at which a violated joint must come back [rad/s].
        drift: (n,) motion of q_s towards that limit that is not commanded [rad/s].
    """

    margin: np.ndarray
    outward: np.ndarray
    weight: np.ndarray
    retreat: np.ndarray
    drift: np.ndarray


@dataclass(frozen=True)
class LookaheadSolution:
    """The lookahead's choice.

    Attributes:
        qddot: (n,) resolved acceleration (s - q_dot) / T [rad/s^2].
        s: (n,) velocity of q_s [rad/s].
        qdot_c: (n,) Eq. (15) with the full-matrix weight [rad/s].
        W: (n, n) the weight matrix of the last pass.
        passes: how often the two loops solved, together.
    """

    qddot: np.ndarray
    s: np.ndarray
    qdot_c: np.ndarray
    W: np.ndarray
    passes: int


def resting_configuration(q: np.ndarray, qdot: np.ndarray, T: float) -> np.ndarray:
    """q_s = q + T q_dot: where q_ddot = -q_dot/T leads. All (n,); T in s."""
    return q + T * qdot


def slip_velocity(
    previous: np.ndarray,
    qdot: np.ndarray,
    qdot_before: np.ndarray,
    qddot_before: np.ndarray,
    *,
    T: float,
    period: float,
    time_constant: float,
) -> np.ndarray:
    """How fast q_s moves besides s: T times what the plant did other than told.

    A torque that is held is not an acceleration that is held, models are wrong, and
    somebody may push. What the last control period showed of it is taken, through a
    first-order low-pass, as what the next will bring.

    Args:
        previous: (n,) this function's value one period ago [rad/s].
        qdot, qdot_before: (n,) velocities now and one period ago [rad/s].
        qddot_before: (n,) commanded one period ago [rad/s^2].
        T: braking horizon [s].
        period: of the controller [s].
        time_constant: of the low-pass [s].

    Returns:
        (n,) [rad/s].
    """
    seen = T * ((qdot - qdot_before) / period - qddot_before)
    return previous + min(1.0, period / time_constant) * (seen - previous)


def row_weights(
    h: np.ndarray, d_min: float, rho: float, alpha: float, beta: float
) -> np.ndarray:
    """omega: the magnitude of Eq. (23) at the margin eta = h - d_min.

    Args:
        h: (R,) distances at rest [m].
        d_min: distance to keep [m].
        rho, alpha, beta: amplitude, decay [1/m] and exponent of Eq. (22).

    Returns:
        (R,) finite: eta counts as at least SMALLEST_MARGIN.
    """
    eta = np.maximum(h - d_min, SMALLEST_MARGIN)
    return rho * np.exp(-alpha * eta) * eta**-beta * (beta / eta + alpha)


def make_rows(
    h: np.ndarray,
    g: np.ndarray,
    drift: np.ndarray,
    *,
    d_min: float,
    influence: float,
    gamma: float,
    fastest: float,
    rho: float,
    alpha: float,
    beta: float,
    slip: np.ndarray | None = None,
) -> Rows:
    """The rows within the influence distance, with weights and retreat speeds.

    Args:
        h, g, drift: (R,), (R, n), (R,) of all rows.
        d_min: distance to keep [m].
        influence: rows with h beyond it do not count [m].
        gamma: a row inside d_min must recede at gamma (d_min - h) [1/s],
        fastest: but at no more than this [m/s].
        rho, alpha, beta: of the weight.
        slip: (n,) velocity of q_s that is not commanded, see `slip_velocity`; only
            what approaches counts [rad/s].
    """
    near = h < influence
    h, g, drift = h[near], g[near], drift[near]
    if slip is not None:
        drift = drift + np.minimum(g @ slip, 0.0)
    return Rows(
        h=h,
        g=g,
        drift=drift,
        weight=row_weights(h, d_min, rho, alpha, beta),
        retreat=np.minimum(gamma * np.maximum(d_min - h, 0.0), fastest),
    )


def make_limits(
    q_s: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    margin: float,
    gamma: float,
    fastest: float,
    rho: float,
    slip: np.ndarray | float = 0.0,
) -> Limits:
    """The joint limits at the resting configuration.

    Args:
        q_s: (n,) resting configuration [rad].
        lower, upper: (n,) limits [rad], infinite where there is none.
        margin: to keep from them [rad].
        gamma: a joint nearer than that must come back at gamma (margin - distance),
        fastest: but at no more than this [rad/s].
        rho: rho_JL, the weight's amplitude.
        slip: (n,) velocity of q_s that is not commanded, see `slip_velocity`; only
            what goes towards the limit counts [rad/s].
    """
    to_upper, to_lower = upper - q_s, q_s - lower
    nearest = np.minimum(to_upper, to_lower)
    outward = np.where(to_upper <= to_lower, 1.0, -1.0)
    return Limits(
        margin=nearest,
        outward=outward,
        drift=outward * np.maximum(outward * slip, 0.0),
        weight=rho * np.abs(joint_limit_gradient(q_s, lower, upper)),
        retreat=np.minimum(gamma * np.maximum(margin - nearest, 0.0), fastest),
    )


def solve_lookahead(
    J: np.ndarray,
    v_r: np.ndarray,
    a_r: np.ndarray,
    qdot: np.ndarray,
    rows: Rows,
    limits: Limits,
    *,
    T: float,
    Gv: float,
    damping: float,
    posture: np.ndarray | None = None,
) -> LookaheadSolution:
    """Resolved acceleration under `rows` and `limits`; it always exists.

    Two stages, each a loop over a growing active set A that starts empty and takes
    up whatever the solution moves towards, until nothing is added. First the
    paper's law with W(A) = I + sum w_i e_i e_i^T + sum omega_j g_j g_j^T in place of
    its diagonal W, Eqs. (15), (30), (34), (35) by the push-through identity:

        M = J^T J + lambda^2 W,   q_dot_c = M^-1 J^T v_r,   z = Gv (q_dot_c - q_dot)
        alpha = M^-1 [J^T a_r + lambda^2 z  if m < n],   s_0 = q_dot + T (alpha + z)

    then the guard, which brings s_0 to the speeds that the constraints allow:

        s = argmin |s - s_0|^2 + sum omega_j (g_j s + drift_j - r_j)^2
                               + sum w_i (s_i + drift_i - r_i)^2

    over the rows and limits that s exceeds.

    Args:
        J: (m, n) task Jacobian.
        v_r: (m,) v_d + K e less the prescribed joints' share.
        a_r: (m,) Eq. (14) less bias and the prescribed joints' share.
        qdot: (n,) present velocity [rad/s].
        rows, limits: the constraints.
        T: braking horizon [s].
        Gv: joint velocity gain [1/s].
        damping: lambda [m], positive.
        posture: (n,) a null-space acceleration, added where m < n [rad/s^2].
    """
    m, n = J.shape
    damping2 = damping**2
    normal = J.T @ J
    normal.flat[:: n + 1] += damping2
    right = np.stack([J.T @ v_r, J.T @ a_r], axis=1)
    row_on = np.zeros(len(rows.h), dtype=bool)
    limit_on = np.zeros(n, dtype=bool)
    penalty = np.zeros((n, n))
    drift_push = np.zeros(n)
    passes = 0
    while True:
        passes += 1
        M = normal + damping2 * penalty
        velocity_side = right[:, 0] - damping2 * drift_push
        qdot_c, M_inv_a = _solve_spd(
            M, np.stack([velocity_side, right[:, 1]], axis=1)
        ).T
        z = Gv * (qdot_c - qdot)
        alpha = M_inv_a
        if m < n:
            pull = z if posture is None else z + posture
            alpha = alpha + _solve_spd(M, damping2 * pull[:, None])[:, 0]
        s_0 = qdot + T * (alpha + z)
        new_rows = ~row_on & (rows.g @ s_0 + rows.drift < 0.0)
        new_limits = (
            ~limit_on
            & (limits.weight > 0.0)
            & (limits.outward * (s_0 + limits.drift) > 0.0)
        )
        if not (new_rows.any() or new_limits.any()):
            break
        row_on |= new_rows
        limit_on |= new_limits
        penalty, drift_push, _ = _penalty(rows, limits, row_on, limit_on)
    W = np.eye(n) + penalty

    row_on[:] = False
    limit_on[:] = False
    s = s_0
    while True:
        new_rows = ~row_on & (rows.g @ s + rows.drift < rows.retreat)
        new_limits = (
            ~limit_on
            & (limits.weight > 0.0)
            & (limits.outward * (s + limits.drift) > -limits.retreat)
        )
        if not (new_rows.any() or new_limits.any()):
            break
        row_on |= new_rows
        limit_on |= new_limits
        passes += 1
        penalty, drift_push, pull = _penalty(rows, limits, row_on, limit_on)
        penalty.flat[:: n + 1] += 1.0
        s = _solve_spd(penalty, (s_0 - drift_push + pull)[:, None])[:, 0]
    return LookaheadSolution((s - qdot) / T, s, qdot_c, W, passes)


def _penalty(
    rows: Rows, limits: Limits, row_on: np.ndarray, limit_on: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sums over the active set: the matrix of sum omega g g^T + sum w e e^T (n, n),
    its right-hand side of the drifts (n,), and that of the retreats (n,)."""
    g, weight = rows.g[row_on], rows.weight[row_on]
    root = np.sqrt(weight)[:, None] * g
    penalty = root.T @ root  # symmetric to the last bit
    w = np.where(limit_on, limits.weight, 0.0)
    penalty.flat[:: len(w) + 1] += w
    drift_push = (weight * rows.drift[row_on]) @ g + w * limits.drift
    retreat = (weight * rows.retreat[row_on]) @ g - w * limits.outward * limits.retreat
    return penalty, drift_push, retreat


def _solve_spd(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Solves A X = B for a symmetric positive definite A (n, n) by Cholesky."""
    _, X, info = dposv(A, B)
    if info:
        raise FloatingPointError(
            "a matrix that is positive definite by construction is not: a NaN or an "
            "overflow reached the solver"
        )
    return X
