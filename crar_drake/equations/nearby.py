"""Which shapes can be near in a motion, and the equations on these alone.

Most pairs of a whole robot are far apart at any time. The balls about two shapes bound
their distance from below, for a tenth of the effort.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.admission import Bounds, Reaches, path_bounds, sizes_of
from crar_drake.equations.capsule_distances import ShapePairs, nearest_points
from crar_drake.equations.compilation import Held, compiled, hold
from crar_drake.equations.kinematics import Robot, link_poses, place_points
from crar_drake.equations.lookahead import LookaheadNumbers


@compiled
def nearby_distances(q: np.ndarray, enough: np.ndarray, robot: Held) -> np.ndarray:
    """Bounds from below for the distances of pairs of shapes, exact where it matters.

    Args:
        q: (T, nq) positions in the plant's order.
        enough: (T, Nr) [m]: a pair is examined only if the balls about its shapes are
            not so far apart.
        robot: holds a `Robot` with a row for each pair of capsules and spheres.

    Returns:
        (T, Nr) the signed distances where they were examined, else those of the balls,
        at least `enough` [m].
    """
    r = robot.value
    pairs = r.pairs.value
    count = enough.shape[1]
    radius = np.empty(count)
    for i in range(count):
        radius[i] = (
            0.5 * (np.sqrt(pairs.sizes.uu[i]) + np.sqrt(pairs.sizes.vv[i]))
            + pairs.sizes.radii[i]
        )
    found = np.empty((len(q), count))
    for k in range(len(q)):
        X = link_poses(q[k : k + 1], r.tree.value)
        points = place_points(X, r.selection, r.first)[0]
        some = np.zeros(count, dtype=np.bool_)
        for i in range(count):
            a, u = points[pairs.start_a[i]], points[pairs.vector_a[i]]
            b, v = points[pairs.start_b[i]], points[pairs.vector_b[i]]
            apart = 0.0
            for c in range(3):
                apart += (a[c] - b[c] + 0.5 * (u[c] - v[c])) ** 2
            found[k, i] = np.sqrt(apart) - radius[i]
            some[i] = not found[k, i] >= enough[k, i]
        rows = np.flatnonzero(some)
        d, _, _, _ = nearest_points(
            points[pairs.start_a[rows]],
            points[pairs.vector_a[rows]],
            points[pairs.start_b[rows]],
            points[pairs.vector_b[rows]],
            sizes_of(pairs.sizes, rows),
        )
        for j in range(len(rows)):
            found[k, rows[j]] = d[j]
    return found


@compiled
def some_shapes(robot: Held, rows: np.ndarray) -> Held:
    """The robot with some pairs of shapes alone, whose rows are then 0, 1, ...

    Args:
        robot: holds a `Robot` in two configurations, with a row for each pair of
            capsules and spheres.
        rows: (N,) which.
    """
    r = robot.value
    pairs = r.pairs.value
    count = len(rows)
    both = np.concatenate((rows, rows + len(pairs.moves)))
    every = np.arange(2 * count)
    some = ShapePairs(
        pairs.start_a[both],
        pairs.start_b[both],
        pairs.vector_a[both],
        pairs.vector_b[both],
        sizes_of(pairs.sizes, both),
        every,
        every.reshape(-1, 1),
        pairs.moves[rows],
    )
    return hold(
        Robot(
            r.order,
            r.positions,
            r.n,
            r.selection,
            r.first,
            r.tree,
            r.tasks,
            r.rows,
            hold(some),
        )
    )


@compiled
def some_reaches(reaches: Held, rows: np.ndarray) -> Held:
    """`Reaches` of these pairs."""
    of = reaches.value
    return hold(
        Reaches(
            of.a_alone[rows],
            of.b_alone[rows],
            of.a[rows],
            of.b[rows],
            of.farthest[rows],
            of.above,
            np.arange(len(rows)),
        )
    )


@compiled
def with_reaches(numbers: Held, reaches: Held) -> Held:
    """`LookaheadNumbers` of these pairs, each of which has one row."""
    n, count = numbers.value, len(reaches.value.rows)
    return hold(
        LookaheadNumbers(
            n.tasks,
            n.limits,
            n.gains,
            n.admission,
            reaches,
            np.arange(count).reshape(-1, 1),
        )
    )


@compiled
def held_path_bounds(
    start: np.ndarray,
    x: np.ndarray,
    level: np.ndarray,
    asked: np.ndarray,
    robot: Held,
    reaches: Held,
) -> Bounds:
    """`path_bounds`, of a held `Robot`."""
    return path_bounds(start, x, level, asked, robot.value, reaches)
