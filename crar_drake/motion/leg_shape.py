"""What of a robot's legs and trunk a motion must know to stand on the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LegShape:
    """A leg, with the robot as it stands at rest; all in the world's axes then.

    Attributes:
        hip: (3,) from the base's origin to the centre of the hip [m].
        thigh, shank: lengths [m].
        reach: how far the foot's frame can be from the hip in every direction that a
            leg takes in walking [m].
        foot: (3, 3) R_WF, of the foot's frame.
        points: (V, 3) of the foot's surface, from the foot's frame [m].
        heel, ball: (3,) the middle of the sole's rear and front edge [m].
        knee: how thick the shank is about the knee: a radius [m].
        shortest: how near the foot's frame can be to the hip: the knee bent as far as
            its limit and what is watched of the leg let it [m].
    """

    hip: np.ndarray
    thigh: float
    shank: float
    reach: float
    foot: np.ndarray
    points: np.ndarray
    heel: np.ndarray
    ball: np.ndarray
    knee: float = 0.0
    shortest: float = 0.0

    @property
    def length(self) -> float:
        """Of thigh and shank [m]."""
        return self.thigh + self.shank

    @property
    def sole_depth(self) -> float:
        """How far the sole is below the foot's frame, at rest [m]."""
        return float(-self.points[:, 2].min())


@dataclass(frozen=True)
class TrunkShape:
    """What the legs carry but arms, with the robot as it stands at rest.

    Attributes:
        pelvis: (V, 3) points of the base's surface, from its origin [m].
        waist: (3,) from there to the waist [m].
        upper: (V, 3) points of what is between waist and arms, from the waist [m].
        neck: (3,) unit vector from the waist to the neck.
        pitch, roll: how far its joints can lean the way from the waist to the neck,
            from straight up: ahead (negative: back), and to the right [rad].
    """

    pelvis: np.ndarray
    waist: np.ndarray
    upper: np.ndarray
    neck: np.ndarray
    pitch: tuple[float, float] = (-np.inf, np.inf)
    roll: tuple[float, float] = (-np.inf, np.inf)
