"""The points of a robot whose positions a control step needs, and what moves them."""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.tree import Frame, RigidBody

from crar_drake.law.compilation import Held, hold
from crar_drake.law.kinematics import Robot, TaskPoints
from crar_drake.law.tasks import TaskLayout
from crar_drake.robot.collision_pairs import WatchedPairs
from crar_drake.robot.kinematics import JointTree


def numbers_of_robot(
    joints: JointTree,
    pairs: WatchedPairs,
    layout: TaskLayout,
    task_targets: Sequence[tuple[Frame, np.ndarray]],
    order: np.ndarray,
    positions: np.ndarray,
    n: int,
) -> Held:
    """Collects every point whose position a step needs, and what moves it.

    Args:
        joints, pairs, layout, task_targets, order, positions, n: as those of a
            `ControlModel`.

    Returns:
        Holds the `Robot`.
    """
    placed = joints.axes(order)
    tasks = [frame.body() for frame, _ in task_targets]
    for body, (frame, p_FT) in zip(tasks, task_targets, strict=True):
        p_B = frame.GetFixedPoseInBodyFrame().multiply(p_FT)
        placed.append(joints.point(body, p_B))
    for i in layout.angular_tasks:
        R = task_targets[i][0].GetFixedRotationMatrixInBodyFrame().matrix()
        placed += [joints.vector(tasks[i], column) for column in R.T]
    first_axis = len(placed)
    axes = [
        (body, axis)
        for body, axes in zip(pairs.bodies, pairs.axes, strict=True)
        for axis in axes
    ]
    placed += [joints.point(body, axis.p_B0) for body, axis in axes]
    placed += [joints.vector(body, axis.p_B1 - axis.p_B0) for body, axis in axes]
    placed += [
        joints.point(body, corner)
        for body, axis in axes
        if axis.hull is not None
        for corner in axis.hull.corners
    ]

    def moved(bodies: Sequence[RigidBody]) -> np.ndarray:
        """(B, nv) 1 where a velocity, in the order of `order`, moves a body.

        By rows, as one row is by itself: all that differs is compiled for anew.
        """
        links = np.array([joints.place(body)[0] for body in bodies], dtype=int)
        return joints.moved_by[links][:, order].astype(float, order="C")

    carries, of_joints = moved(tasks), np.zeros((layout.m, len(order)))
    of_joints[layout.joint_rows, layout.rows.joints] = 1.0
    # What each row turns about, and the axis along which it moves.
    fixed = np.zeros((layout.m, 6))
    for rows in layout.angular_rows:
        fixed[rows, :3] = np.eye(3)
    for rows in layout.linear_rows:
        fixed[rows, 3:] = np.eye(3)
    tree, rows = hold(joints.tree), hold(layout.rows)
    task_points = TaskPoints(
        fixed=fixed,
        of_rows=layout.of_rows,
        carried=carries[layout.of_rows],
        carries=carries,
        above=joints.above(order),
        of_joints=of_joints,
    )
    carried = moved(pairs.bodies)
    moves = carried[pairs.body_a] - carried[pairs.body_b]
    selection, first = joints.select(placed)
    held = map(hold, pairs.for_equations(first_axis, moves))
    return hold(
        Robot(
            *(order, positions, n, selection, first, tree, hold(task_points), rows),
            *held,
        )
    )
