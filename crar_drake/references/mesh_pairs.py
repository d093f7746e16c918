"""The meshes of a robot's links, which pairs of them can meet, and how far they are.

Each link's mesh is given in the frame F of `robot.kinematics` that carries it, so that
welded links share a pose. Distances are asked from below: of convex hulls where these
are apart, else of the triangles.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.multibody.tree import BodyIndex, JointIndex
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from crar_drake.equations.kinematics import link_poses
from crar_drake.references.hull_gaps import hull_corners, hull_gaps
from crar_drake.references.kept_arrays import keep_array, place_of, read_kept
from crar_drake.references.near_parts import Parts, divided
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import find_joint, zero_positions
from crar_drake.robot.kinematics import JointTree
from crar_drake.robot_import.link_meshes import LinkMesh
from crar_drake.robot_import.meshes import triangles_of

try:
    import fcl
except ImportError:  # of an extra, which `link_meshes.check_installed` asks for
    fcl = None

# Meshes that are no farther apart touch: more than what doubles are off by, of a hull's
# vertices as of triangles [m].
ROUNDING = 1e-6

# Where hulls are farther apart than this, the triangles are not asked [m].
_HULLS_ENOUGH = 1e-3

# Modules that find how far apart meshes are.
FOUND_BY = ("mesh_pairs", "hull_gaps", "near_parts")

# A winding number beyond is that of a point inside.
_HALF_TURN = 0.5


class CarriedMesh:
    """A link's mesh in the frame F that carries it.

    Attributes:
        name: of the link.
        frame: number of F.
        vertices: (N, 3) p_FV [m]; faces: (M, 3) indices of them.
        corners: (8, 3) of its bounding box along the axes of F [m].
        centre: (3,) of the box [m]; radius: of the ball about it with all vertices [m].
        hull: corners (H, 3) of its convex hull [m], and (G, 3) triangles of them; none
            if it is flat.
    """

    def __init__(self, link: LinkMesh, frame: int, X_FB) -> None:
        p_BV, faces = triangles_of(link.parts)
        # Files repeat a vertex for each of its triangles.
        p_BV, merged = np.unique(p_BV, axis=0, return_inverse=True)
        a, b, c = (faces := merged.reshape(-1)[faces]).T
        self.faces = faces[(a != b) & (b != c) & (c != a)]
        self.name, self.frame = link.name, frame
        self.vertices = p_BV @ X_FB.rotation().matrix().T + X_FB.translation()
        used = self.vertices[np.unique(self.faces)]
        box = np.array([used.min(axis=0), used.max(axis=0)])
        self.corners = np.array(list(itertools.product(*box.T)))
        self.centre = box.mean(axis=0)
        self.radius = float(np.linalg.norm(used - self.centre, axis=1).max())
        self.hull = np.zeros((0, 3)), np.zeros((0, 3), dtype=int)
        with suppress(QhullError):  # it is flat: its triangles are asked
            hull = ConvexHull(used)
            number = np.empty(len(used), dtype=int)
            number[hull.vertices] = np.arange(len(hull.vertices))
            self.hull = used[hull.vertices], number[hull.simplices]

    @cached_property
    def placed(self) -> tuple[fcl.CollisionObject, fcl.CollisionObject]:
        """Its surface, to be placed as A and as B; its tree takes a while."""
        tree = fcl.BVHModel()
        tree.beginModel(len(self.vertices), len(self.faces))
        tree.addSubModel(self.vertices, self.faces)
        tree.endModel()
        return fcl.CollisionObject(tree), fcl.CollisionObject(tree)

    @cached_property
    def parts(self) -> Parts:
        """Small parts of its surface."""
        return divided(self.vertices[self.faces])

    @cached_property
    def one_vertex_each(self) -> np.ndarray:
        """(K, 3) a vertex of each of the K connected pieces of the surface [m]."""
        a, b, c = self.faces.T
        edges = np.concatenate([a, b]), np.concatenate([b, c])
        size = len(self.vertices)
        graph = coo_array((np.ones(len(edges[0])), edges), shape=(size, size))
        _, piece = connected_components(graph, directed=False)
        used = np.unique(self.faces)
        return self.vertices[used[np.unique(piece[used], return_index=True)[1]]]

    def holds(self, p_FQ: np.ndarray) -> bool:
        """Whether one of some points is inside, by the surface's winding number.

        Args:
            p_FQ: (P, 3) points that are not on the surface [m].
        """
        lower, upper = self.corners[0], self.corners[-1]
        for p in p_FQ[((p_FQ > lower) & (p_FQ < upper)).all(axis=1)]:
            a, b, c = np.moveaxis(self.vertices[self.faces] - p, 1, 0)
            la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
            # Solid angles: A. van Oosterom and J. Strackee, 1983.
            ab, bc, ca = (np.sum(x * y, axis=1) for x, y in ((a, b), (b, c), (c, a)))
            above = np.sum(a * np.cross(b, c), axis=1)
            angles = np.arctan2(above, la * lb * lc + ab * lc + bc * la + ca * lb)
            if abs(angles.sum()) / (2.0 * np.pi) > _HALF_TURN:
                return True
        return False


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
        self.meshes = [
            CarriedMesh(link, *self.joints.place(plant.get_body(link.body)))
            for link in of_links
        ]
        carried = [self._is_carried(mesh.frame, root) for mesh in self.meshes]
        joined = set()
        for index in range(plant.num_joints()):
            joint = plant.get_joint(JointIndex(index))
            ends = (joint.parent_body(), joint.child_body())
            joined.add(frozenset(self.joints.place(body)[0] for body in ends))
        rows, one_joint, beyond_root = [], [], []
        for i, j in itertools.combinations(range(len(self.meshes)), 2):
            frames = frozenset((self.meshes[i].frame, self.meshes[j].frame))
            if len(frames) == 1:
                continue
            if frames in joined:
                one_joint.append((i, j))
            elif carried[i] and carried[j]:
                rows.append((i, j))
            else:
                beyond_root.append((i, j))
        self.rows = np.array(rows, dtype=int).reshape(-1, 2)
        self._nearest = fcl.DistanceRequest(enable_nearest_points=True)
        self._hulls = hull_corners([mesh.hull for mesh in self.meshes])
        built = self._touch_as_built(robot)
        as_built, self.rows = self.named(self.rows[built]), self.rows[~built]
        self.not_of = NotOf(
            one_joint=self.named(one_joint),
            as_built=as_built,
            beyond_root=self.named(beyond_root),
            without_mesh=[b.name() for b in bodies if int(b.index()) not in shaped],
        )

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """(P) names of the pairs."""
        return self.named(self.rows)

    def named(self, rows: Iterable[Sequence[int]]) -> list[tuple[str, str]]:
        """The names of pairs of indices."""
        return [(self.meshes[i].name, self.meshes[j].name) for i, j in rows]

    def distances(
        self, pairs: np.ndarray, R: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """How far surfaces A and B are apart at least.

        Of hulls, which are never farther apart than what they hold, where that says
        enough.

        Args:
            pairs: (K, 2) of the meshes, in the frames A and B.
            R, p: (K, 3, 3) R_AB, and (K, 3) p_AB [m].

        Returns:
            (K,) distances less `ROUNDING`, 0 where they touch [m]; and (K,) whether
            their hulls are apart, so that neither is inside the other.
        """
        gaps = self.gaps(pairs, R, p)
        parted = gaps > ROUNDING
        for k in np.flatnonzero(~(gaps >= _HULLS_ENOUGH)):
            a, b = self._placed(*pairs[k], R[k], p[k])
            gaps[k] = max(gaps[k], fcl.distance(a, b))
        return np.maximum(0.0, gaps - ROUNDING), parted

    def gaps(self, pairs: np.ndarray, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        """(K,) how far hulls are apart at least, 0 or less where nothing says so [m].

        Args: as of `distances`.
        """
        return hull_gaps(pairs, R, p, self._hulls)[0]

    def _placed(self, i: int, j: int, R: np.ndarray, p: np.ndarray) -> tuple:
        """Both surfaces, B where it is in A."""
        a, b = self.meshes[i].placed[0], self.meshes[j].placed[1]
        b.setTransform(fcl.Transform(R, p))
        return a, b

    def nearest(
        self, i: int, j: int, R: np.ndarray, p: np.ndarray, enough: float = np.inf
    ) -> tuple:
        """The distance of two surfaces, 0 where they meet, and their nearest points
        p_AP and p_AQ [m]; of their hulls, where these are farther apart than enough.

        Args:
            i, j: of the meshes, in the frames A and B.
            R: (3, 3) R_AB.
            p: (3,) p_AB [m].
            enough: [m].
        """
        if np.isfinite(enough):
            pair = np.array([[i, j]])
            gaps, points = hull_gaps(pair, R[None], p[None], self._hulls)
            if gaps[0] > enough:
                return gaps[0], *points[0]
        near = fcl.DistanceResult()
        d = fcl.distance(*self._placed(i, j, R, p), self._nearest, near)
        return max(0.0, d), *near.nearest_points

    def one_inside(self, i: int, j: int, R: np.ndarray, p: np.ndarray) -> bool:
        """Whether a piece of one is inside the other, if no triangles intersect.

        Args: as of `nearest`.
        """
        a, b = self.meshes[i], self.meshes[j]
        return a.holds(b.one_vertex_each @ R.T + p) or b.holds(
            (a.one_vertex_each - p) @ R
        )

    def _is_carried(self, frame: int, root: int) -> bool:
        while frame > root:  # parents have smaller numbers
            frame = int(self.joints.tree.parent[frame])
        return frame == root

    def _touch_as_built(self, robot: WholeBody) -> np.ndarray:
        """(P,) whether a pair touches in the zero and in the rest posture.

        It depends on the meshes and these postures alone, and is kept in the user's
        cache under a name by these.
        """
        plant = robot.plant
        limits = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        zero = np.clip(zero_positions(plant), *limits)
        rest = zero.copy()
        for name, value in robot.description.rest_posture.items():
            rest[find_joint(plant, name).position_start()] = value
        frames = np.array([mesh.frame for mesh in self.meshes], dtype=int)
        R, p = self.poses([rest, zero])
        R, p = R[:, frames], p[:, frames]
        surfaces = [
            x for mesh in self.meshes for x in (mesh.vertices, mesh.faces.astype(int))
        ]
        place = place_of("as_built", FOUND_BY, [R, p, *surfaces, self.rows])
        touch = read_kept(place, bool)
        if touch is None or touch.shape != (len(self.rows),):
            touch = self._touch_in(R, p)
            keep_array(place, touch)
        return touch

    def _touch_in(self, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        """(P,) whether a pair touches in all of K postures.

        Args:
            R, p: (K, M, 3, 3) and (K, M, 3) poses of the meshes in them [m].
        """
        touch = np.ones(len(self.rows), dtype=bool)
        for at in zip(R, p, strict=True):
            some = np.flatnonzero(touch)
            rows = self.rows[some]
            X = relative_poses(*at, *rows.T)
            apart, parted = self.distances(rows, *X)
            touch[some] = apart == 0.0
            for i in np.flatnonzero((apart > 0.0) & ~parted):
                touch[some[i]] = self.one_inside(*rows[i], X[0][i], X[1][i])
        return touch

    def poses(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R_WF (K, N, 3, 3) and p_WF (K, N, 3) of all frames [m].

        Args:
            q: (K, nq) positions of the plant.
        """
        tree = self.joints.tree
        X = link_poses(np.array(q, dtype=float), tree, tree.every)
        X = X.reshape(len(q), -1, 4, 3)
        return X[:, :, :3].swapaxes(2, 3), X[:, :, 3]


def relative_poses(R: np.ndarray, p: np.ndarray, a, b) -> tuple:
    """R_AB (..., 3, 3) and p_AB (..., 3) from R_WF (..., N, 3, 3) and p_WF (..., N, 3).

    Args:
        R, p: poses of all frames [m].
        a, b: which of them are A and B.
    """
    R_AW = R[..., a, :, :].swapaxes(-1, -2)
    offset = p[..., b, :] - p[..., a, :]
    return R_AW @ R[..., b, :, :], (R_AW @ offset[..., None])[..., 0]
