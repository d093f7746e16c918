"""What tasks ask for: targets, their reference velocity and acceleration by Eqs. (9)
and (14), and the nominal that a law of tasks makes of them.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.blending import blend_tasks, blend_vectors
from crar_drake.law.compilation import compiled
from crar_drake.law.kinematics import State
from crar_drake.law.tasks import (
    DesiredTasks,
    TaskRows,
    orientation_error,
    stack_rows,
    unpack_tasks,
)
from crar_drake.law.vectors import times

_NONE = np.zeros(0)


@compiled
def reference_acceleration(
    a_d: np.ndarray,
    v_d: np.ndarray,
    v: np.ndarray,
    e: np.ndarray,
    Kp: float | np.ndarray,
    Kv: float | np.ndarray,
) -> np.ndarray:
    """Eq. (14): a_r = a_d + Kv (v_d - v) + Kp e, (m,) [rad/s^2, m/s^2].

    Args:
        a_d: (m,) desired task acceleration [rad/s^2, m/s^2].
        v_d: (m,) desired task velocity [rad/s, m/s].
        v: (m,) present task velocity [rad/s, m/s].
        e: (m,) task error of Eq. (11) [rad, m].
        Kp: gain, a scalar or (m,) [1/s^2].
        Kv: gain, a scalar or (m,) [1/s].
    """
    return a_d + Kv * (v_d - v) + Kp * e


class TaskGains(NamedTuple):
    """The gains on tasks and prescribed joints, see `PaperGains`."""

    K: float  # [1/s]
    Kp: float  # [1/s^2]
    Kv: float  # [1/s]
    posture: float  # stiffness towards the nominal posture [1/s^2]
    weights: np.ndarray  # (m,) of the rows, `tasks.task_weights`; (0,) if all are 1


class Targets(NamedTuple):
    """The targets of one control step.

    A compiled step takes them apart, one array after the other: an array goes into
    compiled code in a fifth of a microsecond, a tuple of arrays in ten times that.
    """

    tasks: np.ndarray  # (layout.size,) [x_d; v_d; a_d] as given, see `TaskLayout`
    prescribed: np.ndarray  # (3 n_p,) desired [q_p; q_dot_p; q_ddot_p]
    posture: np.ndarray  # (n,) that the null space is drawn to; (0,) if not given
    # (layout.size_x + n_p,) what was measured where blending began, as x_d and q_p
    start: np.ndarray = _NONE
    blend: tuple[float, float, float] = (1.0, 0.0, 0.0)  # of `blending.smooth_step`


class Nominal(NamedTuple):
    """What a law of tasks answers: accelerations to be as near to as is safe."""

    vdot: np.ndarray  # (nv,) controlled joints first [rad/s^2 or m/s^2]
    task_error: np.ndarray  # (m,) Eq. (11) against the targets as given [rad, m]
    weights: np.ndarray  # (n,) diagonal of W, Eq. (27); ones where nothing is weighed
    qdot_c: np.ndarray  # (n,) where the velocities are to go, of Eq. (15) [rad/s]
    kept: np.ndarray  # for the next step


class References(NamedTuple):
    """What the targets ask for, with task weights applied to every row."""

    J: np.ndarray  # (m, n) task Jacobian of the controlled joints
    v_r: np.ndarray  # (m,) v_d + K e less the prescribed joints' share
    a_r: np.ndarray  # (m,) Eq. (14) less the prescribed joints' share and the bias.
    posture: np.ndarray  # (n,) acceleration towards the nominal posture; 0 if off
    qddot_p: np.ndarray  # (n_p,) accelerations of the prescribed joints
    error: np.ndarray  # (m,) Eq. (11) against the targets as given, without weights.
    # (n,) what the damped inverse is damped towards at the velocity level,
    # `undamped_preference`
    qdot_0: np.ndarray
    qddot_0: np.ndarray  # (n,) and at the acceleration level
    e: np.ndarray  # (m,) Eq. (11) against the blended targets
    e_dot: np.ndarray  # (m,) how fast it changes
    a_ff: np.ndarray  # (m,) a_r without feedback


@compiled
def find_error(
    q: np.ndarray, R: np.ndarray, p: np.ndarray, desired: DesiredTasks, rows: TaskRows
) -> np.ndarray:
    """Eq. (11) of tasks of every kind, (m,) [rad, m]; of a joint it is q_d - q.

    Args:
        q: (n,) positions of the controlled joints, or of all in that order [rad or m].
        R: (Na, 3, 3) present orientations of the tasks that have one.
        p: (Nl, 3) present positions of the tasks that have one [m].
        rows: which rows belong to which task.
    """
    of_joints = desired.q - q[rows.joints]
    return stack_rows(orientation_error(R, desired.R), desired.p - p, of_joints, rows)


@compiled
def undamped_preference(of_rows: np.ndarray, n: int, rows: TaskRows) -> np.ndarray:
    """x_0 of `References`, (n,): what tasks that are joints ask of these, 0 of others.

    Eq. (34) damps x of J x = b towards 0, and so biases a joint, whose row is a unit
    vector: x = b / (1 + lambda^2). It is damped towards x_0 instead,

        x = x_0 + J* (b - J x_0) = argmin |J x - b|^2 + lambda^2 |x - x_0|^2_W,

    which is x_0 wherever J x_0 = b: targets that one motion fulfils are followed
    exactly. Without such tasks x_0 = 0, and this is Eq. (34).

    Args:
        of_rows: (m,) right-hand side of a level, without weights.
    """
    x_0 = np.zeros(n)
    x_0[rows.joints] = of_rows[rows.joint_rows]
    return x_0


@compiled
def posture_acceleration(
    targets: np.ndarray, q: np.ndarray, qdot: np.ndarray, stiffness: float
) -> np.ndarray:
    """A critically damped pull towards a posture, of the null space (Eq. (33)), (n,).

    Args:
        targets: (n,) positions [rad].
        q, qdot: (n,) present positions [rad] and velocities [rad/s].
        stiffness: [1/s^2].
    """
    return stiffness * (targets - q) - 2.0 * np.sqrt(stiffness) * qdot


@compiled
def find_references(
    state: State, targets: Targets, rows: TaskRows, gains: TaskGains
) -> References:
    """Eqs. (9), (14): what the blended targets ask for, weighted."""
    prescribed, blend, start = targets.prescribed, targets.blend, targets.start
    n_p = len(prescribed) // 3
    n = len(state.v) - n_p
    qdot, qdot_p, q_p = state.v[:n], state.v[n:], state.q[n:]
    q_d, a_d = prescribed[:n_p], prescribed[2 * n_p :]
    v_d = prescribed[n_p : 2 * n_p]
    desired = unpack_tasks(targets.tasks, rows)
    error = e = find_error(state.q, state.R, state.p, desired, rows)
    if blend[0] < 1.0:
        desired = blend_tasks(rows, start, desired, blend)
        q_d, v_d, a_d = blend_vectors(start[len(start) - n_p :], q_d, v_d, a_d, blend)
        e = find_error(state.q, state.R, state.p, desired, rows)
    # Prescribed joints: the desired acceleration, with Eq. (14)'s feedback.
    qddot_p = reference_acceleration(a_d, v_d, qdot_p, q_d - q_p, gains.Kp, gains.Kv)
    v_r = desired.v + gains.K * e  # (9)
    v_task = times(state.J, state.v)
    a_r = reference_acceleration(desired.a, desired.v, v_task, e, gains.Kp, gains.Kv)
    J, J_p = np.ascontiguousarray(state.J[:, :n]), state.J[:, n:]
    v_r = v_r - times(J_p, qdot_p)
    carried = times(J_p, qddot_p)
    a_r = a_r - carried - state.Jdot_qdot
    a_ff, e_dot = desired.a - carried - state.Jdot_qdot, desired.v - v_task
    qdot_0 = undamped_preference(v_r, n, rows)
    qddot_0 = undamped_preference(a_r, n, rows)
    S = gains.weights
    if len(S):
        J, v_r, a_r = S[:, np.newaxis] * J, S * v_r, S * a_r
        e, e_dot, a_ff = S * e, S * e_dot, S * a_ff
    posture = np.zeros(n)
    if len(targets.posture):
        posture = posture_acceleration(
            targets.posture, state.q[:n], qdot, gains.posture
        )
    return References(
        J, v_r, a_r, posture, qddot_p, error, qdot_0, qddot_0, e, e_dot, a_ff
    )
