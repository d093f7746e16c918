"""A step of a pose towards targets, before anything moves, by Eqs. (11), (27), (34)."""

from __future__ import annotations

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.joint_limits import LimitPotential
from crar_drake.equations.paper import PaperGains, constraint_weights
from crar_drake.equations.weighted_inverse import damped_inverse, inverse_times

_STOPPED = 1e9  # the weight of a joint that may go no farther


@compiled
def start_step(
    q: np.ndarray,
    J: np.ndarray,
    error: np.ndarray,
    d: np.ndarray,
    dd_dq: np.ndarray,
    room: tuple[np.ndarray, np.ndarray],
    limits: LimitPotential,
    gains: PaperGains,
) -> np.ndarray:
    """J* e, by the inverse of Eq. (34): (n,) displacements [rad or m].

    W is that of Eq. (27) with every constraint counted as being approached; joints
    that the first such step takes out of their room are stopped in a second one, so
    that the others do what they cannot.

    Args:
        q: (n,) positions of the controlled joints [rad or m].
        J: (m, n) task Jacobian, with the rows' weights.
        error: (m,) Eq. (11), with the same.
        d: (Nc,) signed distances [m].
        dd_dq: (Nc, n) Eq. (20).
        room: (n,), (n,) from where and to where joints may go.
        limits: of the joints.
        gains: damping, rho, alpha, beta and limit_share count.
    """
    lower, upper = room
    # Before, nothing was near.
    W = constraint_weights(
        q, d, dd_dq, np.zeros(len(q)), np.zeros(dd_dq.shape), limits, gains
    ).W
    step = inverse_times(damped_inverse(J, W, gains.damping), error)
    for i in range(len(q)):
        if (q[i] <= lower[i] and step[i] < 0.0) or (q[i] >= upper[i] and step[i] > 0.0):
            W[i] = _STOPPED
    return inverse_times(damped_inverse(J, W, gains.damping), error)
