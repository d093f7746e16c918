"""Turns of orientations that are given as quaternions, w x y z.

An orientation R that turns by a rotation vector phi becomes R' = exp(phi) R.
"""

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.vectors import cross, dot, put

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
def turned_on(
    quaternion: np.ndarray, omega: np.ndarray, alpha: np.ndarray, period: float
) -> np.ndarray:
    """The unit quaternion (4,) where a constant angular acceleration leads to, by

        phi = D omega + D^2/2 alpha + D^3/12 alpha x omega,        D = period,

    the first terms of Magnus' series, the next of which is of the order D^5.

    Args:
        quaternion: (4,) of any length but 0.
        omega, alpha: (3,) angular velocity [rad/s] and acceleration [rad/s^2].
        period: [s].
    """
    phi = period * omega + 0.5 * period**2 * alpha
    return turned(quaternion, phi + period**3 / 12.0 * cross(alpha, omega))
