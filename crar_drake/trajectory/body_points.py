"""Points that a robot's links carry, in the world, and how they move with root and
joints.

Unknowns y of a frame are the root's displacement from where it is given, a turn of it
and the joints: p_WR = p_0 + y_0:3, R_WR = exp(y_3:6) R_0, q = y_6:. A turn is a
rotation vector in the world's axes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.robot.model import ControlModel
from crar_drake.trajectory.distance_rows import configurations, find_poses

ROOT = 6  # unknowns of it
_SMALL = 1e-4  # [rad] below which a turn's Jacobian is taken from its series


def skew(v: np.ndarray) -> np.ndarray:
    """(..., 3, 3) of the cross products v x."""
    found = np.zeros((*v.shape, 3))
    found[..., 0, 1], found[..., 0, 2] = -v[..., 2], v[..., 1]
    found[..., 1, 0], found[..., 1, 2] = v[..., 2], -v[..., 0]
    found[..., 2, 0], found[..., 2, 1] = -v[..., 1], v[..., 0]
    return found


def turn_jacobian(turn: np.ndarray) -> np.ndarray:
    """(K, 3, 3) J with omega = J d(turn): of the rotation exp(turn), in the world's
    axes (K. M. Lynch and F. C. Park, "Modern Robotics", Eq. 8.37 gives its use).

    Args:
        turn: (K, 3) rotation vectors [rad].
    """
    angle = np.linalg.norm(turn, axis=1)[:, None, None]
    safe = np.where(angle > _SMALL, angle, 1.0)
    a = np.where(angle > _SMALL, (1.0 - np.cos(safe)) / safe**2, 0.5)
    b = np.where(angle > _SMALL, (safe - np.sin(safe)) / safe**3, 1.0 / 6.0)
    of = skew(turn)
    return np.eye(3) + a * of + b * of @ of


class Placed:
    """The links of a robot at K frames, and what their points do there."""

    def __init__(
        self,
        model: ControlModel,
        rest: np.ndarray,
        base: tuple[np.ndarray, np.ndarray],
        p_0: np.ndarray,
        R_0: np.ndarray,
        y: np.ndarray,
    ) -> None:
        """
        Args:
            model: of the robot, its root fixed; its L tasks are the poses of links.
            rest: (nq,) its rest posture.
            base: (3,), (3, 3) where its root is fixed.
            p_0, R_0: (K, 3) [m], (K, 3, 3) where the root is given.
            y: (K, 6 + n) the unknowns.
        """
        q = y[:, ROOT:]
        R, p, J = find_poses(configurations(model, rest, q), model.robot_by_pair)
        n, rows = q.shape[1], model.layout
        J = J[:, :, :n]
        turn = Rotation.from_rotvec(y[:, 3:ROOT]).as_matrix()
        R_WR = turn @ R_0
        self.root_rotations, self.root_positions = R_WR, p_0 + y[:, :3]
        root = (R_WR @ base[1].T)[:, None]
        self.R = root @ R  # (K, L, 3, 3)
        self.from_root = (root @ (p - base[0])[..., None])[..., 0]  # (K, L, 3)
        self._linear = root @ J[:, rows.linear_rows]  # (K, L, 3, n)
        self._angular = root @ J[:, rows.angular_rows]
        self.turning = turn_jacobian(y[:, 3:ROOT])  # (K, 3, 3)

    def points(
        self, links: Sequence[int], offsets: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points of links: p_WP (K, P, 3) [m], and their Jacobians (K, P, 3, 6 + n).

        Args:
            links: (P,) which of the tasks each is on.
            offsets: (P, 3) p_LP in its frame [m].
        """
        links = np.asarray(links, dtype=int)
        off = (self.R[:, links] @ offsets[..., None])[..., 0]
        arm = self.from_root[:, links] + off
        K, P, _ = arm.shape
        n = self._linear.shape[-1]
        J = np.empty((K, P, 3, ROOT + n))
        J[..., :3] = np.eye(3)
        J[..., 3:ROOT] = -skew(arm) @ self.turning[:, None]
        J[..., ROOT:] = self._linear[:, links] - skew(off) @ self._angular[:, links]
        return self.root_positions[:, None] + arm, J

    def heights(
        self, frames: np.ndarray, links: np.ndarray, offsets: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of single points at single frames: z (N,) [m], and gradients (N, 6 + n).

        Args:
            frames, links: (N,) which of the K frames, and which of the tasks.
            offsets: (N, 3) p_LP in its frame [m].
        """
        off = (self.R[frames, links] @ offsets[..., None])[..., 0]
        arm = self.from_root[frames, links] + off
        n = self._linear.shape[-1]
        g = np.zeros((len(frames), ROOT + n))
        g[:, 2] = 1.0
        g[:, 3:ROOT] = (-skew(arm)[:, 2:] @ self.turning[frames])[:, 0]
        around = (skew(off)[:, 2:] @ self._angular[frames, links])[:, 0]
        g[:, ROOT:] = self._linear[frames, links, 2] - around
        return self.root_positions[frames, 2] + arm[:, 2], g

    def turns(self, links: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Of links: R_WL (K, P, 3, 3), and angular Jacobians (K, P, 3, 6 + n)."""
        links = np.asarray(links, dtype=int)
        K, P, n = len(self.R), len(links), self._linear.shape[-1]
        J = np.zeros((K, P, 3, ROOT + n))
        J[..., 3:ROOT] = self.turning[:, None]
        J[..., ROOT:] = self._angular[:, links]
        return self.R[:, links], J
