"""A torque limit without a QP: scale the velocity of the resting point.

The paper names torque limits as its next extension. In the words of
`equations.lookahead`, choosing an acceleration is choosing s, the velocity of the point
where the robot would come to rest. With

    alpha(theta) = (theta s - q_dot) / T,    0 <= theta <= 1,

the torque is affine in theta: tau(theta) = tau_b + theta (tau - tau_b), between that of
braking, tau_b, and that of the wish, tau. The largest theta whose torque respects the
limits is taken. A constraint with g·s >= 0 keeps g·(theta s) >= 0.

So that braking stays possible, theta is also bounded by the braking torque of the next
step, which is affine in theta, too: the velocity grows by dt alpha(theta), and

    tau_b+ = tau_b - (dt / T) (tau(theta) - tau_0),

with tau_0 the torque of no acceleration. A robot whose braking torque comes near its
limit (80 % of it: gravity and Coriolis forces change on the way) gets no faster.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Share of a limit that braking in the next step may need [1].
_RESERVE = 0.8


@dataclass(frozen=True)
class TorqueScale:
    """The largest share of the wish that the limits allow.

    Attributes:
        theta: in [0, 1].
        excess: by which share of its limit the torque of the worst actuator is
            still beyond it [1]; 0 if the limits can be respected.
    """

    theta: float
    excess: float


def torque_scale(
    tau: np.ndarray,
    tau_brake: np.ndarray,
    tau_still: np.ndarray,
    limits: np.ndarray,
    *,
    period_over_horizon: float,
) -> TorqueScale:
    """The largest theta within the limits, and with braking possible afterwards.

    Where both cannot be had, the limits count; where not even these can, theta
    minimises the largest excess, and the torque is to be clipped.

    Args:
        tau: (nu,) torque of the wish [Nm or N].
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
    # What is beyond already must come back, as fast as braking alone would bring it.
    usual = _RESERVE * L
    reserve = usual + (1.0 - c) * np.maximum(0.0, np.abs(tau_b) - usual)
    next_low, next_high = _interval(
        tau_b - c * (tau_b - tau_still[limited]), -c * slope, reserve
    )
    both = min(high, next_high)
    if max(low, next_low) > both:
        # Which of the allowed shares brakes hardest: the smallest one.
        both = low
    return TorqueScale(float(both), 0.0)


def _interval(
    start: np.ndarray, slope: np.ndarray, bound: np.ndarray
) -> tuple[float, float]:
    """All theta in [0, 1] with |start + theta slope| <= bound; low > high if none.

    A rounding error of the bound is no violation, since the torque is clipped.
    """
    room = bound * (1.0 + 1e-12)
    still = np.abs(slope) < 1e-12 * (1.0 + bound)
    if (still & (np.abs(start) > room)).any():
        return 1.0, 0.0
    slope = np.where(still, 1.0, slope)
    ends = np.stack([(-room - start) / slope, (room - start) / slope])
    low = np.where(still, 0.0, ends.min(axis=0))
    high = np.where(still, 1.0, ends.max(axis=0))
    return max(0.0, low.max(initial=0.0)), min(1.0, high.min(initial=1.0))


def _least_excess(
    start: np.ndarray, slope: np.ndarray, bound: np.ndarray
) -> TorqueScale:
    """The theta in [0, 1] that minimises the largest |start + theta slope| / bound.

    The maximum of lines is convex, so that its minimum is at an end or where two of
    them cross.
    """
    a = np.concatenate([start, -start]) / np.concatenate([bound, bound])
    b = np.concatenate([slope, -slope]) / np.concatenate([bound, bound])
    rise = b[:, None] - b[None]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = ((a[None] - a[:, None]) / rise).ravel()
    inside = crossings[(crossings > 0.0) & (crossings < 1.0)]
    thetas = np.concatenate([[0.0, 1.0], inside])
    worst = np.max(a[:, None] + b[:, None] * thetas, axis=0)
    best = int(np.argmin(worst))
    return TorqueScale(float(thetas[best]), float(max(0.0, worst[best] - 1.0)))
