"""Compiled equations from Drake's kinematics to the commanded acceleration."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from crar_drake.compiled.compiler import njit
from crar_drake.compiled.distances import distances
from crar_drake.compiled.vectors import (
    add_square,
    column,
    cross,
    factorize,
    solve,
    times,
    transposed_times,
)
from crar_drake.equations.collisions import DISTANCE_CLAMP
from crar_drake.equations.joint_limits import LIMIT_CLAMP
from crar_drake.equations.lookahead import SMALLEST_MARGIN


class Robot(NamedTuple):
    """What else the step needs of a robot."""

    link: np.ndarray  # (P,) that carries each point, tasks' points first
    p_L: np.ndarray  # (P, 4) homogeneous, in the link's frame [m]
    end_signs: np.ndarray  # (ends, nv)
    carried: np.ndarray  # (tasks, nv) 1 where the joint moves the task
    row_weights: np.ndarray  # (m,)
    controlled: np.ndarray  # (n,)
    prescribed: np.ndarray  # (n_p,)
    lower: np.ndarray  # (n,) as the model has them
    upper: np.ndarray
    potential: np.ndarray  # (5, n) lower, upper, first, last, factor: LimitPotential


class Gains(NamedTuple):
    """The parameters that the step uses."""

    period: float
    K: float
    Kp: float
    Kv: float
    Gv: float
    GvN: float
    damping: float
    rho: float
    alpha: float
    beta: float
    limit_share: float
    T: float
    rho_ahead: float
    rho_limits: float
    distance_margin: float
    limit_margin: float
    retreat_rate: float
    retreat_speed: float
    joint_retreat_speed: float
    slip_share: float
    influence: float


# --- kinematics and references: link_kinematics, equations.tasks and .references ---


@njit
def _points_and_motion(X, ends, robot):
    """Points (K, 3, P) and S (K, 6, nv) of poses X (K, L, 3, 4) and ends' Jacobians
    (K, ends, 6, nv)."""
    K, P, nv = len(X), len(robot.link), ends.shape[3]
    points, S = np.empty((K, 3, P)), np.zeros((K, 6, nv))
    for k in range(K):
        for i in range(P):
            pose, p = X[k, robot.link[i]], robot.p_L[i]
            for a in range(3):
                points[k, a, i] = (
                    pose[a, 0] * p[0] + pose[a, 1] * p[1] + pose[a, 2] * p[2]
                ) + pose[a, 3] * p[3]
        for end in range(ends.shape[1]):
            for row in range(6):
                for c in range(nv):
                    S[k, row, c] += ends[k, end, row, c] * robot.end_signs[end, c]
    return points, S


@njit
def _references(p, S, bias, v, q_p, targets, prescribed, starts, blend, robot, gains):
    """J (m, n), v_r, a_r less the bias (m,), weighted; error (m,), qddot_p (n_p,)."""
    m, n, n_p = len(bias), len(robot.controlled), len(robot.prescribed)
    s, s_dot, s_ddot = blend
    x_p = np.empty((2, n_p))  # velocities and accelerations of the prescribed joints
    for i in range(n_p):
        gap = prescribed[i] - starts[m + i]
        v_d, a_d = prescribed[n_p + i], prescribed[2 * n_p + i]
        wanted = starts[m + i] + s * gap if s < 1.0 else prescribed[i]
        a_d = s_ddot * gap + 2.0 * s_dot * v_d + s * a_d
        v_d = s_dot * gap + s * v_d
        x_p[0, i] = v[robot.prescribed[i]]
        x_p[1, i] = a_d + gains.Kv * (v_d - x_p[0, i]) + gains.Kp * (wanted - q_p[i])
    J, v_r, a_r, error = np.empty((m, n)), np.empty(m), np.empty(m), np.empty(m)
    full = np.empty(len(v))
    for row in range(m):
        task, axis = row // 3, row % 3
        velocity = 0.0
        for c in range(len(v)):
            turn = cross(column(S, c), column(p, task))
            full[c] = (turn[axis] + S[3 + axis, c]) * robot.carried[task, c]
            velocity += full[c] * v[c]
        e = error[row] = targets[row] - p[axis, task]
        gap = targets[row] - starts[row]
        v_d, a_d = targets[m + row], targets[2 * m + row]
        if s < 1.0:
            e = starts[row] + s * gap - p[axis, task]
            a_d = s_ddot * gap + 2.0 * s_dot * v_d + s * a_d
            v_d = s_dot * gap + s * v_d
        by_velocity = v_d + gains.K * e
        by_acceleration = a_d + gains.Kv * (v_d - velocity) + gains.Kp * e
        for i in range(n_p):
            by_velocity -= full[robot.prescribed[i]] * x_p[0, i]
            by_acceleration -= full[robot.prescribed[i]] * x_p[1, i]
        weight = robot.row_weights[row]
        v_r[row] = weight * by_velocity
        a_r[row] = weight * (by_acceleration - bias[row])
        for c in range(n):
            J[row, c] = weight * full[robot.controlled[c]]
    return J, v_r, a_r, error, x_p[1]


# --- constraints "lookahead": equations.lookahead ---------------------------------


@njit
def _limit_gradient(potential, i, q):
    q = min(max(q, potential[2, i]), potential[3, i])
    to_upper, to_lower = potential[1, i] - q, q - potential[0, i]
    return potential[4, i] * (to_lower - to_upper) / (to_upper * to_lower) ** 2


@njit
def _rows(d, dd_dv, q, v, qddot_p, slip, robot, gains):
    """h, weight, drift, retreat as columns (C, 4), g (C, n), and resting margins."""
    n, T, Nc = len(robot.controlled), gains.T, d.shape[1]
    rows, g = np.empty((2 * Nc + n, 4)), np.zeros((2 * Nc + n, n))
    margins = np.full(2, np.inf)
    C = 0
    for k in range(2):
        for j in range(Nc):
            h, gradient = d[k, j], dd_dv[k, j]
            if k == 0:
                for c in range(len(v)):
                    h += T * gradient[c] * v[c]
            margins[0] = min(margins[0], h)
            if not h < gains.influence:
                continue
            drift = approach = 0.0
            for i in range(len(qddot_p)):
                c = robot.prescribed[i]
                drift += gradient[c] * (v[c] + T * qddot_p[i])
            for i in range(n):
                g[C, i] = gradient[robot.controlled[i]]
                approach += g[C, i] * slip[i]
            eta = max(h - gains.distance_margin, SMALLEST_MARGIN)
            weight = gains.rho_ahead * math.exp(-gains.alpha * eta)
            weight *= eta**-gains.beta * (gains.beta / eta + gains.alpha)
            recede = gains.retreat_rate * max(gains.distance_margin - h, 0.0)
            recede = min(recede, gains.retreat_speed)
            rows[C] = np.array((h, weight, drift + min(approach, 0.0), recede))
            C += 1
    for i in range(n):
        if not (np.isfinite(robot.lower[i]) and np.isfinite(robot.upper[i])):
            continue
        q_s = q[robot.controlled[i]] + T * v[robot.controlled[i]]
        to_upper, to_lower = robot.upper[i] - q_s, q_s - robot.lower[i]
        h = min(to_upper, to_lower)
        inward = 1.0 if to_upper >= to_lower else -1.0
        g[C, i] = inward
        weight = gains.rho_limits * abs(_limit_gradient(robot.potential, i, q_s))
        recede = gains.retreat_rate * max(gains.limit_margin - h, 0.0)
        recede = min(recede, gains.joint_retreat_speed)
        rows[C] = np.array((h, weight, min(inward * slip[i], 0.0), recede))
        margins[1] = min(margins[1], h)
        C += 1
    return rows[:C], g[:C], margins


@njit
def _take_up(on, g, s, drift, limit):
    """Adds the rows whose rate g s + drift is below the limit; returns which."""
    added = np.zeros(len(on), dtype=np.bool_)
    for j in range(len(on)):
        if not on[j]:
            rate = drift[j]
            for i in range(len(s)):
                rate += g[j, i] * s[i]
            added[j] = on[j] = rate < limit[j]
    return added


@njit
def _lookahead(J, v_r, a_r, qdot, rows, g, gains):
    """q_ddot, q_dot_c and the diagonal of W: `solve_lookahead`."""
    (m, n), damping2, T = J.shape, gains.damping**2, gains.T
    weight, drift, retreat = rows[:, 1], rows[:, 2], rows[:, 3]
    M, W = np.zeros((n, n)), np.ones(n)
    for row in range(m):
        add_square(M, J[row], 1.0)
    for i in range(n):
        M[i, i] += damping2
    side_v, side_a = transposed_times(J, v_r), transposed_times(J, a_r)
    on = np.zeros(len(g), dtype=np.bool_)
    zero = np.zeros(len(g))
    while True:
        L = M.copy()
        factorize(L)
        qdot_c = solve(L, side_v)
        z = gains.Gv * (qdot_c - qdot)
        right = side_a + damping2 * z if m < n else side_a
        s_0 = qdot + T * (solve(L, right) + z)
        added = _take_up(on, g, s_0, drift, zero)
        if not added.any():
            break
        for j in np.flatnonzero(added):
            add_square(M, g[j], damping2 * weight[j])
            W += weight[j] * g[j] ** 2
            side_v -= damping2 * weight[j] * drift[j] * g[j]
    on[:] = False
    M, side, s = damping2 * np.eye(n), damping2 * s_0, s_0
    while True:
        added = _take_up(on, g, s, drift, retreat)
        if not added.any():
            break
        for j in np.flatnonzero(added):
            add_square(M, g[j], damping2 * weight[j])
            side += damping2 * weight[j] * (retreat[j] - drift[j]) * g[j]
        L = M.copy()
        factorize(L)
        s = solve(L, side)
    return (s - qdot) / T, qdot_c, W


# --- constraints "paper": Eqs. (15)-(35) ------------------------------------------


@njit
def _paper_weights(d, dd_dv, q, near_limit, near_pair, robot, gains):
    """W (n,) of Eq. (27), and the next step's (n,) and (Nc, n) to compare with."""
    n, Nc = len(robot.controlled), len(d)
    W_JL, W_COL = np.ones(n), np.zeros(n)
    limits, pairs = np.empty(n), np.empty((Nc, n))
    for i in range(n):
        q_i = q[robot.controlled[i]]
        magnitude = abs(_limit_gradient(robot.potential, i, q_i))
        inside = min(max(q_i, robot.potential[2, i]), robot.potential[3, i])
        limits[i] = magnitude * (1.0 + abs(q_i - inside) / LIMIT_CLAMP)
        if limits[i] >= near_limit[i]:
            W_JL[i] += magnitude
    for j in range(Nc):
        D = max(d[j], DISTANCE_CLAMP)
        slope = gains.rho * math.exp(-gains.alpha * D) * D**-gains.beta
        slope *= gains.beta / D + gains.alpha
        depth = 1.0 + max(DISTANCE_CLAMP - d[j], 0.0) / DISTANCE_CLAMP
        for i in range(n):
            magnitude = abs(slope * dd_dv[j, robot.controlled[i]])
            pairs[j, i] = magnitude * depth
            W_COL[i] += 1.0 + magnitude if pairs[j, i] >= near_pair[j, i] else 1.0
    W_COL = W_COL / Nc if Nc else np.ones(n)
    return gains.limit_share * W_JL + (1.0 - gains.limit_share) * W_COL, limits, pairs


@njit
def _paper(J, v_r, a_r, qdot, W, gains):
    """q_ddot and q_dot_c; of Eq. (34)'s two forms the one with the smaller system."""
    (m, n), damping2 = J.shape, gains.damping**2
    small = n < m
    A = np.zeros((n, n)) if small else np.zeros((m, m))
    if small:
        for row in range(m):
            add_square(A, J[row], 1.0)
        for i in range(n):
            A[i, i] += damping2 * W[i]
    else:
        for i in range(n):
            add_square(A, J[:, i], 1.0 / W[i])
        for row in range(m):
            A[row, row] += damping2
    factorize(A)
    qdot_c = _inverse_times(A, J, W, v_r, small)
    alpha = _inverse_times(A, J, W, a_r, small)
    if m < n:
        zeta = gains.GvN * (qdot_c - qdot)
        alpha += zeta - _inverse_times(A, J, W, times(J, zeta), small)
    return alpha + gains.Gv * (qdot_c - qdot), qdot_c


@njit
def _inverse_times(L, J, W, x, small):
    """J* x, from the factor."""
    if small:
        return solve(L, transposed_times(J, x))
    return transposed_times(J, solve(L, x)) / W


# --- the step ---------------------------------------------------------------------


@njit
def compiled_step(
    X, ends, bias, q, v, tasks, prescribed, starts, blend, before, near_pair,
    shapes, robot, gains,
):  # fmt: skip
    """Everything between Drake's kinematics and inverse dynamics.

    Args:
        X, ends: (K, L, 3, 4), (K, ends, 6, nv) Drake's poses and Jacobians; K = 2
            configurations for "lookahead", 1 for "paper".
        bias: (m,) Jdot qdot.
        q, v: (nq,), (nv,).
        tasks, prescribed: the targets as they come.
        starts: (m + n_p,) where blending began.
        blend: s, s_dot, s_ddot.
        before: (3, n) of the step before: "lookahead" qdot + period qddot and slip,
            then 1 or, if there was none, 0; "paper" its limit_proximity.
        near_pair: (Nc, n) "paper": its pair_proximity.

    Returns:
        acceleration (nv,), error (m,), distances (Nc,), W (n,), q_dot_c (n,),
        position command (nq + nv,), resting margins (2,), slip or limit_proximity
        (n,), pair_proximity.
    """
    points, S = _points_and_motion(X, ends, robot)
    num_tasks, n = len(robot.carried), len(robot.controlled)
    d, dd_dv = distances(points[:, :, num_tasks:], S, shapes)
    q_p, qdot = q[robot.prescribed], v[robot.controlled]
    J, v_r, a_r, error, qddot_p = _references(
        points[0], S[0], bias, v, q_p, tasks, prescribed, starts, blend, robot, gains
    )
    margins, pairs = np.full(2, np.nan), near_pair
    if len(X) == 2:
        kept = np.zeros(n)
        if before[2, 0] == 1.0:
            seen = gains.T * (qdot - before[0]) / gains.period
            kept = before[1] + gains.slip_share * (seen - before[1])
        rows, g, margins = _rows(d, dd_dv, q, v, qddot_p, kept, robot, gains)
        qddot, qdot_c, W = _lookahead(J, v_r, a_r, qdot, rows, g, gains)
    else:
        W, kept, pairs = _paper_weights(
            d[0], dd_dv[0], q, before[0], near_pair, robot, gains
        )
        qddot, qdot_c = _paper(J, v_r, a_r, qdot, W, gains)
    vdot, command = np.empty(len(v)), np.empty(2 * len(v))
    vdot[robot.controlled], vdot[robot.prescribed] = qddot, qddot_p
    command[len(q) :] = v + gains.period * vdot
    command[: len(q)] = q + gains.period * command[len(q) :]
    return vdot, error, d[0], W, qdot_c, command, margins, kept, pairs
