"""What of a robot's legs a motion must know to stand on the floor."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LegShape:
    """A leg, with the robot as it stands at rest; all in the world's axes then.

    Attributes:
        hip: (3,) from the base's origin to the centre of the hip [m].
        thigh, shank: lengths [m].
        points: (V, 3) of the foot's surface, from the foot's frame [m].
        heel, ball: (3,) the middle of the sole's rear and front edge [m].
    """

    hip: np.ndarray
    thigh: float
    shank: float
    points: np.ndarray
    heel: np.ndarray
    ball: np.ndarray

    @property
    def length(self) -> float:
        """Of thigh and shank [m]."""
        return self.thigh + self.shank
