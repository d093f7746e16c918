"""The joint-limit potential and its weight: Eqs. (17) and (18)."""

from __future__ import annotations

import numpy as np

# Nearer than this to a limit [rad or m] the gradient is taken at this distance:
# at the limit it is infinite, and beyond it the printed formula shrinks again.
LIMIT_CLAMP = 1e-4


def joint_limit_potential(
    q: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """The potential h whose gradient is Eq. (17): (u-l)^2 / (4 (u-q) (q-l)).

    Defined between finite limits only; here for tests and plots.

    Args:
        q, lower, upper: (n,) positions and limits [rad or m].

    Returns:
        (n,) h_i [1]; 1 in the middle of the range, infinite at the limits.
    """
    return (upper - lower) ** 2 / (4.0 * (upper - q) * (q - lower))


class LimitPotential:
    """The gradient of the joint-limit potential, Eq. (17), for one set of limits.

    Inside by less than LIMIT_CLAMP, or outside, it is taken at LIMIT_CLAMP inside
    (for a range narrower than four clamps, at a quarter of the range; a locked
    joint has a range as wide as one clamp). Where a limit is infinite the joint
    counts as unlimited and the gradient is 0.

    Attributes:
        lower, upper: (n,) limits, finite, and not equal [rad or m].
        first, last: (n,) where the gradient is taken at the least and at the most.
        factor: (n,) a quarter of the squared range; 0 for unlimited joints.
    """

    def __init__(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """
        Args:
            lower, upper: (n,) limits [rad or m], +-inf where there is none.
        """
        limited = np.isfinite(lower) & np.isfinite(upper)
        lower = np.where(limited, lower, -1.0)
        upper = np.where(limited, upper, 1.0)
        # Equal limits would give 0/0.
        widening = 0.5 * np.maximum(LIMIT_CLAMP - (upper - lower), 0.0)
        self.lower, self.upper = lower - widening, upper + widening
        span = self.upper - self.lower
        clamp = np.minimum(LIMIT_CLAMP, 0.25 * span)
        self.first, self.last = self.lower + clamp, self.upper - clamp
        self.factor = np.where(limited, 0.25 * span**2, 0.0)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """Eq. (17) at q (n,) [rad or m]: (n,) [1/rad or 1/m]."""
        return self._gradient(self._clamped(q))

    def gradient_and_proximity(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Eq. (17), and the |grad h_i| that Eq. (18) compares between steps.

        Inside the clamp that is the magnitude of Eq. (17). From there outwards the
        printed formula jumps to infinity and then shrinks, so it would take going
        further out for coming back; here it goes on growing linearly with q instead.

        Args:
            q: (n,) positions, not clamped [rad or m].

        Returns:
            (n,) gradient and (n,) monotone measure of nearness [1/rad or 1/m], both
            0 for unlimited joints.
        """
        clamped = self._clamped(q)
        gradient = self._gradient(clamped)
        beyond = np.abs(q - clamped)
        return gradient, np.abs(gradient) * (1.0 + beyond / LIMIT_CLAMP)

    def _clamped(self, q: np.ndarray) -> np.ndarray:
        return np.minimum(np.maximum(q, self.first), self.last)

    def _gradient(self, q: np.ndarray) -> np.ndarray:
        to_upper, to_lower = self.upper - q, q - self.lower
        return self.factor * (to_lower - to_upper) / np.square(to_upper * to_lower)


def joint_limit_weights(
    gradient: np.ndarray, proximity: np.ndarray, previous: np.ndarray | None
) -> np.ndarray:
    """Eq. (18): the diagonal of W_JL.

    Args:
        gradient: (n,) Eq. (17) at the present step.
        proximity: (n,) `LimitPotential.gradient_and_proximity` at the present step.
        previous: (n,) the same at the previous step; None at the first step,
            where the change counts as 0, that is as approaching.

    Returns:
        (n,) 1 + |grad h_i| for a joint that approaches its limit, else 1.
    """
    if previous is None:
        return 1.0 + np.abs(gradient)
    return 1.0 + np.abs(gradient) * (proximity >= previous)
