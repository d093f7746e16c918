"""The links that obstacles are kept from, with their balls and reaches."""

import numpy as np

from crar_drake.errors import ScenarioError
from crar_drake.law.moving_obstacles import Links
from crar_drake.robot.balls import ball_about
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
    joints, order = model.joints, model.order
    nv = len(order)
    tree, axes_of = joints.tree, model.pairs.axes
    turning = joints.turns[order].any(axis=1)
    names, centres, starts, vectors, radii = [], [], [], [], []
    counts, radius, reach, by, turned, carried = [0], [], [], [], [], []
    for body, axes in zip(model.pairs.bodies, axes_of, strict=True):
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
        ends, centre, size = ball_about(axes)
        at_zero, by_slide = chain_reaches(joints, order, body, [centre, *ends])
        names.append(body.name())
        centres.append((frame, np.append(X_FB.multiply(centre), 1.0)))
        for axis in axes:
            p, end = X_FB.multiply(axis.p_B0), X_FB.multiply(axis.p_B1)
            starts.append((frame, np.append(p, 1.0)))
            vectors.append((frame, np.append(end - p, 0.0)))
            radii.append(axis.radius)
        counts.append(len(radii))
        radius.append(size)
        reach.append(at_zero)
        by.append(by_slide)
        thickest = max(axis.radius for axis in axes)
        turned.append(np.where(moved & turning, thickest, 0.0))
        carried.append(moved.astype(float))
    per_slide = lengths_of_slides(joints)
    by = np.array(by).reshape(-1, len(per_slide), nv).transpose(1, 0, 2)
    longer = [k for k in np.flatnonzero(per_slide > 0.0) if by[k].any()]
    places = np.argsort(order)
    limits = model.plant.GetPositionLowerLimits(), model.plant.GetPositionUpperLimits()
    extents = np.maximum(*np.abs(limits))[tree.position][longer]
    unlimited = ~np.isfinite(extents)
    if (by[longer][unlimited] @ errors).any():
        raise ScenarioError(
            "controller.tracking_error: a joint slides without limits, and "
            "what carries it errs: nothing bounds how near links are to obstacles; "
            "give the joint limits, or what carries it no error (tracking_errors)"
        )
    extents[unlimited] = 0.0
    reach = np.array(reach, dtype=float).reshape(-1, nv)
    reach += np.tensordot(extents, by[longer], 1)
    slides = np.array([places[joints.velocities[k][0]] for k in longer], dtype=np.int64)
    longest = reach + np.tensordot(errors[slides], by[longer], 1)
    lost = longest @ errors
    selection, first = joints.select([*centres, *starts, *vectors])
    numbers = Links(
        np.concatenate((model.robot.value.selection[: 3 * nv], selection)),
        np.concatenate((model.robot.value.first[: 3 * nv], first)),
        np.array(radius, dtype=float) + lost,
        np.array(counts, dtype=np.int64),
        np.array(radii, dtype=float) + np.repeat(lost, np.diff(counts)),
        reach,
        np.array(turned, dtype=float).reshape(-1, nv),
        np.array(carried, dtype=float).reshape(-1, nv),
        joints.above(order),
        slides,
        extents,
        np.ascontiguousarray(by[longer]),
    )
    return numbers, tuple(names)
