"""Distances of meshes, and their gradients, where a motion is to part them.

Of two surfaces that are apart, d is the distance of their nearest points P of A and Q
of B. With n the direction from P to Q

    d = n . (p_Q - p_P),    dd/dq = n . (J_Q - J_P).

Of two that meet there is no such pair. B is then moved out of A along some direction m,
until they are hardly apart. The nearest points there, moved back with B, have d and the
gradient, and d is negative. As m the direction n of a neighbour on the motion is taken,
where it is known, and then the n that was found, while the way out becomes shorter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.mesh_pairs import MeshPairs, relative_poses
from crar_drake.trajectory.distance_rows import NearRows, join_rows, no_rows
from crar_drake.trajectory.optimiser import Samples

# What is asked, and what is clear: a file's rounding moves no surface as far [m].
_ASKED, _CLEAR = 1.5e-3, 1e-5
# Surfaces that are nearer are taken as if they met, and moved as far out [m].
_APART = 1e-4
# A way out is sought so far, then twice as far and so on [m].
_FIRST, _FARTHEST = 1e-3, 0.128
_TURNS = 3  # of the direction of a way out, at most
_ADVANCES = 30  # back on it, at most
_AXES = np.vstack([np.eye(3), -np.eye(3)])


class MeshRows:
    """Rows of the pairs of `ClearanceOfMeshes`: `trajectory.keeping.Meshes`."""

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

    def touching(self, q: np.ndarray) -> np.ndarray:
        """See `trajectory.keeping.Meshes`."""
        found = self._clearance.find(q[:, self._columns()])
        touching = found.at_frames < _CLEAR
        ways = found.on_ways < _CLEAR
        touching[:, :-1] |= ways
        touching[:, 1:] |= ways
        return touching

    def near_rows(
        self, pairs: np.ndarray, at: Samples, q: np.ndarray, look: float
    ) -> NearRows:
        """See `trajectory.keeping.Meshes`."""
        columns, robot = self._columns(), self._robot
        poses = self._meshes.poses(robot.configurations(q[:, columns]))
        order = np.lexsort([at.share, at.frame])
        rows = [no_rows(q.shape[1])]
        for number, pair in enumerate(pairs):
            k, d, of_plant = self._of_pair(pair, order, poses, _ASKED + look)
            gradient = np.zeros((len(k), q.shape[1]))
            gradient[:, columns] = of_plant @ robot.velocities(np.eye(robot.n)).T
            rows.append(NearRows(k, np.full(len(k), number), d - _ASKED, gradient))
        return join_rows(*rows)

    def _columns(self) -> list[int]:
        return [self._names.index(name) for name in self._robot.joint_names]

    def _of_pair(
        self, pair: int, order: np.ndarray, poses: tuple, enough: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where a pair is nearer than enough: which samples, d [m] and (R, nv) its
        gradient.

        Args:
            pair: which.
            order: (S,) of the samples on the motion.
            poses: R_WF (S, N, 3, 3) and p_WF (S, N, 3) of all frames.
            enough: [m].
        """
        meshes, (R, p) = self._meshes, poses
        i, j = meshes.rows[pair]
        a, b = meshes.meshes[i].frame, meshes.meshes[j].frame
        X = relative_poses(R[order], p[order], a, b)
        k, P, Q, n = nearest_points(meshes, i, j, *X, enough)
        k = order[k]
        d = np.sum(n * (Q - P), axis=1)
        P, Q, n = (np.einsum("kxy,ky->kx", R[k, a], x) for x in (P, Q, n))
        joints = meshes.joints
        of_joint = joints.frame_of_velocity
        axes, ways = (
            np.einsum("kvxy,vy->kvx", R[k][:, of_joint], x)
            for x in (joints.turns, joints.slides)
        )
        gradient = np.zeros((len(k), len(of_joint)))
        for point, frame, sign in ((P, a, -1.0), (Q, b, 1.0)):
            arms = (point + p[k, a])[:, None] - p[k][:, of_joint]
            moves = np.cross(axes, arms) + ways
            moves = sign * joints.moved_by[frame][:, None] * moves
            gradient += np.einsum("kx,kvx->kv", n, moves)
        return k, d, gradient


def nearest_points(
    meshes: MeshPairs, i: int, j: int, R: np.ndarray, p: np.ndarray, enough: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of two meshes A and B that are not far apart, along a motion.

    Args:
        meshes: of the robot; i, j: which of its meshes.
        R, p: (S, 3, 3) R_AB and (S, 3) p_AB [m].
        enough: where they are as far apart, they are left out [m].

    Returns:
        Which of the S (K,), p_AP and p_AQ [m] and n, (K, 3) each. Where they meet and
        no way out was found, they are left out as well.
    """
    found, meet = {}, []
    for k in range(len(R)):
        d, P, Q = meshes.nearest(i, j, R[k], p[k])
        if d > _APART:
            found[k] = P, Q, (Q - P) / d
        else:
            meet.append(k)
    known = np.array(sorted(found))
    # From those that are clear on into what meets.
    meet.sort(key=lambda k: np.abs(known - k).min(initial=len(R)))
    for k in meet:
        near = [found[x][2] for x in (k - 1, k + 1) if x in found]
        ways = [_way_out(meshes, i, j, R[k], p[k], m) for m in near or _AXES]
        ways = [way for way in ways if way is not None]
        if ways:
            _, *found[k] = min(ways, key=lambda way: way[0])
    some = [
        k for k in sorted(found) if found[k][2] @ (found[k][1] - found[k][0]) < enough
    ]
    points = np.array([found[k] for k in some]).reshape(-1, 3, 3)
    return np.array(some, dtype=int), *points.swapaxes(0, 1)


def _way_out(meshes: MeshPairs, i: int, j: int, R, p, m) -> tuple | None:
    """How far B is moved out of A, along m or from there on a shorter way [m], with P,
    Q and n; None if no way is found."""
    best = None
    for _ in range(_TURNS):
        s, d = _FIRST, 0.0
        while s <= _FARTHEST:
            d, P, Q = meshes.nearest(i, j, R, p + s * m)
            if d > 0.0:
                break
            s *= 2.0
        if not d > 0.0:
            break
        # Less far by as much as they are apart, they do not meet yet.
        for _ in range(_ADVANCES):
            if d < 2.0 * _APART:
                break
            s -= d - _APART
            d, P, Q = meshes.nearest(i, j, R, p + s * m)
        if best is not None and s >= best[0]:
            break
        n = (Q - P) / d
        best, m = (s, P, Q - s * m, n), n
    return best
