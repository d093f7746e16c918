"""Where points of a robot's links are, and how every joint moves them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable, RigidBody
from pydrake.systems.framework import Context

_ORIGIN = np.zeros(3)


class LinkKinematics:
    """Positions of points and the joints' motion, of several states at once.

    About the world's origin, column j of a link's spatial Jacobian is the same for
    every link that joint j carries, and 0 for all others. One matrix S (6, nv), read
    off the links at the ends of the tree, therefore serves all links: a wrench
    [moment about the origin; force] on link L does work on the joints at the rates
    wrench^T S, where `carried_by(body)` is true. A force f at point p is the wrench
    [p x f; f].

    Bodies that are welded together are one link.

    Attributes:
        links: L bodies, one of each link.
        selection: (4 L, P + V) homogeneous points and vectors in their links' frames,
            each in the rows of its link.
        ends: links whose Jacobians tell S, and
        end_signs: (ends, 1, nv) -1 where a column is taken from an end, else 0.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        points: Sequence[tuple[RigidBody, np.ndarray]],
        vectors: Sequence[tuple[RigidBody, np.ndarray]] = (),
        bodies: Sequence[RigidBody] = (),
    ) -> None:
        """
        Args:
            plant: finalized.
            points: body B and p_BP (3,) of each point [m].
            vectors: body B and (3,) in B of each vector that turns with it.
            bodies: others whose motion S is to tell.
        """
        self._plant = plant
        self._world: Frame = plant.world_frame()
        self.links: list[RigidBody] = []
        self._link_of: dict[int, int] = {}  # index of a link's first body to the link
        for body in (*bodies, *(body for body, _ in (*points, *vectors))):
            first = self._first_welded(body)
            if int(first.index()) not in self._link_of:
                self._link_of[int(first.index())] = len(self.links)
                self.links.append(first)
        # Column i picks point i out of all links' poses [X_WL0 X_WL1 ...] (3, 4 L).
        placed = [(*point, 1.0) for point in points]
        placed += [(*vector, 0.0) for vector in vectors]
        self.selection = np.zeros((4 * len(self.links), len(placed)))
        context = plant.CreateDefaultContext()
        for i, (body, p_B, one) in enumerate(placed):
            first = self._first_welded(body)
            X_LB = plant.CalcRelativeTransform(
                context, first.body_frame(), body.body_frame()
            ).GetAsMatrix34()
            row = 4 * self._link_of[int(first.index())]
            self.selection[row : row + 3, i] = X_LB @ np.append(p_B, one)
            self.selection[row + 3, i] = one
        self._carried = self._find_carried()  # (L, nv)
        self._choose_ends()

    def carried_by(self, body: RigidBody) -> np.ndarray:
        """Whether a velocity moves a body that was given: (nv,) bool."""
        return self._carried[self._link_of[int(self._first_welded(body).index())]]

    def __call__(self, contexts: Sequence[Context]) -> tuple[np.ndarray, np.ndarray]:
        """Points (K, 3, P + V), with the vectors last, and S (K, 6, nv), all in W.

        Args:
            contexts: K contexts of the plant.
        """
        poses, ends = self.ask(contexts)
        K = len(contexts)
        X = np.concatenate(poses, axis=1).reshape(3, K, -1)
        points = X.swapaxes(0, 1) @ self.selection
        J = np.concatenate(ends).reshape(K, len(self.ends), 6, self.end_signs.shape[2])
        return points, (J * self.end_signs).sum(axis=1)

    def ask(
        self, contexts: Sequence[Context]
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Drake's answers that all else follows from, context by context.

        Args:
            contexts: K contexts of the plant.

        Returns:
            K L poses X_WL (3, 4) of the links; K Jacobians (6, nv) for each of `ends`,
            of how the world moves about its origin as seen from there.
        """
        plant, W, kV = self._plant, self._world, JacobianWrtVariable.kV
        poses, ends = [], []
        for context in contexts:
            poses += [
                plant.EvalBodyPoseInWorld(context, link).GetAsMatrix34()
                for link in self.links
            ]
            # It is the link's motion, negated; of the world's origin it needs no shift.
            ends += [
                plant.CalcJacobianSpatialVelocity(context, kV, W, _ORIGIN, end, W)
                for end in self.ends
            ]
        return poses, ends

    def _first_welded(self, body: RigidBody) -> RigidBody:
        welded = self._plant.GetBodiesWeldedTo(body)
        return min(welded, key=lambda other: int(other.index()))

    def _find_carried(self) -> np.ndarray:
        plant = self._plant
        carried = np.zeros((len(self.links), plant.num_velocities()), dtype=bool)
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            if not joint.num_velocities():
                continue
            start = joint.velocity_start()
            moved = {
                int(body) for body in plant.GetBodiesKinematicallyAffectedBy([index])
            }
            for i, link in enumerate(self.links):
                if int(link.index()) in moved:
                    carried[i, start : start + joint.num_velocities()] = True
        return carried

    def _choose_ends(self) -> None:
        """As few links as carry every column, and which column to take of which."""
        missing = self._carried.any(axis=0)
        ends, signs = [], []
        while missing.any():
            best = int(np.argmax((self._carried & missing).sum(axis=1)))
            taken = self._carried[best] & missing
            ends.append(self.links[best].body_frame())
            signs.append(-1.0 * taken)
            missing &= ~taken
        if not ends:  # nothing moves: any link will do, and contributes nothing
            ends.append(self._world)
            signs.append(np.zeros(self._carried.shape[1]))
        self.ends = ends
        self.end_signs = np.array(signs)[:, None, :]
