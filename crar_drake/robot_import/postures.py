"""Poses of a plant's links in many postures at once, and how distances change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, PrismaticJoint, RevoluteJoint


@dataclass(frozen=True, eq=False)
class Placed:
    """Bodies and joints in K postures, in the world.

    Attributes:
        R: (K, B, 3, 3) and
        p: (K, B, 3), of the bodies, by index [m].
        axes: (K, n, 3) of the positions' joints; zero where a joint is of another kind.
        origins: (K, n, 3) a point of each axis [m].
    """

    R: np.ndarray
    p: np.ndarray
    axes: np.ndarray
    origins: np.ndarray


class Postures:
    """The tree of a plant's bodies, of joints that turn, slide or are welded.

    Other joints stay where the plant has them by default: what moves a robot as a whole
    does not change how far its links are apart.
    """

    def __init__(self, plant: MultibodyPlant) -> None:
        """
        Args:
            plant: finalized.
        """
        self.size = plant.num_positions()
        self.lower, self.upper = position_ranges(plant)
        self._context = plant.CreateDefaultContext()
        self._plant, self._count = plant, plant.num_bodies()
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        below = {int(joint.child_body().index()): joint for joint in joints}
        self.parents = np.full(self._count, -1)
        for child, joint in below.items():
            self.parents[child] = int(joint.parent_body().index())
        self._order = [below[child] for child in self._outwards()]
        self._fixed = {
            int(joint.child_body().index()): self._parts(joint) for joint in self._order
        }
        # Which positions move which body: (B, n).
        self.moved_by = np.zeros((self._count, self.size), dtype=bool)
        for joint in self._order:
            child = int(joint.child_body().index())
            self.moved_by[child] = self.moved_by[self.parents[child]]
            if isinstance(joint, RevoluteJoint | PrismaticJoint):
                self.moved_by[child, joint.position_start()] = True
        self.turns = np.zeros(self.size, dtype=bool)
        for joint in self._order:
            if isinstance(joint, RevoluteJoint):
                self.turns[joint.position_start()] = True

    def place(self, q: np.ndarray) -> Placed:
        """Everything in K postures (K, nq)."""
        count = len(q)
        R = np.tile(np.eye(3), (count, self._count, 1, 1))
        p = np.zeros((count, self._count, 3))
        axes, origins = (np.zeros((count, self.size, 3)) for _ in range(2))
        for joint in self._order:
            child = int(joint.child_body().index())
            parent = self.parents[child]
            R_PF, p_PF, R_MC, p_MC, axis = self._fixed[child]
            R_WF = R[:, parent] @ R_PF
            p_WM = p[:, parent] + R[:, parent] @ p_PF
            R_WM = R_WF
            if axis is not None:
                index = joint.position_start()
                axes[:, index] = R_WF @ axis
                if isinstance(joint, RevoluteJoint):
                    R_WM = R_WF @ _turned(axis, q[:, index])
                else:
                    p_WM = p_WM + axes[:, index] * q[:, index, np.newaxis]
                origins[:, index] = p_WM
            R[:, child] = R_WM @ R_MC
            p[:, child] = p_WM + R_WM @ p_MC
        return Placed(R, p, axes, origins)

    def gradients(
        self, placed: Placed, bodies: np.ndarray, points: np.ndarray, way: np.ndarray
    ) -> np.ndarray:
        """(K, n) how fast a point of a body, one in each posture, moves along a
        direction, per position.

        Args:
            placed: in K postures.
            bodies: (K,) indices.
            points: (K, 3) in the world [m].
            way: (K, 3) unit vectors.
        """
        arms = points[:, np.newaxis] - placed.origins
        moved = np.where(
            self.turns[:, np.newaxis], np.cross(placed.axes, arms), placed.axes
        )
        along = np.einsum("knx,kx->kn", moved, way)
        return np.where(self.moved_by[bodies], along, 0.0)

    def _outwards(self) -> Sequence[int]:
        depth = np.zeros(self._count, dtype=int)
        for body in range(self._count):
            ancestor = self.parents[body]
            while ancestor >= 0:
                depth[body] += 1
                ancestor = self.parents[ancestor]
        return [b for b in np.argsort(depth, kind="stable") if self.parents[b] >= 0]

    def _parts(self, joint: Joint):
        """Fixed parts of a child's pose: from parent to joint, from joint to child."""
        X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
        X_MC = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
        axis = None
        if isinstance(joint, RevoluteJoint):
            axis = np.array(joint.revolute_axis())
        elif isinstance(joint, PrismaticJoint):
            axis = np.array(joint.translation_axis())
        elif joint.num_positions():
            X_PF = X_PF @ joint.frame_on_child().CalcPose(
                self._context, joint.frame_on_parent()
            )
        return (
            X_PF.rotation().matrix(),
            X_PF.translation(),
            X_MC.rotation().matrix(),
            X_MC.translation(),
            axis,
        )


def position_ranges(plant: MultibodyPlant) -> tuple[np.ndarray, np.ndarray]:
    """(n,) lower and upper positions that are worth trying: a whole turn at most."""
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    unlimited = ~(np.isfinite(lower) & np.isfinite(upper))
    lower = np.where(unlimited, np.maximum(lower, -np.pi), lower)
    upper = np.where(unlimited, np.minimum(upper, lower + 2.0 * np.pi), upper)
    lower = np.where(unlimited, np.maximum(lower, upper - 2.0 * np.pi), lower)
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        if isinstance(joint, RevoluteJoint):
            at = joint.position_start()
            upper[at] = min(upper[at], lower[at] + 2.0 * np.pi)
    return lower, upper


def _turned(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(K, 3, 3) rotations about an axis."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    sine = np.sin(angle)[:, np.newaxis, np.newaxis]
    rest = (1.0 - np.cos(angle))[:, np.newaxis, np.newaxis]
    return np.eye(3) + sine * cross + rest * (cross @ cross)
