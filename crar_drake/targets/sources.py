"""What the controller is asked to track: systems that emit `desired_tasks`."""

from collections.abc import Mapping

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from crar_drake.errors import ScenarioError
from crar_drake.law.tasks import TaskLayout
from crar_drake.targets.ways import TaskWay


class PoseTrajectorySource(LeafSystem):
    """Emits [x_d; v_d; a_d] of tasks of any kind along keyframes or a motion.

    Drake's TrajectorySource serves position tasks; it has no derivatives for
    orientations.

    Output port:
        desired_tasks: (layout.size,), see `TaskLayout`.
    """

    def __init__(self, layout: TaskLayout, ways: Mapping[str, TaskWay]) -> None:
        """
        Raises:
            ScenarioError: a task has no keyframes, or keyframes no task.
        """
        missing = [name for name in layout.names if name not in ways]
        unknown = [name for name in ways if name not in layout.names]
        if missing:
            raise ScenarioError(f"keyframes: none for task {', '.join(missing)}")
        if unknown:
            raise ScenarioError(
                f"keyframes: there is no task {', '.join(unknown)}; the tasks are "
                f"{', '.join(layout.names)}"
            )
        self._layout = layout
        self._ways = [ways[name] for name in layout.names]
        self._joints = [
            way
            for way, kind in zip(self._ways, layout.kinds, strict=True)
            if kind == "joint"
        ]
        self.duration = max(way.end for way in self._ways)
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
            R[i], v[rows], a[rows] = self._ways[task].orientation(time)
        for i, task in enumerate(layout.linear_tasks):
            rows = layout.linear_rows[i]
            p[i], v[rows], a[rows] = self._ways[task].position(time)
        q = np.empty(len(layout.joint_rows))
        for i, way in enumerate(self._joints):
            row = layout.joint_rows[i]
            q[i], v[row], a[row] = way.joint(time)
        return layout.pack(R, p, v, a, q)

    def _Calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.at(context.get_time()))
