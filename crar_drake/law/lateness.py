"""How late a measured state is, seen by what was commanded and what came of it.

A loop with a preview is stiff: a state that is 10 ms late makes it shake, unless the
law knows of it and answers the state that will be there (`Shared.latency`). The
law can see it. With a lag of n periods the measured velocities change as was commanded
that long ago,

    v_k - v_(k-1) = period * q_ddot_(k-1-n),

and what is missing of that, squared and averaged, is the least for the true n. Pushes,
wrong masses and noise are missing with any n alike, so only a lag that explains clearly
more than the present one takes its place. It must explain most of what changed, too:
of a robot that is stuck while commands grow, older ones are less wrong, but none
explains anything.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

# Lags are looked for up to this much beyond what the law is told [s].
LATEST = 0.015
# What was missing counts for so long [s], and for so many periods before it is
# believed.
_WINDOW, _FIRST = 0.2, 8
# Another lag must leave at most this share of what the present one does [1], and what
# is missing with that must be more than this [rad/s or m/s].
_CLEARLY, _NOTICED = 0.25, 0.01


class Lateness(NamedTuple):
    """What is known of the lag after a control step."""

    v: np.ndarray  # (nv,) as measured there [rad/s]
    # (K + 1,) mean square of what was missing, for each lag; last of all that changed,
    # as if nothing had been commanded [(rad/s)^2]
    missed: np.ndarray
    steps: int = 0  # how many were averaged
    periods: int = 0  # n, the lag that is believed, beyond what the law is told


def watch_lateness(
    before: Lateness | None,
    v: np.ndarray,
    sent: Sequence[np.ndarray],
    told: float,
    period: float,
) -> Lateness:
    """What a new measurement says of the lag.

    Args:
        before: of the step before; None at a start.
        v: (nv,) measured now [rad/s].
        sent: accelerations (nv,) that were commanded, the newest first; where the robot
            has just started, none are known.
        told: lag that is known, in periods [1].
        period: of the controller [s].
    """
    lags = round(LATEST / period) + 1
    if before is None:
        return Lateness(v, np.zeros(lags + 1))
    first = int(told)
    if len(sent) < first + lags + 1:
        return before._replace(v=v)
    commanded = np.array(sent[first : first + lags + 1])
    part = told - first
    expected = period * ((1.0 - part) * commanded[:-1] + part * commanded[1:])
    expected = np.vstack((expected, np.zeros(len(v))))
    missing = np.sum((v - before.v - expected) ** 2, axis=1)
    steps = before.steps + 1
    share = max(period / _WINDOW, 1.0 / steps)
    missed = before.missed + share * (missing - before.missed)
    now, best = before.periods, int(np.argmin(missed))
    noticed = missed[now] > _NOTICED**2
    rival = min(missed[now], missed[-1])
    if steps >= _FIRST and noticed and missed[best] < _CLEARLY * rival:
        now = best
    return Lateness(v, missed, steps, now)
