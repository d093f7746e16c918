"""A recorded motion as a Drake system that emits targets."""

from __future__ import annotations

import os
from collections.abc import Sequence

from pydrake.systems.framework import BasicVector, Context, LeafSystem, OutputPort

from crar_drake.errors import InputError
from crar_drake.motion.conditioning import DEFAULT_CUTOFF
from crar_drake.motion.options import MotionOptions
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.targets.motion import load_motion_targets


class MotionSource(LeafSystem):
    """A person's motion, scaled to a robot's tasks.

                        ┌──────────────┐
                        │              ├──► desired_tasks
                        │ MotionSource │
                        │              ├──► desired_prescribed (if any)
                        └──────────────┘

    Output ports:
        desired_tasks: (layout.size,) [x_d; v_d; a_d] of the tasks in their order, in
            the world of a robot whose base is where its description has it.
        desired_prescribed: (3 n_p,) of the description's prescribed joints, in their
            order; absent if there are none.

    After the motion's end the targets stand still where they are; with `loop` it begins
    anew, and they jump.

    Attributes:
        duration: of the motion [s].
        model: of the robot with these tasks.
    """

    def __init__(
        self,
        motion: str | os.PathLike[str],
        robot: str | os.PathLike[str] | RobotDescription,
        tasks: Sequence[Task],
        *,
        cutoff: float = DEFAULT_CUTOFF,
        loop: bool = False,
        options: MotionOptions | None = None,
    ) -> None:
        """
        Args:
            motion: a name (`dance`, `cmu:05_02`) or the path of a recording.
            robot: as of `AddRobot`; its points are what a motion can drive.
            tasks: those of the controller.
            cutoff: of the low-pass on the motion [Hz].
            loop: whether it begins anew at its end.
            options: what is known of the motion beyond its file.

        Raises:
            ModelError: as of `ControlModel.FromDescription`.
            MotionError: the motion cannot be found, read or scaled.
            ScenarioError: a task is none that a motion can drive.
        """
        super().__init__()
        self.set_name("motion")
        if not isinstance(robot, RobotDescription):
            robot = load_robot_description(robot)
        self.model = ControlModel.FromDescription(robot, tasks)
        loaded = load_motion_targets(
            os.fspath(motion), self.model, options=options, cutoff=cutoff
        )
        self.duration, self._loop = loaded.duration, loop
        made = {
            "desired_tasks": loaded.MakeTaskSource,
            "desired_prescribed": loaded.MakePrescribedSource,
        }
        self._ports = {
            name: self._declare(name, make()) for name, make in made.items() if make
        }

    def get_output_port_desired_tasks(self) -> OutputPort:
        """Port (layout.size,)."""
        return self._ports["desired_tasks"]

    def get_output_port_desired_prescribed(self) -> OutputPort:
        """Port (3 n_p,).

        Raises:
            InputError: the description prescribes no joint.
        """
        if "desired_prescribed" not in self._ports:
            raise InputError(f"{self.get_name()}: no joint is prescribed")
        return self._ports["desired_prescribed"]

    def _declare(self, name: str, source: LeafSystem) -> OutputPort:
        """A port that emits what another system does, at the motion's time."""
        port, own = source.get_output_port(), source.CreateDefaultContext()

        def calc(context: Context, output: BasicVector) -> None:
            time = context.get_time()
            own.SetTime(time % self.duration if self._loop else time)
            output.SetFromVector(port.Eval(own))

        return self.DeclareVectorOutputPort(
            name, port.size(), calc, {self.time_ticket()}
        )
