"""How far joints can move a robot's watched shapes, in any configuration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.tree import RigidBody

from crar_drake.law.admission import Reaches
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
    their limits, or have none, `law.admission.reaching` looks where they are.

    Args:
        pairs: of it; those of other shapes have none.
        order: (nv,) of the joints, as in `law.kinematics.Robot`.
        lower, upper: (nq,) limits of all joints, in the plant's order.
    """
    tree = joints.tree
    per_slide = lengths_of_slides(joints)
    extents = np.maximum(np.abs(lower), np.abs(upper))[tree.position]
    extents[~np.isfinite(extents)] = 0.0
    places = np.argsort(order)  # of velocities in `order`
    sliding = np.flatnonzero(per_slide > 0.0)
    found, body_of = [], []
    for body, axes in zip(pairs.bodies, pairs.axes, strict=True):
        for axis in axes:
            found.append(chain_reaches(joints, order, body, axis.ends))
            body_of.append(joints.place(body)[0])
    at_zero = np.array([reach for reach, _ in found]).reshape(-1, len(order))
    by_slide = np.array([by for _, by in found]).reshape(-1, len(per_slide), len(order))
    by_slide = by_slide[:, sliding]
    frames = np.array(body_of, dtype=int)
    a, b = pairs.shape_axes
    moved = joints.moved_by[frames][:, order].reshape(-1, len(order))
    a_alone, b_alone = moved[a] & ~moved[b], moved[b] & ~moved[a]

    def between(shapes: np.ndarray, alone: np.ndarray) -> np.ndarray:
        return np.where(alone, by_slide[shapes].transpose(1, 0, 2), 0.0)

    a_by, b_by = between(a, a_alone), between(b, b_alone)
    some = [k for k in range(len(sliding)) if a_by[k].any() or b_by[k].any()]
    a_by, b_by, longer = a_by[some], b_by[some], sliding[some]
    reach_a = np.where(a_alone, at_zero[a], 0.0)
    reach_b = np.where(b_alone, at_zero[b], 0.0)
    reach_a += np.tensordot(extents[longer], a_by, 1)
    reach_b += np.tensordot(extents[longer], b_by, 1)
    return Reaches(
        a_alone.astype(float),
        b_alone.astype(float),
        reach_a,
        reach_b,
        np.ascontiguousarray((reach_a + reach_b).T),
        joints.above(order),
        np.arange(len(reach_a)),
        np.array([places[joints.velocities[k][0]] for k in longer], dtype=np.int64),
        extents[longer],
        np.ascontiguousarray(a_by),
        np.ascontiguousarray(b_by),
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
