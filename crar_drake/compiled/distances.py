"""Compiled distances of capsules and their gradients: `equations.capsule_distances`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from crar_drake.compiled.compiler import njit
from crar_drake.compiled.vectors import along, column, cross, dot, unit

# As in equations.capsule_distances.
_NEARLY_PARALLEL, _PARALLEL, _TOUCHING = 1e-8, 1e-24, 1e-12


class Shapes(NamedTuple):
    """What the distances need of a robot, by shape pair (N,) and watched pair (Nc,)."""

    axis_a: np.ndarray  # (N,) which axis is a's
    axis_b: np.ndarray
    uu: np.ndarray  # (N,) squared lengths [m^2]
    vv: np.ndarray
    radii: np.ndarray  # (N,) sum of both [m]
    pair: np.ndarray  # (N,) the watched pair it belongs to
    moves: np.ndarray  # (Nc, nv) see `distance_gradient_about_origin`


@njit
def distances(points, S, shapes):
    """Distances (K, Nc) and gradients (K, Nc, nv), Eq. (20), in K configurations.

    Args:
        points: (K, 3, 2 Na) starts of all axes and the vectors to their ends [m].
        S: (K, 6, nv) see `LinkKinematics`.
    """
    K, num_axes = len(points), points.shape[2] // 2
    num_pairs, nv = shapes.moves.shape
    d, dd_dv = np.full((K, num_pairs), np.inf), np.zeros((K, num_pairs, nv))
    for k in range(K):
        for j in range(len(shapes.pair)):
            a, b, i = shapes.axis_a[j], shapes.axis_b[j], shapes.pair[j]
            p_a, u = column(points[k], a), column(points[k], num_axes + a)
            p_b, v = column(points[k], b), column(points[k], num_axes + b)
            d_j, normal, p = _nearest(p_a, u, p_b, v, shapes.uu[j], shapes.vv[j])
            d_j -= shapes.radii[j]
            if d_j < d[k, i]:
                d[k, i] = d_j
                moment = cross(p, normal)
                for c in range(nv):
                    if shapes.moves[i, c] != 0.0:
                        turn, shift = column(S[k], c), column(S[k, 3:], c)
                        rate = dot(moment, turn) + dot(normal, shift)
                        dd_dv[k, i, c] = rate * shapes.moves[i, c]
    return d, dd_dv


@njit
def _nearest(p_a, u, p_b, v, uu, vv):
    """Distance of two axes, unit normal from b to a, nearest point of a."""
    r = along(p_a, -1.0, p_b)
    uv, ur, vr = dot(u, v), dot(u, r), dot(v, r)
    product = uu * vv if uu * vv > 0.0 else 1.0
    determinant = product - uv * uv
    if determinant < _NEARLY_PARALLEL * product:
        s = _along_nearly_parallel(u, v, r, uu, vv, uv, ur)
    else:
        s = (uv * vr - ur * vv) / determinant
    t = unit((uv * unit(s) + vr) / (vv if vv > 0.0 else 1.0))
    s = unit((uv * t - ur) / (uu if uu > 0.0 else 1.0))
    nearest_a = along(p_a, s, u)
    difference = along(nearest_a, -1.0, along(p_b, t, v))
    distance = math.sqrt(dot(difference, difference))
    if distance < _TOUCHING:
        return distance, _perpendicular(u, v), nearest_a
    x, y, z = difference
    return distance, (x / distance, y / distance, z / distance), nearest_a


@njit
def _along_nearly_parallel(u, v, r, uu, vv, uv, ur):
    across = cross(u, v)
    determinant = dot(across, across)
    if determinant > _PARALLEL * uu * vv:
        return dot(cross(v, r), across) / determinant
    end_0, end_1 = -ur / uu, (uv - ur) / uu
    return 0.5 * (unit(min(end_0, end_1)) + unit(max(end_0, end_1)))


@njit
def _perpendicular(u, v):
    normal = cross(u, v)
    lengths = math.sqrt(dot(u, u)) * math.sqrt(dot(v, v))
    if lengths == 0.0 or math.sqrt(dot(normal, normal)) <= 1e-9 * lengths:
        x, y, z = u if dot(u, u) > 0.0 else v
        if abs(x) <= abs(y) and abs(x) <= abs(z):
            helper = (1.0, 0.0, 0.0)
        elif abs(y) <= abs(z):
            helper = (0.0, 1.0, 0.0)
        else:
            helper = (0.0, 0.0, 1.0)
        axis = (x, y, z)
        normal = cross(axis, helper) if dot(axis, axis) > 0.0 else helper
    length = math.sqrt(dot(normal, normal))
    return normal[0] / length, normal[1] / length, normal[2] / length
