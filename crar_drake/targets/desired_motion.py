"""What a robot is to follow, wherever it comes from."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.systems.framework import LeafSystem

from crar_drake.motion.performer import Performer


@dataclass(frozen=True)
class DesiredMotion:
    """The desired motion of one robot, as systems and as functions of time."""

    duration: float  # of the motion [s]
    # makes the system that emits `desired_tasks`, a function of time alone
    MakeTaskSource: Callable[[], LeafSystem]
    # makes that of `desired_prescribed`; None without prescribed joints
    MakePrescribedSource: Callable[[], LeafSystem] | None = None
    performer: Performer | None = None  # of the file; None with keyframes

    def tasks_at(self, time: float) -> np.ndarray:
        """[x_d; v_d; a_d] (layout.size,) of the tasks at a time [s]."""
        return _at(self._tasks, time)

    def prescribed_at(self, time: float) -> np.ndarray:
        """Positions (n_p,) of the prescribed joints at a time [s]."""
        if self.MakePrescribedSource is None:
            return np.zeros(0)
        values = _at(self._prescribed, time)
        return values[: len(values) // 3]

    @cached_property
    def _tasks(self) -> LeafSystem:
        return self.MakeTaskSource()

    @cached_property
    def _prescribed(self) -> LeafSystem:
        return self.MakePrescribedSource()


def _at(source: LeafSystem, time: float) -> np.ndarray:
    """What a source emits at a time [s]."""
    context = source.CreateDefaultContext()
    context.SetTime(time)
    return source.get_output_port(0).Eval(context)
