"""What of a robot's legs a motion must know to stand on the floor."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LegShape:
    """A leg, with the robot as it stands at rest; all in the world's axes then."""

    hip: np.ndarray  # (3,) from the base's origin to the centre of the hip [m]
    thigh: float  # its length [m]
    shank: float  # its length [m]
    points: np.ndarray  # (V, 3) of the foot's surface, from the foot's frame [m]
    heel: np.ndarray  # (3,) the middle of the sole's rear edge [m]
    ball: np.ndarray  # (3,) and of its front edge [m]

    @property
    def length(self) -> float:
        """Of thigh and shank [m]."""
        return self.thigh + self.shank
