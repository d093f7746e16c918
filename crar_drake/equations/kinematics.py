"""From Drake's poses and Jacobians to the numbers of a state: Eqs. (5), (6).

About the world's origin, column j of a link's spatial Jacobian is the same for every
link that joint j carries, and 0 for all others. One matrix S (6, nv), read off the
links at the ends of the tree, therefore serves all links: a wrench [moment about the
origin; force] on link L does work on the joints at the rates wrench^T S, of the joints
that carry L. A force f at point p is the wrench [p x f; f].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.equations.capsule_distances import ShapePairs, nearest_of_pairs
from crar_drake.equations.collisions import distance_gradient_about_origin
from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.tasks import TaskRows, stack_rows
from crar_drake.equations.vectors import cross_rows, product, sparse_product, times


class TaskPoints(NamedTuple):
    """Where a robot's tasks are and what moves them; T tasks, m rows."""

    origins: np.ndarray  # (T,) row of X (4 L, 3) with each task's link's origin
    fixed: np.ndarray  # (m, 6) of `task_jacobian`
    by_point: np.ndarray  # (6 m, 3 T) likewise
    carried: np.ndarray  # (m, nv) 1 where the joint moves the row's task


@compiled
def place_points(X: np.ndarray, selection: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Points and vectors (K, P, 3) in W, in K configurations.

    Args:
        X: (K, 4 L, 3) the links' poses X_WL, transposed, one below the other [m].
        selection: (P, 4 L) homogeneous points and vectors in their links' frames, each
            in the columns of its link, which begin at
        first: (P,).
    """
    return sparse_product(selection, first, X)


@compiled
def joint_motion(J: np.ndarray, signs: np.ndarray, order: np.ndarray) -> np.ndarray:
    """S (K, 6, nv): how each joint moves what it carries, about the world's origin.

    Args:
        J: (K, E, 6, nv) Drake's spatial Jacobians of the world's origin as seen from
            the E ends of the tree.
        signs: (E, nv) -1 where the column is taken from that end, else 0.
        order: (nv,) which joint is which column of S.
    """
    S = J[:, 0] * signs[0]
    for end in range(1, len(signs)):
        S += J[:, end] * signs[end]
    return np.ascontiguousarray(S[:, :, order])


@compiled
def task_jacobian(p: np.ndarray, S: np.ndarray, tasks: TaskPoints) -> np.ndarray:
    """Eq. (5): the task Jacobian J (m, nv), of v = J q_dot, from the joints' motion.

    A unit velocity of a task's point p along axis e is felt by the joints as the
    wrench [p x e; e] about the world's origin, a turn about e as [e; 0]: these are
    the rows that multiply S.

    Args:
        p: (T, 3) the tasks' points in W [m].
        S: (6, nv) `joint_motion`.
        tasks: with the wrenches' parts that are fixed, and those by the points.
    """
    wrenches = times(tasks.by_point, p.ravel()).reshape(-1, 6) + tasks.fixed
    return product(wrenches, S) * tasks.carried


@compiled
def task_bias(
    bias: np.ndarray,
    X: np.ndarray,
    p: np.ndarray,
    S: np.ndarray,
    v: np.ndarray,
    tasks: TaskPoints,
    rows: TaskRows,
) -> np.ndarray:
    """Eq. (6): Jdot q_dot (m,), the tasks' acceleration where no joint accelerates.

    Of a point p of link L, with Lo the link's origin, r = p - Lo:
    a_p = a_Lo + alpha x r + omega x (omega x r).

    Args:
        bias: (T, 6) Drake's spatial acceleration [alpha; a_Lo] of each task's link
            with q_ddot = 0, in W [rad/s^2, m/s^2].
        X: (4 L, 3) see `place_points`, at the state.
        p: (T, 3) the tasks' points in W [m].
        S: (6, nv) `joint_motion`.
        v: (nv,) velocities.
        tasks, rows: of the tasks.
    """
    linear = rows.linear_tasks
    alpha, a_Lo = bias[:, :3], bias[linear, 3:]
    omega = product(tasks.carried[rows.linear_rows[::3]] * v, S[:3].T)
    r = p[linear] - X[tasks.origins[linear]]
    a_p = a_Lo + cross_rows(alpha[linear], r)
    a_p += cross_rows(omega, cross_rows(omega, r))
    return stack_rows(alpha[rows.angular_tasks], a_p, rows)


class State(NamedTuple):
    """The numbers of one state, all in the world frame W.

    nv joints, the controlled first and then the prescribed; K = 2 configurations where
    the robot would come to rest counts, too, else 1; N watched pairs.
    """

    q: np.ndarray  # (nv,) positions of the joints [rad, m]
    v: np.ndarray  # (nv,) velocities [rad/s, m/s]
    R: np.ndarray  # (Na, 3, 3) orientations R_WT of the tasks that have one
    p: np.ndarray  # (Nl, 3) positions p_WT of the tasks that have one [m]
    J: np.ndarray  # (m, nv) Eq. (5)
    Jdot_qdot: np.ndarray  # (m,) Eq. (6)
    d: np.ndarray  # (K, Nc) signed distances [m]
    dd_dv: np.ndarray  # (K, Nc, nv) Eq. (20)


class FromDrake(NamedTuple):
    """Drake's numbers of a state, and of another configuration where K = 2."""

    X: np.ndarray  # (K, 4 L, 3) see `place_points`
    ends: np.ndarray  # (K, E, 6, nv) see `joint_motion`
    bias: np.ndarray  # (T, 6) see `task_bias`
    q: np.ndarray  # (nv,) in the plant's order
    v: np.ndarray  # (nv,) in the plant's order
    asked: np.ndarray  # (K (N - Nf), 7) see `nearest_of_pairs`


class Robot(NamedTuple):
    """What the equations need to know of a robot and its tasks."""

    order: np.ndarray  # (nv,) places in the plant's v: first the controlled joints
    n: int  # number of controlled joints
    selection: np.ndarray  # (P, 4 L) of `place_points`: the tasks' points, the axes of
    # the tasks with an orientation, and then those of the watched pairs
    first: np.ndarray  # (P,) likewise
    signs: np.ndarray  # (E, nv) of `joint_motion`, in the plant's order
    tasks: TaskPoints
    rows: TaskRows
    pairs: ShapePairs  # in as many configurations as `FromDrake` has


@compiled
def find_state(drake: FromDrake, r: Robot) -> State:
    """Eqs. (5), (6), (20): the numbers of a state from Drake's."""
    tasks, rows, X = r.tasks, r.rows, drake.X
    points = place_points(X, r.selection, r.first)
    S = joint_motion(drake.ends, r.signs, r.order)
    d, normal, p_WA = nearest_of_pairs(points, drake.asked, r.pairs)
    T, Na = len(tasks.origins), len(rows.angular_tasks)
    p = points[0, :T]
    axes = points[0, T : T + 3 * Na].reshape(-1, 3, 3)  # columns of R_WT, as rows
    v = drake.v[r.order]
    return State(
        drake.q[r.order],
        v,
        np.ascontiguousarray(axes.transpose(0, 2, 1)),
        p[rows.linear_tasks],
        task_jacobian(p, S[0], tasks),
        task_bias(drake.bias, X[0], p, S[0], v, tasks, rows),
        d.reshape(len(X), -1),
        distance_gradient_about_origin(normal, p_WA, S, r.pairs.moves),
    )


@compiled
def evaluate_state(drake: FromDrake, robot: Held) -> State:
    """`find_state`, of a held `Robot`."""
    return find_state(drake, robot.value)


@compiled
def join_joints(
    qddot: np.ndarray, qddot_p: np.ndarray, order: np.ndarray
) -> np.ndarray:
    """Accelerations (nv,) in the plant's order.

    Args:
        qddot, qddot_p: (n,), (n_p,) of the controlled and the prescribed joints.
        order: (nv,) their places in the plant's order, see `Robot`.
    """
    vdot = np.empty(len(order))
    n = len(qddot)
    for i in range(len(order)):
        vdot[order[i]] = qddot[i] if i < n else qddot_p[i - n]
    return vdot
