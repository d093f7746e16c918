"""From joint positions and velocities to the numbers of a state: Eqs. (5), (6).

The robot is a tree of frames, each moved by one velocity against its parent; bodies
that are welded share a frame, and frame 0 is the world. `robot.kinematics` reads the
tree off Drake's plant; its formulas are Featherstone's (Rigid Body Dynamics Algorithms,
2008, chapters 2 and 4).

About the world's origin, the spatial velocity that joint j gives is the same for every
link that it carries, and 0 for all others. One matrix S (6, nv) therefore serves all
links: a wrench [moment about the origin; force] on link L does work on the joints at
the rates wrench^T S, of the joints that carry L. A force f at point p is the wrench
[p x f; f].
"""

import math
from typing import NamedTuple

import numpy as np

from crar_drake.law.capsule_distances import (
    distance_gradient_about_origin,
    nearest_of_pairs,
)
from crar_drake.law.compilation import Held, compiled
from crar_drake.law.tasks import TaskRows, rotation_from_quaternion, stack_rows
from crar_drake.law.vectors import cross_rows, product


class Tree(NamedTuple):
    """The frames of a robot, N = nv + 1, parents before their children.

    The transposed pose (4, 4) of frame i in its parent is

        fixed_i + sin(q) sine_i + (1 - cos(q)) versine_i + q slide_i,

    with q the position that moves it: Rodrigues' formula for a turn about an axis that
    is fixed in both, a slide along one, or both at once (a screw).

    A free joint (Drake's quaternion floating joint) has two frames instead of six: one
    that follows its translation and does not turn, in which its angular velocity is
    measured, and next the one that turns.
    """

    parent: np.ndarray  # (N,) the world is its own
    position: np.ndarray  # (N,) which of the plant's positions; of the world's, any
    fixed: np.ndarray  # (N, 4, 4) of the world, the identity
    sine: np.ndarray  # (N, 4, 4) of the world, as the others, 0
    versine: np.ndarray
    slide: np.ndarray
    every: np.ndarray  # (N,) True
    # (F, 2) of free joints: the first frame, and where in the plant's positions their
    # quaternion is, with the translation after it
    free: np.ndarray


class TaskPoints(NamedTuple):
    """What moves a robot's tasks; T tasks, m rows."""

    fixed: np.ndarray  # (m, 6) of `task_jacobian`
    of_rows: np.ndarray  # (m,) the task of each row
    carried: np.ndarray  # (m, nv) 1 where the joint moves the row's task
    carries: np.ndarray  # (T, nv) 1 where the joint moves the task
    above: np.ndarray  # (nv, nv) 1 where joint j carries joint i, i = j not included
    of_joints: np.ndarray  # (m, nv) 1 where a row is that joint


@compiled
def free_poses(q: np.ndarray, tree: Tree) -> np.ndarray:
    """`Tree.fixed` with the poses of the free joints' frames, (N, 4, 4).

    Args:
        q: (nq,) positions of all joints, in the plant's order.
    """
    X = tree.fixed
    if len(tree.free):
        X = tree.fixed.copy()
        for k in range(len(tree.free)):
            frame, at = tree.free[k, 0], tree.free[k, 1]
            p = q[at + 4 : at + 7]
            for c in range(3):
                for r in range(3):
                    X[frame, 3, c] += p[r] * X[frame, r, c]
            R = rotation_from_quaternion(q[at : at + 4].copy().reshape(1, 4))[0]
            X[frame + 1, :3, :3] = R.T
    return X


@compiled
def link_poses(q: np.ndarray, tree: Tree, needed: np.ndarray) -> np.ndarray:
    """X (K, 4 N, 3): the frames' poses X_WL, transposed, one below the other [m].

    Of each frame three rows of R_WL^T, and then p_WL.

    Args:
        q: (K, nq) positions of all joints in K configurations, in the plant's order.
        needed: (N,) bool, which frames, parents with their children; `Tree.every`.
    """
    K, N = len(q), len(tree.parent)
    X = np.empty((K, 4 * N, 3))
    for k in range(K):
        fixed_at = free_poses(q[k], tree)
        for c in range(3):
            for r in range(4):
                X[k, r, c] = 1.0 if r == c else 0.0
        for i in range(1, N):
            if not needed[i]:
                continue
            at = q[k, tree.position[i]]
            s, versine = math.sin(at), 1.0 - math.cos(at)
            up, here = 4 * tree.parent[i], 4 * i
            fixed, sine = fixed_at[i], tree.sine[i]
            turn, slide = tree.versine[i], tree.slide[i]
            for r in range(4):
                x = fixed[r, 0] + s * sine[r, 0] + versine * turn[r, 0]
                y = fixed[r, 1] + s * sine[r, 1] + versine * turn[r, 1]
                z = fixed[r, 2] + s * sine[r, 2] + versine * turn[r, 2]
                if r == 3:
                    x += at * slide[3, 0]
                    y += at * slide[3, 1]
                    z += at * slide[3, 2]
                for c in range(3):
                    X[k, here + r, c] = (
                        x * X[k, up, c] + y * X[k, up + 1, c] + z * X[k, up + 2, c]
                    )
            for c in range(3):
                X[k, here + 3, c] += X[k, up + 3, c]
    return X


@compiled
def place_points(X: np.ndarray, selection: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Points and vectors (K, P, 3) in W, in K configurations.

    Args:
        X: (K, 4 N, 3) of `link_poses`.
        selection: (P, 4) homogeneous points and vectors in their frames, whose rows
            of X begin at
        first: (P,).
    """
    C = np.empty((len(X), len(selection), 3))
    one = np.uintp(1)
    for k in range(len(X)):
        for i in range(len(selection)):
            # Of a signed place Numba asks each time whether it counts from the end.
            j = np.uintp(first[i])
            x, y, z = j + one, j + one + one, j + one + one + one
            of = selection[i]
            p, q, r, s = of[0], of[1], of[2], of[3]
            for c in range(3):
                first_two = p * X[k, j, c] + q * X[k, x, c]
                C[k, i, c] = first_two + r * X[k, y, c] + s * X[k, z, c]
    return C


@compiled
def joint_motion(placed: np.ndarray) -> np.ndarray:
    """S (K, 6, nv): how each joint moves what it carries, about the world's origin.

    Args:
        placed: (K, 3 nv, 3) in W, in K configurations: a point of each joint's axis
            [m]; then the unit vectors along the axes, 0 where nothing turns; then
            the directions of slides, 0 where nothing slides.
    """
    K, nv = len(placed), placed.shape[1] // 3
    S = np.empty((K, 6, nv))
    for k in range(K):
        p, turn, slide = placed[k, :nv], placed[k, nv : 2 * nv], placed[k, 2 * nv :]
        S[k, :3], S[k, 3:] = turn.T, (cross_rows(p, turn) + slide).T
    return S


@compiled
def task_jacobian(p: np.ndarray, S: np.ndarray, tasks: TaskPoints) -> np.ndarray:
    """Eq. (5): the task Jacobian J (m, nv), of v = J q_dot, from the joints' motion.

    A unit velocity of a task's point p along axis e is felt by the joints as the
    wrench [p x e; e] about the world's origin, a turn about e as [e; 0]: these are
    the rows that multiply S. The row of a joint is a unit vector.

    Args:
        p: (T, 3) the tasks' points in W [m].
        S: (6, nv) `joint_motion`.
        tasks: with the turns or axes e of the rows, 0 of a joint's.
    """
    e = tasks.fixed[:, 3:]
    w = cross_rows(p[tasks.of_rows], e) + tasks.fixed[:, :3]
    return tasks.of_joints + tasks.carried * product(np.hstack((w, e)), S)


@compiled
def task_bias(
    p: np.ndarray, S: np.ndarray, v: np.ndarray, tasks: TaskPoints, rows: TaskRows
) -> np.ndarray:
    """Eq. (6): Jdot q_dot (m,), the tasks' acceleration where no joint accelerates.

    Joint j's column of S turns and moves with the frame that carries it, whose
    spatial velocity about the world's origin is [w; u] = sum S_i q_dot_i over the
    joints up to j, so that

        d/dt S_j q_dot_j = [w x s; w x t + u x s],     [s; t] = S_j q_dot_j.

    The sum A = [alpha; a] over the joints that carry a task is the acceleration of
    what passes the world's origin, less w x u; that of the task's point p is

        a_p = a + alpha x p + w x (u + w x p),      [w; u] of the task's link.

    Args:
        p: (T, 3) the tasks' points in W [m].
        S: (6, nv) `joint_motion`.
        v: (nv,) velocities.
    """
    own = np.ascontiguousarray((S * v).T)
    moving = product(tasks.above, own)
    w, u, s, t = moving[:, :3], moving[:, 3:], own[:, :3], own[:, 3:]
    change = np.hstack((cross_rows(w, s), cross_rows(w, t) + cross_rows(u, s)))
    A, link = product(tasks.carries, change), product(tasks.carries, own)
    alpha, w = A[:, :3], link[:, :3]
    at = link[:, 3:] + cross_rows(w, p)
    a_p = A[:, 3:] + cross_rows(alpha, p) + cross_rows(w, at)
    still = np.zeros(len(rows.joint_rows))
    return stack_rows(alpha[rows.angular_tasks], a_p[rows.linear_tasks], still, rows)


class State(NamedTuple):
    """The numbers of one state, all in the world frame W.

    nv velocities, the controlled joints' first and then the prescribed ones', a free
    root's at the end, whose orientation has a position more.
    """

    q: np.ndarray  # (nq,) positions of the joints [rad, m]
    v: np.ndarray  # (nv,) velocities [rad/s, m/s]
    R: np.ndarray  # (Na, 3, 3) orientations R_WT of the tasks that have one
    p: np.ndarray  # (Nl, 3) positions p_WT of the tasks that have one [m]
    J: np.ndarray  # (m, nv) Eq. (5)
    Jdot_qdot: np.ndarray  # (m,) Eq. (6)
    points: np.ndarray  # (P, 3) of `Robot.selection`
    S: np.ndarray  # (6, nv) `joint_motion`


class Robot(NamedTuple):
    """What the equations need to know of a robot and its tasks.

    Its parts are held: handing them on is quick to compile, and to do.
    """

    order: np.ndarray  # (nv,) places in the plant's v: first the controlled joints
    positions: np.ndarray  # (nq,) places in the plant's q, in the same order
    n: int  # number of controlled joints' velocities
    # (P, 4) of `place_points`: the joints' axes, as in `joint_motion`; the tasks'
    # points; the axes of the tasks with an orientation; and those of the watched shapes
    selection: np.ndarray
    first: np.ndarray  # (P,) of `place_points` as well
    tree: Held  # of a `Tree`
    tasks: Held  # of `TaskPoints`
    rows: Held  # of `TaskRows`
    pairs: Held  # of `ShapePairs`
    watched: Held  # of `WatchedRows`


@compiled
def find_state(q: np.ndarray, v: np.ndarray, robot: Held) -> State:
    """Eqs. (5), (6): the numbers of a state, (nq,), (nv,) in the plant's order.

    Args:
        robot: holds the `Robot`.
    """
    r = robot.value
    tasks, rows, nv = r.tasks.value, r.rows.value, len(r.order)
    tree = r.tree.value
    X = link_poses(q.reshape(1, -1), tree, tree.every)
    points = place_points(X, r.selection, r.first)
    S = joint_motion(points[:, : 3 * nv])[0]
    T, Na = len(tasks.carries), len(rows.angular_tasks)
    first, points = 3 * nv, points[0]
    p = points[first : first + T]
    R, axes = np.empty((Na, 3, 3)), points[first + T :]
    for i in range(Na):
        R[i] = axes[3 * i : 3 * i + 3].T
    v = v[r.order]
    return State(
        q[r.positions],
        v,
        R,
        p[rows.linear_tasks],
        task_jacobian(p, S, tasks),
        task_bias(p, S, v, tasks, rows),
        points,
        S,
    )


@compiled
def watched_distances(
    state: State, asked: np.ndarray, robot: Held
) -> tuple[np.ndarray, np.ndarray]:
    """Eq. (20): signed distances (Nc,) of the watched pairs [m], and their gradients
    (Nc, nv) by all joints.

    Args:
        state: of the robot.
        asked: of `nearest_of_pairs`.
        robot: holds the `Robot`.
    """
    r = robot.value
    watched = r.watched.value
    d, normal, p = nearest_of_pairs(state.points, asked, r.pairs.value, watched)
    return d, distance_gradient_about_origin(normal, p, state.S, watched.moves)
