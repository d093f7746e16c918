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
    tasks_at: Callable[[float], np.ndarray]  # time [s] to [x_d; v_d; a_d]
    # (layout.size,)
    prescribed_at: Callable[[float], np.ndarray]  # time [s] to the prescribed joints'
    # positions (nq_p,)
    MakeTaskSource: Callable[[], LeafSystem]  # makes the system that emits
    # `desired_tasks`
    MakePrescribedSource: Callable[[], LeafSystem] | None  # makes that of
    # `desired_prescribed`; None without prescribed joints
    performer: Performer | None = None  # of the file; None with keyframes
    start: np.ndarray | None = None  # (nq,) the whole robot at time 0; None where the
    # motion does not tell
