"""Controlled joints come to rest within their limits, and keep their speed limits.

Lemma: braking keeps both. The braking path ends at q_s, where it ends a period on, too,
and speeds fall to (1 - period / T) of what they are. So s = 0 is within the bounds (A2)
of s by which q'_s is within the limits and q_dot' within the speeds. A limit that the
braking path passes already counts as where it ends, a speed that is exceeded as what
braking leaves of it: nothing gets worse.

Rows: the bounds; and within a margin of a limit how fast a joint that would rest there
comes back, outside of it how fast it may come near, (L7), if there is such a rate.
"""

import numpy as np

from crar_drake.law.approach import SHARE_OF_RANGE, Approach, least_rate
from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.projection import Rows, hard_rows
from crar_drake.law.step import SafetyCheck, State

# Of a bound of s, what rounding may pass [1]; a joint is beyond its limit by more than
# this [rad or m].
_ROUNDING, _AT_LIMIT = 1e-12, 1e-9
_SAFE = SafetyCheck(True, np.inf)


class Limits:
    """The constraint of joint limits and speeds; it sets the bounds of a step.

    Attributes:
        lower, upper: (n,) joint limits, infinite where there is none [rad or m].
        fastest: (n,) speed limits, infinite where there is none [rad/s or m/s].
        kept: (n,), (n,) from where on joints are beyond their limits [rad or m].
    """

    name = "joint limit"

    def __init__(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        fastest: np.ndarray,
        approach: Approach,
    ) -> None:
        """With the numbers of the rows, and the others as of the attributes."""
        self.lower, self.upper, self.fastest = lower, upper, fastest
        self.kept = lower - _AT_LIMIT, upper + _AT_LIMIT
        self._approach = hold(approach)
        unit = np.eye(len(lower))
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
        n = state.n
        state.lowest, state.highest = velocity_bounds(
            *(state.q[:n], state.v[:n], self.lower, self.upper, self.fastest),
            *(state.T, state.period, state.plant_step),
        )
        state.keep_rows |= not is_within(state.q, *self.kept)

    def rows(self, state: State) -> Rows:
        n = state.n
        least = limit_rows(
            *(state.q[:n], state.v[:n], self.lower, self.upper),
            *(state.lowest, state.highest, state.T, self._approach),
        )
        return hard_rows(self._g, least)

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        if is_within(s, state.lowest, state.highest):
            return _SAFE
        n = state.n
        joint, of_speed = farthest_beyond(
            *(state.q[:n], state.v[:n], s, self.lower, self.upper, self.fastest),
            *(state.T, state.period),
        )
        reason = "joint speed" if of_speed else self.name
        return SafetyCheck(False, np.nan, index=joint, reason=reason)


@compiled
def limit_rows(
    q: np.ndarray,
    v: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    lowest: np.ndarray,
    highest: np.ndarray,
    T: float,
    approach: Held,
) -> np.ndarray:
    """(2n,) the least of s and of -s: the bounds (n,) each, and `least_rate` of how far
    a joint would rest from its limits; `approach` holds an `Approach`."""
    a, end = approach.value, q + T * v
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
def farthest_beyond(
    q: np.ndarray,
    v: np.ndarray,
    s: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    fastest: np.ndarray,
    T: float,
    period: float,
) -> tuple[int, bool]:
    """The joint that a step s (nv,) takes farthest beyond, measured by what it moves in
    T, and whether that is beyond its speed; of n joints, as of `velocity_bounds`."""
    end, after = q + T * v, v + period / T * (s[: len(q)] - v)
    rest = q + (period + T) * after
    low = np.minimum(lower, np.minimum(q, end))
    high = np.maximum(upper, np.maximum(q, end))
    far = np.maximum(low - rest, rest - high)
    allowed = np.maximum(fastest, np.abs(v) * (1.0 - period / T))
    fast = T * (np.abs(after) - allowed)
    joint = np.argmax(np.maximum(far, fast))
    return joint, fast[joint] > far[joint]


@compiled
def velocity_bounds(
    q: np.ndarray,
    v: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    fastest: np.ndarray,
    T: float,
    period: float,
    step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(A2): the s that keep q'_s within the joint limits and q_dot' within the speeds.

    Limits that the braking path passes already count as where it ends, speeds that
    are exceeded as what braking leaves of them: s = 0 is always among these.

    Args:
        q, v: (n,) state of the controlled joints.
        lower, upper: (n,) limits [rad], infinite where there is none.
        fastest: (n,) speed limits [rad/s], infinite where there is none.
        T, period, step: see `path_bounds.next_path`.

    Returns:
        (n,), (n,) smallest and largest s, of either sign [rad/s].
    """
    e = 0.5 * period * (period + step) / T
    ends = q + T * v
    lower = np.minimum(lower, np.minimum(q, ends))
    upper = np.maximum(upper, np.maximum(q, ends))
    base = q + (T - e) * v
    fastest = np.maximum(fastest, np.abs(v) * (1.0 - period / T))
    per_speed = T / period
    low = np.maximum((lower - base) / (period + e), v - per_speed * (fastest + v))
    high = np.minimum((upper - base) / (period + e), v + per_speed * (fastest - v))
    return np.minimum(low, 0.0), np.maximum(high, 0.0)
