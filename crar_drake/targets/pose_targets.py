"""Poses, as Drake's own inverse kinematics takes them, to `desired_tasks`."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, BusValue, Context, LeafSystem

from crar_drake.errors import InputError
from crar_drake.law.tasks import TaskLayout


class PoseTargets(LeafSystem):
    """Poses that rest, as targets of tasks.

    Connect one of the input ports. A task of kind "position" takes a pose's position,
    one of kind "orientation" its orientation; velocities and accelerations are 0.

    Input ports:
        poses: a list of RigidTransform, X_WT of each task in their order.
        bus: a BusValue of them by the tasks' names, as of Drake's
            DifferentialInverseKinematicsSystem.

    Output port:
        desired_tasks: (layout.size,), see `TaskLayout`.
    """

    def __init__(self, layout: TaskLayout) -> None:
        """
        Args:
            layout: of the controller: `controller.model.layout`.

        Raises:
            InputError: a task is a joint's, which has no pose.
        """
        super().__init__()
        self.set_name("pose_targets")
        if len(layout.joint_rows):
            raise InputError(f"{self.get_name()}: a joint's task has no pose")
        self._layout = layout
        poses = AbstractValue.Make([RigidTransform()] * len(layout.names))
        self._poses = self.DeclareAbstractInputPort("poses", poses)
        self._bus = self.DeclareAbstractInputPort("bus", Value(BusValue()))
        self.DeclareVectorOutputPort("desired_tasks", layout.size, self._Calc)

    def _Calc(self, context: Context, output: BasicVector) -> None:
        layout = self._layout
        if self._poses.HasValue(context):
            poses = list(self._poses.Eval(context))
        elif self._bus.HasValue(context):
            found = (self._bus.Eval(context).Find(name) for name in layout.names)
            poses = [each for each in found if each is not None]
        else:
            raise InputError(f"{self.get_name()}: connect poses or bus")
        if len(poses) != len(layout.names):
            raise InputError(
                f"{self.get_name()}: {len(poses)} poses for the tasks "
                f"{', '.join(layout.names)}"
            )
        R = [poses[i].rotation().matrix() for i in layout.angular_tasks]
        p = [poses[i].translation() for i in layout.linear_tasks]
        R, p = np.reshape(R, (-1, 3, 3)), np.reshape(p, (-1, 3))
        output.SetFromVector(layout.pack(R, p, None, None, np.zeros(0)))
