"""How fast margins may be used up, and are to be regained: (L3), (L4), (L7).

A margin h where the robot would come to rest, of a distance or of a joint to a limit,
changes by g s per second. It is to change at least by `least_rate`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from crar_drake.law.compilation import compiled
from crar_drake.law.vectors import times

# The most of its range that a joint keeps from each limit [1].
SHARE_OF_RANGE = 0.1


class Approach(NamedTuple):
    """The numbers of the rows, see `LookaheadParameters`."""

    distance_margin: float  # d_min [m]
    limit_margin: float  # at most, and SHARE_OF_RANGE [rad or m]
    retreat_rate: float  # gamma [1/s]
    retreat_speed: float  # of a pair [m/s]
    joint_retreat_speed: float  # [rad/s or m/s]
    approach_rate: float  # kappa of pairs [1/s]
    limit_approach_rate: float  # of limits, infinite for no row [1/s]
    influence_distance: float  # pairs that are farther apart have no row [m]
    fastest: float  # that q_s is asked to move in any joint [rad/s or m/s]


@compiled
def least_rate(
    h: np.ndarray, margin: ArrayLike, gamma: float, fastest: float, kappa: float
) -> np.ndarray:
    """How fast a margin has to grow at least; (C,) [m/s, rad/s].

    Inside the margin gamma (margin - h), but at most `fastest`; outside of it
    -kappa (h - margin), which bounds how fast it is approached: so a velocity damper
    (Faverjon and Tournassoud, 1987) has it.

    Args:
        h: (C,) margins [m or rad].
        margin: to be kept, of all or (C,) [m or rad].
        gamma: [1/s].
        fastest: [m/s or rad/s].
        kappa: [1/s].
    """
    lacks = margin - h
    return np.minimum(np.where(lacks > 0.0, gamma, kappa) * lacks, fastest)


@compiled
def distance_rows(
    d: np.ndarray,
    dd_dv: np.ndarray,
    drift: np.ndarray,
    v: np.ndarray,
    T: float,
    approach: Approach,
) -> tuple[np.ndarray, np.ndarray]:
    """g (C, nv), least (C,): the rows (L3), (L4) of distances within the influence
    distance, first those expected from q, and then those at q_s.

    Each pair of shapes has its own: one of the nearest two alone would jump where two
    are equally near, and let the first go. What (L4) leaves out of its rows' rate, T
    q_dot^T hess(d) q_dot, is estimated by the secant, for q_s is T q_dot away.

    Args:
        d: (2, Nr) signed distances at q and at q_s [m].
        dd_dv: (2, Nr, nv) their gradients by all joints.
        drift: (Nr,) how fast distances shrink by themselves [m/s].
        v: (nv,) velocities [rad/s, m/s].
        T: braking time constant [s].
        approach: margin and rates.
    """
    rate = times(dd_dv[0], v)
    h = np.concatenate((d[0] + T * rate, d[1]))
    least = least_rate(
        h,
        approach.distance_margin,
        approach.retreat_rate,
        approach.retreat_speed,
        approach.approach_rate,
    )
    secant = times(dd_dv[1], v) - rate
    curvature = np.concatenate((secant, np.zeros(len(secant))))
    least += np.concatenate((drift, drift)) - curvature
    near = np.flatnonzero(h < approach.influence_distance)
    return dd_dv.reshape(len(h), len(v))[near], least[near]
