"""Inverse dynamics, Eqs. (2), (29), of a robot whose base is fixed.

Newton and Euler by a pass outwards and one back (Featherstone, Rigid Body Dynamics
Algorithms, 2008, chapter 5), about the world's origin. It is what Drake computes, for
steps that need torques in many states.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import link_poses
from crar_drake.law.wrenches import turn_body


class Dynamics(NamedTuple):
    """What torques follow from; made by `robot.dynamics.find_dynamics`."""

    masses: Held  # of `Masses`
    gravity: np.ndarray  # (3,) [m/s^2]
    heavy: np.ndarray  # (N,) the mass of each frame that gravity pulls at [kg]
    heavy_moment: np.ndarray  # (N, 3) times its centre, in the frame [kg m]
    # (nv,) of each velocity: what its acceleration takes besides (rotors, implicit
    # damping) [kg m^2 or kg], and its velocity [Nms or Ns/m]
    rotors: np.ndarray
    damping: np.ndarray
    # (nv,) springs: k q - slack [Nm/rad or N/m], [Nm or N]
    stiffness: np.ndarray
    slack: np.ndarray


@compiled
def _joint_motion(R, p, turn, slide, S):
    """Writes S (6,), zeros before: how a joint moves what passes the world's origin."""
    for k in range(3):
        for j in range(3):
            S[k] += turn[j] * R[j, k]
            S[3 + k] += slide[j] * R[j, k]
    for k in range(3):
        m, n = (k + 1) % 3, (k + 2) % 3
        S[3 + k] += p[m] * S[n] - p[n] * S[m]


@compiled
def joint_torques(
    q: np.ndarray, v: np.ndarray, vdot: np.ndarray, dynamics: Dynamics
) -> np.ndarray:
    """tau = H q_ddot + C q_dot + tau_g, (nv,) [Nm or N].

    Args:
        q, v, vdot: (nv,), (nv,), (nv,) in the plant's order.
        dynamics: of the robot.
    """
    masses = dynamics.masses.value
    tree = masses.tree.value
    N = len(masses.mass)
    X = link_poses(q.reshape(1, -1), tree, tree.every)[0]
    # Of each frame, about the world's origin: its joint's motion S, its velocity V, its
    # acceleration A and the wrench F on it.
    S, V, A, F = np.zeros((4, N, 6))
    own, c, pull = np.empty(6), np.empty(3), np.empty(3)
    turns, spin, change = np.empty((2, 3)), np.empty(3), np.empty(3)
    for i in range(1, N):
        R, p = X[4 * i : 4 * i + 3], X[4 * i + 3]  # R transposed
        up, at = tree.parent[i], masses.velocity[i]
        _joint_motion(R, p, masses.turn[i], masses.slide[i], S[i])
        for k in range(6):
            own[k] = v[at] * S[i, k]
            V[i, k] = V[up, k] + own[k]
            A[i, k] = A[up, k] + vdot[at] * S[i, k]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            A[i, k] += V[i, m] * own[n] - V[i, n] * own[m]
            A[i, 3 + k] += V[i, m] * own[3 + n] - V[i, n] * own[3 + m]
            A[i, 3 + k] += V[i, 3 + m] * own[n] - V[i, 3 + n] * own[m]
        mass = masses.mass[i]
        if mass == 0.0:
            continue
        # The centre's acceleration, less gravity's share of the force.
        for k in range(3):
            c[k] = p[k]
            for j in range(3):
                c[k] += masses.centre[i, j] * R[j, k]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            own[k] = V[i, 3 + k] + V[i, m] * c[n] - V[i, n] * c[m]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            a = A[i, 3 + k] + A[i, m] * c[n] - A[i, n] * c[m]
            F[i, 3 + k] = mass * (a + V[i, m] * own[n] - V[i, n] * own[m])
        turn_body(R, masses.inertia[i], V[i, :3], A[i, :3], turns, spin, change)
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            F[i, k] = c[m] * F[i, 3 + n] - c[n] * F[i, 3 + m]
            pull[k] = dynamics.heavy[i] * p[k]
            for j in range(3):
                F[i, k] += change[j] * R[j, k]
                pull[k] += dynamics.heavy_moment[i, j] * R[j, k]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            F[i, k] -= pull[m] * dynamics.gravity[n] - pull[n] * dynamics.gravity[m]
            F[i, 3 + k] -= dynamics.heavy[i] * dynamics.gravity[k]
    tau = dynamics.rotors * vdot + dynamics.damping * v
    for i in range(N - 1, 0, -1):
        up, at = tree.parent[i], masses.velocity[i]
        tau[at] += dynamics.stiffness[at] * q[tree.position[i]] - dynamics.slack[at]
        for k in range(6):
            tau[at] += S[i, k] * F[i, k]
            F[up, k] += F[i, k]
    return tau


@compiled
def inertia_matrix(q: np.ndarray, dynamics: Dynamics) -> np.ndarray:
    """H (nv, nv) of `joint_torques`, by composite bodies (Featherstone, 2008, chapter
    6), about the world's origin [kg m^2, kg m or kg].

    Args:
        q: (nv,) in the plant's order.
        dynamics: of the robot.
    """
    masses = dynamics.masses.value
    tree = masses.tree.value
    N = len(masses.mass)
    X = link_poses(q.reshape(1, -1), tree, tree.every)[0]
    # Of all that a frame carries: mass, mass times centre, inertia about the origin.
    m, h, J, S = np.zeros(N), np.zeros((N, 3)), np.zeros((N, 3, 3)), np.zeros((N, 6))
    turned, force = np.empty((3, 3)), np.empty(6)
    for i in range(1, N):
        R, p = X[4 * i : 4 * i + 3], X[4 * i + 3]  # R transposed
        _joint_motion(R, p, masses.turn[i], masses.slide[i], S[i])
        mass = masses.mass[i]
        if mass == 0.0:
            continue
        m[i] = mass
        for k in range(3):
            h[i, k] = mass * p[k]
            for j in range(3):
                h[i, k] += mass * masses.centre[i, j] * R[j, k]
                turned[j, k] = 0.0
                for c in range(3):
                    turned[j, k] += masses.inertia[i, j, c] * R[c, k]
        square = (h[i, 0] ** 2 + h[i, 1] ** 2 + h[i, 2] ** 2) / mass
        for k in range(3):
            J[i, k, k] = square
            for c in range(3):
                J[i, k, c] -= h[i, k] * h[i, c] / mass
                for j in range(3):
                    J[i, k, c] += R[j, k] * turned[j, c]
    H = np.diag(dynamics.rotors)
    for i in range(N - 1, 0, -1):
        up, row = tree.parent[i], masses.velocity[i]
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            force[k] = h[i, a] * S[i, 3 + b] - h[i, b] * S[i, 3 + a]
            force[3 + k] = m[i] * S[i, 3 + k] - (h[i, a] * S[i, b] - h[i, b] * S[i, a])
            for c in range(3):
                force[k] += J[i, k, c] * S[i, c]
        j = i
        while j:
            value = 0.0
            for k in range(6):
                value += S[j, k] * force[k]
            column = masses.velocity[j]
            H[row, column] += value
            if j != i:
                H[column, row] += value
            j = tree.parent[j]
        m[up] += m[i]
        for k in range(3):
            h[up, k] += h[i, k]
            for c in range(3):
                J[up, k, c] += J[i, k, c]
    return H
