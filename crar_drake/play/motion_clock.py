"""When a motion that is stopped, goes on and turns round is where: its own clock.

The motion's time, its *phase*, is a smooth function of the simulated one, so that
targets that were twice differentiable stay so: where the rate of the phase changes, it
does so along a cubic that keeps the acceleration of the phase continuous. At its ends
the motion turns round and runs back: prescribed joints have no governor, and a jump to
the beginning would be one of theirs.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

_RAMP = 1.0  # from one rate to another, at most [s]
# Of the way through a ramp, where it is asked how far the phase comes.
_PLACES = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class MotionClock:
    """The phase as a function of time, from one change of its rate on.

    With x = (t - start) / ramp in [0, 1] the rate is

        r0 + a0 ramp x (1 - x)^2 + (r1 - r0) x^2 (3 - 2 x),

    and r1 after that: it and its derivative are continuous.

    Attributes:
        start: when the change begins [s].
        phase, rate, acceleration: of the motion then [s], [1], [1/s].
        goal: the rate after the change.
        ramp: how long it takes [s].
    """

    start: float = 0.0
    phase: float = 0.0
    rate: float = 1.0
    acceleration: float = 0.0
    goal: float = 1.0
    ramp: float = _RAMP

    def at(self, time: float) -> tuple[float, float, float]:
        """Phase [s], its rate and its acceleration [1/s].

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
        return self.phase + T * moved + self.goal * after, rate, slope / T

    def toward(self, time: float, goal: float, ramp: float = _RAMP) -> MotionClock:
        """The clock that goes on from here, to another rate.

        Args:
            time: of the change [s].
            goal: the rate to go to.
            ramp: how long that takes [s].
        """
        return MotionClock(time, *self.at(time), goal, ramp)

    def to_vector(self) -> np.ndarray:
        """(6,) its attributes."""
        return np.array(astuple(self))

    @staticmethod
    def from_vector(values: np.ndarray) -> MotionClock:
        """The clock of `to_vector`."""
        return MotionClock(*map(float, values))


class MotionSwitch:
    """Turns a motion on and off, and round at its ends.

    Attributes:
        clock: of the motion.
        on: whether it runs, or is about to.
    """

    def __init__(self, duration: float, *, on: bool = True) -> None:
        """
        Args:
            duration: of the motion [s].
            on: whether it runs from the beginning.
        """
        self._duration = duration
        self._ramp = min(_RAMP, 0.5 * duration)
        self._forward = 1.0
        self.on = on
        self.clock = MotionClock(rate=float(on), goal=float(on), ramp=self._ramp)

    def set(self, on: bool, time: float) -> None:
        """Lets the motion go on from where it is, or come to rest there.

        Args:
            on: which.
            time: when [s].
        """
        if on == self.on:
            return
        self.on = on
        self.clock = self.clock.toward(time, self._forward * on, self._ramp)

    def turn(self, time: float, period: float) -> None:
        """Turns the motion round if it would else leave its ends.

        To be called once a period.

        Args:
            time: of the step that is next [s].
            period: until the step after it [s].
        """
        phase, rate, _ = self.clock.at(time)
        room = self._duration - phase if self._forward > 0.0 else phase
        if not self.on or room > 2.0 * self._ramp:
            return
        later = self._turned(time + period)
        times = later.start + later.ramp * _PLACES
        phases = np.array([later.at(t)[0] for t in times])
        if phases.min() < 0.0 or phases.max() > self._duration:
            self.clock = self._turned(time)
            self._forward = -self._forward

    def _turned(self, time: float) -> MotionClock:
        return self.clock.toward(time, -self._forward, self._ramp)
