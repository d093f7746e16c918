"""How far joints can move a robot's watched shapes, in any configuration."""

from __future__ import annotations

import numpy as np

from crar_drake.equations.admission import Reaches
from crar_drake.errors import ModelError
from crar_drake.robot.collision_pairs import WatchedPairs
from crar_drake.robot.kinematics import JointTree


def find_reaches(
    joints: JointTree,
    pairs: WatchedPairs,
    order: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> Reaches:
    """The reaches of all pairs of capsules and spheres.

    The reach of joint j for a shape is the length of the chain from j's axis to the
    farther end of the shape's axis, stretched out.

    Args:
        joints: of the plant.
        pairs: of it; those of other shapes have none.
        order: (nv,) of the joints, as in `equations.kinematics.Robot`.
        lower, upper: (nq,) limits of all joints, in the plant's order.

    Raises:
        ModelError: an unlimited slide is carried by a turning joint that moves a
            watched shape.
    """
    tree = joints.tree
    # How far a frame's origin can be from its parent's, and how much of that slides.
    steps = tree.fixed[:, 3, :3]
    slides = np.linalg.norm(tree.slide[:, 3, :3], axis=1)
    extent = np.maximum(np.abs(lower), np.abs(upper))[tree.position]
    with np.errstate(invalid="ignore"):
        ranges = np.where(slides > 0.0, slides * extent, 0.0)
    for frame, _ in tree.free:
        ranges[frame] = np.inf

    def reaches_of(body, ends) -> np.ndarray:
        """(nv,) by the plant's order, 0 for joints that do not move the body."""
        frame, X_FB = joints.place(body)
        reach = np.zeros(len(order))
        points = [X_FB.multiply(end) for end in ends]
        rest, offset = 0.0, points  # the chain beyond, and where in `frame` it begins
        while frame:
            for velocity in joints.velocities[frame]:
                turn, slide = joints.turns[velocity], joints.slides[velocity]
                reach[velocity] = np.linalg.norm(slide)
                if len(joints.velocities[frame]) > 1 and turn.any():
                    # The axis of a free joint's turn is any through its origin.
                    reach[velocity] = max(map(np.linalg.norm, offset)) + rest
                elif turn.any():
                    arm = max(np.linalg.norm(np.cross(turn, point)) for point in offset)
                    reach[velocity] += arm + rest
            rest += max(np.linalg.norm(point) for point in offset) + ranges[frame]
            offset = [steps[frame]]
            frame = tree.parent[frame]
        return reach

    axis_reaches, body_of = [], []
    for body, axes in zip(pairs.bodies, pairs.axes, strict=True):
        for axis in axes:
            axis_reaches.append(reaches_of(body, (axis.p_B0, axis.p_B1)))
            body_of.append(joints.place(body)[0])
    every = np.array(axis_reaches).reshape(-1, len(order))[:, order]
    frames = np.array(body_of, dtype=int)
    a, b = pairs.closed_axes
    moved = joints.moved_by[frames][:, order].reshape(-1, len(order))
    a_alone, b_alone = moved[a] & ~moved[b], moved[b] & ~moved[a]
    reach_a = np.where(a_alone, every[a], 0.0)
    reach_b = np.where(b_alone, every[b], 0.0)
    if not (np.isfinite(reach_a).all() and np.isfinite(reach_b).all()):
        raise ModelError(
            "a sliding joint without limits is carried by a joint that turns, so that "
            "nothing bounds how far it takes a watched shape: give it limits in the "
            "robot's file"
        )
    own = joints.frame_of_velocity[order]
    above = joints.moved_by[own][:, order].astype(float)
    np.fill_diagonal(above, 0.0)
    return Reaches(
        a_alone.astype(float),
        b_alone.astype(float),
        reach_a,
        reach_b,
        np.ascontiguousarray((reach_a + reach_b).T),
        np.ascontiguousarray(above),
        pairs.closed_rows,
        np.arange(len(reach_a)),
    )
