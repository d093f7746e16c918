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

from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.joint_limits import (
    LimitPotential,
    limit_gradient,
    limit_potential,
)
from crar_drake.equations.kinematics import FromDrake, find_state, join_joints
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
    times,
    transposed_times,
)

# A margin of a row smaller than this [m] weighs as this: weights stay finite.
SMALLEST_MARGIN = 1e-4


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


class Limits(NamedTuple):
    """The joints with limits, made by `find_limits`; nl of n."""

    joints: np.ndarray  # (nl,)
    lower: np.ndarray  # (nl,) [rad]
    upper: np.ndarray
    potential: LimitPotential  # of these


class Constraints(NamedTuple):
    """Margins h that should stay positive and change by g s + drift per second.

    Rows of pairs and of joint limits alike: of a limit, g is a signed unit vector.

    Attributes:
        h: (C,) margins where the robot will come to rest: distances of pairs [m],
            or from a joint to its nearer limit [rad], negative beyond it.
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


class LookaheadSolution(NamedTuple):
    """The lookahead's choice.

    Attributes:
        qddot: (n,) resolved acceleration (s - q_dot) / T [rad/s^2].
        s: (n,) velocity of q_s [rad/s].
        qdot_c: (n,) Eq. (15) with the full-matrix weight [rad/s].
        W: (n,) diagonal of the weight matrix of the last pass.
        passes: how often the two loops solved, together.
    """

    qddot: np.ndarray
    s: np.ndarray
    qdot_c: np.ndarray
    W: np.ndarray
    passes: int


def resting_configuration(q: np.ndarray, qdot: np.ndarray, T: float) -> np.ndarray:
    """(L1): q_s = q + T q_dot: where q_ddot = -q_dot/T leads. All (n,); T in s."""
    return q + T * qdot


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


def find_limits(lower: np.ndarray, upper: np.ndarray) -> Limits:
    """The joints that have limits.

    Args:
        lower, upper: (n,) limits [rad], infinite where there is none.
    """
    joints = np.flatnonzero(np.isfinite(lower) & np.isfinite(upper))
    lower, upper = lower[joints], upper[joints]
    return Limits(joints, lower, upper, limit_potential(lower, upper))


@compiled
def limit_constraints(
    q_s: np.ndarray, slip: np.ndarray, limits: Limits, gains: LookaheadGains
) -> Constraints:
    """One row per limited joint, of its nearer limit, with weight Eq. (17) at q_s.

    Args:
        q_s: (n,) resting configuration [rad].
        slip: (n,) velocity of q_s that is not commanded, see `slip_velocity`;
            only what goes towards the limit counts [rad/s].
        limits: of the joints.
        gains: of the mode.
    """
    nl = len(limits.joints)
    at = q_s[limits.joints]
    to_upper, to_lower = limits.upper - at, at - limits.lower
    h = np.minimum(to_upper, to_lower)
    inward = np.copysign(1.0, to_upper - to_lower)  # -1 near the upper limit
    g = np.zeros((nl, len(q_s)))
    for i in range(nl):
        g[i, limits.joints[i]] = inward[i]
    return Constraints(
        h,
        g,
        np.minimum(inward * slip[limits.joints], 0.0),
        gains.rho_limits * np.abs(limit_gradient(at, limits.potential)),
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


@compiled
def solve_lookahead(
    J: np.ndarray,
    v_r: np.ndarray,
    a_r: np.ndarray,
    qdot: np.ndarray,
    posture: np.ndarray,
    constraints: Constraints,
    gains: LookaheadGains,
) -> LookaheadSolution:
    """(L6)-(L8): resolved acceleration under constraints; it always exists.

    Two stages, each a loop over a growing active set A that starts empty and takes
    up whatever the solution moves towards, until nothing is added. First the
    paper's law with W(A) = I + sum omega_j g_j g_j^T (of a limit: w_i e_i e_i^T) in
    place of its diagonal W, Eqs. (15), (30), (34), (35) by the push-through
    identity:

        M = J^T J + lambda^2 W
        q_dot_c = M^-1 (J^T v_r - lambda^2 sum omega_j drift_j g_j)
        z = Gv (q_dot_c - q_dot)
        alpha = M^-1 [J^T a_r + lambda^2 z  if m < n],   s_0 = q_dot + T (alpha + z)

    then the guard, which brings s_0 to the speeds that the constraints allow:

        s = argmin |s - s_0|^2 + sum omega_j (g_j s + drift_j - r_j)^2

    over the constraints that s exceeds; and alpha_c = (s - q_dot) / T.

    Args:
        J: (m, n) task Jacobian.
        v_r: (m,) v_d + K e less the prescribed joints' share.
        a_r: (m,) Eq. (14) less bias and the prescribed joints' share.
        qdot: (n,) present velocity [rad/s].
        posture: (n,) a null-space acceleration, added to z where m < n [rad/s^2].
        constraints: rows and limits.
        gains: of the mode.
    """
    m, n = J.shape
    T, damping2 = gains.T, gains.damping**2
    drift, retreat = constraints.drift, constraints.retreat
    # With lambda in the roots, both stages have lambda^2 on their diagonals.
    root = gains.damping * np.sqrt(constraints.weight)
    rows = root[:, np.newaxis] * constraints.g
    damped = np.full(n, damping2)

    normal = gram(J)
    add_to_diagonal(normal, damped)
    right_v, right_a = transposed_times(J, v_r), transposed_times(J, a_r)
    M, right = normal, right_v
    W = np.ones(n)
    on = np.zeros(len(drift), dtype=np.bool_)
    passes = 0
    while True:
        passes += 1
        factor = cholesky(M)
        qdot_c = cholesky_solve(factor, right)
        z = gains.Gv * (qdot_c - qdot)
        if m < n:
            alpha = cholesky_solve(factor, right_a + damping2 * (z + posture))
        else:
            alpha = cholesky_solve(factor, right_a)
        s_0 = resting_velocity(qdot, alpha + z, T)
        rate = times(constraints.g, s_0) + drift
        added = (rate < 0.0) & ~on
        if not added.any():
            break
        on |= added
        A = np.flatnonzero(on)
        active = rows[A]
        penalty = gram(active)
        M = normal + penalty
        W = 1.0 + np.diag(penalty) / damping2
        right = right_v - transposed_times(active, (root * drift)[A])

    wish = root * (retreat - drift)
    on[:] = False
    s = s_0
    while True:
        added = (rate < retreat) & ~on
        if not added.any():
            break
        passes += 1
        on |= added
        A = np.flatnonzero(on)
        active = rows[A]
        M = gram(active)
        add_to_diagonal(M, damped)
        right = damping2 * s_0 + transposed_times(active, wish[A])
        s = cholesky_solve(cholesky(M), right)
        rate = times(constraints.g, s) + drift
    return LookaheadSolution((s - qdot) / T, s, qdot_c, W, passes)


class LookaheadNumbers(NamedTuple):
    """What the mode is made with."""

    tasks: TaskGains
    limits: Limits
    gains: LookaheadGains


class LookaheadMemory(NamedTuple):
    """What one step of the mode leaves to the next, all (n,)."""

    qdot: np.ndarray  # measured [rad/s]
    qddot: np.ndarray  # commanded [rad/s^2]
    slip: np.ndarray  # `slip_velocity` [rad/s]


@compiled
def lookahead_step(
    drake: FromDrake,
    wanted: Wanted,
    robot: Held,
    mode: Held,
    before: LookaheadMemory,
) -> tuple[Answer, np.ndarray, np.ndarray]:
    """(L3)-(L9) in their order: one control step of the mode.

    Args:
        drake: its numbers at q and at q_s.
        wanted: the targets.
        robot: holds a `Robot`.
        mode: holds `LookaheadNumbers`.
        before: of the step before; at the first, with q_dot itself and zeros, so that
            nothing slipped.

    Returns:
        The answer; (n,) slip; (2,) smallest margins of pairs [m] and limits [rad].
    """
    r, numbers = robot.value, mode.value
    limits, gains = numbers.limits, numbers.gains
    n, T = r.n, gains.T
    state = find_state(drake, r)
    references = find_references(state, wanted, r.rows, numbers.tasks)
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
        times(by_joint[:, n:], s_p),
        slip,
        gains,
    )
    at_limits = limit_constraints(state.q[:n] + T * qdot, slip, limits, gains)
    solution = solve_lookahead(
        references.J,
        references.v_r,
        references.a_r,
        qdot,
        references.posture,
        join_constraints(pairs, at_limits),
        gains,
    )
    margins = np.full(2, np.inf)
    if len(h):
        margins[0] = h.min()
    if len(at_limits.h):
        margins[1] = at_limits.h.min()
    answer = Answer(
        join_joints(solution.qddot, references.qddot_p, r.order),
        references.error,
        state.d[0],
        solution.W,
        solution.qdot_c,
    )
    return answer, slip, margins
