"""Which pairs of shapes can be near on a way, by the balls about their links and them.

Most pairs of a whole robot stay far apart in a control step, and a bound of a few
numbers says so. The centre of a ball moves on a way q + u x, 0 <= u <= 1, off the
chord between its ends by at most an eighth of its acceleration, which in the world is
at most

    c = sum_i |x_i| rho_i (|x_i| + 2 sum_(j above i) |x_j|),                   (A3)

here over all joints i that carry it. So two balls keep the distance of the origin from
the chord of (centre a - centre b), less (c_a + c_b) / 8 and both radii.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.capsule_distances import ShapePairs
from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import Robot, link_poses, place_points
from crar_drake.law.vectors import times

# Where more pairs of shapes are near, a segment is asked in so many parts: from there
# on that takes less time.
MANY, _PARTS = 300, 4


class Balls(NamedTuple):
    """The balls about the watched shapes of B links; made by `robot.balls.find_balls`.

    Of Nc watched pairs of links; Np pairs of shapes, those of one pair side by side.
    """

    centre: np.ndarray  # (B, 4) homogeneous, in their frames, whose rows of poses begin
    first: np.ndarray  # (B,) at these, see `place_points`
    radius: np.ndarray  # (B,) [m]
    reach: np.ndarray  # (B, nv) rho, of all that the link's balls are about [m/rad, 1]
    above: np.ndarray  # (nv, nv) 1 where joint j carries joint i, i = j not included
    a: np.ndarray  # (Nc,) the links of each pair
    b: np.ndarray  # (Nc,)
    shapes: np.ndarray  # (Nc + 1,) where its pairs of shapes begin, and all end
    always: np.ndarray  # (Nc,) whether no ball holds a shape: a half space


class Shapes(NamedTuple):
    """What pairs need of a robot."""

    robot: Held  # of a `Robot`
    reaches: Held  # of `path_bounds.Reaches` of its pairs of shapes
    balls: Held  # of `Balls`


@compiled
def curvature(x: np.ndarray, reach: np.ndarray, above: np.ndarray) -> np.ndarray:
    """The bound c above of each link, (B,) [m].

    Args:
        x: (nv,) what each joint moves on the way [rad, m].
        reach, above: (B, nv), (nv, nv) as of `Balls`.
    """
    speed = np.abs(x)
    return times(reach, speed * (speed + 2.0 * times(above, speed)))


@compiled
def near_on_way(
    centres: np.ndarray,
    points: np.ndarray,
    bend: np.ndarray,
    enough: float,
    pairs: ShapePairs,
    balls: Balls,
) -> tuple[np.ndarray, float]:
    """The pairs of shapes that are not shown to keep a distance on a way.

    Args:
        centres: (2, B, 3) of the links' balls where the way begins and ends, or (1, B,
            3) where they stay [m].
        points: (2, P, 3) the shapes' axes there, as `ShapePairs` wants them [m].
        bend: (B,) how far each link may be off its chord [m].
        enough: the distance [m].
        pairs: of the shapes.

    Returns:
        (k,) which pairs of shapes; no distance of the others is smaller [m].
    """
    rows, count, low = np.empty(balls.shapes[-1], dtype=np.int64), 0, np.inf
    size, vectors = balls.radius + bend, pairs.to_vector
    starts = points.shape[1] - vectors  # no pair has no vector
    middles = points[:, :starts] + 0.5 * points[:, vectors:]
    for pair in range(len(balls.a)):
        a, b = np.uintp(balls.a[pair]), np.uintp(balls.b[pair])
        if not balls.always[pair]:
            apart = _least_apart(centres, a, b) - (size[a] + size[b])
            # A bound that is none (NaN) shows nothing.
            if apart >= enough:
                low = min(low, apart)
                continue
        for row in range(balls.shapes[pair], balls.shapes[pair + 1]):
            if not balls.always[pair]:
                i, j = np.uintp(pairs.start_a[row]), np.uintp(pairs.start_b[row])
                apart = _least_apart(middles, i, j)
                apart -= pairs.balls[row] + bend[a] + bend[b]
                if apart >= enough:
                    low = min(low, apart)
                    continue
            rows[count] = row
            count += 1
    return rows[:count], low


@compiled
def _least_apart(at, i, j):
    """How near two of the points (2, P, 3) come on chords between two instants."""
    # Of a signed place Numba asks each time whether it counts from the end.
    zero, one, two, last = np.uintp(0), np.uintp(1), np.uintp(2), np.uintp(len(at) - 1)
    x = at[zero, i, zero] - at[zero, j, zero]
    y = at[zero, i, one] - at[zero, j, one]
    z = at[zero, i, two] - at[zero, j, two]
    u = at[last, i, zero] - at[last, j, zero] - x
    v = at[last, i, one] - at[last, j, one] - y
    w = at[last, i, two] - at[last, j, two] - z
    return least_length(x, y, z, u, v, w)


@compiled
def least_length(x, y, z, u, v, w):
    """The smallest length of (x, y, z) + t (u, v, w), 0 <= t <= 1."""
    here, towards = x * x + y * y + z * z, x * u + y * v + z * w
    if towards < 0.0:
        way = u * u + v * v + w * w
        t = min(-towards / way, 1.0)
        here = max(here + t * (2.0 * towards + t * way), 0.0)
    return np.sqrt(here)


@compiled
def place_ways(
    start: np.ndarray, x: np.ndarray, parts: int, r: Robot, balls: Balls
) -> tuple[np.ndarray, np.ndarray]:
    """The links where equal parts of a segment begin and end, from `start` by x in
    joint space, (nv,), (nv,): (parts + 1, P, 3), (parts + 1, B, 3) of
    `place_postures`.
    """
    places = np.empty((parts + 1, len(start)))
    for k in range(parts + 1):
        for i in range(len(start)):
            places[k, i] = start[i] + (k / parts) * x[i]
    return place_postures(places, r, balls)


@compiled
def place_postures(
    q: np.ndarray, r: Robot, balls: Balls
) -> tuple[np.ndarray, np.ndarray]:
    """The links in K postures (K, nv), in the equations' order.

    Returns:
        (K, P, 3) points of the shapes, as `ShapePairs` wants them; (K, B, 3) centres of
        the links' bounding spheres [m].
    """
    places = np.empty(q.shape)
    for k in range(len(q)):
        for i in range(q.shape[1]):
            places[k, r.positions[i]] = q[k, i]
    X = link_poses(places, r.tree.value, r.tree.value.every)
    points = place_points(X, r.selection, r.first)
    return points, place_points(X, balls.centre, balls.first)


@compiled
def near_segment(
    start: np.ndarray, x: np.ndarray, distance: float, many: int, shapes: Shapes
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """The pairs of shapes that may come nearer than a distance [m] on a segment that
    leads from `start` by x, (nv,) each.

    If they are more than `many`, the segment is long: of a quarter of it the bound of
    curvature is a sixteenth.

    Returns:
        (k,) which; (parts, k) bool, in which parts of the segment, as `path_bounds`
        wants them; no other distance is smaller [m]; (2, P, 3) the points where the
        segment begins and ends [m].
    """
    r, balls = shapes.robot.value, shapes.balls.value
    pairs, bend = r.pairs.value, 0.125 * curvature(x, balls.reach, balls.above)
    points, centres = place_ways(start, x, 1, r, balls)
    rows, low = near_on_way(centres, points, bend, distance, pairs, balls)
    if len(rows) <= many:
        return rows, np.ones((1, len(rows)), np.bool_), low, points
    ways, centres = place_ways(start, x, _PARTS, r, balls)
    near = np.zeros((_PARTS, balls.shapes[-1]), np.bool_)
    low, bend = np.inf, bend / 16.0
    for k in range(_PARTS):
        of = centres[k : k + 2], ways[k : k + 2], bend
        rows, least = near_on_way(*of, distance, pairs, balls)
        low = min(low, least)
        near[k][rows] = True
    rows = np.flatnonzero(near.sum(axis=0))
    return rows, np.ascontiguousarray(near[:, rows]), low, points
