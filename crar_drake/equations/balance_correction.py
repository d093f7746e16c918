"""The accelerations nearest to others that keep the rows of balance, see (B5)."""

import numpy as np

from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.kinematics import (
    joint_motion,
    link_poses,
    place_points,
    task_jacobian,
)
from crar_drake.equations.one_sided import one_sided_nearest_in
from crar_drake.equations.vectors import cholesky, gram, some_columns, times

# A row weighs so much more than an acceleration [1/m of the weight's arm], and so much
# a joint's bound.
_ROW_WEIGHT = 1e6


@compiled
def correction_norm(q: np.ndarray, damping: float, robot: Held) -> np.ndarray:
    """The norm in which accelerations are changed the least: by what that does to the
    tasks, and a little by itself. The lower factor L (n, n) of L L^T = c (J^T J +
    damping^2 I), whose trace is n; what stands above it means nothing.

    Args:
        q: (nq,) positions, in the plant's order.
        damping: what a joint counts beside the tasks [m].
        robot: holds the `Robot`.
    """
    r = robot.value
    tasks, tree, nv, n = r.tasks.value, r.tree.value, len(r.order), r.n
    T = len(tasks.carries)
    X = link_poses(q.reshape(1, -1), tree, tree.every)
    points = place_points(X, r.selection[: 3 * nv + T], r.first[: 3 * nv + T])
    S = joint_motion(points[:, : 3 * nv])[0]
    J = task_jacobian(points[0, 3 * nv :], S, tasks)
    norm = gram(some_columns(J, np.arange(n)))
    trace = n * damping**2
    for i in range(n):
        norm[i, i] += damping**2
        trace += norm[i, i] - damping**2
    return cholesky(norm * (n / trace))


@compiled
def nearest_balanced(
    root: np.ndarray,
    wanted: np.ndarray,
    g: np.ndarray,
    b: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    far: float,
) -> np.ndarray:
    """The accelerations (n,) nearest to others for which g . q_ddot <= b and each is
    within its bounds.

    Args:
        root: (n, n) of `correction_norm`.
        wanted: (n,) the others.
        g, b: (C, n), (C,) of the weight [m].
        lower, upper: (n,) each joint's bounds.
        far: rows that are farther from binding at the others are left out [m].
    """
    n = len(wanted)
    short = times(g, wanted) - b
    near = np.flatnonzero(short > -far)
    rows = np.zeros((len(near) + 2 * n, n))
    desired = np.empty(len(rows))
    for i in range(len(near)):
        desired[i] = -_ROW_WEIGHT * b[near[i]]
        for j in range(n):
            rows[i, j] = -_ROW_WEIGHT * g[near[i], j]
    for j in range(n):
        i = len(near) + 2 * j
        rows[i, j], desired[i] = _ROW_WEIGHT, _ROW_WEIGHT * lower[j]
        rows[i + 1, j], desired[i + 1] = -_ROW_WEIGHT, -_ROW_WEIGHT * upper[j]
    return one_sided_nearest_in(root, wanted, rows, desired)
