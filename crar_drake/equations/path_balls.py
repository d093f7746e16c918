"""Which pairs can be near on a way, by the balls about their links and shapes.

Most pairs of a whole robot stay far apart in a control step, and a bound of a few
numbers says so. The centre of a ball moves on a way q + u x, 0 <= u <= 1, off the
chord between its ends by at most an eighth of its acceleration, which in the world is
at most

    c = sum_i |x_i| rho_i (|x_i| + 2 sum_(j above i) |x_j|),                   (A3)

here over all joints i that carry it. So two balls keep the distance of the origin from
the chord of (centre a - centre b), less (c_a + c_b) / 8 and both radii.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.equations.capsule_distances import ShapePairs
from crar_drake.equations.compilation import compiled
from crar_drake.equations.vectors import times


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


@compiled
def curvature(x: np.ndarray, balls: Balls) -> np.ndarray:
    """The bound c above of each link, (B,) [m].

    Args:
        x: (nv,) what each joint moves on the way [rad, m].
        balls: of the robot.
    """
    speed = np.abs(x)
    return times(balls.reach, speed * (speed + 2.0 * times(balls.above, speed)))


@compiled(loops=True)
def apart(start: np.ndarray, end: np.ndarray, a: int, b: int, at: np.ndarray) -> float:
    """How far two points that move on chords come at least to each other [m].

    Args:
        start, end: (P, 3) points where the chords begin and end [m].
        a, b: which two; of each at[0] is added to half of at[1], if that is not
            negative: the middle of an axis that begins there.
        at: (2,) vectors of the axes, or -1.
    """
    dot, way, here = 0.0, 0.0, 0.0
    for c in range(3):
        r, s = start[a, c] - start[b, c], end[a, c] - end[b, c]
        if at[0] >= 0:
            r += 0.5 * (start[at[0], c] - start[at[1], c])
            s += 0.5 * (end[at[0], c] - end[at[1], c])
        u = s - r
        dot += r * u
        way += u * u
        here += r * r
    if dot >= 0.0 or way == 0.0:
        return np.sqrt(here)
    t = min(-dot / way, 1.0)
    return np.sqrt(max(here + t * (2.0 * dot + t * way), 0.0))


@compiled(loops=True)
def near_on_ways(
    centres: np.ndarray,
    points: np.ndarray,
    ways: np.ndarray,
    bends: np.ndarray,
    enough: float,
    pairs: ShapePairs,
    balls: Balls,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The pairs of shapes that are not shown to keep a distance on each of some ways.

    Args:
        centres: (K, B, 3) of the links' balls in K configurations [m].
        points: (K, P, 3) the shapes' axes in them, as `ShapePairs` wants them [m].
        ways: (W, 2) the configurations where each way begins and ends.
        bends: (W, B) how far each link may be off the chord on it [m].
        enough: the distance [m].
        pairs: of the shapes, the first configuration's in its first half.
        balls: of the robot.

    Returns:
        (k,) which pairs of shapes; (k, W) whether on this way; (W,) no distance of the
        others is smaller on it [m].
    """
    W, total = len(ways), balls.shapes[-1]
    rows = np.empty(total, dtype=np.int64)
    near = np.zeros((total, W), dtype=np.bool_)
    low = np.full(W, np.inf)
    none, axes = np.full(2, -1), np.empty(2, dtype=np.int64)
    open_ = np.empty(W, dtype=np.bool_)
    count = 0
    for pair in range(len(balls.a)):
        a, b = balls.a[pair], balls.b[pair]
        any_open = balls.always[pair]
        for way in range(W):
            open_[way] = True
            if balls.always[pair]:
                continue
            start, end = centres[ways[way, 0]], centres[ways[way, 1]]
            off = balls.radius[a] + balls.radius[b] + bends[way, a] + bends[way, b]
            bound = apart(start, end, a, b, none) - off
            # A bound that is none (NaN) shows nothing.
            if bound >= enough:
                open_[way] = False
                low[way] = min(low[way], bound)
            else:
                any_open = True
        if not any_open:
            continue
        for row in range(balls.shapes[pair], balls.shapes[pair + 1]):
            axes[0], axes[1] = pairs.vector_a[row], pairs.vector_b[row]
            found = False
            for way in range(W):
                near[count, way] = False
                if not open_[way]:
                    continue
                if not balls.always[pair]:
                    start, end = points[ways[way, 0]], points[ways[way, 1]]
                    off = pairs.sizes.balls[row] + bends[way, a] + bends[way, b]
                    of_a, of_b = pairs.start_a[row], pairs.start_b[row]
                    bound = apart(start, end, of_a, of_b, axes) - off
                    if bound >= enough:
                        low[way] = min(low[way], bound)
                        continue
                near[count, way] = found = True
            if found:
                rows[count] = row
                count += 1
    return rows[:count], near[:count], low
