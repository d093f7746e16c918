"""Which shapes can be near in a motion, and the equations on these alone.

Most pairs of a whole robot are far apart at any time. The balls about two shapes bound
their distance from below, for a tenth of the effort.
"""

import numpy as np

from crar_drake.law.admission import Bounds, Reaches, path_bounds
from crar_drake.law.capsule_distances import ShapePairs, nearest_points
from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.kinematics import Robot, link_poses, place_points
from crar_drake.law.vectors import put, put_at, some_columns


@compiled
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
def near_balls(
    points: np.ndarray,
    starts: np.ndarray,
    to_vector: int,
    balls: np.ndarray,
    enough: float,
) -> np.ndarray:
    """Which of N pairs of shapes have balls about them that are nearer than `enough`.

    As `ball_distances`, of many pairs of few shapes.

    Args:
        points: (P, 3) of one configuration [m].
        starts: (2, N) where the axes of a, and of b, start, among these.
        to_vector: so many places after an axis' start is its vector, of each.
        balls: (N,) of `CapsuleSizes` [m].
        enough: [m]; infinite for all.

    Returns:
        (M,) in ascending order; those that are not a number are among them.
    """
    middles = np.empty((len(points) - to_vector, 3))
    for i in range(len(middles)):
        for c in range(3):
            middles[i, c] = points[i, c] + 0.5 * points[i + to_vector, c]
    near, count = np.empty(len(balls), np.int64), 0
    for i in range(len(balls)):
        a, b = np.uintp(starts[0, i]), np.uintp(starts[1, i])
        x = middles[a, 0] - middles[b, 0]
        y = middles[a, 1] - middles[b, 1]
        z = middles[a, 2] - middles[b, 2]
        far = max(balls[i] + enough, 0.0)
        near[count] = i
        count += not x * x + y * y + z * z >= far * far
    return near[:count]


@compiled
def nearby_distances(q: np.ndarray, enough: np.ndarray, robot: Held) -> np.ndarray:
    """Bounds from below for the distances of pairs of shapes, exact where it matters.

    Args:
        q: (T, nq) positions in the plant's order.
        enough: (T, Nr) [m]: a pair is examined only if the balls about its shapes are
            not so far apart.
        robot: holds a `Robot` with a row for each pair of shapes.

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
        pairs.hull_a,
        pairs.hull_b,
        pairs.hulls,
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
            of.a_alone,
            of.b_alone,
            of.a,
            of.b,
            some_columns(of.farthest, rows),
            of.above,
            of.own[rows],
            of.slides,
            of.extents,
            of.a_by,
            of.b_by,
        )
    )


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
    return path_bounds(start, x, straight, levels, asked, shapes, some, False)
