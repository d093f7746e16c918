"""The points of a robot whose positions a control step needs, and what moves them."""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.tree import Frame, RigidBody

from crar_drake.law.compilation import Held, hold
from crar_drake.law.kinematics import Robot, TaskPoints
from crar_drake.law.tasks import TaskLayout, task_of_rows, task_wrenches
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
) -> tuple[np.ndarray, Held, Held]:
    """Collects every point whose position a step needs, and what moves it.

    Args:
        joints, pairs, layout, task_targets, order, positions, n: as those of a
            `ControlModel`.

    Returns:
        `pair_moves`, `robot_by_pair` and `robot_ahead` of the model.
    """

    def coordinates(body: RigidBody, x_B: np.ndarray, one: float):
        """Of a point (one 1) or vector (one 0) on a body: its frame, and there."""
        frame, X_FB = joints.place(body)
        x_F = X_FB.rotation() @ x_B + one * X_FB.translation()
        return frame, np.append(x_F, one)

    frames = joints.frame_of_velocity[order]
    placed = [(frame, np.array([0.0, 0.0, 0.0, 1.0])) for frame in frames]
    for vectors in (joints.turns, joints.slides):
        placed += [
            (frame, np.append(vector, 0.0))
            for frame, vector in zip(frames, vectors[order], strict=True)
        ]
    tasks = [frame.body() for frame, _ in task_targets]
    for frame, p_FT in task_targets:
        p_B = frame.GetFixedPoseInBodyFrame().multiply(p_FT)
        placed.append(coordinates(frame.body(), p_B, 1.0))
    for frame, _ in (task_targets[i] for i in layout.angular_tasks):
        R = frame.GetFixedRotationMatrixInBodyFrame().matrix()
        placed += [coordinates(frame.body(), column, 0.0) for column in R.T]
    first_axis = len(placed)
    axes = [
        (body, axis)
        for body, axes in zip(pairs.bodies, pairs.axes, strict=True)
        for axis in axes
    ]
    placed += [coordinates(body, axis.p_B0, 1.0) for body, axis in axes]
    placed += [coordinates(body, axis.p_B1 - axis.p_B0, 0.0) for body, axis in axes]
    placed += [
        coordinates(body, corner, 1.0)
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

    of_rows = task_of_rows(layout)
    carries = moved(tasks)
    tree, rows = hold(joints.tree), hold(layout.rows)
    task_points = TaskPoints(
        fixed=task_wrenches(layout),
        of_rows=of_rows,
        carried=carries[of_rows],
        carries=carries,
        above=joints.moved_by[frames][:, order].astype(float, order="C"),
        of_joints=_joint_rows(layout, len(order)),
    )
    task_points = hold(task_points)
    carried = moved(pairs.bodies)
    moves = carried[pairs.body_a] - carried[pairs.body_b]
    pair_moves = np.ascontiguousarray(moves)
    selection, first = joints.select(placed)

    robots = [
        hold(
            Robot(
                *(order, positions, n, selection, first, tree, task_points, rows),
                hold(of),
            )
        )
        for of in pairs.for_equations(len(placed), first_axis, pair_moves)
    ]
    return pair_moves, *robots


def _joint_rows(layout: TaskLayout, nv: int) -> np.ndarray:
    """(m, nv) 1 where a row is a joint, in the order of `order`; (0, 0) if none."""
    if not len(layout.joint_rows):
        return np.zeros((0, 0))
    rows = np.zeros((layout.m, nv))
    rows[layout.joint_rows, layout.rows.joints] = 1.0
    return rows
