"""What a robot is to follow, wherever it comes from."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import LeafSystem

from crar_drake.motion.performer import Performer


@dataclass(frozen=True)
class DesiredMotion:
    """The desired motion of one robot, as functions of time and as systems.

    Attributes:
        duration: of the motion [s].
        tasks_at: time [s] to [x_d; v_d; a_d] (layout.size,).
        prescribed_at: time [s] to the prescribed joints' positions (nq_p,).
        MakeTaskSource: makes the system that emits `desired_tasks`.
        MakePrescribedSource: makes that of `desired_prescribed`; None without
            prescribed joints.
        performer: what the motion file holds; None with keyframes.
        start: (nq,) the whole robot at time 0; None where the motion does not tell.
    """

    duration: float  # [s]
    tasks_at: Callable[[float], np.ndarray]
    prescribed_at: Callable[[float], np.ndarray]
    MakeTaskSource: Callable[[], LeafSystem]
    MakePrescribedSource: Callable[[], LeafSystem] | None
    performer: Performer | None = None
    start: np.ndarray | None = None
