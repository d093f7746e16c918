"""What a motion of the joints keeps from collisions and limits, frame by frame.

Between two frames a motion is taken to go straight in joint space, as those who play
or interpolate it do. The distance on the whole of such a way is bounded from below as
that of a braking path is, (A5) of `law.path_bounds`: by a bound, not by samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.path_bounds import LOWEST, path_bounds, reaching, travel
from crar_drake.law.placed_shapes import shape_distances
from crar_drake.robot.model import ControlModel
from crar_drake.trajectory.distance_rows import configurations

# A way's bound is sought so far below what its ends keep, then four times farther
# and so on, and is found to so much [m].
_FIRST_SLACK = 2e-4
_LARGEST_SLACK = 0.05

# Frames whose distances are in memory at a time.
_BLOCK = 512


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
    reaches: Held,
    q: np.ndarray,
    rate: float,
) -> Margins:
    """The margins of a motion.

    Args:
        model: of the robot, its root fixed; its watched pairs are examined.
        reaches: holds `Reaches` of its pairs.
        q: (T, n) positions of the controlled joints [rad or m].
        rate: frames per second [Hz].
    """
    frames, rest = len(q), model.rest_positions()
    distance, between = np.full((2, frames), np.inf)
    pair = np.full(frames, -1)
    for start in range(0, frames, _BLOCK) if len(model.pairs) else ():
        some = slice(start, start + _BLOCK + 1)  # with the way to the next
        whole = configurations(model, rest, q[some])
        d = shape_distances(whole, model.robot)
        nearest = d.argmin(axis=1)
        distance[some] = d[np.arange(len(d)), nearest]
        pair[some] = model.pairs.pair_of_shapes[nearest]
        ways = np.ascontiguousarray(whole[:, model.positions])
        ways = bounds_between(ways, d, model.robot, reaches)
        between[some] = np.append(ways, distance[some][-1])
    fastest = model.velocity_limits[model.controlled]
    speed = np.zeros(frames)
    speed[:-1] = (np.abs(np.diff(q, axis=0)) * rate / fastest).max(axis=1)
    limit = np.minimum(q - model.lower, model.upper - q).min(axis=1)
    return Margins(distance, pair, between, limit, speed)


@compiled
def bounds_between(
    q: np.ndarray, d: np.ndarray, robot: Held, reaches: Held
) -> np.ndarray:
    """(T - 1,) bounds for all distances on the straight ways between T frames [m].

    A bound is only as close as the level that was asked for: it is sought between one
    that is shown and one that is not.

    Args:
        q: (T, nq) positions in the equations' order.
        d: (T, Nr) the distances there [m].
        robot: holds the `Robot`.
        reaches: holds `Reaches` of all pairs.
    """
    bounds, straight = np.empty(len(q) - 1), np.zeros(len(reaches.value.above))
    every = np.arange(d.shape[1])
    for k in range(len(bounds)):
        start, x = q[k], q[k + 1] - q[k]
        nearest = min(d[k].min(), d[k + 1].min())
        reach = reaching(start, x, straight, every, reaches.value)
        low = 0.5 * (d[k] + d[k + 1] - travel(x, reach))
        slack, failed, shown = _FIRST_SLACK, 0.0, np.inf
        while slack < _LARGEST_SLACK and shown - failed > _FIRST_SLACK:
            level = nearest - slack
            rows = np.flatnonzero(low < level)
            clear = True
            if len(rows):
                keep, of = np.full(len(rows), level), (robot.value, reaches)
                whole = np.ones((1, len(rows)), np.bool_)
                path = start, x, straight, rows, keep, *of, whole
                found = path_bounds(*path, LOWEST)
                for i in range(len(rows)):
                    if found.at[i] < 0.0:
                        low[rows[i]] = max(low[rows[i]], found.low[i])
                    else:
                        clear = False
            if clear:
                shown = slack
            else:
                failed = slack
            slack = 4.0 * slack if np.isinf(shown) else 0.5 * (failed + shown)
        bounds[k] = low.min()
    return bounds
