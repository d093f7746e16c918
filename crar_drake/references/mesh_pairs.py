"""The meshes of a robot's links, and which pairs of them can meet.

Each link's mesh is given in the frame F of `robot.kinematics` that carries it, so that
welded links share a pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex

from crar_drake.judging.judged_pairs import pairs_by_joints
from crar_drake.law.kinematics import link_poses
from crar_drake.references.surfaces import Surface
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.kinematics import JointTree
from crar_drake.robot_import.link_meshes import LinkMesh
from crar_drake.robot_import.meshes import triangles_of

# Meshes that are no farther apart touch: more than what doubles are off by, of a hull's
# vertices as of triangles [m].
ROUNDING = 1e-6


@dataclass(frozen=True)
class NotOf:
    """What nothing is said of."""

    # pairs of links with one joint between them; those with none, which are welded, are
    # one body
    one_joint: list[tuple[str, str]]
    # pairs that touch in the zero and in the rest posture
    as_built: list[tuple[str, str]]
    # pairs with a link that the root does not carry: they depend on where the root is
    beyond_root: list[tuple[str, str]]
    without_mesh: list[str]  # links that have no shape


class MeshPairs:
    """The pairs of links that more than one joint is between.

    Attributes:
        joints: the frames of the robot.
        meshes: (L) of the links that have one.
        rows: (P, 2) pairs of indices of `meshes`.
        not_of: what is no pair.
    """

    def __init__(self, robot: WholeBody) -> None:
        """
        Raises:
            ModelError: a mesh cannot be read, or a joint is of no known kind.
        """
        plant = robot.plant
        self.joints = JointTree(plant)
        of_links = robot.link_meshes
        shaped = {int(link.body) for link in of_links}
        bodies = [plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies())]
        root, _ = self.joints.place(plant.GetBodyByName(robot.root))
        self._names = [link.name for link in of_links]
        self.meshes = [
            _carried(link, *self.joints.place(plant.get_body(link.body)))
            for link in of_links
        ]
        of_meshes = [link.body for link in of_links]
        carried = [self._is_carried(mesh.frame, root) for mesh in self.meshes]
        apart, one_joint = pairs_by_joints(plant, of_meshes)
        rows = [(i, j) for i, j in apart if carried[i] and carried[j]]
        beyond_root = [pair for pair in apart if pair not in rows]
        self.rows = np.array(rows, dtype=int).reshape(-1, 2)
        self.not_of = NotOf(
            one_joint=self.named(one_joint),
            as_built=[],
            beyond_root=self.named(beyond_root),
            without_mesh=[b.name() for b in bodies if int(b.index()) not in shaped],
        )

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """(P) names of the pairs."""
        return self.named(self.rows)

    def named(self, rows: Iterable[Sequence[int]]) -> list[tuple[str, str]]:
        """The names of pairs of indices."""
        return [(self._names[i], self._names[j]) for i, j in rows]

    def _is_carried(self, frame: int, root: int) -> bool:
        while frame > root:  # parents have smaller numbers
            frame = int(self.joints.tree.parent[frame])
        return frame == root

    def leave_out(self, built: np.ndarray) -> None:
        """Takes out pairs that touch as they are built.

        Args:
            built: (P,) which do.
        """
        self.not_of.as_built.extend(self.named(self.rows[built]))
        self.rows = self.rows[~built]

    def poses(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R_WF (K, N, 3, 3) and p_WF (K, N, 3) of all frames [m].

        Args:
            q: (K, nq) positions of the plant.
        """
        tree = self.joints.tree
        X = link_poses(np.array(q, dtype=float), tree, tree.every)
        X = X.reshape(len(q), -1, 4, 3)
        return X[:, :, :3].swapaxes(2, 3), X[:, :, 3]


def _carried(link: LinkMesh, frame: int, X_FB: RigidTransform) -> Surface:
    """A link's mesh in the frame of that number, F; X_FB: where the link is."""
    p_BV, faces = triangles_of(link.parts)
    # Files repeat a vertex for each of its triangles.
    p_BV, merged = np.unique(p_BV, axis=0, return_inverse=True)
    a, b, c = (faces := merged.reshape(-1)[faces]).T
    vertices = p_BV @ X_FB.rotation().matrix().T + X_FB.translation()
    return Surface(frame, vertices, faces[(a != b) & (b != c) & (c != a)])


def relative_poses(R: np.ndarray, p: np.ndarray, a, b) -> tuple:
    """R_AB (..., 3, 3) and p_AB (..., 3) from R_WF (..., N, 3, 3) and p_WF (..., N, 3).

    Args:
        R, p: poses of all frames [m].
        a, b: which of them are A and B.
    """
    R_AW = R[..., a, :, :].swapaxes(-1, -2)
    offset = p[..., b, :] - p[..., a, :]
    return R_AW @ R[..., b, :, :], (R_AW @ offset[..., None])[..., 0]
