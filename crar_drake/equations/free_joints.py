"""Configurations of joints that are free in space: quaternions without charts.

A *free* joint (Drake's quaternion floating joint) has seven positions, the unit
quaternion w, x, y, z of its orientation R and then its translation p [m], and six
velocities, its angular velocity [rad/s] and p's velocity [m/s], all in the frame that
it moves in. So positions and velocities differ in number, and a configuration q (nq,)
and a displacement x (nv,) are vectors of two kinds. A robot has at most one such joint,
its root, and only the orientation makes the difference: it begins at the same place
`turn` in both, and all that comes before and after it is plain numbers, the root's
translation, wherever it is among them, too.

A displacement of a free joint is a rotation vector phi and a translation:

    R' = exp(phi) R,        p' = p + x.

t x for t from 0 to 1 is then a way with constant velocities x, from anywhere: there is
no attitude at which anything locks, and nothing that the ways are charted from.
"""

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.vectors import cross, dot, put

QUATERNION, TURN = 4, 3  # entries of an orientation, and of its displacement

# `turn` of vectors without an orientation; any other negative number says the same.
PLAIN = -1

# Below this the sine of an angle is the angle [rad].
_SMALL = 1e-8


@compiled
def quaternion_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a b of two quaternions (4,), w x y z, of any length: first b, then a."""
    c = np.empty(4)
    c[0] = a[0] * b[0] - dot(a[1:], b[1:])
    put(c, 1, a[0] * b[1:] + b[0] * a[1:] + cross(a[1:], b[1:]))
    return c


@compiled
def turned(quaternion: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """The unit quaternion (4,) of exp(phi) R.

    Args:
        quaternion: (4,) of R, of any length but 0.
        phi: (3,) rotation vector [rad], in the frame that R turns into.
    """
    half = 0.5 * np.sqrt(dot(phi, phi))
    turn = np.empty(4)
    turn[0] = np.cos(half)
    put(turn, 1, (0.5 * np.sin(half) / half if half > _SMALL else 0.5) * phi)
    product = quaternion_product(turn, quaternion)
    return product / np.sqrt((product**2).sum())


@compiled
def turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The phi (3,) of R_end = exp(phi) R_start, of a length up to pi [rad].

    Args:
        start, end: (4,) quaternions of either sign, of any length but 0.
    """
    back = -start
    back[0] = start[0]
    turn = quaternion_product(end, back)
    if turn[0] < 0.0:  # the other sign is the shorter way
        turn = -turn
    vector = turn[1:].copy()
    length = np.sqrt(dot(vector, vector))
    if length <= _SMALL * turn[0]:
        return 2.0 * vector / turn[0]
    return vector * (2.0 * np.arctan2(length, turn[0]) / length)


@compiled
def displaced(q: np.ndarray, x: np.ndarray, turn: int) -> np.ndarray:
    """The configuration (nq,) that a displacement x (nv,) leads to from q (nq,).

    Args:
        turn: where the quaternion begins in q, and the rotation vector in x; negative
            if there is none.
    """
    if turn < 0:
        return q + x
    q_after, x_after = turn + QUATERNION, turn + TURN
    moved = np.empty(len(q))
    put(moved, 0, q[:turn] + x[:turn])
    put(moved, turn, turned(q[turn:q_after], x[turn:x_after]))
    put(moved, q_after, q[q_after:] + x[x_after:])
    return moved


@compiled
def displacement(start: np.ndarray, end: np.ndarray, turn: int) -> np.ndarray:
    """The x (nv,) by which `displaced` leads from start (nq,) to end (nq,).

    Of an orientation it is the shorter way round; half a turn may be either.
    """
    if turn < 0:
        return end - start
    q_after, x_after = turn + QUATERNION, turn + TURN
    x = np.empty(len(start) - (QUATERNION - TURN))
    put(x, 0, end[:turn] - start[:turn])
    put(x, turn, turn_between(start[turn:q_after], end[turn:q_after]))
    put(x, x_after, end[q_after:] - start[q_after:])
    return x


@compiled
def turned_by_plant(
    quaternion: np.ndarray,
    omega: np.ndarray,
    alpha: np.ndarray,
    period: float,
    plant_step: float,
) -> np.ndarray:
    """The unit quaternion (4,) where a constant angular acceleration leads to.

    Each step d of a discrete plant of Drake's takes the angular velocity first, and
    then adds d times the quaternion's rate,

        omega_k = omega + k d alpha,        Q_k = (1, d omega_k / 2) Q_(k-1),

    which turns by 2 arctan(d |omega_k| / 2). A continuous one (d = 0) turns by

        phi = D omega + D^2/2 alpha + D^3/12 alpha x omega,        D = period,

    the first terms of Magnus' series, the next of which is of the order D^5.

    Args:
        quaternion: (4,) of any length but 0.
        omega, alpha: (3,) angular velocity [rad/s] and acceleration [rad/s^2].
        period, plant_step: as in `prediction.next_state`.
    """
    if plant_step == 0.0:
        phi = period * omega + 0.5 * period**2 * alpha
        return turned(quaternion, phi + period**3 / 12.0 * cross(alpha, omega))
    steps = max(1, int(round(period / plant_step)))
    step = period / steps
    turn, result = np.ones(4), quaternion
    for k in range(1, steps + 1):
        put(turn, 1, 0.5 * step * (omega + (k * step) * alpha))
        result = quaternion_product(turn, result)
    return result / np.sqrt((result**2).sum())


@compiled
def has_orientation(q: np.ndarray, turn: int) -> bool:
    """Whether the quaternion of a configuration (nq,) has a length other than 0.

    Args:
        turn: where the quaternion begins; negative if there is none to be wrong.
    """
    return turn < 0 or (q[turn : turn + QUATERNION] ** 2).sum() > 0.0
