"""The state that a step answers: of what was measured, what a robot can have, now.

*Finite*, or an error names what is not.

*Plausible.* A sensor's glitch, another unit, or an index that is off by one give states
that no robot has. A law that believes them asks for torques that no motor has, either.

*Late.* A loop with a preview is stiff: a state that is 10 ms late makes it shake,
unless the law knows of it (`Shared.latency`) and answers the state that will be there.
The law can see it. With a lag of n periods the measured velocities change as was
commanded that long ago,

    v_k - v_(k-1) = period * q_ddot_(k-1-n),

and what is missing of that, squared and averaged, is the least for the true n. Pushes,
wrong masses and noise are missing with any n alike, so only a lag that explains clearly
more than the present one takes its place. It must explain most of what changed, too:
of a robot that is stuck while commands grow, older ones are less wrong, but none
explains anything.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crar_drake.errors import InputError
from crar_drake.law.compilation import compiled
from crar_drake.law.prediction import state_ahead
from crar_drake.robot.joints import joint_units
from crar_drake.robot.model import ControlModel

# A joint that turns sixteen times a second, or slides at 30 m/s, is none of a robot's;
# nor is one at three times the speed limit that is stated for it.
_FASTEST = {"rad": 100.0, "m": 30.0}  # [rad/s], [m/s]
_OVER_LIMIT = 3.0
# From rest to rest within a period this is more than any joint moves.
_JUMP = {"rad": 0.25, "m": 0.1}  # [rad], [m]
# The lookahead asks for at most this share of a speed that is believed: else it would
# take for a glitch what it did itself.
_ASKED = 0.99

# Lags are looked for up to this much beyond what the law is told [s].
LATEST = 0.015
# What was missing counts for so long [s], and for so many periods before it is
# believed.
_WINDOW, _FIRST = 0.2, 8
# Another lag must leave at most this share of what the present one does [1], and what
# is missing with that must be more than this [rad/s or m/s].
_CLEARLY, _NOTICED = 0.25, 0.01
_ROUNDING = 1e-9  # of a period: so little more is none


@compiled
def is_finite(x: np.ndarray) -> bool:
    """Whether no entry of x (n,) is NaN or infinite, without asking each.

    A sum of squares is finite unless an entry is not, or is beyond all sense.
    """
    s = 0.0
    for i in range(len(x)):
        s += x[i] * x[i]
    return math.isfinite(s)


def check_finite(name: str, value: np.ndarray, time: float) -> None:
    """Raises InputError, with the port or argument and the time, on NaN or inf."""
    if not np.isfinite(value).all():
        bad = np.flatnonzero(~np.isfinite(value))
        raise InputError(
            f"{name} has a NaN or infinite value at t = {time:g} s "
            f"(entries {', '.join(map(str, bad[:8]))}"
            f"{', ...' if len(bad) > 8 else ''}); check what is connected to it"
        )


def fastest_believed(model: ControlModel) -> np.ndarray:
    """(n,) speeds of the controlled joints beyond which a state is not believed
    [rad/s or m/s]."""
    units = joint_units(model.plant, model.joint_names)
    limits = model.velocity_limits[model.controlled]
    limits = np.where(np.isfinite(limits), _OVER_LIMIT * limits, 0.0)
    return np.maximum([_FASTEST[unit] for unit in units], limits)


def fastest_asked(model: ControlModel) -> np.ndarray:
    """(n,) speeds of the controlled joints that a law may ask for [rad/s or m/s]."""
    return _ASKED * fastest_believed(model)


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
    missing = missing_squares(v - before.v, commanded, told - first, period)
    steps = before.steps + 1
    share = max(period / _WINDOW, 1.0 / steps)
    missed = before.missed + share * (missing - before.missed)
    now, best = before.periods, int(np.argmin(missed))
    noticed = missed[now] > _NOTICED**2
    rival = min(missed[now], missed[-1])
    if steps >= _FIRST and noticed and missed[best] < _CLEARLY * rival:
        now = best
    return Lateness(v, missed, steps, now)


@compiled
def missing_squares(
    change: np.ndarray, commanded: np.ndarray, part: float, period: float
) -> np.ndarray:
    """(K + 1,) squares of what is missing of a change of velocity, for each lag, and if
    nothing had been commanded [(rad/s)^2].

    Args:
        change: (nv,) in a period [rad/s].
        commanded: (K + 1, nv) accelerations, the newest first [rad/s^2].
        part: of a period that each lag is longer [1].
        period: [s].
    """
    missing = np.zeros(len(commanded))
    for j in range(len(change)):
        for lag in range(len(missing)):
            left = change[j]
            if lag + 1 < len(missing):
                here, next_ = commanded[lag, j], commanded[lag + 1, j]
                left -= period * ((1.0 - part) * here + part * next_)
            missing[lag] += left * left
    return missing


@compiled
def is_way(
    q0: np.ndarray,
    v0: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    period: float,
    positions: np.ndarray,
    velocities: np.ndarray,
    turns: np.ndarray,
    jump: np.ndarray,
) -> bool:
    """`MeasuredStates.way`, of n joints: by which entries they are, (n,) (n,), whether
    they are only known within one turn (n,), and how far they may be off (n,)."""
    for i in range(len(positions)):
        moved = abs(q[positions[i]] - q0[positions[i]])
        if turns[i]:
            moved %= 2.0 * np.pi
            moved = min(moved, 2.0 * np.pi - moved)
        fastest = max(abs(v[velocities[i]]), abs(v0[velocities[i]]))
        if not moved <= period * fastest + jump[i]:
            return False
    return True


class MeasuredStates:
    """What is believed of the measured states of a robot.

    Attributes:
        num_sent: how many commands are to be remembered: those whose effect a late
            state does not show yet, and by which an unknown lag is seen.
        told: the lag that is known, in periods [1].
    """

    def __init__(
        self, model: ControlModel, period: float, latency: float, watches: bool
    ) -> None:
        """
        Args:
            model: whose joints.
            period: of the controller [s].
            latency: that is known [s].
            watches: whether another lag is looked for.
        """
        self._model, self._period, self._latency = model, period, latency
        self._plant_step = float(model.plant.time_step())
        self.told = latency / period
        late = self.told * (1.0 - _ROUNDING)
        self.num_sent = math.ceil(late) + 1 if late else 0
        if watches:
            self.num_sent = math.ceil(late) + round(LATEST / period) + 2
        self._q, self._v = model.controlled_positions, model.controlled
        units = joint_units(model.plant, model.joint_names)
        self._fastest = fastest_believed(model)
        self._jump = np.array([_JUMP[unit] for unit in units])
        # An angle without limits may be given within one turn.
        self._turns = ~np.isfinite(model.upper - model.lower)

    def believed(self, v: np.ndarray, before: np.ndarray | None) -> np.ndarray:
        """Velocities, those of joints that are too fast replaced by the ones before.

        Args:
            v: (nv,) measured.
            before: (nv,) believed a period or less ago; None for zeros.

        Returns:
            (nv,) `v` itself where no joint is too fast.
        """
        fast = self._v[np.abs(v[self._v]) > self._fastest]
        if not len(fast):
            return v
        v = v.copy()
        v[fast] = 0.0 if before is None else before[fast]
        return v

    def way(self, q0: np.ndarray, v0: np.ndarray, q: np.ndarray, v: np.ndarray) -> bool:
        """Whether joints may have come from one state to another in a period.

        Args:
            q0, v0: (nq,), (nv,) measured a control period ago, plausible speeds.
            q, v: (nq,), (nv,) measured now, plausible speeds.
        """
        of = self._q, self._v, self._turns, self._jump
        return is_way(q0, v0, q, v, self._period, *of)

    def now(
        self,
        sent: Sequence[np.ndarray],
        lateness: Lateness | None,
        held: float,
        q: np.ndarray,
        v: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state now, if q (nq,), v (nv,) was that a latency ago and the robot did
        as told: by the accelerations `sent`, the newest of them first, and `held` for
        so long [s]."""
        model, left, since = self._model, self._latency, []
        if lateness is not None:
            left += lateness.periods * self._period
        for vdot in sent:
            if left <= _ROUNDING * self._period:
                break
            time = min(held, left)
            since.append((vdot, time))
            left, held = left - time, self._period
        for vdot, time in reversed(since):
            x = state_ahead(
                q, v, vdot, time, self._plant_step, model.positions, model.order
            )
            q, v = x[: len(q)], x[len(q) :]
        return q, v
