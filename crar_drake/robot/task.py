"""What is tracked: a position, orientation or pose of a frame, or a joint."""

# YAML loading reads the types of the fields, so no postponed annotations here.
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from crar_drake.errors import ModelError
from crar_drake.law.tasks import KINDS


@dataclass
class Task:
    """One thing to track: the position, orientation or pose of a frame, or a joint.

    Attributes:
        name: the task's name; by default that of the frame or joint.
        frame: a task frame of the robot description, or any frame of the plant.
        kind: "position", "orientation", "pose" or "joint".
        joint: instead of a frame, if the kind is "joint": a controlled joint with one
            position.
        point: p_FT, the tracked point T in that frame [m].
        position_weight: weight of the position rows [1], or of a joint [m/rad].
        orientation_weight: weight of the orientation rows [m/rad].
    """

    frame: str = ""
    kind: str = "position"
    name: str = ""
    point: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    position_weight: float = 1.0
    orientation_weight: float = 1.0
    joint: str = ""

    @property
    def of(self) -> str:
        """What is tracked: the frame or the joint."""
        return self.joint if self.kind == "joint" else self.frame

    def validate(self) -> None:
        """Raises ModelError where a field is out of its range."""
        label = f"task {self.name or self.frame or self.joint or '(without a frame)'}"
        if self.kind not in KINDS:
            raise ModelError(f"{label}: kind: {self.kind!r} is none of {KINDS}")
        if self.kind == "joint":
            if not self.joint or self.frame:
                raise ModelError(
                    f"{label}: joint: give the name of the joint to track, and no frame"
                )
        elif self.joint:
            raise ModelError(f"{label}: joint: only for kind joint; give a frame")
        elif not self.frame:
            raise ModelError(f"{label}: frame: give the name of the frame to track")
        if np.shape(self.point) != (3,) or not np.isfinite(self.point).all():
            raise ModelError(f"{label}: point: {self.point} must be three numbers")
        for weight in ("position_weight", "orientation_weight"):
            if not 0.0 < getattr(self, weight) < np.inf:
                raise ModelError(f"{label}: {weight} must be positive")


def position_tasks(frames: list[str]) -> list[Task]:
    """One position task, of weight one, per frame.

    Args:
        frames: task frames of the robot description, or any frames of the plant.

    Raises:
        ModelError: it is one name, not a list.
    """
    _check_list(frames)
    return [Task(frame=frame) for frame in frames]


def joint_tasks(joints: list[str], weight: float = 1.0) -> list[Task]:
    """One task per joint, of one weight [m/rad].

    Args:
        joints: controlled joints of the plant.
        weight: of each.

    Raises:
        ModelError: as of `position_tasks`.
    """
    _check_list(joints)
    return [Task(kind="joint", joint=name, position_weight=weight) for name in joints]


def _check_list(names: list[str]) -> None:
    # Each letter would be a name.
    if isinstance(names, str):
        raise ModelError(f"tasks: {names!r} is one name; give a list, [{names!r}]")
    for name in names:
        if not isinstance(name, str):
            raise ModelError(f"tasks: {name!r} is no name of a frame or joint")


def check_tasks(tasks: Sequence[Task]) -> tuple[Task, ...]:
    """The tasks, each of which is one.

    Raises:
        ModelError: there is something else, or a task whose fields are out of range.
    """
    if isinstance(tasks, str) or not isinstance(tasks, Iterable):
        raise ModelError(
            f"tasks: {tasks!r} is no list of tasks; write position_tasks([...])"
        )
    tasks = tuple(tasks)
    for task in tasks:
        if not isinstance(task, Task):
            raise ModelError(
                f"tasks: {task!r} is no Task; write position_tasks([{task!r}]), or "
                "Task(frame=..., kind=...)"
            )
        task.validate()
    return tasks


def experiment_tasks(experiment: str) -> list[Task]:
    """The tasks of an experiment, one of `EXPERIMENTS`."""
    return position_tasks(EXPERIMENTS[experiment])


# The task sets of the paper's two experiments, Section IV.
EXPERIMENTS: dict[str, list[str]] = {
    "wrists": ["left_wrist", "right_wrist"],
    "upper-body": [
        "left_shoulder",
        "right_shoulder",
        "left_elbow",
        "right_elbow",
        "left_wrist",
        "right_wrist",
        "neck",
    ],
}
