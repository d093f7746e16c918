"""What a motion of the joints keeps from collisions and limits, frame by frame.

Between two frames a motion is taken to go straight in joint space, as those who play
or interpolate it do. The distance on the whole of such a way is bounded from below as
that of a braking path is, (A5) of `law.path_bounds`: by a bound, not by samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crar_drake.law.capsule_distances import nearest_points
from crar_drake.law.compilation import Held, compiled
from crar_drake.law.path_balls import MANY, near_on_way, near_segment, place_postures
from crar_drake.law.path_bounds import LOWEST, path_bounds, reaching, travel
from crar_drake.robot.model import ControlModel
from crar_drake.trajectory.distance_rows import configurations

# A way's bound is sought so far below what its ends keep, then four times farther
# and so on, and is found to so much [m].
_FIRST_SLACK = 2e-4
_LARGEST_SLACK = 0.05

# Pairs that are farther apart are looked at only where none is nearer [m].
_NEAR = 0.05


@dataclass(frozen=True)
class Margins:
    """Of T frames."""

    # (T,) the smallest of all watched pairs [m], negative in penetration; infinite
    # without any
    distance: np.ndarray
    pair: np.ndarray  # (T,) which pair it is of; -1 of none
    # (T,) no distance on the way to the next frame is smaller [m]; of the last frame
    # its own distance
    between: np.ndarray
    limit: np.ndarray  # (T,) what is left to the nearest joint limit [rad or m]
    # (T,) on the way to the next frame, the largest share of its speed limit that a
    # joint uses; of the last frame 0
    speed: np.ndarray


def find_margins(
    model: ControlModel,
    shapes: Held,
    q: np.ndarray,
    rate: float,
) -> Margins:
    """The margins of a motion.

    Args:
        model: of the robot, its root fixed; its watched pairs are examined.
        shapes: holds `Shapes` of its pairs.
        q: (T, n) positions of the controlled joints [rad or m].
        rate: frames per second [Hz].
    """
    frames, rest = len(q), model.rest_positions()
    distance, between = np.full((2, frames), np.inf)
    pair = np.full(frames, -1)
    if len(model.pairs):
        whole = configurations(model, rest, q)
        whole = np.take(whole, model.positions, axis=1)
        distance, nearest = nearest_shapes(whole, shapes)
        pair = model.pairs.pair_of_shapes[nearest]
        between = np.append(bounds_between(whole, distance, shapes), distance[-1])
    fastest = model.velocity_limits[model.controlled]
    speed = np.zeros(frames)
    speed[:-1] = (np.abs(np.diff(q, axis=0)) * rate / fastest).max(axis=1)
    limit = np.minimum(q - model.lower, model.upper - q).min(axis=1)
    return Margins(distance, pair, between, limit, speed)


@compiled
def nearest_shapes(q: np.ndarray, shapes: Held) -> tuple[np.ndarray, np.ndarray]:
    """The smallest signed distance of T configurations (T,) [m], and (T,) which pair of
    shapes has it.

    Args:
        q: (T, nq) positions in the equations' order.
        shapes: holds `Shapes`.
    """
    r, balls = shapes.value.robot.value, shapes.value.balls.value
    still = np.zeros(len(balls.radius))
    least, nearest = np.full(len(q), np.inf), np.zeros(len(q), np.int64)
    for k in range(len(q)):
        points, centres = place_postures(q[k : k + 1], r, balls)
        for enough in (_NEAR, np.inf):
            of = centres, points, still, enough, r.pairs.value, balls
            rows, _ = near_on_way(*of)
            d, _, _, _ = nearest_points(points[0], r.pairs.value, rows)
            if len(rows):
                i = d.argmin()
                least[k], nearest[k] = d[i], rows[i]
            if least[k] < enough:
                break
    return least, nearest


@compiled
def bounds_between(q: np.ndarray, d: np.ndarray, shapes: Held) -> np.ndarray:
    """(T - 1,) bounds for all distances on the straight ways between T frames [m].

    A bound is only as close as the level that was asked for: it is sought between one
    that is shown and one that is not.

    Args:
        q: (T, nq) positions in the equations' order.
        d: (T,) the smallest distances there [m].
        shapes: holds `Shapes`.
    """
    robot, reaches = shapes.value.robot, shapes.value.reaches
    pairs, straight = robot.value.pairs.value, np.zeros(len(reaches.value.above))
    bounds = np.empty(len(q) - 1)
    for k in range(len(bounds)):
        start, x, nearest = q[k], q[k + 1] - q[k], min(d[k], d[k + 1])
        near, _, others, ends = near_segment(start, x, nearest, MANY, shapes.value)
        before, _, _, _ = nearest_points(ends[0], pairs, near)
        after, _, _, _ = nearest_points(ends[1], pairs, near)
        reach = reaching(start, x, straight, near, reaches.value)
        low = 0.5 * (before + after - travel(x, reach))
        slack, failed, shown = _FIRST_SLACK, 0.0, np.inf
        while slack < _LARGEST_SLACK and shown - failed > _FIRST_SLACK:
            level = nearest - slack
            some = np.flatnonzero(low < level)
            clear = True
            if len(some):
                keep = np.full(len(some), level)
                whole = np.ones((1, len(some)), np.bool_)
                of = keep, robot.value, reaches, whole
                found = path_bounds(start, x, straight, near[some], *of, LOWEST)
                for i in range(len(some)):
                    if found.at[i] < 0.0:
                        low[some[i]] = max(low[some[i]], found.low[i])
                    else:
                        clear = False
            if clear:
                shown = slack
            else:
                failed = slack
            slack = 4.0 * slack if np.isinf(shown) else 0.5 * (failed + shown)
        bounds[k] = min(others, nearest)
        if len(low) and not low.min() >= bounds[k]:
            bounds[k] = low.min()
    return bounds
