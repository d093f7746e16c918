"""Inverse dynamics, Eqs. (2), (29), of a robot whose base is fixed.

Newton and Euler by a pass outwards and one back (Featherstone, Rigid Body Dynamics
Algorithms, 2008, chapter 5), with the matrices of `law.masses`. It is what Drake
computes, for steps that need torques in many states.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.masses import (
    add_product,
    move_masses,
    place_masses,
    work,
)


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
        for r in range(3):
            for c in range(4):
                forces[up, r, c] += forces[i, r, c]
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
        for r in range(4):
            for c in range(4):
                P[up, r, c] += P[i, r, c]
    return H
