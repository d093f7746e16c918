"""Controlled joints come to rest within their limits, and keep their speed limits.

Lemma: braking keeps both. The braking path ends at q_s, where it ends a period on, too,
and speeds fall to (1 - period / T) of what they are. So s = 0 is within the bounds (A2)
of s by which q'_s is within the limits and q_dot' within the speeds. A limit that the
braking path passes already counts as where it ends, a speed that is exceeded as what
braking leaves of it: nothing gets worse.

Rows: the bounds; and within a margin of a limit how fast a joint that would rest there
comes back, outside of it how fast it may come near, (L7), if there is such a rate.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.approach import SHARE_OF_RANGE, Approach, least_rate
from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.projection import Rows, hard_rows
from crar_drake.law.step import SafetyCheck, State

# Of a bound of s, what rounding may pass [1]; a joint is beyond its limit by more than
# this [rad or m].
_ROUNDING, _AT_LIMIT = 1e-12, 1e-9
_SAFE = SafetyCheck(True, np.inf)


class JointLimits(NamedTuple):
    """Limits of n joints, infinite where there is none, and the times of a step."""

    lower: np.ndarray  # (n,) [rad or m]
    upper: np.ndarray
    fastest: np.ndarray  # (n,) speeds [rad/s or m/s]
    period: float  # of the controller [s]
    step: float  # of the plant [s], at most the period


class Limits:
    """The constraint of joint limits and speeds; it sets the bounds of a step.

    Attributes:
        lower, upper: (n,) of `JointLimits`.
        kept: (n,), (n,) from where on joints are beyond their limits [rad or m].
    """

    name = "joint limit"

    def __init__(self, limits: JointLimits, approach: Approach) -> None:
        """Of the controlled joints, with the numbers of the rows."""
        self.lower, self.upper = limits.lower, limits.upper
        self.kept = self.lower - _AT_LIMIT, self.upper + _AT_LIMIT
        self._limits, self._approach = hold(limits), hold(approach)
        unit = np.eye(len(self.lower))
        self._g = np.concatenate((unit, -unit))

    def is_safe(
        self, q: np.ndarray, v: np.ndarray, T: float, known: float = 0.0
    ) -> bool:
        """Whether joints come to rest within their limits, braking over T [s]; one that
        is beyond a limit, or comes to rest there over a T that is known, no farther."""
        n = len(self.lower)
        here, end = q[:n], q[:n] + T * v[:n]
        rest = here + known * v[:n]
        lower = np.minimum(self.lower, np.minimum(here, rest))
        upper = np.maximum(self.upper, np.maximum(here, rest))
        return is_within(end, lower - _AT_LIMIT, upper + _AT_LIMIT)

    def begin(self, state: State) -> None:
        at = state.q, state.v, state.T
        state.lowest, state.highest = velocity_bounds(*at, self._limits)
        state.keep_rows |= not is_within(state.q, *self.kept)

    def rows(self, state: State) -> Rows:
        bounds = state.lowest, state.highest, self._limits, self._approach
        least = limit_rows(state.q, state.v, state.T, *bounds)
        return hard_rows(self._g, least)

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        if is_within(s, state.lowest, state.highest):
            return _SAFE
        at = state.q, state.v, s, state.T
        joint, of_speed = farthest_beyond(*at, self._limits)
        reason = "joint speed" if of_speed else self.name
        return SafetyCheck(False, np.nan, index=joint, reason=reason)


@compiled
def limit_rows(
    q: np.ndarray,
    v: np.ndarray,
    T: float,
    lowest: np.ndarray,
    highest: np.ndarray,
    limits: Held,
    approach: Held,
) -> np.ndarray:
    """(2n,) the least of s and of -s: the bounds (n,) each, and `least_rate` of how far
    a joint would rest from its limits; `approach` holds an `Approach`."""
    a, n = approach.value, len(lowest)
    lower, upper, end = limits.value.lower, limits.value.upper, q[:n] + T * v[:n]
    margin = np.minimum(a.limit_margin, SHARE_OF_RANGE * (upper - lower))
    rate = least_rate(
        *(np.concatenate((end - lower, upper - end)), np.concatenate((margin, margin))),
        *(a.retreat_rate, a.joint_retreat_speed, a.limit_approach_rate),
    )
    # At its margin an infinite rate gives no number, and asks for nothing.
    return np.fmax(np.concatenate((lowest, -highest)), rate)


@compiled
def is_within(s: np.ndarray, lowest: np.ndarray, highest: np.ndarray) -> bool:
    """Whether the first n entries of s (nv,), or of positions, are within bounds (n,),
    but for rounding; a number that is none (NaN) is not."""
    for i in range(len(lowest)):
        off = _ROUNDING * (1.0 + abs(s[i]))
        if not (lowest[i] - off <= s[i] <= highest[i] + off):
            return False
    return True


@compiled
def kept_limits(
    q: np.ndarray, v: np.ndarray, T: float, limits: JointLimits
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a step from a state (n,), (n,) keeps: limits (n,), (n,) and speeds (n,).

    Limits that the braking path passes already count as where it ends, speeds that
    are exceeded as what braking leaves of them.
    """
    ends, slower = q + T * v, np.abs(v) * (1.0 - limits.period / T)
    lower = np.minimum(limits.lower, np.minimum(q, ends))
    upper = np.maximum(limits.upper, np.maximum(q, ends))
    return lower, upper, np.maximum(limits.fastest, slower)


@compiled
def farthest_beyond(
    q: np.ndarray, v: np.ndarray, s: np.ndarray, T: float, limits: Held
) -> tuple[int, bool]:
    """The joint that a step s (nv,) takes farthest beyond, measured by what it moves in
    T, and whether that is beyond its speed; arguments as of `velocity_bounds`."""
    n, period = len(limits.value.lower), limits.value.period
    q, v, s = q[:n], v[:n], s[:n]
    lower, upper, fastest = kept_limits(q, v, T, limits.value)
    after = v + period / T * (s - v)
    rest = q + (period + T) * after
    far, fast = np.maximum(lower - rest, rest - upper), T * (np.abs(after) - fastest)
    joint = np.argmax(np.maximum(far, fast))
    return joint, fast[joint] > far[joint]


@compiled
def velocity_bounds(
    q: np.ndarray, v: np.ndarray, T: float, limits: Held
) -> tuple[np.ndarray, np.ndarray]:
    """(A2): the s that keep q'_s within the joint limits and q_dot' within the speeds
    of `kept_limits`: s = 0 is always among these.

    Args:
        q, v: (nv,), (nv,) state, n controlled joints first.
        T: braking time constant [s].
        limits: holds `JointLimits` of these.

    Returns:
        (n,), (n,) smallest and largest s, of either sign [rad/s].
    """
    n, period = len(limits.value.lower), limits.value.period
    q, v = q[:n], v[:n]
    lower, upper, fastest = kept_limits(q, v, T, limits.value)
    e, per_speed = 0.5 * period * (period + limits.value.step) / T, T / period
    base = q + (T - e) * v
    low = np.maximum((lower - base) / (period + e), v - per_speed * (fastest + v))
    high = np.minimum((upper - base) / (period + e), v + per_speed * (fastest - v))
    return np.minimum(low, 0.0), np.maximum(high, 0.0)
