"""Which shapes can be near in a motion, and the equations on these alone.

Most pairs of a whole robot are far apart at any time. The balls about two shapes bound
their distance from below, for a tenth of the effort.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.admission import (
    Bounds,
    Reaches,
    extended,
    path_bounds,
    reaching,
    step_reach,
    travel,
)
from crar_drake.equations.capsule_distances import ShapePairs, nearest_points
from crar_drake.equations.compilation import Held, compiled, hold
from crar_drake.equations.kinematics import Robot, link_poses, place_points
from crar_drake.equations.lookahead_guard import LookaheadNumbers
from crar_drake.equations.vectors import put, put_at, some_columns


@compiled(loops=True)
def ball_distances(
    points: np.ndarray, pairs: ShapePairs, some: np.ndarray
) -> np.ndarray:
    """How far the balls about two shapes are apart, (N,) [m]; as `nearest_points`."""
    d = np.empty(len(some))
    # Of a signed place Numba asks each time whether it counts from the end.
    for i in range(len(some)):
        of = np.uintp(some[i])
        a, b = np.uintp(pairs.start_a[of]), np.uintp(pairs.start_b[of])
        u, v = np.uintp(pairs.vector_a[of]), np.uintp(pairs.vector_b[of])
        x = points[a, 0] - points[b, 0] + 0.5 * (points[u, 0] - points[v, 0])
        y = points[a, 1] - points[b, 1] + 0.5 * (points[u, 1] - points[v, 1])
        z = points[a, 2] - points[b, 2] + 0.5 * (points[u, 2] - points[v, 2])
        d[i] = np.sqrt(x * x + y * y + z * z) - pairs.sizes.balls[of]
    return d


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
    pairs, tree = r.pairs.value, r.tree.value
    count = enough.shape[1]
    found = np.empty((len(q), count))
    for k in range(len(q)):
        X = link_poses(q[k : k + 1], tree, tree.every)
        points = place_points(X, r.selection, r.first)[0]
        shapes = pairs.shapes[:count]
        d = ball_distances(points, pairs, shapes)
        rows = np.flatnonzero(~(d >= enough[k]))
        near, _, _, _ = nearest_points(points, pairs, shapes[rows])
        put_at(d, rows, near)
        put(found[k], 0, d)
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
        pairs.start_a,
        pairs.start_b,
        pairs.vector_a,
        pairs.vector_b,
        pairs.sizes,
        pairs.shapes[both],
        every,
        every.reshape(-1, 1),
        pairs.moves[rows],
    )
    return hold(
        Robot(
            r.order,
            r.positions,
            r.n,
            r.turn,
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
            of.a_alone,
            of.b_alone,
            of.a,
            of.b,
            some_columns(of.farthest, rows),
            of.above,
            np.arange(len(rows)),
            of.own[rows],
            of.slides,
            of.extents,
            of.a_by,
            of.b_by,
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
            n.preview,
        )
    )


@compiled
def pairs_within(
    q: np.ndarray, enough: np.ndarray, robot: Held, numbers: Held
) -> tuple[np.ndarray, np.ndarray, Held, Held]:
    """The pairs of shapes that are near, and the law on these alone.

    Args:
        q: (nq,) positions in the plant's order.
        enough: (Nr,) from which distance on a pair is left out [m].
        robot, numbers: hold a `Robot` and `LookaheadNumbers`.

    Returns:
        (N,) their rows, of the nearest if none is so near; (Nr,) of
        `nearby_distances`; the robot and the numbers of these alone.
    """
    d = nearby_distances(q.reshape(1, -1), enough.reshape(1, -1), robot)[0]
    rows = np.flatnonzero(~(d >= enough))
    if not len(rows):
        rows = np.array([np.argmin(d)])
    some = some_reaches(numbers.value.reaches, rows)
    return rows, d, some_shapes(robot, rows), with_reaches(numbers, some)


@compiled
def reaching_within(q: np.ndarray, far: np.ndarray, reaches: Held) -> Held:
    """Holds `Reaches` that hold as long as no joint goes farther than `far` from q.

    Args:
        q: (nv,) positions in the order of the equations; no root floats.
        far: (nv,) [rad or m], likewise.
        reaches: holds `Reaches`.
    """
    of = reaches.value
    extents = np.maximum(of.extents, (np.abs(q) + far)[of.slides])
    if (extents == of.extents).all():
        return reaches
    return extended(extents, reaches)


@compiled
def watched_nearby(
    q: np.ndarray, v: np.ndarray, fastest: np.ndarray, robot: Held, numbers: Held
) -> tuple[np.ndarray, np.ndarray, Held, Held]:
    """The law on the pairs of shapes that a step can be influenced by.

    A distance changes by at most (A6) on the braking path, and by as much again on the
    way to the next one. So a pair has no row in the law if it is farther apart than the
    first and the influence distance; and it keeps the floor, whatever the law does, if
    it is farther than both and the floor. Of a step that is faster than `fastest`, the
    second is to be asked again: `still_clear`.

    Args:
        q, v: (nq,), (nv,) state, in the plant's order.
        fastest: (nv,) what is expected of |s|, likewise.
        robot, numbers: hold a `Robot` and `LookaheadNumbers`.

    Returns:
        (N,) rows of the pairs that are watched; (Nr,) what no distance on the present
        braking path is smaller than [m], infinite for these; the robot and the numbers
        of these alone.
    """
    n, r = numbers.value, robot.value
    gains = n.admission
    x = gains.T * v[r.order]
    next_ = step_reach(v, gains) * fastest[r.order]
    of = reaching_within(q[r.positions], np.abs(x) + next_, n.reaches)
    here, beyond = travel(x, of), travel(next_, of)
    enough = here + np.maximum(n.gains.influence_distance, gains.floor + beyond)
    rows, d, some, its_numbers = pairs_within(q, enough, robot, numbers)
    room = d - here
    room[rows] = np.inf
    return rows, room, some, its_numbers


@compiled
def still_clear(
    q: np.ndarray, v: np.ndarray, s: np.ndarray, room: np.ndarray, numbers: Held
) -> bool:
    """Whether a step leaves clear what `watched_nearby` left out.

    Args:
        q, v: (nv,), (nv,) state, in the order of the equations.
        s: (nv,) velocity of where the robot would come to rest, in the order of the
            equations.
        room: (Nr,) of `watched_nearby`.
        numbers: of all pairs.
    """
    n = numbers.value
    next_ = step_reach(s, n.admission) * s
    far = n.admission.T * np.abs(v) + np.abs(next_)
    moved = travel(next_, reaching_within(q, far, n.reaches))
    return bool((room - moved >= n.admission.floor).all())


@compiled
def bounds_of_some(
    start: np.ndarray,
    x: np.ndarray,
    level: float,
    rows: np.ndarray,
    robot: Held,
    reaches: Held,
) -> Bounds:
    """`path_bounds` of some pairs, which are all to keep one level.

    Args:
        start, x: (nq,), (nv,) where the path begins, and where it leads from there, in
            the order of the equations.
        level: distance to be kept [m].
        rows: (N,) which pairs.
        robot: holds a `Robot`, as in `some_shapes`.
        reaches: holds `Reaches` of all pairs.
    """
    levels, asked = np.full(len(rows), level), np.ones(len(rows), dtype=np.bool_)
    some = some_reaches(reaches, rows)
    shapes, straight = some_shapes(robot, rows).value, np.zeros(len(x))
    return path_bounds(start, x, straight, levels, asked, shapes, some)


@compiled
def keeps_level(
    start: np.ndarray, x: np.ndarray, level: float, robot: Held, reaches: Held
) -> bool:
    """Whether all pairs keep a level on a path; arguments as in `bounds_of_some`."""
    r = robot.value
    reaches = reaching(start, x, np.zeros(len(x)), reaches, r.turn)
    enough = level + 0.5 * travel(x, reaches)
    middle = start + 0.5 * x
    in_plant = np.empty((1, len(start)))
    for i in range(len(start)):
        in_plant[0, r.positions[i]] = middle[i]
    found = nearby_distances(in_plant, enough.reshape(1, -1), robot)[0]
    rows = np.flatnonzero(~(found >= enough))
    if not len(rows):
        return True
    return not (bounds_of_some(start, x, level, rows, robot, reaches).at >= 0.0).any()
