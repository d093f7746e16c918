"""The joint-limit potential and its weight: Eqs. (17) and (18)."""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import compiled

# Nearer than this to a limit [rad or m] the gradient is taken at this distance:
# at the limit it is infinite, and beyond it the printed formula shrinks again.
LIMIT_CLAMP = 1e-4


class LimitPotential(NamedTuple):
    """One set of limits, made ready for Eq. (17) by `limit_potential`; all (n,)."""

    lower: np.ndarray  # finite, and not equal [rad or m]
    upper: np.ndarray
    first: np.ndarray  # where the gradient is taken at the least
    last: np.ndarray  # and at the most
    factor: np.ndarray  # a quarter of the squared range; 0 for unlimited joints


def limit_potential(lower: np.ndarray, upper: np.ndarray) -> LimitPotential:
    """The joint-limit potential, Eq. (17), for one set of limits.

    Inside by less than LIMIT_CLAMP, or outside, its gradient is taken at LIMIT_CLAMP
    inside (for a range narrower than four clamps, at a quarter of the range; a locked
    joint has a range as wide as one clamp). Where a limit is infinite the joint
    counts as unlimited and the gradient is 0.

    Args:
        lower, upper: (n,) limits [rad or m], +-inf where there is none.
    """
    limited = np.isfinite(lower) & np.isfinite(upper)
    lower = np.where(limited, lower, -1.0)
    upper = np.where(limited, upper, 1.0)
    # Equal limits would give 0/0.
    widening = 0.5 * np.maximum(LIMIT_CLAMP - (upper - lower), 0.0)
    lower, upper = lower - widening, upper + widening
    span = upper - lower
    clamp = np.minimum(LIMIT_CLAMP, 0.25 * span)
    factor = np.where(limited, 0.25 * span**2, 0.0)
    return LimitPotential(lower, upper, lower + clamp, upper - clamp, factor)


@compiled
def limit_gradient(q: np.ndarray, limits: LimitPotential) -> np.ndarray:
    """Eq. (17): dh/dq_i = (u-l)^2 (2q-u-l) / (4 (u-q)^2 (q-l)^2), clamped, (n,).

    Args:
        q: (n,) positions [rad or m].
    """
    q = np.minimum(np.maximum(q, limits.first), limits.last)
    to_upper, to_lower = limits.upper - q, q - limits.lower
    return limits.factor * (to_lower - to_upper) / np.square(to_upper * to_lower)


@compiled
def limit_proximity(
    q: np.ndarray, gradient: np.ndarray, limits: LimitPotential
) -> np.ndarray:
    """The |grad h_i| that Eq. (18) compares between steps, (n,); 0 without limits.

    Inside the clamp that is the magnitude of Eq. (17). From there outwards the
    printed formula jumps to infinity and then shrinks, so it would take going
    further out for coming back; here it goes on growing linearly with q instead.

    Args:
        q: (n,) positions, not clamped [rad or m].
        gradient: (n,) Eq. (17) there.
    """
    beyond = np.abs(q - np.minimum(np.maximum(q, limits.first), limits.last))
    return np.abs(gradient) * (1.0 + beyond / LIMIT_CLAMP)


@compiled
def joint_limit_weights(
    gradient: np.ndarray, proximity: np.ndarray, previous: np.ndarray
) -> np.ndarray:
    """Eq. (18): the diagonal of W_JL.

    Args:
        gradient: (n,) Eq. (17) at the present step.
        proximity: (n,) `limit_proximity` at the present step.
        previous: (n,) the same at the previous step; zeros at the first step,
            where the change counts as 0, that is as approaching.

    Returns:
        (n,) 1 + |grad h_i| for a joint that approaches its limit, else 1.
    """
    return 1.0 + np.abs(gradient) * (proximity >= previous)
