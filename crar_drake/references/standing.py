"""How a motion stands in its world: what tells right readings of a file."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody

# Frames that are looked at, evenly over the motion.
_FRAMES = 24

# Lowest points are on the floor within this [m]: hardly any is below it, and not only
# few frames come down to it, which is all that somebody who runs or jumps does.
_ON_FLOOR, _BELOW, _DOWN = 0.1, 0.1, 0.3

# Of what counts as much as one: joints beyond their limits, in total [rad]; how the
# lowest points go up and down [m]; the tilt of the sole that is lower [rad].
_SCALES = 0.3, 0.05, 0.3


class Standing:
    """A motion of a robot, in some of its frames."""

    def __init__(self, motion: RobotMotion, robot: WholeBody) -> None:
        """
        Args:
            motion: its joints have the robot's names, in any order.
            robot: that moves.
        """
        last = motion.num_frames - 1
        rows = np.unique(np.linspace(0, last, _FRAMES).astype(int))
        columns = robot.columns_in(motion.joint_names)
        self._robot = robot
        self._q = motion.joint_positions[rows][:, columns]
        self._p, self._R = motion.root_positions[rows], motion.root_rotations[rows]
        beyond = np.maximum(robot.lower - self._q, self._q - robot.upper)
        # (n,) how far joints are beyond their limits in a tenth of the frames [rad]
        self.beyond = np.percentile(np.maximum(beyond, 0.0), 90, axis=0)

    @cached_property
    def _poses(self) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        links = tuple(self._robot.outlines)
        return links, *self._robot.poses_in_world(self._p, self._R, self._q, links)

    @cached_property
    def _lows(self) -> np.ndarray:
        """(T, L) heights of each link's lowest point [m]."""
        return self._robot.lowest(*self._poses)

    @property
    def lowest(self) -> np.ndarray:
        """(T,) heights of the robot's lowest points; none without shapes [m]."""
        return self._lows.min(axis=1) if self._lows.size else np.empty(0)

    @property
    def on_floor(self) -> bool:
        """Whether the robot's lowest points stand, or come down, on z = 0."""
        if not self.lowest.size:
            return False
        below, down = np.quantile(self.lowest, [_BELOW, _DOWN])
        return bool(below > -_ON_FLOOR and down < _ON_FLOOR)

    @property
    def off_floor(self) -> float:
        """How far the robot's lower points are from z = 0 [m]."""
        low = self.lowest
        return float(np.abs(np.quantile(low, _BELOW))) if low.size else 0.0

    @property
    def tilt(self) -> float:
        """Of the root's z axis against the vertical, on average [rad]."""
        return mean_tilt(self._R)

    @cached_property
    def cost(self) -> float:
        """How badly it stands and keeps limits; 0 is best, and 1 is much."""
        limits, floor, sole = _SCALES
        low = np.sort(self.lowest)[: (self.lowest.size + 1) // 2]  # not what jumps
        spread = float(low.std()) if low.size else 0.0
        return float(self.beyond.sum()) / limits + spread / floor + self._sole() / sole

    def _sole(self) -> float:
        """How tilted the lower of two feet is on average, against the robot at zero
        [rad]; 0 without feet."""
        robot = self._robot
        feet = robot.links_at(("left_foot", "right_foot"))
        links, _, R_WB = self._poses
        columns = [links.index(foot) for foot in feet if foot in links]
        if len(columns) < 2:
            return 0.0
        _, R_zero = robot.poses_in_root(np.zeros((1, robot.n)), links)
        lower = self._lows[:, columns].argmin(axis=1)
        up = [
            R_WB[t, columns[k], 2] @ R_zero[0, columns[k], 2]
            for t, k in enumerate(lower)
        ]
        return float(np.arccos(np.clip(up, -1.0, 1.0)).mean())


def mean_tilt(rotations) -> float:
    """Of the z axes of rotations against the vertical, on average [rad]."""
    cosines = rotations.apply([0.0, 0.0, 1.0])[:, 2]
    return float(np.arccos(np.clip(cosines, -1.0, 1.0)).mean())
