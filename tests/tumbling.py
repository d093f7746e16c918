"""A root that tumbles, as a function of time."""

import numpy as np
from floating_robots import wxyz
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation


class Tumbling:
    """The root's pose over time: turns about every axis, several times, and swings."""

    def __init__(self, rest: RigidTransform, speed: float = 1.0) -> None:
        """
        Args:
            rest: X_WB that it turns and swings about.
            speed: of its time.
        """
        self._rest, self._speed = rest, speed

    def pose(self, time: float) -> tuple[Rotation, np.ndarray]:
        t = self._speed * time
        R = Rotation.from_euler("ZYX", [6.0 * t, 9.0 * t, 7.0 * np.sin(2.0 * t)])
        p = [0.3 * np.sin(3.0 * t), 0.2 * np.sin(2.0 * t), 0.2 * np.cos(4.0 * t)]
        R_WB = Rotation.from_matrix(self._rest.rotation().matrix())
        return R * R_WB, self._rest.translation() + p

    def rates(self, time: float, h: float = 1e-4) -> np.ndarray:
        """(12,) velocity and acceleration, by differences."""
        poses = [self.pose(time + k * h) for k in (-2, -1, 0, 1, 2)]
        twists = [
            np.concatenate([(b[0] * a[0].inv()).as_rotvec(), b[1] - a[1]]) / h
            for a, b in zip(poses[:-1], poses[1:], strict=True)
        ]
        middle = 0.5 * (twists[1] + twists[2])
        return np.concatenate([middle, (twists[2] - twists[1]) / h])

    def vector(self, time: float) -> np.ndarray:
        R, p = self.pose(time)
        return np.concatenate([wxyz(R), p, self.rates(time)])

    def carried(self, time: float, p_B: np.ndarray) -> tuple[np.ndarray, ...]:
        """Points (N, 3) of the body: where they are, their velocities and so on."""
        R, p = self.pose(time)
        omega, v, alpha, a = self.rates(time).reshape(4, 3)
        arm = R.apply(p_B)
        turning = np.cross(omega, arm)
        acceleration = a + np.cross(alpha, arm) + np.cross(omega, turning)
        return p + arm, v + turning, acceleration
