"""The wrenches of a robot whose base is fixed, and how they change with its joints.

Of masses P with the velocities G and the accelerations A, see `law.masses`, gravity
included in A,

    w = wrench of A P.

A joint j that moves what it carries by the twist S takes P to (1 + S) P (1 + S)^T, and
leaves how its own frame moves, G_j and A_j, as it is. So with K = [G_j, S], Z =
[A_j, S] - 2 K G_j, and momentum H = G P and forces F = A P of all that it carries,

    dw/dq_ddot = wrench of S P
    dw/dq_dot  = wrench of 2 (K P + S H)
    dw/dq      = wrench of S F + F S^T + Z P + 2 K H.                              (B6)
"""

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.masses import (
    Masses,
    add_product,
    move_masses,
    place_masses,
    write_wrench,
)


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
        for r in range(4):
            for c in range(4):
                P[up, r, c] += P[i, r, c]
                H[up, r, c] += H[i, r, c]
                F[up, r, c] += F[i, r, c]
    return slopes
