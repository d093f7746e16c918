"""Weights of joints near constraints, Eqs. (17)-(28), and one with the inertia.

`paper.constraint_weights` puts them together.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.vectors import add_to_diagonal, cholesky

# Nearer than this to a limit [rad or m] the gradient is taken at this distance:
# at the limit it is infinite, and beyond it the printed formula shrinks again.
LIMIT_CLAMP = 1e-4

# Below this distance [m] the magnitude of Eq. (23) is taken at this distance: at
# d = 0 it is infinite, and for d < 0 the printed formula shrinks again.
DISTANCE_CLAMP = 1e-3


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
def collision_potential_slope(
    d: np.ndarray,
    rho: float | np.ndarray,
    alpha: float | np.ndarray,
    beta: float | np.ndarray,
) -> np.ndarray:
    """Eq. (23): df/dd = -rho exp(-alpha d) d^-beta (beta/d + alpha), (Nc,) [1/m].

    Below DISTANCE_CLAMP, in contact and in penetration it is taken there.

    Args:
        d: (Nc,) signed distances [m].
        rho, alpha, beta: scalars or (Nc,); amplitude, decay [1/m], exponent.
    """
    d = np.maximum(d, DISTANCE_CLAMP)
    return -rho * np.exp(-alpha * d) * d**-beta * (beta / d + alpha)


@compiled
def collision_proximity(gradient: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The |grad f_i| that Eq. (21) compares between steps, (Nc, n).

    Down to DISTANCE_CLAMP it is the magnitude of Eq. (25); below, where the slope
    is clamped, it goes on growing linearly with the depth, so that going deeper
    is distinguished from coming out.

    Args:
        gradient: (Nc, n) Eq. (25).
        d: (Nc,) signed distances, not clamped [m].
    """
    depth = np.maximum(DISTANCE_CLAMP - d, 0.0) / DISTANCE_CLAMP
    return np.abs(gradient) * (1.0 + depth)[:, np.newaxis]


@compiled
def approach_weights(
    gradient: np.ndarray, proximity: np.ndarray, previous: np.ndarray
) -> np.ndarray:
    """Eqs. (18), (21): the diagonal of W_JL (n,), and those of W_COL_j, (Nc, n).

    Args:
        gradient: Eq. (17) or (25) at the present step.
        proximity: `limit_proximity` or `collision_proximity` at the present step.
        previous: the same at the previous step; zeros at the first step, where the
            change counts as 0, that is as approaching.

    Returns:
        1 + |gradient| where the constraint is approached, else 1.
    """
    return 1.0 + np.abs(gradient) * (proximity >= previous)


def composite_index(num_pairs: int) -> float:
    """Eq. (28): a = 1 / (Nc + 1), for Nc watched pairs."""
    return 1.0 / (num_pairs + 1)


@compiled
def inertia_weight(H: np.ndarray, W: np.ndarray) -> np.ndarray:
    """The paper's "dynamically consistent weight matrix" (end of Section IV).

    W of Eq. (27) is the identity, plus a penalty for joints near constraints. Here
    the joint-space inertia takes the identity's place:

        W_H = H / det(H)^(1/n) + (W - I).

    Far from constraints the inverse of Eq. (16) is then the dynamically consistent
    one, H^-1 J^T (J H^-1 J^T)^-1 (Khatib 1987): of all velocities that do the
    tasks it has the least kinetic energy. A joint whose weight goes to infinity
    stops, and the others do the least for the robot with that joint locked. (The
    congruence W^1/2 H W^1/2 would also stop it, but the others would then move as
    if it were free.) Dividing by the geometric mean of H's eigenvalues takes out the
    unit and leaves the determinant that the identity has, so that the damping
    factor of Eq. (34) stays comparable. The sum is positive definite, because H is,
    and no weight is below 1.

    Args:
        H: (n, n) joint-space inertia matrix, symmetric positive definite [kg m^2].
        W: (n,) diagonal of Eq. (27), at least 1.

    Returns:
        (n, n) symmetric positive definite.
    """
    logdet = 2.0 * np.log(np.diag(cholesky(H))).sum()
    W_H = H * np.exp(-logdet / len(H))
    add_to_diagonal(W_H, W - 1.0)
    return W_H
