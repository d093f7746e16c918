"""The balls about the watched shapes of a robot's links."""

from collections.abc import Sequence

import numpy as np

from crar_drake.law.path_balls import Balls
from crar_drake.robot.collision_pairs import CapsuleAxis
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import chain_reaches


def ball_about(axes: Sequence[CapsuleAxis]) -> tuple[np.ndarray, np.ndarray, float]:
    """Of the shapes of a body B: (N, 3) the points of which their axes are the hulls,
    and a ball with all of them in it, its centre (3,) and radius, in B [m]."""
    ends = np.array([end for axis in axes for end in axis.ends]).reshape(-1, 3)
    radii = np.repeat([axis.radius for axis in axes], [len(axis.ends) for axis in axes])
    centre = np.zeros(3)
    if len(ends):
        centre = 0.5 * ((ends - radii[:, None]).min(0) + (ends + radii[:, None]).max(0))
    distances = np.linalg.norm(ends - centre, axis=1) + radii
    return ends, centre, float(distances.max(initial=0.0))


def find_balls(model: ControlModel, losses: np.ndarray | None = None) -> Balls:
    """The balls about the watched links of a model, and how far joints can move them.

    Where a slide between a joint and a link makes the joint's reach longer, or a shape
    is a half space, no ball counts: such pairs are near always.

    Args:
        model: of a robot that does not float.
        losses: (Np,) by how much nearer pairs of shapes count than they are, in the
            order of `pairs.pair_of_shapes` [m]; by default not at all.
    """
    joints, pairs, order = model.joints, model.pairs, model.order
    placed, radius, reach, unbounded = [], [], [], []
    for body, axes in zip(pairs.bodies, pairs.axes, strict=True):
        ends, centre, size = ball_about(axes)
        placed.append(joints.point(body, centre))
        radius.append(size)
        found, by_slide = chain_reaches(joints, order, body, [centre, *ends])
        reach.append(found)
        unbounded.append(bool(by_slide.any()) or any(axis.flat for axis in axes))
    centre, first = joints.select(placed)
    unbounded = np.array(unbounded, dtype=bool)
    of_shapes = pairs.pair_of_shapes
    radius = np.array(radius, dtype=float)
    if losses is not None:
        nearer = np.zeros(len(radius))
        for of in (pairs.body_a, pairs.body_b):
            np.maximum.at(nearer, of[of_shapes], 0.5 * losses)
        radius += nearer
    return Balls(
        centre,
        first,
        radius,
        np.array(reach, dtype=float).reshape(-1, len(order)),
        joints.above(order),
        pairs.body_a,
        pairs.body_b,
        np.searchsorted(of_shapes, np.arange(len(pairs) + 1)),
        unbounded[pairs.body_a] | unbounded[pairs.body_b],
    )
