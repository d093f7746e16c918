"""Rows of the distances of meshes, where a motion is changed.

Where pairs are to be parted the rows are of their nearest points (`nearest_points`).
Elsewhere pairs with two joints between them have rows, which are interpolated
(`pair_grids`): so that most meshes are apart before they are asked.

Nothing that is certified depends on these: `mesh_clearance` measures anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.nearest_points import NearestPoints
from crar_drake.references.pair_grids import PairGrid
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
        self._grids = {row: PairGrid(table) for row, table in clearance.tables.items()}
        plant = clearance.robot.plant
        self._lower = plant.GetPositionLowerLimits()
        self._upper = plant.GetPositionUpperLimits()
        # (2, n) of each, by how much joints of the robot move its two.
        robot, n = self._robot, self._robot.n
        moves = robot.configurations(np.eye(n)) - robot.configurations(np.zeros((1, n)))
        self._moves = {k: moves[:, x.table.columns].T for k, x in self._grids.items()}
        # What is built closer than that is not asked to be farther apart.
        at_zero = [x.find(np.zeros((1, 2)))[0][0] for x in self._grids.values()]
        asked = np.fmin(np.fmax(0.5 * np.array(at_zero), _CLEAR), _ASKED)
        self._asked = dict(zip(self._grids, asked, strict=True))

    def touching(self, q: np.ndarray) -> np.ndarray:
        """See `trajectory.keeping.Meshes`."""
        found = self._clearance.find(q[:, self._columns()])
        touching = found.at_frames < _CLEAR
        ways = found.on_ways < _CLEAR
        touching[:, :-1] |= ways
        touching[:, 1:] |= ways
        for grid in self._grids.values():
            grid.keep()
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
            rows = [no_rows(q.shape[1]), *self._of_grids(at, whole, where, look)]
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

    def _of_grids(
        self, at: Samples, q: np.ndarray, where: np.ndarray, look: float
    ) -> list[NearRows]:
        """Of each pair with two joints between them, where no nearest points are.

        Args:
            at, look: as of `optimiser.Problem`.
            q: (S, nq) positions of the plant at the samples.
            where: as of `trajectory.keeping.Meshes`.
        """
        columns, rows, look = self._columns(), [], min(look, _LOOK)
        # What is beyond a limit will not stay so: no cells are measured for it.
        inside = np.clip(q, self._lower, self._upper)
        for row, grid in self._grids.items():
            both = grid.table.columns
            d, slopes = grid.find(inside[:, both])
            near = d < self._asked[row] + look
            if not near.any():
                continue
            some = np.flatnonzero(near & ~where[row, at.frame])
            d, slopes = d[some] - self._asked[row], slopes[some]
            slopes *= inside[some[:, None], both] == q[some[:, None], both]
            gradient = np.zeros((len(some), len(columns)))
            gradient[:, columns] = slopes @ self._moves[row]
            number = np.full(len(some), row)
            rows.append(NearRows(some, number, d, gradient))
        return rows

    def _columns(self) -> list[int]:
        return [self._names.index(name) for name in self._robot.joint_names]
