"""Which pairs can be near on a way, by the balls about their links and shapes.

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
from crar_drake.law.compilation import compiled
from crar_drake.law.vectors import times


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
    """
    speed = np.abs(x)
    return times(balls.reach, speed * (speed + 2.0 * times(balls.above, speed)))


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
        centres: (2, B, 3) of the links' balls where the way begins and ends [m].
        points: (2, P, 3) the shapes' axes there, as `ShapePairs` wants them [m].
        bend: (B,) how far each link may be off its chord [m].
        enough: the distance [m].
        pairs: of the shapes, the first configuration's in its first half.

    Returns:
        (k,) which pairs of shapes; no distance of the others is smaller [m].
    """
    rows, count, low = np.empty(balls.shapes[-1], dtype=np.int64), 0, np.inf
    size, start, end = balls.radius + bend, points[0], points[1]
    # Of a signed place Numba asks each time whether it counts from the end.
    zero, one, two = np.uintp(0), np.uintp(1), np.uintp(2)
    for pair in range(len(balls.a)):
        a, b = np.uintp(balls.a[pair]), np.uintp(balls.b[pair])
        if not balls.always[pair]:
            x = centres[zero, a, zero] - centres[zero, b, zero]
            y = centres[zero, a, one] - centres[zero, b, one]
            z = centres[zero, a, two] - centres[zero, b, two]
            u = centres[one, a, zero] - centres[one, b, zero] - x
            v = centres[one, a, one] - centres[one, b, one] - y
            w = centres[one, a, two] - centres[one, b, two] - z
            apart, off = least_length(x, y, z, u, v, w), size[a] + size[b]
            # A bound that is none (NaN) shows nothing.
            if apart - off >= enough:
                low = min(low, apart - off)
                continue
        for row in range(balls.shapes[pair], balls.shapes[pair + 1]):
            if not balls.always[pair]:
                i, j = np.uintp(pairs.start_a[row]), np.uintp(pairs.start_b[row])
                k, m = np.uintp(pairs.vector_a[row]), np.uintp(pairs.vector_b[row])
                x = start[i, zero] - start[j, zero]
                y = start[i, one] - start[j, one]
                z = start[i, two] - start[j, two]
                x += 0.5 * (start[k, zero] - start[m, zero])
                y += 0.5 * (start[k, one] - start[m, one])
                z += 0.5 * (start[k, two] - start[m, two])
                u = end[i, zero] - end[j, zero] - x
                v = end[i, one] - end[j, one] - y
                w = end[i, two] - end[j, two] - z
                u += 0.5 * (end[k, zero] - end[m, zero])
                v += 0.5 * (end[k, one] - end[m, one])
                w += 0.5 * (end[k, two] - end[m, two])
                apart = least_length(x, y, z, u, v, w)
                off = pairs.sizes.balls[row] + bend[a] + bend[b]
                if apart - off >= enough:
                    low = min(low, apart - off)
                    continue
            rows[count] = row
            count += 1
    return rows[:count], low


@compiled
def least_length(x, y, z, u, v, w):
    """The smallest length of (x, y, z) + t (u, v, w), 0 <= t <= 1."""
    here, towards = x * x + y * y + z * z, x * u + y * v + z * w
    if towards < 0.0:
        way = u * u + v * v + w * w
        t = min(-towards / way, 1.0)
        here = max(here + t * (2.0 * towards + t * way), 0.0)
    return np.sqrt(here)
