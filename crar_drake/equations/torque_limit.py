"""A torque limit without a QP: the nearest accelerations, then slower ones.

The paper names torque limits as its next extension. The torque is affine in the
accelerations, and each actuator's is to lie in an interval: within its limit, and such
that braking stays possible. First come the accelerations nearest to the nominal ones
that are in all intervals, by one-sided least squares: where one motor is weak, its
joint lags and the others go on. What is left beyond, where intervals contradict each
other, is taken away by slowing down altogether. In the words of `equations.lookahead`,
choosing an acceleration is choosing s, the velocity of the point where the robot would
come to rest. With

    alpha(theta) = (theta s - q_dot) / T,    0 <= theta <= 1,

the torque is affine in theta: tau(theta) = tau_b + theta (tau - tau_b), between that of
braking, tau_b, and that of the nominal accelerations, tau. The largest theta whose
torque respects the limits is taken. A constraint with g·s >= 0 keeps g·(theta s) >= 0.

So that braking stays possible, the torque is also bounded by the braking torque of the
next step, which is affine in it, too: the velocity grows by dt alpha, and

    tau_b+ = tau_b - (dt / T) (tau - tau_0),

with tau_0 the torque of no acceleration. A robot whose braking torque comes near its
limit (80 % of it: gravity and Coriolis forces change on the way) gets no faster, and
beyond that slows down as braking would.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.one_sided import one_sided_minimum
from crar_drake.equations.prediction import state_ahead
from crar_drake.equations.vectors import identity, largest, put_at, sum_rows, times

# Share of a limit that braking in the next step may need [1]: the rest is for what
# changes in between, of Coriolis forces and gravity.
_RESERVE = 0.8


# Weight of being outside an interval, against the distance from the nominal [1], and by
# which share intervals are taken to end earlier, so that what is found is within.
_WEIGHT = 1e4
_INSIDE = 1e-6


class TorqueScale(NamedTuple):
    """The largest share of the nominal step that the limits allow."""

    theta: float  # in [0, 1]
    # by which share of its limit the torque of the worst actuator is still beyond it
    # [1]; 0 if the limits can be respected
    excess: float


@compiled
def torque_scale(
    tau: np.ndarray,
    tau_brake: np.ndarray,
    tau_still: np.ndarray,
    limits: np.ndarray,
    period_over_horizon: float,
) -> TorqueScale:
    """The largest theta within the limits, and with braking possible afterwards.

    Where both cannot be had, the limits count; where not even these can, theta
    minimises the largest excess, and the torque is to be clipped.

    Args:
        tau: (nu,) torque of the nominal accelerations [Nm or N].
        tau_brake: (nu,) torque of braking, q_ddot = -q_dot / T.
        tau_still: (nu,) torque of q_ddot = 0.
        limits: (nu,) largest |torque|, infinite where there is none.
        period_over_horizon: dt / T [1].
    """
    limited = np.isfinite(limits)
    L, tau_b = limits[limited], tau_brake[limited]
    slope = tau[limited] - tau_b
    low, high = _interval(tau_b, slope, L)
    if low > high:
        return _least_excess(tau_b, slope, L)
    c = period_over_horizon
    braked = tau_b - c * (tau_b - tau_still[limited])
    reserve = _reserve(tau_b, braked, L)
    next_low, next_high = _interval(braked, -c * slope, reserve)
    both = min(high, next_high)
    if max(low, next_low) > both:
        # Which of the allowed shares brakes hardest: the smallest one.
        both = low
    return TorqueScale(both, 0.0)


@compiled
def _interval(start, slope, bound):
    """All theta in [0, 1] with |start + theta slope| <= bound; low > high if none.

    A rounding error of the bound is no violation, since the torque is clipped.
    """
    low, high = 0.0, 1.0
    for i in range(len(start)):
        room = bound[i] * (1.0 + 1e-12)
        if abs(slope[i]) < 1e-12 * (1.0 + bound[i]):
            if abs(start[i]) > room:
                return 1.0, 0.0
        else:
            one, other = (-room - start[i]) / slope[i], (room - start[i]) / slope[i]
            low, high = max(low, min(one, other)), min(high, max(one, other))
    return low, high


@compiled
def _least_excess(start, slope, bound):
    """The theta in [0, 1] that minimises the largest |start + theta slope| / bound.

    The maximum of lines is convex, so that its minimum is at an end or where two of
    them cross.
    """
    a = np.concatenate((start / bound, -start / bound))
    b = np.concatenate((slope / bound, -slope / bound))
    best, least = 0.0, a.max()
    if (a + b).max() < least:
        best, least = 1.0, (a + b).max()
    for i in range(len(a)):
        for j in range(i):
            rise, gap = b[i] - b[j], a[j] - a[i]
            if rise < 0.0:
                rise, gap = -rise, -gap
            if not 0.0 < gap < rise:  # they cross elsewhere; no division overflows
                continue
            theta = gap / rise
            if (a + b * theta).max() < least:
                best, least = theta, (a + b * theta).max()
    return TorqueScale(best, max(0.0, least - 1.0))


@compiled
def _reserve(tau_brake, braked, limits):
    """What braking in the next step may need, (nu,).

    What is beyond 80 % of a limit may not grow, and must come back as far as braking
    alone brings it, to `braked`: Coriolis forces may grow as fast.
    """
    least = np.minimum(np.abs(tau_brake), np.abs(braked))
    return np.maximum(_RESERVE * limits, least)


@compiled
def next_braking_torque(
    vdot: np.ndarray,
    tau: np.ndarray,
    inertia: np.ndarray,
    v: np.ndarray,
    controlled: np.ndarray,
    T: float,
    period: float,
) -> np.ndarray:
    """tau_b+, what braking takes one period on, (nu,) [Nm or N].

    Of the accelerations alone: gravity and Coriolis forces change on the way, too.

    Args:
        vdot: (nv,) accelerations till then [rad/s^2].
        tau: (nu,) their torque.
        inertia, v, controlled, T, period: as in `limit_torque`.
    """
    braking = vdot.copy()
    put_at(braking, controlled, -(v + period * vdot)[controlled] / T)
    return tau + times(inertia, braking - vdot)


@compiled
def share_of_nominal(
    vdot: np.ndarray, nominal: np.ndarray, qdot: np.ndarray, T: float
) -> float:
    """How much is left of the way from braking to the nominal: theta, if it was scaled.

    Args:
        vdot, nominal: accelerations, first those of the joints that brake [rad/s^2].
        qdot: (n,) velocities of the joints that brake [rad/s].
        T: braking horizon [s].

    Returns:
        1 - |nominal - vdot| / |nominal - braking|, in [0, 1], below 1 if they differ.
    """
    if (vdot == nominal).all():
        return 1.0
    way, lost = 0.0, 0.0
    for i in range(len(qdot)):
        way += (nominal[i] + qdot[i] / T) ** 2
        lost += (nominal[i] - vdot[i]) ** 2
    if lost >= way:  # also where braking is nominal, and there is no way
        return 0.0
    return min(1.0 - np.sqrt(lost / way), 1.0 - 1e-16)


@compiled
def nearest_accelerations(
    vdot: np.ndarray,
    tau: np.ndarray,
    inertia: np.ndarray,
    v: np.ndarray,
    controlled: np.ndarray,
    limits: np.ndarray,
    lowest: np.ndarray,
    highest: np.ndarray,
    T: float,
    period: float,
) -> np.ndarray:
    """The accelerations nearest to the nominal whose torques are in their intervals.

        x = argmin |x - nominal|^2 + w sum max(0, beyond_i(x))^2

    with each actuator's excess over its interval, in terms of accelerations, each
    joint's over its bounds, and a weight that leaves next to none of either where there
    are such accelerations.

    Args:
        vdot, tau, inertia, v, controlled, limits, T, period: as in `limit_torque`.
        lowest, highest: (n,) bounds of the controlled joints' accelerations, infinite
            where there is none [rad/s^2].

    Returns:
        (nv,) accelerations; of the other joints the nominal ones.
    """
    c, n = period / T, len(controlled)
    nominal, M = vdot[controlled], np.ascontiguousarray(inertia[:, controlled])
    tau_brake = tau - times(M, v[controlled] / T + nominal)
    tau_still = tau - times(M, nominal)
    size = np.sqrt(sum_rows(M * M))
    some = np.flatnonzero(np.isfinite(limits) & (size > 0.0))
    L, size, brake = limits[some], size[some], tau_brake[some]
    room = _reserve(brake, brake - c * (brake - tau_still[some]), L)
    # Where both cannot be had, the limits count.
    inside = L * (1.0 - _INSIDE)
    low = np.minimum(np.maximum(tau_still[some] + (brake - room) / c, -inside), inside)
    high = np.minimum(np.maximum(tau_still[some] + (brake + room) / c, -inside), inside)
    below, above = np.isfinite(lowest), np.isfinite(highest)
    spare = _INSIDE * np.minimum(highest - lowest, 1.0)
    lowest, highest = lowest + spare, highest - spare
    rows = M[some] / size[:, np.newaxis]
    there = times(rows, nominal)
    unit = identity(n)
    x, _, _ = one_sided_minimum(
        unit,
        nominal,
        _WEIGHT * np.concatenate((rows, -rows, unit[below], -unit[above])),
        _WEIGHT
        * np.concatenate(
            (
                there + (low - tau[some]) / size,
                (tau[some] - high) / size - there,
                lowest[below],
                -highest[above],
            )
        ),
        nominal,
    )
    nearest = vdot.copy()
    put_at(nearest, controlled, x)
    return nearest


@compiled
def limit_torque(
    vdot: np.ndarray,
    tau: np.ndarray,
    inertia: np.ndarray,
    v: np.ndarray,
    controlled: np.ndarray,
    limits: np.ndarray,
    T: float,
    period: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Accelerations and torque within the effort limits.

    The torque is affine in the accelerations, Eq. (2): the torques of braking and of
    no acceleration follow from that of the nominal ones by the inertia.

    Args:
        vdot: (nv,) nominal accelerations [rad/s^2].
        tau: (nu,) its torque [Nm].
        inertia: (nu, nv) change of the torque with the accelerations [kg m^2].
        v: (nv,) velocities [rad/s].
        controlled: (n,) the joints that brake; the others keep their acceleration.
        limits: (nu,) effort limits, infinite where there is none [Nm].
        T: braking horizon [s].
        period: of the controller [s].

    Returns:
        (nv,) accelerations; (nu,) torque, clipped; (2,) theta and excess.
    """
    still, brake = vdot.copy(), vdot.copy()
    still[controlled] = 0.0
    put_at(brake, controlled, -v[controlled] / T)
    tau_brake = tau + times(inertia, brake - vdot)
    tau_still = tau + times(inertia, still - vdot)
    theta, excess = torque_scale(tau, tau_brake, tau_still, limits, period / T)
    if theta < 1.0:
        vdot = brake + theta * (vdot - brake)
        tau = tau_brake + theta * (tau - tau_brake)
    tau = np.minimum(np.maximum(tau, -limits), limits)
    return vdot, tau, np.array([theta, excess])


class Holding(NamedTuple):
    """What holding accelerations for a period depends on, see `held_step`."""

    controlled: np.ndarray  # (n,) the joints that brake where limits are passed
    T: float  # braking horizon [s]
    period: float  # of the controller [s]
    plant_step: float  # see `prediction.next_state` [s]
    positions: np.ndarray  # (nq,) see `prediction.state_ahead`
    order: np.ndarray  # (nv,)


@compiled
def held_step(
    q: np.ndarray,
    v: np.ndarray,
    vdot: np.ndarray,
    tau: np.ndarray,
    inertia: np.ndarray,
    limits: np.ndarray,
    time: float,
    holding: Held,
) -> np.ndarray:
    """`limit_torque`, and where that leads by `state_ahead`: one vector comes back, as
    by `equations.handover`.

    Args:
        q, v: (nq,), (nv,) state of the plant.
        vdot, tau, inertia, limits: as in `limit_torque`; without an inertia (0, 0)
            accelerations and torque stay.
        time: for which the accelerations are held [s].
        holding: holds `Holding`.

    Returns:
        One after the other: (nv,) accelerations, (nu,) torque, (2,) theta and excess,
        (nq + nv,) the state that they lead to.
    """
    h = holding.value
    share = np.array([1.0, 0.0])
    if len(inertia):
        vdot, tau, share = limit_torque(
            vdot, tau, inertia, v, h.controlled, limits, h.T, h.period
        )
    after = state_ahead(q, v, vdot, time, h.plant_step, h.positions, h.order)
    return np.concatenate((vdot, tau, share, after))


@compiled
def clip_torque(tau: np.ndarray, limits: np.ndarray) -> tuple[np.ndarray, float]:
    """A torque within the effort limits, where the acceleration is not to change.

    Args:
        tau: (nu,) torque [Nm or N].
        limits: (nu,) effort limits, infinite where there is none.

    Returns:
        (nu,) the torque, clipped; and by which share of its limit the worst actuator
        was beyond it [1], 0 if none was.
    """
    excess = largest(tau / limits) - 1.0
    if excess <= 1e-12:  # a rounding error of the limit is no excess
        excess = 0.0
    return np.minimum(np.maximum(tau, -limits), limits), excess
