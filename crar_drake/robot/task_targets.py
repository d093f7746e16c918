"""What tasks mean in a plant: frames, points and joints."""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame

from crar_drake.errors import ModelError, nearest
from crar_drake.law.tasks import TaskLayout
from crar_drake.robot.description import (
    RobotDescription,
    find_frame,
    find_joint,
    frame_names,
)
from crar_drake.robot.joints import names_by_joint
from crar_drake.robot.task import Task


def find_targets(
    plant: MultibodyPlant,
    description: RobotDescription,
    tasks: Sequence[Task],
    joint_names: list[str],
) -> tuple[list[tuple[Frame, np.ndarray]], TaskLayout]:
    """Finds in the plant what the tasks are of.

    Args:
        plant: finalized.
        joint_names: (n,) of the controlled joints.

    Returns:
        Per task its frame F and its point p_FT (3,) [m], of a joint the world's, which
        no row uses; and the tasks' rows.

    Raises:
        ModelError: a name is not in the plant, or two tasks have one.
    """
    targets, joints = [], []
    for task in tasks:
        if task.kind == "joint":
            joints.append(_find_task_joint(plant, task, joint_names))
            targets.append((plant.world_frame(), np.zeros(3)))
            continue
        known = description.task_frames
        name = known.get(task.frame, task.frame)
        try:
            frame = find_frame(plant, name)
        except ModelError as error:
            if task.frame in known:
                raise
            what = str(error)
            if known:
                close = nearest(task.frame, [*known, *frame_names(plant)])
                what = (
                    f"robot {description.name} has neither a point nor a frame "
                    f"{task.frame!r}{close}"
                )
            raise ModelError(f"task {task.name or task.frame}: {what}") from error
        targets.append((frame, np.asarray(task.point, dtype=float)))
    names = tuple(task.name or task.of for task in tasks)
    for name in names:
        if names.count(name) > 1:
            raise ModelError(f"two tasks are named {name!r}; name them apart")
    kinds = tuple(task.kind for task in tasks)
    return targets, TaskLayout(names, kinds, tuple(joints))


def _find_task_joint(plant: MultibodyPlant, task: Task, joint_names: list[str]) -> int:
    """Which of the controlled joints a task of kind joint tracks."""
    name = task.joint
    if "::" in name:  # which the plain name is, where no other joint has it
        joint = find_joint(plant, name)
        name = names_by_joint(plant)[joint.velocity_start()]
    if name in joint_names:
        return joint_names.index(name)
    raise ModelError(
        f"task {task.name or task.joint}: joint: {task.joint!r} is no controlled "
        f"joint with one position{nearest(task.joint, joint_names)}"
    )
