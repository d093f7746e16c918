"""What the controller is asked to track: systems that emit `desired_tasks`."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from crar_drake.errors import ScenarioError
from crar_drake.law.tasks import TaskLayout


class PoseTrajectory(Protocol):
    """The way of one task; it stands still after `end`.

    A way that no task of its layout asks for its orientation needs none, and likewise
    for the position and for the joint.
    """

    end: float  # [s]

    def position(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """p (3,) [m], its velocity and its acceleration at `time` [s], in W."""

    def orientation(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """R (3, 3), angular velocity (3,) and acceleration (3,) at `time`, in W."""

    def joint(self, time: float) -> tuple[float, float, float]:
        """q of a joint [rad or m], its velocity and its acceleration at `time`."""


class PoseTrajectorySource(LeafSystem):
    """Emits [x_d; v_d; a_d] of tasks of any kind along keyframes or a motion.

    Drake's TrajectorySource serves position tasks; it has no derivatives for
    orientations.

    Output port:
        desired_tasks: (layout.size,), see `TaskLayout`.
    """

    def __init__(
        self, layout: TaskLayout, trajectories: Mapping[str, PoseTrajectory]
    ) -> None:
        """
        Raises:
            ScenarioError: a task has no keyframes, or keyframes no task.
        """
        missing = [name for name in layout.names if name not in trajectories]
        unknown = [name for name in trajectories if name not in layout.names]
        if missing:
            raise ScenarioError(f"keyframes: none for task {', '.join(missing)}")
        if unknown:
            raise ScenarioError(
                f"keyframes: there is no task {', '.join(unknown)}; the tasks are "
                f"{', '.join(layout.names)}"
            )
        self._layout = layout
        self._trajectories = [trajectories[name] for name in layout.names]
        self._kinds = list(zip(self._trajectories, layout.kinds, strict=True))
        self.duration = max(t.end for t in self._trajectories)
        super().__init__()
        self.set_name("desired_tasks")
        self.DeclareVectorOutputPort(
            "desired_tasks", layout.size, self._Calc, {self.time_ticket()}
        )

    def at(self, time: float) -> np.ndarray:
        """[x_d; v_d; a_d] (layout.size,) at `time` [s]."""
        layout = self._layout
        R = np.empty((len(layout.angular_tasks), 3, 3))
        p = np.empty((len(layout.linear_tasks), 3))
        v, a = np.empty(layout.m), np.empty(layout.m)
        for i, task in enumerate(layout.angular_tasks):
            rows = layout.angular_rows[i]
            R[i], v[rows], a[rows] = self._trajectories[task].orientation(time)
        for i, task in enumerate(layout.linear_tasks):
            rows = layout.linear_rows[i]
            p[i], v[rows], a[rows] = self._trajectories[task].position(time)
        q = np.empty(len(layout.joint_rows))
        joints = [way for way, kind in self._kinds if kind == "joint"]
        for i, (way, row) in enumerate(zip(joints, layout.joint_rows, strict=True)):
            q[i], v[row], a[row] = way.joint(time)
        return layout.pack(R, p, v, a, q)

    def _Calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.at(context.get_time()))
