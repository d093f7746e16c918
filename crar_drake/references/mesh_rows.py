"""Rows of the distances of meshes, where a motion is changed.

Where pairs are to be parted the rows are of their nearest points (`nearest_points`).
Nothing that is certified depends on these: `mesh_clearance` measures anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.nearest_points import NearestPoints
from crar_drake.trajectory.distance_rows import NearRows, join_rows, no_rows
from crar_drake.trajectory.optimiser import Samples

# What is asked for each part of a way, and what is clear: a file's rounding moves no
# surface as far [m].
_ASKED, _CLEAR = 5e-4, 1e-5
_LOOK = 5e-3  # what is farther than this and what is asked is left out [m]


class MeshRows:
    """Rows of the pairs of `ClearanceOfMeshes`: `trajectory.keeping.Meshes`.

    Attributes:
        num_pairs: P.
    """

    def __init__(
        self, clearance: ClearanceOfMeshes, joint_names: Sequence[str]
    ) -> None:
        """
        Args:
            clearance: of the meshes.
            joint_names: (n,) the order of the joints; all of the robot are among them.
        """
        self._clearance, self._meshes = clearance, clearance.meshes
        self._robot, self._names = clearance.robot, list(joint_names)
        self.num_pairs = len(self._meshes.rows)

    def touching(self, q: np.ndarray) -> np.ndarray:
        """See `trajectory.keeping.Meshes`."""
        found = self._clearance.find(q[:, self._columns()])
        near, ways = found.at_frames < _CLEAR, found.on_ways < _CLEAR
        near[:, :-1] |= ways
        near[:, 1:] |= ways
        touching = np.zeros((self.num_pairs, len(q)), dtype=bool)
        touching[found.near] = near
        return touching

    def near_rows(
        self, where: np.ndarray, parts: int
    ) -> Callable[[Samples, np.ndarray, float], NearRows]:
        """See `trajectory.keeping.Meshes`."""
        columns, robot = self._columns(), self._robot
        of_joints = robot.velocities(np.eye(robot.n)).T
        # Parts that are halved in vain are those of a way about an edge.
        asked = parts * _ASKED
        pairs = np.flatnonzero(where.any(axis=1))
        near = [NearestPoints(self._meshes, *self._meshes.rows[k]) for k in pairs]

        def find(at: Samples, q: np.ndarray, look: float) -> NearRows:
            whole = robot.configurations(q[:, columns])
            rows = [no_rows(q.shape[1])]
            if len(pairs):
                R, p = self._meshes.poses(whole)
            order = np.lexsort([at.share, at.frame])
            order = order[at.share[order] * parts % 1.0 == 0.0]
            enough = asked + min(look, _LOOK)
            for pair, points in zip(pairs, near, strict=True):
                some = order[where[pair, at.frame[order]]]
                places = list(zip(at.frame[some], at.share[some], strict=True))
                k, d, of_plant = points.find(places, R[some], p[some], enough)
                gradient = np.zeros((len(k), q.shape[1]))
                gradient[:, columns] = of_plant @ of_joints
                number = np.full(len(k), pair)
                rows.append(NearRows(some[k], number, d - asked, gradient))
            return join_rows(*rows)

        return find

    def _columns(self) -> list[int]:
        return [self._names.index(name) for name in self._robot.joint_names]
