"""Controlled joints come to rest within their limits, and keep their speed limits.

Lemma: braking keeps both. The braking path ends at q_s, where it ends a period on, too,
and speeds fall to (1 - period / T) of what they are. So s = 0 is within the bounds (A2)
of s by which q'_s is within the limits and q_dot' within the speeds. A limit that the
braking path passes already counts as where it ends, a speed that is exceeded as what
braking leaves of it: nothing gets worse.

A joint that rests beyond a limit is to come back: the rows ask for
g s >= min(gamma (limit - q_s), speed).
"""

import numpy as np

from crar_drake.equations.admission import velocity_bounds
from crar_drake.equations.compilation import compiled
from crar_drake.law.projection import Rows, hard_rows
from crar_drake.law.step import SafetyCheck, State

# Of a bound of s, what rounding may pass [1]; a joint is beyond its limit by more than
# this [rad or m].
_ROUNDING, _AT_LIMIT = 1e-12, 1e-9


class Limits:
    """The constraint of joint limits and speeds; it sets the bounds of a step.

    Attributes:
        lower, upper: (n,) joint limits, infinite where there is none [rad or m].
        fastest: (n,) speed limits, infinite where there is none [rad/s or m/s].
    """

    name = "joint limit"

    def __init__(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        fastest: np.ndarray,
        retreat_rate: float,
        retreat_speed: float,
    ) -> None:
        """
        Args:
            lower, upper, fastest: as of the attributes.
            retreat_rate: gamma, how fast a joint comes back from beyond a limit [1/s],
                but at most at
            retreat_speed: [rad/s or m/s].
        """
        self.lower, self.upper, self.fastest = lower, upper, fastest
        self._retreat = retreat_rate, retreat_speed
        unit = np.eye(len(lower))
        self._g = np.concatenate((unit, -unit))

    def begin(self, state: State) -> None:
        n = state.n
        state.lowest, state.highest, beyond = limit_bounds(
            *(state.q[:n], state.v[:n], self.lower, self.upper, self.fastest),
            *(state.T, state.period, state.plant_step),
        )
        state.recovering |= beyond

    def rows(self, state: State) -> Rows:
        n = state.n
        end = state.q[:n] + state.T * state.v[:n]
        least = np.concatenate((state.lowest, -state.highest))
        beyond = np.concatenate((self.lower - end, end - self.upper))
        some = np.flatnonzero(beyond > 0.0)
        if len(some):
            rate, speed = self._retreat
            back = np.minimum(rate * beyond[some], speed)
            least[some] = np.maximum(least[some], back)
        return hard_rows(self._g, least)

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        beyond, joint = farthest_beyond(s, state.lowest, state.highest)
        if beyond <= 0.0:
            return SafetyCheck(True, np.inf)
        reason = self._reason(state, s, joint)
        return SafetyCheck(False, np.nan, index=joint, reason=reason)

    def _reason(self, state: State, s: np.ndarray, j: int) -> str:
        """Whether the limit or the speed of a joint is what binds."""
        after = state.v[j] + state.period / state.T * (s[j] - state.v[j])
        braked = abs(state.v[j]) * (1.0 - state.period / state.T)
        if abs(after) > max(self.fastest[j], braked):
            return "joint speed"
        return "joint limit"


@compiled
def limit_bounds(
    q: np.ndarray,
    v: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    fastest: np.ndarray,
    T: float,
    period: float,
    plant_step: float,
) -> tuple[np.ndarray, np.ndarray, bool]:
    """(n,), (n,) `velocity_bounds`, (A2); and whether a joint is beyond a limit."""
    low, high = velocity_bounds(q, v, lower, upper, fastest, T, period, plant_step)
    beyond = False
    for i in range(len(q)):
        beyond |= max(lower[i] - q[i], q[i] - upper[i]) > _AT_LIMIT
    return low, high, beyond


@compiled
def farthest_beyond(
    s: np.ndarray, lowest: np.ndarray, highest: np.ndarray
) -> tuple[float, int]:
    """By how much the worst of the first n entries of s (nv,) is beyond its bounds
    (n,), but for rounding; and which it is."""
    worst, joint = -np.inf, -1
    for i in range(len(lowest)):
        off = _ROUNDING * (1.0 + abs(s[i]))
        beyond = max(lowest[i] - s[i], s[i] - highest[i]) - off
        # A number that is none (NaN) is beyond.
        if not beyond <= worst:
            worst, joint = beyond, i
    return worst, joint
