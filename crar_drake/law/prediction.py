"""Where the plant will be one control period on, if it does as commanded."""

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.vectors import to_places


@compiled
def next_state(
    q: np.ndarray,
    v: np.ndarray,
    vdot: np.ndarray,
    period: float,
    plant_step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The state q' (nv,), v' (nv,) that an acceleration held for a period leads to.

    With D = period and d = plant_step,

        v' = v + D a,        q' = q + D v + D (D + d) / 2 a.

    A discrete plant of Drake's takes semi-implicit Euler steps: v_k = v + k d a, then
    q_k = q_(k-1) + d v_k. The sum of k from 1 to N = D / d is N (N + 1) / 2, and
    d^2 N (N + 1) / 2 = D (D + d) / 2. With d = 0 it is the parabola of a continuous
    plant; with d = D it is q' = q + D v'.

    Limits: exact where the plant's step divides the period, the plant is the control
    model, and the torque follows the state at each of the plant's steps, as it does
    where these last a millisecond or longer.

    Args:
        q, v: (nv,), (nv,) positions and velocities [rad, rad/s].
        vdot: (nv,) accelerations [rad/s^2].
        period: of the controller [s].
        plant_step: time step of the discrete plant, 0 for a continuous one [s]; one
            that is longer than the period counts as the period.
    """
    v_next = v + period * vdot
    # Such that no rounding tells it from q + D v' where the steps are the periods.
    ahead = 0.5 * (period - min(plant_step, period))
    return q + period * (v_next - ahead * vdot), v_next


@compiled
def state_within(
    q: np.ndarray, v: np.ndarray, vdot: np.ndarray, t: float, plant_step: float
) -> tuple[np.ndarray, np.ndarray]:
    """(nv,), (nv,) the state at a time t within the period in which vdot is held [s].

    As `next_state`, but between the steps of a plant, too.
    """
    return q + t * v + 0.5 * t * (t + plant_step) * vdot, v + t * vdot


@compiled
def state_ahead(
    q: np.ndarray,
    v: np.ndarray,
    vdot: np.ndarray,
    period: float,
    plant_step: float,
    positions: np.ndarray,
    order: np.ndarray,
) -> np.ndarray:
    """`next_state` in the plant's order, [q'; v'] (2 nv,).

    Args:
        q, v, vdot: (nv,), (nv,), (nv,) of the plant.
        period, plant_step: as above.
        positions, order: (nv,), (nv,) places in the plant's q and v.
    """
    q_next, v_next = next_state(q[positions], v[order], vdot[order], period, plant_step)
    return np.concatenate((to_places(q_next, positions), to_places(v_next, order)))
