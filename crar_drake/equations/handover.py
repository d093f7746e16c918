"""What Python hands to a compiled step: one vector, and one comes back.

Every array that goes into compiled code takes half a microsecond, one that comes back
twice as much, and a tuple of them as much as several: with the arrays of `Measured`,
`Wanted` and `Answer` that is a tenth of a step.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.kinematics import Measured, Robot
from crar_drake.equations.references import BlendStart, Wanted


def hand_over(measured: Measured, wanted: Wanted, *kept: np.ndarray) -> np.ndarray:
    """State, targets and what the step before left, one after the other.

    Args:
        measured: the state; what was asked of SceneGraph is not among it.
        wanted: the targets.
        kept: arrays of any shape, see `take_over`.
    """
    start = wanted.start
    return np.concatenate(
        (
            measured.q[0],
            measured.v,
            wanted.blend,
            start.R.ravel(),
            start.p.ravel(),
            start.q_p,
            start.q,
            wanted.prescribed,
            wanted.tasks,
            *(x.ravel() for x in kept),
            wanted.posture,
        )
    )


@compiled
def take_over(given: np.ndarray, r: Robot, num_kept: int) -> tuple[Wanted, np.ndarray]:
    """The targets out of `hand_over`, and what the step before left.

    The state comes first, q (nq,) and v (nv,) in the plant's order.

    Args:
        given: by `hand_over`.
        r: of the robot.
        num_kept: how many numbers the step before left.

    Returns:
        The targets; (num_kept,), all that was kept, one after the other.
    """
    rows = r.rows.value
    nq, nv = len(r.positions), len(r.order)
    n_p = nv - r.n
    nq_p = n_p + (1 if r.turn >= r.n else 0)  # an orientation has a position more
    Na, Nl = len(rows.angular_tasks), len(rows.linear_tasks)
    Nj = len(rows.joint_rows)
    blend = nq + nv
    R = blend + 3
    p = R + 9 * Na
    q_p = p + 3 * Nl
    q = q_p + nq_p
    prescribed = q + Nj
    tasks = prescribed + nq_p + 2 * n_p
    kept = tasks + 10 * Na + 9 * Nl + 3 * Nj  # x_d, v_d and a_d, see `TaskLayout`
    posture = kept + num_kept
    start = BlendStart(
        given[R:p].reshape(Na, 3, 3),
        given[p:q_p].reshape(Nl, 3),
        given[q_p:q],
        given[q:prescribed],
    )
    wanted = Wanted(
        given[tasks:kept],
        given[prescribed:tasks],
        given[posture:],
        start,
        (given[blend], given[blend + 1], given[blend + 2]),
    )
    return wanted, given[kept:posture]
