"""What a robot is to follow, wherever it comes from."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import LeafSystem

from crar_drake.motion.performer import Performer


@dataclass(frozen=True)
class DesiredMotion:
    """The desired motion of one robot, as functions of time and as systems."""

    duration: float  # of the motion [s]
    # time [s] to [x_d; v_d; a_d] (layout.size,)
    tasks_at: Callable[[float], np.ndarray]
    # time [s] to the prescribed joints' positions (n_p,)
    prescribed_at: Callable[[float], np.ndarray]
    # makes the system that emits `desired_tasks`
    MakeTaskSource: Callable[[], LeafSystem]
    # makes that of `desired_prescribed`; None without prescribed joints
    MakePrescribedSource: Callable[[], LeafSystem] | None
    performer: Performer | None = None  # of the file; None with keyframes
