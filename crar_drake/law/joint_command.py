"""The nominal of a joint command: where the robot is to be a period on.

The command's state moves by steps of the period: q' = q + period q_dot'. A desired
position q_d, velocity or acceleration is a desired state, and s_d the step that leads
there. Where that is not safe, the nominal brings the place where the robot would come
to rest to that where the desired motion would,

    q'_s = q_d + T q_dot_d,       so that      q_d - q decays with the time constant T.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import compiled


class JointCommand(NamedTuple):
    """What is desired of the joints, n of them, for the end of a period.

    Attributes:
        q: (n,) positions [rad or m]; None where none are.
        v: (n,) velocities [rad/s or m/s]; beside positions how fast these move, which
            is optional.
        a: (n,) accelerations [rad/s^2 or m/s^2]; alone.
    """

    q: np.ndarray | None = None
    v: np.ndarray | None = None
    a: np.ndarray | None = None

    def is_finite(self) -> bool:
        """Whether all that is given is."""
        return all(x is None or all_finite(x) for x in self)

    def step(
        self, q: np.ndarray, v: np.ndarray, T: float, period: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """q', q_dot' and s (n,) each, of the command as it is, from a state (n,), (n,)
        a period [s] ago; numbers that overflow are infinite or NaN."""
        if self.q is not None:
            return self.q, *to_position(q, v, self.q, T, period)
        after = v + period * self.a if self.v is None else self.v
        return to_velocity(q, v, after, T, period)

    @np.errstate(over="ignore", invalid="ignore")
    def nominal(
        self,
        q: np.ndarray,
        v: np.ndarray,
        before: np.ndarray | None,
        T: float,
        period: float,
        speed: float,
    ) -> np.ndarray:
        """(n,) s of a command that is not taken as it is [rad/s or m/s].

        Args:
            q, v: (n,), (n,) state.
            before: (n,) the position that was desired a period ago; None if none was.
            T, period: [s].
            speed: that no joint is asked to be faster than [rad/s or m/s].
        """
        if self.a is not None:
            s = v + T * self.a
        elif self.q is None:
            s = self.v
        else:
            rate = self.v
            if rate is None:
                rate = (self.q - (self.q if before is None else before)) / period
            ahead = self.q + T * np.clip(rate, -speed, speed)
            e = period * period / T
            s = (ahead - (q + (T - e) * v)) / (period + e)
        return np.clip(s, -speed, speed)


@compiled
def all_finite(x: np.ndarray) -> bool:
    """Whether no entry of x (n,) is NaN or infinite."""
    return np.isfinite(x).all()


@compiled
def to_position(
    q: np.ndarray, v: np.ndarray, desired: np.ndarray, T: float, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """q_dot' and s (n,) each, of a desired position (n,), from a state (n,), (n,)."""
    after = (desired - q) / period
    return after, v + (T / period) * (after - v)


@compiled
def to_velocity(
    q: np.ndarray, v: np.ndarray, desired: np.ndarray, T: float, period: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q', q_dot', s (n,) each, of a desired velocity (n,), from a state (n,), (n,)."""
    return q + period * desired, desired, v + (T / period) * (desired - v)
