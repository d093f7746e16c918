"""The watched shapes of a robot, and which pairs of them can be near on a segment."""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import Robot, link_poses, place_points
from crar_drake.law.path_balls import Balls, curvature, near_on_way


class Shapes(NamedTuple):
    """What pairs need of a robot; made by `pairs.Pairs`."""

    robot: Held  # of a `Robot` with a row for each pair of shapes in closed form
    reaches: Held  # of `law.admission.Reaches`
    balls: Held  # of `Balls`


@compiled
def place_ends(
    start: np.ndarray, end: np.ndarray, r: Robot, balls: Balls
) -> tuple[np.ndarray, np.ndarray]:
    """The links where a segment in joint space begins and ends, (nv,), (nv,).

    Returns:
        (2, P, 3) points of the shapes, as `ShapePairs` wants them; (2, B, 3) centres of
        the links' bounding spheres [m].
    """
    both = np.empty((2, len(start)))
    for i in range(len(start)):
        both[0, r.positions[i]], both[1, r.positions[i]] = start[i], end[i]
    X = link_poses(both, r.tree.value, r.tree.value.every)
    points = place_points(X, r.selection, r.first)
    return points, place_points(X, balls.centre, balls.first)


@compiled
def near_segment(
    start: np.ndarray, x: np.ndarray, distance: float, shapes: Shapes
) -> tuple[np.ndarray, float, np.ndarray]:
    """The pairs of shapes that may come nearer than a distance [m] on a segment that
    leads from `start` by x, (nv,) each.

    Returns:
        (k,) which; no distance of the others is smaller [m]; (2, P, 3) the points where
        the segment begins and ends [m].
    """
    r, balls = shapes.robot.value, shapes.balls.value
    points, centres = place_ends(start, start + x, r, balls)
    bend = 0.125 * curvature(x, balls)
    rows, low = near_on_way(centres, points, bend, distance, r.pairs.value, balls)
    return rows, low, points
