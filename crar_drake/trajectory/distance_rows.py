"""Distances of watched pairs, and their gradients, at many configurations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.law.capsule_distances import (
    distance_gradient_about_origin,
    nearest_points,
)
from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import (
    find_state,
    joint_motion,
)
from crar_drake.law.path_balls import near_on_way, place_postures
from crar_drake.law.vectors import put
from crar_drake.robot.model import ControlModel

_ROOM = 128  # rows of a sample, to begin with


def configurations(model: ControlModel, rest: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(..., nq) of the plant, the prescribed joints as in `rest`, from (..., n)."""
    whole = np.empty((*q.shape[:-1], len(rest)))
    whole[...] = rest
    whole[..., model.controlled_positions] = q
    return whole


class NearRows(NamedTuple):
    """Pairs that are near, at some of S samples of a motion."""

    sample: np.ndarray  # (R,) of which sample, in ascending order
    row: np.ndarray  # (R,) of which pair of shapes
    d: np.ndarray  # (R,) the signed distance [m]
    gradient: np.ndarray  # (R, m) of d by the unknowns, Eq. (20) [m/rad or 1].


def no_rows(unknowns: int) -> NearRows:
    """None, of so many unknowns."""
    nothing = np.zeros(0, dtype=int)
    return NearRows(nothing, nothing, np.zeros(0), np.zeros((0, unknowns)))


def join_rows(*rows: NearRows) -> NearRows:
    """Those of several kinds, whose numbers of rows are their own."""
    joined = [np.concatenate(each) for each in zip(*rows, strict=True)]
    order = np.argsort(joined[0], kind="stable")
    return NearRows(*(np.take(x, order, axis=0) for x in joined))


@compiled
def find_near_rows(
    q: np.ndarray, enough: np.ndarray, room: np.ndarray, before: int, shapes: Held
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The fields of `NearRows`; gradients of unknowns of which n joints come last.

    Args:
        q: (S, nq) positions in the equations' order.
        enough: (S,) pairs that are as far apart are left out [m].
        room: (Nr,) and those that are so much farther apart than that.
        before: number of unknowns before the joints.
        shapes: holds `Shapes`.
    """
    r, balls = shapes.value.robot.value, shapes.value.balls.value
    pairs, n, nv = r.pairs.value, r.n, len(r.order)
    still, most = np.zeros(len(balls.radius)), 0.0
    for of_row in room:
        most = max(most, of_row)
    size = _ROOM * len(q)
    samples, rows = np.empty(size, np.int64), np.empty(size, np.int64)
    d, g = np.empty(size), np.empty((size, before + n))
    used = 0
    for k in range(len(q)):
        points, centres = place_postures(q[k : k + 1], r, balls)
        of = centres, points, still, enough[k] + most, pairs, balls
        maybe, _ = near_on_way(*of)
        far, normal, p, _ = nearest_points(points[0], pairs, maybe)
        near = np.flatnonzero(~(far >= enough[k] + room[maybe]))
        while used + len(near) > size:
            samples = np.concatenate((samples, np.empty_like(samples)))
            rows = np.concatenate((rows, np.empty_like(rows)))
            d = np.concatenate((d, np.empty_like(d)))
            g = np.concatenate((g, np.empty_like(g)))
            size *= 2
        some = maybe[near]
        S = joint_motion(points[:, : 3 * nv])[0]
        gradient = distance_gradient_about_origin(
            normal[near], p[near], S, pairs.moves[some]
        )
        for i in range(len(near)):
            samples[used], rows[used], d[used] = k, some[i], far[near[i]]
            g[used, :before] = 0.0
            put(g[used], before, gradient[i, :n])
            used += 1
    return samples[:used], rows[:used], d[:used], g[:used]


@compiled
def find_poses(q: np.ndarray, robot: Held) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the tasks' frames are, and how joints move them: Eq. (5).

    Args:
        q: (K, nq) positions in the plant's order.
        robot: holds a `Robot` whose tasks are T poses.

    Returns:
        R (K, T, 3, 3), p (K, T, 3) [m] and J (K, 6 T, nv), see `TaskRows`.
    """
    r = robot.value
    rows, m, nv = r.rows.value, len(r.tasks.value.fixed), len(r.order)
    K = len(q)
    R = np.empty((K, len(rows.angular_tasks), 3, 3))
    p = np.empty((K, len(rows.linear_tasks), 3))
    J, still = np.empty((K, m, nv)), np.zeros(nv)
    for k in range(K):
        state = find_state(q[k], still, robot)
        R[k], p[k], J[k] = state.R, state.p, state.J
    return R, p, J
