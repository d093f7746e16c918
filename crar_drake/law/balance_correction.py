"""The norm in which a step of a robot on its soles is changed the least, see (B5)."""

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import (
    joint_motion,
    link_poses,
    place_points,
    task_jacobian,
)
from crar_drake.law.vectors import cholesky, gram, some_columns


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
