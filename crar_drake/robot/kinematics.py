"""Where points of a robot's links are, and how every joint moves them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable, RigidBody
from pydrake.systems.framework import Context

_ORIGIN = np.zeros(3)


class LinkKinematics:
    """What to ask of Drake for `equations.kinematics`: poses and a few Jacobians.

    Bodies that are welded together are one link.

    Attributes:
        links: L bodies, one of each link.
        selection: (P, 4 L) homogeneous points and vectors in their links' frames, each
            in the columns of its link, which begin at
        first: (P,).
        ends: links whose Jacobians tell the joints' motion, and
        end_signs: (E, nv) -1 where a column is taken from an end, else 0.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        placed: Sequence[tuple[tuple[RigidBody, np.ndarray], float]],
        bodies: Sequence[RigidBody] = (),
    ) -> None:
        """
        Args:
            plant: finalized.
            placed: body B and p_BP (3,) of each point, and 1 [m]; or B and (3,) in B
                of a vector that turns with it, and 0.
            bodies: others whose motion S is to tell.
        """
        self._plant = plant
        self._world: Frame = plant.world_frame()
        self.links: list[RigidBody] = []
        self._link_of: dict[int, int] = {}  # index of a link's first body to the link
        for body in (*bodies, *(body for (body, _), _ in placed)):
            first = self._first_welded(body)
            if int(first.index()) not in self._link_of:
                self._link_of[int(first.index())] = len(self.links)
                self.links.append(first)
        # Row i picks point i out of all links' poses, one below the other (4 L, 3).
        self.selection = np.zeros((len(placed), 4 * len(self.links)))
        self.first = np.empty(len(placed), dtype=int)
        for i, ((body, p_B), one) in enumerate(placed):
            self.first[i] = first = 4 * self.link_of(body)
            p_L = self.pose_in_link(body) @ np.append(p_B, one)
            self.selection[i, first : first + 4] = np.append(p_L, one)
        self._carried = self._find_carried()  # (L, nv)
        self._choose_ends()

    def carried_by(self, body: RigidBody) -> np.ndarray:
        """Whether a velocity moves a body that was given: (nv,) bool."""
        return self._carried[self.link_of(body)]

    def ask(self, contexts: Sequence[Context]) -> tuple[np.ndarray, np.ndarray]:
        """Drake's answers that all else follows from, see `equations.kinematics`.

        Args:
            contexts: K contexts of the plant.

        Returns:
            (K, 4 L, 3) poses X_WL of the links, transposed; (K, E, 6, nv) Jacobians of
            how the world moves about its origin as seen from each of `ends`.
        """
        plant, W, kV = self._plant, self._world, JacobianWrtVariable.kV
        poses, ends = [], []
        for context in contexts:
            poses += [
                plant.EvalBodyPoseInWorld(context, link).GetAsMatrix34().T
                for link in self.links
            ]
            # It is the link's motion, negated; of the world's origin it needs no shift.
            ends += [
                plant.CalcJacobianSpatialVelocity(context, kV, W, _ORIGIN, end, W)
                for end in self.ends
            ]
        K = len(contexts)
        X = np.concatenate(poses).reshape(K, -1, 3)
        J = np.ascontiguousarray(np.concatenate(ends))
        return X, J.reshape(K, len(self.ends), 6, -1)

    def link_of(self, body: RigidBody) -> int:
        """The place among `links` of the link that a body that was given belongs to."""
        return self._link_of[int(self._first_welded(body).index())]

    def pose_in_link(self, body: RigidBody) -> np.ndarray:
        """X_LB (3, 4) of a body that was given."""
        plant = self._plant
        return plant.CalcRelativeTransform(
            plant.CreateDefaultContext(),
            self._first_welded(body).body_frame(),
            body.body_frame(),
        ).GetAsMatrix34()

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
        self.end_signs = np.array(signs)
