"""How the masses of a robot whose base is fixed lie and move, what torques that takes,
Eqs. (2), (29), and what wrench of the ground.

Points have homogeneous coordinates [x; 1] in the world. A body has the *pseudo-inertia*

    P = int [x; 1] [x; 1]^T dm = [second moments, m c; (m c)^T, m].

A twist S = [s x, t; 0, 0], of the turn s and what it moves the world's origin by, moves
its points by S [x; 1]. Forces L [x; 1] dm, L (4, 4), have L P = int L [x; 1] [x; 1]^T
dm, in which their wrench is (`write_wrench`), and do the work <S, L P> on a twist S.
G. Legnani, F. Casolo, P. Righettini, B. Zappa, "A homogeneous matrix approach to 3D
kinematics and dynamics", Mechanism and Machine Theory 31(5), 1996.

Torques are what Drake computes, for steps that need them in many states: by Newton and
Euler, a pass outwards and one back (Featherstone, Rigid Body Dynamics Algorithms, 2008,
chapter 5).

The wrench of masses P with the velocities G and the accelerations A, gravity included
in A, is that of A P. A joint j that moves what it carries by the twist S takes P to
(1 + S) P (1 + S)^T, and leaves how its own frame moves, G_j and A_j, as it is. So with
K = [G_j, S], Z = [A_j, S] - 2 K G_j, and momentum H = G P and forces F = A P of all
that it carries,

    dw/dq_ddot = wrench of S P
    dw/dq_dot  = wrench of 2 (K P + S H)
    dw/dq      = wrench of S F + F S^T + Z P + 2 K H.                              (B6)
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import link_poses
from crar_drake.law.vectors import add_to


class Masses(NamedTuple):
    """The masses of a robot whose base is fixed; all that is welded is one frame.

    Of the N frames of `Tree`, the world's, 0, has the base. Each other moves by one
    velocity.
    """

    tree: Held  # of a `Tree`
    velocity: np.ndarray  # (N,) the index in v of what moves the frame; 0's any
    turn: np.ndarray  # (N, 3) its axis of rotation in the frame, 0 if it only slides
    slide: np.ndarray  # (N, 3) how it slides in the frame, 0 if it only turns
    inertia: np.ndarray  # (N, 4, 4) P, in the frame [kg m^2, kg m and kg]
    g: float  # [m/s^2], downwards


class Dynamics(NamedTuple):
    """What torques follow from; made by `robot.dynamics.find_dynamics`."""

    masses: Held  # of `Masses`
    gravity: np.ndarray  # (3,) [m/s^2]
    # (N, 4) [m c; m] of the masses in each frame that gravity pulls at [kg m, kg]
    heavy: np.ndarray
    # (nv,) of each velocity: what its acceleration takes besides (rotors, implicit
    # damping) [kg m^2 or kg], and its velocity [Nms or Ns/m]
    rotors: np.ndarray
    damping: np.ndarray
    # (nv,) springs: k q - slack [Nm/rad or N/m], [Nm or N]
    stiffness: np.ndarray
    slack: np.ndarray


@compiled
def place_masses(
    q: np.ndarray, masses: Masses
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the frames are, and what they have.

    Args:
        q: (nq,) positions, in the plant's order.
        masses: of the robot.

    Returns:
        X (4 N, 3) of `link_poses`; of each frame in the world S (N, 4, 4), the twist of
        its joint, and P (N, 4, 4).
    """
    tree = masses.tree.value
    N = len(masses.inertia)
    X = link_poses(q.reshape(1, -1), tree, tree.every)[0]
    S, P = np.zeros((2, N, 4, 4))
    pose, half, s, t = np.zeros((4, 4)), np.zeros((4, 4)), np.empty(3), np.empty(3)
    pose[3, 3] = 1.0
    for i in range(N):
        for k in range(3):
            s[k], t[k] = 0.0, 0.0
            for c in range(4):
                pose[k, c] = X[4 * i + c, k]
            for c in range(3):
                s[k] += pose[k, c] * masses.turn[i, c]
                t[k] += pose[k, c] * masses.slide[i, c]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            S[i, n, m], S[i, m, n] = s[k], -s[k]
            S[i, k, 3] = t[k] + pose[m, 3] * s[n] - pose[n, 3] * s[m]
        half[:3] = 0.0
        add_product(pose, masses.inertia[i], 1.0, half)
        add_product(half, pose.T, 1.0, P[i])
        for c in range(3):
            P[i, 3, c] = P[i, c, 3]
        P[i, 3, 3] = masses.inertia[i, 3, 3]
    return X, S, P


@compiled
def move_masses(
    S: np.ndarray, v: np.ndarray, vdot: np.ndarray, masses: Masses
) -> tuple[np.ndarray, np.ndarray]:
    """G, A (N, 4, 4): the points of each frame have the velocities G [x; 1] and the
    accelerations A [x; 1].

    A frame that moves against its parent by S has A = A_up + v_dot S + v (G_up + G) S.

    Args:
        S: (N, 4, 4) of `place_masses`.
        v, vdot: (nv,), (nv,) velocities and accelerations, in the plant's order.
        masses: of the robot.
    """
    tree = masses.tree.value
    G, A = np.zeros((2, len(S), 4, 4))
    both = np.empty((4, 4))
    for i in range(1, len(S)):
        up, j = tree.parent[i], masses.velocity[i]
        for r in range(3):
            for c in range(4):
                G[i, r, c] = G[up, r, c] + v[j] * S[i, r, c]
                A[i, r, c] = A[up, r, c] + vdot[j] * S[i, r, c]
                both[r, c] = G[up, r, c] + G[i, r, c]
        add_product(both, S[i], v[j], A[i])
    return G, A


@compiled
def add_product(A: np.ndarray, B: np.ndarray, by: float, to: np.ndarray) -> None:
    """Adds A B, times `by`, to a matrix; all (4, 4), without the last rows."""
    for r in range(3):
        x, y, z, w = by * A[r, 0], by * A[r, 1], by * A[r, 2], by * A[r, 3]
        for c in range(4):
            to[r, c] += x * B[0, c] + y * B[1, c] + z * B[2, c] + w * B[3, c]


@compiled
def work(S: np.ndarray, forces: np.ndarray) -> float:
    """<S, L P>: what forces do on a twist."""
    done = 0.0
    for r in range(3):
        for c in range(4):
            done += S[r, c] * forces[r, c]
    return done


@compiled
def write_wrench(forces: np.ndarray, w: np.ndarray) -> None:
    """Writes the wrench (6,) of L P: moment about the world's origin, and force."""
    for k in range(3):
        m, n = (k + 1) % 3, (k + 2) % 3
        w[k] = forces[n, m] - forces[m, n]
        w[3 + k] = forces[k, 3]


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
    X, S, P = place_masses(q, masses)
    _, A = move_masses(S, v, vdot, masses)
    forces = np.zeros_like(S)
    tau = dynamics.rotors * vdot + dynamics.damping * v
    for i in range(len(S) - 1, 0, -1):
        up, at = tree.parent[i], masses.velocity[i]
        add_product(A[i], P[i], 1.0, forces[i])
        for c in range(3):
            moment = 0.0
            for j in range(4):
                moment += dynamics.heavy[i, j] * X[4 * i + j, c]
            for r in range(3):
                forces[i, r, c] -= dynamics.gravity[r] * moment
            forces[i, c, 3] -= dynamics.gravity[c] * dynamics.heavy[i, 3]
        tau[at] += dynamics.stiffness[at] * q[tree.position[i]] - dynamics.slack[at]
        tau[at] += work(S[i], forces[i])
        add_to(forces[up], forces[i])
    return tau


@compiled
def inertia_matrix(q: np.ndarray, dynamics: Dynamics) -> np.ndarray:
    """H (nv, nv) of `joint_torques`, by composite bodies (Featherstone, 2008, chapter
    6) [kg m^2, kg m or kg].

    Args:
        q: (nv,) in the plant's order.
        dynamics: of the robot.
    """
    masses = dynamics.masses.value
    tree = masses.tree.value
    _, S, P = place_masses(q, masses)
    H, forces = np.diag(dynamics.rotors), np.empty((4, 4))
    for i in range(len(S) - 1, 0, -1):
        up, row = tree.parent[i], masses.velocity[i]
        forces[:] = 0.0
        add_product(S[i], P[i], 1.0, forces)
        j = i
        while j:
            value, column = work(S[j], forces), masses.velocity[j]
            H[row, column] += value
            if j != i:
                H[column, row] += value
            j = tree.parent[j]
        add_to(P[up], P[i])
    return H


@compiled
def wrenches(
    q: np.ndarray, v: np.ndarray, vdot: np.ndarray, masses: Masses
) -> np.ndarray:
    """The wrench that the ground must give, (3, 6), in three parts [Nm and N]: of the
    weight; of velocities alone, centripetal and gyroscopic; of accelerations alone.

    Args:
        q: (nq,) positions, in the plant's order.
        v, vdot: (nv,), (nv,) velocities and accelerations, likewise.
        masses: of the robot.
    """
    tree = masses.tree.value
    _, S, P = place_masses(q, masses)
    _, turning = move_masses(S, v, np.zeros(len(v)), masses)
    pushed, forces, found = np.zeros_like(S), np.zeros((3, 4, 4)), np.empty((3, 6))
    for i in range(len(P)):
        up, rate = tree.parent[i], vdot[masses.velocity[i]] if i else 0.0
        for r in range(3):
            for c in range(4):
                pushed[i, r, c] = pushed[up, r, c] + rate * S[i, r, c]
        for c in range(4):
            forces[0, 2, c] += masses.g * P[i, 3, c]
        add_product(turning[i], P[i], 1.0, forces[1])
        add_product(pushed[i], P[i], 1.0, forces[2])
    for k in range(3):
        write_wrench(forces[k], found[k])
    return found


@compiled
def wrench_slopes(
    q: np.ndarray,
    v: np.ndarray,
    vdot: np.ndarray,
    joints: np.ndarray,
    masses: Masses,
) -> np.ndarray:
    """(B6): slopes (n, 3, 6) of the sum of `wrenches` by q, by v and by vdot.

    Args:
        q, v, vdot, masses: as of `wrenches`.
        joints: (n,) velocities that it is asked of; each alone moves one frame.
    """
    tree = masses.tree.value
    _, S, P = place_masses(q, masses)
    G, A = move_masses(S, v, vdot, masses)
    N, column = len(P), np.full(len(v), -1)
    for j in range(len(joints)):
        column[joints[j]] = j
    H, F = np.zeros((2, N, 4, 4))
    for i in range(N):
        A[i, 2, 3] += masses.g
        add_product(G[i], P[i], 1.0, H[i])
        add_product(A[i], P[i], 1.0, F[i])
    slopes = np.empty((len(joints), 3, 6))
    K, Z, change = np.empty((3, 4, 4))
    for i in range(N - 1, 0, -1):
        up, j = tree.parent[i], column[masses.velocity[i]]
        if j >= 0:
            K[:], Z[:] = 0.0, 0.0
            add_product(G[i], S[i], 1.0, K)
            add_product(S[i], G[i], -1.0, K)
            add_product(A[i], S[i], 1.0, Z)
            add_product(S[i], A[i], -1.0, Z)
            add_product(K, G[i], -2.0, Z)
            change[:] = 0.0
            add_product(S[i], F[i], 1.0, change)
            add_product(F[i], S[i].T, 1.0, change)
            add_product(Z, P[i], 1.0, change)
            add_product(K, H[i], 2.0, change)
            write_wrench(change, slopes[j, 0])
            change[:] = 0.0
            add_product(K, P[i], 2.0, change)
            add_product(S[i], H[i], 2.0, change)
            write_wrench(change, slopes[j, 1])
            change[:] = 0.0
            add_product(S[i], P[i], 1.0, change)
            write_wrench(change, slopes[j, 2])
        for of in (P, H, F):
            add_to(of[up], of[i])
    return slopes
