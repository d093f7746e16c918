"""How far joints can move a robot's watched shapes, in any configuration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.tree import RigidBody

from crar_drake.law.path_bounds import Reaches
from crar_drake.robot.collision_pairs import WatchedPairs
from crar_drake.robot.kinematics import JointTree


def find_reaches(
    joints: JointTree,
    pairs: WatchedPairs,
    order: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> Reaches:
    """The reaches of all pairs of capsules, spheres and convex hulls.

    The reach of joint j for a shape is the length of the chain from j's axis to the
    farther end of the shape's axis, stretched out; of a hull, to its farthest corner.

    The limits of slides bound how far they take what they carry; where they are beyond
    their limits, or have none, `law.path_bounds.reaching` looks where they are.

    Args:
        pairs: of it; those of other shapes have none.
        order: (nv,) of the joints, as in `law.kinematics.Robot`.
        lower, upper: (nq,) limits of all joints, in the plant's order.
    """
    per_slide = lengths_of_slides(joints)
    extents = np.maximum(np.abs(lower), np.abs(upper))[joints.tree.position]
    extents[~np.isfinite(extents)] = 0.0
    sliding = np.flatnonzero(per_slide > 0.0)
    bodies, reaches, slides = [], [], []
    for body, axes in zip(pairs.bodies, pairs.axes, strict=True):
        for axis in axes:
            bodies.append(joints.place(body)[0])
            reach, by_slide = chain_reaches(joints, order, body, axis.ends)
            reaches.append(reach)
            slides.append(by_slide[sliding])
    moved = joints.moved_by[np.array(bodies, dtype=int)][:, order]
    reaches = np.array(reaches).reshape(-1, len(order))
    slides = np.array(slides).reshape(len(bodies), len(sliding), len(order))
    a, b = pairs.shape_axes
    both = moved[a] & moved[b]
    # A joint that moves one shape alone has no reach for the other.
    reach = np.where(both, 0.0, reaches[a] + reaches[b])
    by = np.where(both, 0.0, (slides[a] + slides[b]).transpose(1, 0, 2))
    some = by.any(axis=(1, 2))
    sliding, by = sliding[some], np.ascontiguousarray(by[some])
    places = np.argsort(order)  # of velocities in `order`
    return Reaches(
        reach + np.tensordot(extents[sliding], by, 1),
        joints.above(order),
        np.array([places[joints.velocities[k][0]] for k in sliding], dtype=np.int64),
        extents[sliding],
        by,
    )


def chain_reaches(
    joints: JointTree, order: np.ndarray, body: RigidBody, ends: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """How far joints can move points of a body, with all slides at zero.

    Args:
        joints, order: as of `find_reaches`.
        ends: (3,) points in its frame [m]; the farthest counts.

    Returns:
        (nv,) by `order` [m/rad, 1], 0 for joints that do not move the body; and
        (frames, nv) what a unit of each slide between a joint and the points adds.
    """
    tree = joints.tree
    steps = tree.fixed[:, 3, :3]  # where a frame's origin is in its parent
    per_slide = lengths_of_slides(joints)
    places = np.argsort(order)
    frame, X_FB = joints.place(body)
    reach = np.zeros(len(order))
    by_slide = np.zeros((len(per_slide), len(order)))
    points = [X_FB.multiply(end) for end in ends]
    rest, offset = 0.0, points  # the chain beyond, and where in `frame` it begins
    slides = np.zeros(len(per_slide))  # and what is between
    while frame:
        for velocity in joints.velocities[frame]:
            turn, slide = joints.turns[velocity], joints.slides[velocity]
            place = places[velocity]
            reach[place] = np.linalg.norm(slide)
            if not turn.any():
                continue
            by_slide[:, place] = slides
            arm = max(np.linalg.norm(np.cross(turn, point)) for point in offset)
            reach[place] += arm + rest
        rest += max(np.linalg.norm(point) for point in offset)
        slides[frame] = per_slide[frame]
        offset = [steps[frame]]
        frame = tree.parent[frame]
    return reach, by_slide


def lengths_of_slides(joints: JointTree) -> np.ndarray:
    """(frames,) how far each frame slides for a unit of q [m]."""
    return np.linalg.norm(joints.tree.slide[:, 3, :3], axis=1)
