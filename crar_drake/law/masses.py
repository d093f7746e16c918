"""How the masses of a robot whose base is fixed lie and move, by 4 x 4 matrices.

Points have homogeneous coordinates [x; 1] in the world. A body has the *pseudo-inertia*

    P = int [x; 1] [x; 1]^T dm = [second moments, m c; (m c)^T, m].

A twist S = [s x, t; 0, 0], of the turn s and what it moves the world's origin by, moves
its points by S [x; 1]. Forces L [x; 1] dm, L (4, 4), have L P = int L [x; 1] [x; 1]^T
dm, in which their wrench is (`write_wrench`), and do the work <S, L P> on a twist S.
G. Legnani, F. Casolo, P. Righettini, B. Zappa, "A homogeneous matrix approach to 3D
kinematics and dynamics", Mechanism and Machine Theory 31(5), 1996.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import link_poses


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
