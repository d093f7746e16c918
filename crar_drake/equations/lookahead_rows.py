"""What the lookahead constrains: rows of pairs and limits, where the robot would come
to rest, (L1)-(L5), (L9). `equations.lookahead` says what they mean.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.joint_limits import (
    LimitPotential,
    limit_gradient,
    limit_potential,
)
from crar_drake.equations.kinematics import Robot, State
from crar_drake.equations.vectors import times

# A margin of a row smaller than this [m] weighs as this: weights stay finite. At a
# tenth of a millimetre a pair's weight has long taken all that a task asks against it.
SMALLEST_MARGIN = 1e-4

# What rows weigh that bound how fast something is approached: the guard's norm is of
# the order of 1, so that what they give way is not seen.
BOUNDING_WEIGHT = 1e6

# A joint with one limit is weighted as if the other were so far away [rad or m].
ONE_SIDED_RANGE = 2.0 * np.pi

# q_s is not asked to move faster than this unless it is given [rad/s or m/s]: half of
# it misses fast motions, twice as much gains a millimetre or two for a tenth to a fifth
# more acceleration.
NOMINAL_SPEED_LIMIT = 16.0


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
    nominal_speed_limit: float = NOMINAL_SPEED_LIMIT  # of q_s [rad/s or m/s]
    task_norm: bool = False  # whether the guard's norm is that of the tasks
    guard_damping: float = 0.0  # nu of that norm [m]
    approach_rate: float = 0.0  # kappa [1/s]; 0: rows weigh by their margins instead
    limit_approach_rate: float = 0.0  # kappa of limits [1/s]


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
    """

    # (C,) margins where the robot will come to rest: distances of pairs [m], or from a
    # joint to a limit [rad], negative beyond it
    h: np.ndarray
    g: np.ndarray  # (C, n) their gradients by the controlled joints [m/rad or 1]
    # (C,) their change other than by s: by the prescribed joints, and by what of the
    # slip goes towards the constraint [m/s or rad/s]
    drift: np.ndarray
    weight: np.ndarray  # (C,) `row_weights` of pairs, rho_JL |grad h_i| of limits
    retreat: np.ndarray  # (C,) r, how fast a violated one must recede [m/s or rad/s]


@compiled
def resting_configuration(q: np.ndarray, qdot: np.ndarray, T: float) -> np.ndarray:
    """(L1): q_s = q + T q_dot: where q_ddot = -q_dot/T leads.

    Args:
        q, qdot: (nv,), (nv,) state.
        T: [s].
    """
    return q + T * qdot


@compiled
def with_resting(q: np.ndarray, v: np.ndarray, r: Robot, T: float) -> np.ndarray:
    """A configuration, and where the robot would come to rest from it: (2, nv).

    Args:
        q, v: (nv,), (nv,) state in the plant's order.
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
    """(L3), (L4): h of two rows a pair, where the robot comes to rest.

    At the state by its velocity, d(q) + T dd/dq q_dot, and at q_s itself, d(q_s).
    Each pair of shapes has its own: one of the nearest two alone would jump where two
    are equally near, and let the first go.

    Args:
        d: (2, Nc) signed distances at q and at q_s [m].
        dd_dv: (2, Nc, nv) their gradients by all joints.
        v: (nv,) velocities [rad/s, m/s].
        T: braking horizon [s].

    Returns:
        (2 Nc,) [m]: first those expected from q, and then those at q_s.
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
def weighed_margins(
    h: np.ndarray, before: np.ndarray, least: float, most: float
) -> np.ndarray:
    """(L5): the margins by which rows weigh, h, but not growing at once; (R,).

    A velocity moves a margin that is expected in T by a lot in a period. If weights
    fell as fast, what they held back would come at once, and be held back again.

    Args:
        h: (R,) margins of rows [m or rad].
        before: (R,) this function's value one period ago, infinite at a start; (0,)
            where rows were others.
        least: what counts of those at least, lest rows with a deep
            penetration weigh for long [m or rad].
        most: by which they grow at most [m or rad].
    """
    if not len(before):
        return h
    return np.minimum(h, np.maximum(before, least) + most)


@compiled
def row_weights(
    h: np.ndarray, d_min: float, rho: float, alpha: float, beta: float
) -> np.ndarray:
    """(L5): omega (R,), the magnitude of Eq. (23) at the margin eta = h - d_min.

    Args:
        h: (R,) distances at rest, `weighed_margins` [m].
        d_min: distance to keep [m].
        rho, alpha, beta: amplitude, decay [1/m] and exponent of Eq. (22).
    """
    eta = np.maximum(h - d_min, SMALLEST_MARGIN)
    return rho * np.exp(-alpha * eta) * eta**-beta * (beta / eta + alpha)


@compiled
def retreat_speed(
    h: np.ndarray, margin: float, gamma: float, fastest: float, kappa: float
) -> np.ndarray:
    """r of (L7): how fast a margin has to grow at least; (C,) [m/s, rad/s].

    Inside the margin gamma (margin - h), but at most `fastest`; outside of it
    -kappa (h - margin), which bounds how fast it is approached: so a velocity damper
    (Faverjon and Tournassoud, 1987) has it.

    Args:
        h: (C,) margins [m or rad].
        margin: to be kept [m or rad].
        gamma: [1/s].
        fastest: [m/s or rad/s].
        kappa: [1/s].
    """
    inside, outside = np.maximum(margin - h, 0.0), np.maximum(h - margin, 0.0)
    return np.minimum(gamma * inside - kappa * outside, fastest)


@compiled
def pair_constraints(
    h: np.ndarray,
    weighed: np.ndarray,
    g: np.ndarray,
    drift: np.ndarray,
    slip: np.ndarray,
    gains: LookaheadGains,
) -> Constraints:
    """The rows of pairs within the influence distance.

    Args:
        h, g, drift: (R,), (R, n), (R,) of all rows, see `Constraints`.
        weighed: (R,) `weighed_margins` [m].
        slip: (n,) velocity of q_s that is not commanded, see `slip_velocity`; only
            what approaches counts [rad/s].
    """
    near = np.flatnonzero(h < gains.influence_distance)
    h, g = h[near], g[near]
    if gains.approach_rate > 0.0:
        weights = np.full(len(h), BOUNDING_WEIGHT)
    else:
        weights = row_weights(
            weighed[near], gains.distance_margin, gains.rho, gains.alpha, gains.beta
        )
    return Constraints(
        h,
        g,
        drift[near] + np.minimum(times(g, slip), 0.0),
        weights,
        retreat_speed(
            h,
            gains.distance_margin,
            gains.retreat_rate,
            gains.retreat_speed,
            gains.approach_rate,
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
def limit_margins(q_s: np.ndarray, limits: Limits) -> np.ndarray:
    """(nl,) how far the resting configuration (n,) is inside each limit [rad]."""
    return limits.inward * (q_s[limits.joints] - limits.at)


@compiled
def limit_constraints(
    h: np.ndarray,
    weighed: np.ndarray,
    slip: np.ndarray,
    limits: Limits,
    gains: LookaheadGains,
) -> Constraints:
    """A row of each limit, with the weight Eq. (17) at q_s, 0 on its far half.

    Args:
        h: (nl,) `limit_margins` [rad].
        weighed: (nl,) `weighed_margins` [rad].
        slip: (n,) velocity of q_s that is not commanded, see `slip_velocity`;
            only what goes towards the limit counts [rad/s].
    """
    joints, inward = limits.joints, limits.inward
    nl = len(joints)
    g = np.zeros((nl, len(slip)))
    for i in range(nl):
        g[i, joints[i]] = inward[i]
    if gains.approach_rate > 0.0:
        weights = np.full(nl, BOUNDING_WEIGHT)
    else:
        at = limits.at + inward * weighed
        towards = -inward * limit_gradient(at, limits.potential)
        weights = gains.rho_limits * np.maximum(towards, 0.0)
    return Constraints(
        h,
        g,
        np.minimum(inward * slip[joints], 0.0),
        weights,
        retreat_speed(
            h,
            gains.limit_margin,
            gains.retreat_rate,
            gains.joint_retreat_speed,
            gains.limit_approach_rate,
        ),
    )


@compiled
def some_of(constraints: Constraints, some: np.ndarray) -> Constraints:
    """Of the rows those (k,) that are named."""
    return Constraints(
        constraints.h[some],
        constraints.g[some],
        constraints.drift[some],
        constraints.weight[some],
        constraints.retreat[some],
    )


@compiled
def that_weigh(constraints: Constraints) -> Constraints:
    """Without the rows whose weight is 0, which change nothing: half of the limits'."""
    return some_of(constraints, np.flatnonzero(constraints.weight > 0.0))


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
    """(L9): how fast q_s moves besides s: T times what the plant did other than
    commanded.

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
def find_constraints(
    state: State,
    h: np.ndarray,
    by_pairs: np.ndarray,
    to_limits: np.ndarray,
    by_limits: np.ndarray,
    s_p: np.ndarray,
    slip: np.ndarray,
    limits: Limits,
    gains: LookaheadGains,
) -> Constraints:
    """The rows of pairs and of limits that weigh.

    Args:
        h, by_pairs: (2 Nr,) margins of the pairs, and those by which they weigh [m].
        to_limits, by_limits: (nl,) the same of limits [rad].
        s_p: (n_p,) velocity of q_s of the prescribed joints.
        slip: (n,) that is expected to go on [rad/s].
    """
    n, v = len(slip), state.v
    by_joint = state.dd_dv.reshape(len(h), len(v))
    pairs = pair_constraints(
        h,
        by_pairs,
        np.ascontiguousarray(by_joint[:, :n]),
        times(by_joint[:, n:], s_p) + margin_curvature(state.dd_dv, v),
        slip,
        gains,
    )
    at_limits = limit_constraints(to_limits, by_limits, slip, limits, gains)
    return join_constraints(pairs, that_weigh(at_limits))
