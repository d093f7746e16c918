"""The links that obstacles are kept from, with their reaches."""

import numpy as np

from crar_drake.errors import ScenarioError
from crar_drake.law.compilation import hold
from crar_drake.law.moving_obstacles import Links
from crar_drake.law.path_bounds import Reaches
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import chain_reaches, lengths_of_slides


def watched_links(
    model: ControlModel, errors: np.ndarray
) -> tuple[Links, tuple[str, ...]]:
    """The moving links of all watched pairs with capsules or spheres; their names.

    A link that no joint moves keeps its distances whatever the robot does, and is none.

    Args:
        model: of a robot that does not float.
        errors: (nv,) how far each joint may be from its command [rad or m]; shapes are
            thicker by what that moves them at most.

    Raises:
        ScenarioError: a joint that slides without limits is carried by one that errs,
            or a link has a box or another hull.
    """
    joints, order, plant = model.joints, model.order, model.plant
    turning = joints.turns[order].any(axis=1)
    names, starts, vectors, lengths, radii = [], [], [], [], []
    counts, reach, by, turned, carried = [0], [], [], [], []
    for body, axes in zip(model.pairs.bodies, model.pairs.axes, strict=True):
        frame, X_FB = joints.place(body)
        moved = joints.moved_by[frame][order]
        axes = [axis for axis in axes if not axis.flat]
        if not axes or not moved.any():
            continue
        if any(axis.hull is not None for axis in axes):
            raise ScenarioError(
                f"obstacles: link {body.name()!r} has a box or a convex mesh, which is "
                "not kept from obstacles that move; give it capsules or spheres"
            )
        ends = [end for axis in axes for end in axis.ends]
        at_zero, by_slide = chain_reaches(joints, order, body, ends)
        names.append(body.name())
        for axis in axes:
            p, end = X_FB.multiply(axis.p_B0), X_FB.multiply(axis.p_B1)
            starts.append((frame, np.append(p, 1.0)))
            vectors.append((frame, np.append(end - p, 0.0)))
            lengths.append(np.linalg.norm(end - p))
            radii.append(axis.radius)
        counts.append(len(radii))
        reach.append(at_zero)
        by.append(by_slide)
        thickest = max(axis.radius for axis in axes)
        turned.append(np.where(moved & turning, thickest, 0.0))
        carried.append(moved.astype(float))
    reach, turned, carried = (
        np.array(of, dtype=float).reshape(-1, len(order))
        for of in (reach, turned, carried)
    )
    frames = len(lengths_of_slides(joints))
    by = np.array(by).reshape(-1, frames, len(order)).transpose(1, 0, 2)
    longer = np.flatnonzero(by.any(axis=(1, 2)))
    slides = np.argsort(order)[[joints.velocities[k][0] for k in longer]]
    by = np.ascontiguousarray(by[longer])
    farthest = np.abs(
        [plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()]
    ).max(axis=0)[joints.tree.position[longer]]
    carries_error = (by @ errors).any(axis=1)
    if np.isinf(farthest[carries_error]).any():
        raise ScenarioError(
            "controller.tracking_error: a joint slides without limits, and "
            "what carries it errs: nothing bounds how near links are to obstacles; "
            "give the joint limits, or what carries it no error (tracking_errors)"
        )
    farthest = np.where(carries_error, farthest + errors[slides], 0.0)
    lost = (reach + np.tensordot(farthest, by, 1)) @ errors
    radii = np.array(radii, dtype=float) + np.repeat(lost, np.diff(counts))
    selection, first = joints.select([*starts, *vectors])
    robot, axes = model.robot.value, slice(3 * len(order))
    robot = robot._replace(
        selection=np.concatenate((robot.selection[axes], selection)),
        first=np.concatenate((robot.first[axes], first)),
    )
    links = Links(
        hold(robot),
        np.array(counts, dtype=np.int64),
        *(radii, radii + 0.5 * np.array(lengths, dtype=float)),
        Reaches(reach, joints.above(order), slides, np.zeros(len(slides)), by),
        *(turned, carried),
    )
    return links, tuple(names)
