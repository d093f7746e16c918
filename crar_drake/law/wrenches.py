"""The wrenches of a robot whose base is fixed, and how they change with its joints.

The wrenches are those of (B1) in `law.balance`. Their slopes come of one pass:
with 4 x 4 matrices a mass is at X(q); its velocity is G X, its acceleration
(A + G^2) X, with the twists G and A = dG/dt, where q_ddot = 0. A joint j that moves
what it carries by the twist S takes X to (1 + S) X, and leaves G_j and A_j of its own
frame as they are. So with K = [G_j, S] and Z = [A_j, S] + [G_j, K], and momentum,
turning, inertia I and integrals over the points rho that it carries,

    d momentum / dx = I S
    d momentum / dq = S x* momentum + I K
    d turning / dx = 2 (I K + int S rho_dot)
    d turning / dq = S x* turning + I Z + 2 int K rho_dot,                         (B6)

where int S rho_dot, the wrench of the forces s x rho_dot dm with the turn s of S, is
[(tr D) s - D s; s x p] with D = int rho_dot rho^T dm and p = int rho_dot dm.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import link_poses

# The columns of `wrench_slopes`.
WEIGHT_Q, TURNING_Q, TURNING_X, MOMENTUM_Q, MOMENTUM_X = range(5)


class Masses(NamedTuple):
    """The masses of a robot whose base is fixed; all that is welded is one frame.

    Of the N frames of `Tree`, the world's, 0, has the base. Each other moves by one
    velocity.
    """

    tree: Held  # of a `Tree`
    velocity: np.ndarray  # (N,) the index in v of what moves the frame; 0's any
    turn: np.ndarray  # (N, 3) its axis of rotation in the frame, 0 if it only slides
    slide: np.ndarray  # (N, 3) the direction of its slide in the frame, 0 if it turns
    mass: np.ndarray  # (N,) [kg]
    centre: np.ndarray  # (N, 3) of mass, in the frame [m]
    inertia: np.ndarray  # (N, 3, 3) about the centre, in the frame's axes [kg m^2]
    offset: np.ndarray  # (N,) how far the frame is from its parent, joints at 0 [m]
    radius: np.ndarray  # (N,) root mean square distance of its masses from it [m]
    g: float  # [m/s^2], downwards


class Wrenches(NamedTuple):
    """The three terms of (B1) at a configuration, (6,) each, for displacements x."""

    weight: np.ndarray
    turning: np.ndarray
    momentum: np.ndarray


@compiled
def turn_body(
    R: np.ndarray,
    inertia: np.ndarray,
    w: np.ndarray,
    alpha: np.ndarray,
    own: np.ndarray,
    spin: np.ndarray,
    change: np.ndarray,
) -> None:
    """Writes spin = I w and change = I alpha + w x I w, (3,) each, in the body's axes.

    Args:
        R: (3, 3) from the world's axes to the body's.
        inertia: (3, 3) I about its centre, in its axes.
        w, alpha: (3,), (3,) how it turns, in the world.
        own: (2, 3) to compute in.
    """
    for j in range(3):
        own[0, j], own[1, j] = 0.0, 0.0
        for k in range(3):
            own[0, j] += R[j, k] * w[k]
            own[1, j] += R[j, k] * alpha[k]
    for j in range(3):
        spin[j], change[j] = 0.0, 0.0
        for k in range(3):
            spin[j] += inertia[j, k] * own[0, k]
            change[j] += inertia[j, k] * own[1, k]
    for j in range(3):
        m, n = (j + 1) % 3, (j + 2) % 3
        change[j] += own[0, m] * spin[n] - own[0, n] * spin[m]


@compiled
def wrenches(q: np.ndarray, x: np.ndarray, masses: Masses) -> Wrenches:
    """The terms of (B1) by a pass from the base outwards (Featherstone, Rigid Body
    Dynamics Algorithms, 2008, chapter 5), about the world's origin.

    Args:
        q: (nq,) positions, in the plant's order.
        x: (nv,) velocities, or displacements of a path, likewise.
        masses: of the robot.
    """
    tree = masses.tree.value
    N = len(masses.mass)
    X = link_poses(q.reshape(1, -1), tree, tree.every)[0]
    # Velocity and acceleration of what passes the world's origin, with each frame.
    w, u = np.zeros((N, 3)), np.zeros((N, 3))
    alpha, a = np.zeros((N, 3)), np.zeros((N, 3))
    weight, turning, momentum = np.zeros(6), np.zeros(6), np.zeros(6)
    s, t, c, v, acc = np.empty((5, 3))
    own, spin, change = np.empty((2, 3)), np.empty(3), np.empty(3)
    moves = np.zeros(N, dtype=np.bool_)
    for i in range(N):
        R, p = X[4 * i : 4 * i + 3], X[4 * i + 3]  # R transposed
        if i:
            up, rate = tree.parent[i], x[masses.velocity[i]]
            moves[i] = moves[up] or rate != 0.0
        if moves[i]:
            for k in range(3):
                s[k], t[k] = 0.0, 0.0
                for j in range(3):
                    s[k] += rate * masses.turn[i, j] * R[j, k]
                    t[k] += rate * masses.slide[i, j] * R[j, k]
            for k in range(3):
                m, n = (k + 1) % 3, (k + 2) % 3
                v[k] = t[k] + p[m] * s[n] - p[n] * s[m]
            for k in range(3):
                w[i, k] = w[up, k] + s[k]
                u[i, k] = u[up, k] + v[k]
            for k in range(3):
                m, n = (k + 1) % 3, (k + 2) % 3
                # d/dt of the joint's own motion [s; v], as of `task_bias`.
                alpha[i, k] = alpha[up, k] + w[i, m] * s[n] - w[i, n] * s[m]
                a[i, k] = a[up, k] + (w[i, m] * v[n] - w[i, n] * v[m])
                a[i, k] += u[i, m] * s[n] - u[i, n] * s[m]
        mass = masses.mass[i]
        if mass == 0.0:
            continue
        for k in range(3):
            c[k] = p[k]
            for j in range(3):
                c[k] += masses.centre[i, j] * R[j, k]
        weight[0] += mass * masses.g * c[1]
        weight[1] -= mass * masses.g * c[0]
        weight[5] += mass * masses.g
        if not moves[i]:
            continue
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            v[k] = u[i, k] + w[i, m] * c[n] - w[i, n] * c[m]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            acc[k] = a[i, k] + alpha[i, m] * c[n] - alpha[i, n] * c[m]
            acc[k] += w[i, m] * v[n] - w[i, n] * v[m]
        turn_body(R, masses.inertia[i], w[i], alpha[i], own, spin, change)
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            momentum[k] += mass * (c[m] * v[n] - c[n] * v[m])
            turning[k] += mass * (c[m] * acc[n] - c[n] * acc[m])
            momentum[3 + k] += mass * v[k]
            turning[3 + k] += mass * acc[k]
            for j in range(3):
                momentum[k] += spin[j] * R[j, k]
                turning[k] += change[j] * R[j, k]
    return Wrenches(weight, turning, momentum)


@compiled
def wrench_slopes(
    q: np.ndarray, x: np.ndarray, joints: np.ndarray, masses: Masses
) -> np.ndarray:
    """(B6): slopes (n, 5, 6) of `wrenches`: of its weight by q; of its turning by q and
    by x; and of its momentum by q and by x.

    Args:
        q: (nq,) positions, in the plant's order.
        x: (nv,) velocities, likewise.
        joints: (n,) velocities that it is asked of; each alone moves one frame.
    """
    tree = masses.tree.value
    N, n = len(masses.mass), len(joints)
    column = np.full(len(x), -1)
    for j in range(n):
        column[joints[j]] = j
    X = link_poses(q.reshape(1, -1), tree, tree.every)[0]
    S, V, A = np.zeros((N, 6)), np.zeros((N, 6)), np.zeros((N, 6))
    # Of what each frame carries: mass, first moment, inertia about the world's origin,
    # D, momentum, turning.
    m, s = np.zeros(N), np.zeros((N, 3))
    inertia, D = np.zeros((N, 3, 3)), np.zeros((N, 3, 3))
    h, f = np.zeros((N, 6)), np.zeros((N, 6))
    c, turned = np.empty(3), np.empty((3, 3))
    carried = np.zeros(N, dtype=np.bool_)
    for i in range(N):
        R, p = X[4 * i : 4 * i + 3], X[4 * i + 3]  # R transposed
        if i:
            up, rate = tree.parent[i], x[masses.velocity[i]]
            carried[i] = carried[up] or column[masses.velocity[i]] >= 0
            if not carried[i] and rate == 0.0 and not V[up].any():
                continue
            for k in range(3):
                for j in range(3):
                    S[i, k] += masses.turn[i, j] * R[j, k]
                    S[i, 3 + k] += masses.slide[i, j] * R[j, k]
            for k in range(3):
                a, b = (k + 1) % 3, (k + 2) % 3
                S[i, 3 + k] += p[a] * S[i, b] - p[b] * S[i, a]
            for k in range(6):
                V[i, k] = V[up, k] + rate * S[i, k]
                A[i, k] = A[up, k]
            _add_bracket(V[i], S[i], rate, A[i])
        mass = masses.mass[i]
        if mass == 0.0 or not carried[i]:
            continue
        for k in range(3):
            c[k] = p[k]
            for j in range(3):
                c[k] += masses.centre[i, j] * R[j, k]
                turned[k, j] = 0.0
                for b in range(3):
                    turned[k, j] += masses.inertia[i, k, b] * R[b, j]
        m[i] = mass
        square = c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
        trace = 0.0
        for k in range(3):
            s[i, k] = mass * c[k]
            for j in range(3):
                value = -mass * c[k] * c[j]
                for b in range(3):
                    value += R[b, k] * turned[b, j]
                inertia[i, k, j] = value
            inertia[i, k, k] += mass * square
            trace += inertia[i, k, k]
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            for j in range(3):
                # The second moment is trace / 2 - inertia.
                D[i, k, j] = V[i, 3 + k] * s[i, j]
                D[i, k, j] -= V[i, a] * inertia[i, b, j] - V[i, b] * inertia[i, a, j]
            D[i, k, b] += 0.5 * trace * V[i, a]
            D[i, k, a] -= 0.5 * trace * V[i, b]
        _add_inertial(m[i], s[i], inertia[i], V[i], 1.0, h[i])
        _add_inertial(m[i], s[i], inertia[i], A[i], 1.0, f[i])
        _add_turned(D[i], h[i], V[i], 1.0, f[i])
    for i in range(N - 1, 0, -1):
        up = tree.parent[i]
        if not carried[up]:
            continue
        m[up] += m[i]
        for k in range(3):
            s[up, k] += s[i, k]
            for j in range(3):
                inertia[up, k, j] += inertia[i, k, j]
                D[up, k, j] += D[i, k, j]
        for k in range(6):
            h[up, k] += h[i, k]
            f[up, k] += f[i, k]
    slopes = np.zeros((n, 5, 6))
    K, Z = np.empty(6), np.empty(6)
    for i in range(1, N):
        j = column[masses.velocity[i]]
        if j < 0:
            continue
        found = slopes[j]
        for k in range(6):
            K[k], Z[k] = 0.0, 0.0
        _add_bracket(V[i], S[i], 1.0, K)
        _add_bracket(A[i], S[i], 1.0, Z)
        _add_bracket(V[i], K, 1.0, Z)
        for k in range(2):
            a, b = (k + 1) % 3, (k + 2) % 3
            moved = S[i, 3 + k] * m[i] + S[i, a] * s[i, b] - S[i, b] * s[i, a]
            found[WEIGHT_Q, 1 - k] = (-masses.g if k == 0 else masses.g) * moved
        _add_inertial(m[i], s[i], inertia[i], S[i], 1.0, found[MOMENTUM_X])
        _add_crossed(S[i], h[i], found[MOMENTUM_Q])
        _add_inertial(m[i], s[i], inertia[i], K, 1.0, found[MOMENTUM_Q])
        _add_inertial(m[i], s[i], inertia[i], K, 2.0, found[TURNING_X])
        _add_turned(D[i], h[i], S[i], 2.0, found[TURNING_X])
        _add_crossed(S[i], f[i], found[TURNING_Q])
        _add_inertial(m[i], s[i], inertia[i], Z, 1.0, found[TURNING_Q])
        _add_turned(D[i], h[i], K, 2.0, found[TURNING_Q])
    return slopes


@compiled
def _add_bracket(V: np.ndarray, S: np.ndarray, by: float, to: np.ndarray) -> None:
    """Adds the bracket of two twists (6,), times `by`."""
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        to[k] += by * (V[a] * S[b] - V[b] * S[a])
        to[3 + k] += by * (V[a] * S[3 + b] - V[b] * S[3 + a])
        to[3 + k] += by * (V[3 + a] * S[b] - V[3 + b] * S[a])


@compiled
def _add_inertial(m, s, inertia, V, by, to):
    """Adds I V, times `by`: the momentum of masses that move by the twist V."""
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        value = s[a] * V[3 + b] - s[b] * V[3 + a]
        for j in range(3):
            value += inertia[k, j] * V[j]
        to[k] += by * value
        to[3 + k] += by * (V[a] * s[b] - V[b] * s[a] + m * V[3 + k])


@compiled
def _add_crossed(S, w, to):
    """Adds S x* w: how a wrench changes that is moved by the twist S."""
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        to[k] += S[a] * w[b] - S[b] * w[a]
        to[k] += S[3 + a] * w[3 + b] - S[3 + b] * w[3 + a]
        to[3 + k] += S[a] * w[3 + b] - S[b] * w[3 + a]


@compiled
def _add_turned(D, h, S, by, to):
    """Adds int S rho_dot, times `by`, of masses with D and the momentum h."""
    trace = D[0, 0] + D[1, 1] + D[2, 2]
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        value = trace * S[k]
        for j in range(3):
            value -= D[k, j] * S[j]
        to[k] += by * value
        to[3 + k] += by * (S[a] * h[3 + b] - S[b] * h[3 + a])
