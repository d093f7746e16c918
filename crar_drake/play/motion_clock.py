"""When a motion that is stopped, goes on and turns round is where.

Its time, the *phase* s, is a smooth function of the simulated one, so that targets that
were twice differentiable stay so: s = f(u(t)). The way u(t) goes on at rate 1 or rests,
and changes from one to the other along a cubic that keeps its acceleration continuous.
The function f runs to the end of the motion, round and back, without end: prescribed
joints cannot jump to the beginning.
"""

from __future__ import annotations

from dataclasses import dataclass

_RAMP = 1.0  # from rest to motion and back, and round at an end, at most [s]


@dataclass(frozen=True)
class MotionClock:
    """The way u as a function of time, from one change of its rate on.

    With x = (t - start) / ramp in [0, 1] the rate is

        r0 + a0 ramp x (1 - x)^2 + (r1 - r0) x^2 (3 - 2 x),

    and r1 after that: it and its derivative are continuous.
    """

    start: float = 0.0  # when the change begins [s]
    way: float = 0.0  # u then [s]
    rate: float = 1.0  # its derivative [1]
    acceleration: float = 0.0  # and the second [1/s]
    goal: float = 1.0  # the rate after the change
    ramp: float = _RAMP  # how long it takes [s]

    def at(self, time: float) -> tuple[float, float, float]:
        """u [s], its rate and its acceleration [1/s].

        Args:
            time: not before `start` [s].
        """
        T, change = self.ramp, self.goal - self.rate
        x = min(max((time - self.start) / T, 0.0), 1.0)
        after = max(time - self.start - T, 0.0)
        rise = self.acceleration * T
        rate = self.rate + rise * x * (1.0 - x) ** 2 + change * x * x * (3.0 - 2.0 * x)
        slope = rise * (1.0 - x) * (1.0 - 3.0 * x) + change * 6.0 * x * (1.0 - x)
        moved = (
            self.rate * x
            + rise * (0.5 - (2.0 / 3.0 - 0.25 * x) * x) * x * x
            + change * (1.0 - 0.5 * x) * x**3
        )
        return self.way + T * moved + self.goal * after, rate, slope / T

    def toward(self, time: float, goal: float) -> MotionClock:
        """The clock that goes on from here, to another rate.

        Args:
            time: of the change [s].
        """
        return MotionClock(time, *self.at(time), goal)

    def phase(self, time: float, duration: float) -> tuple[float, float, float]:
        """s = f(u) of a motion [s], its rate [1] and its acceleration [1/s].

        Args:
            time: not before `start` [s].
            duration: of the motion [s].
        """
        way, rate, change = self.at(time)
        phase, slope, bend = to_and_fro(way, duration)
        return phase, slope * rate, bend * rate**2 + slope * change


def turning_time(duration: float) -> float:
    """How long a motion of that duration takes to turn round at an end [s]."""
    return min(_RAMP, duration)


def to_and_fro(way: float, duration: float) -> tuple[float, float, float]:
    """f(u) in [0, duration], and its first and second derivative.

    It has slope 1 and -1 in turn, but for W = `turning_time` at each end, where with x
    in [0, 1] the slope goes from 1 to -1 (or back) as 1 - 2 x^2 (3 - 2 x). At u = 0 it
    is in the middle of the turn at the beginning, f = 0.

    Args:
        way: u [s].
        duration: of the motion [s].
    """
    W = turning_time(duration)
    reach = 0.3125 * W  # what a turn leads beyond where it began
    straight = duration - 2.0 * reach
    half = straight + W  # of the period
    turns, u = divmod(way + 0.5 * W, half)
    if u < W:  # turning at the beginning, or on the way back, seen from there, the end
        x = u / W
        f = reach - W * (x - (2.0 - x) * x**3)
        slope, bend = -1.0 + 2.0 * x * x * (3.0 - 2.0 * x), 12.0 * x * (1.0 - x) / W
    else:
        f, slope, bend = reach + u - W, 1.0, 0.0
    return (f, slope, bend) if turns % 2 == 0 else (duration - f, -slope, -bend)
