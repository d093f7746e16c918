"""Signed distances of the watched segment pairs, from SceneGraph's shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    Capsule,
    GeometryId,
    QueryObject,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from crar_drake.equations.capsule_distances import CapsulePairs
from crar_drake.errors import ModelError

DISTANCES = ("closed_form", "scene_graph")


@dataclass(frozen=True)
class CapsuleAxis:
    """A capsule's or sphere's axis, fixed in its link's frame B."""

    p_B0: np.ndarray  # (3,) [m]
    p_B1: np.ndarray  # (3,) [m]
    radius: float  # [m]


@dataclass(slots=True)
class Proximity:
    """Where the segments of each watched pair are nearest, in K configurations.

    Attributes:
        d: (K, Nc) signed distances [m].
        normal: (K, 3, Nc) unit vectors from segment b to segment a, in W.
        p_WA: (K, 3, Nc) points fixed to a on the line of the shortest distance [m]:
            on the axes of capsules, else on the surfaces.
    """

    d: np.ndarray
    normal: np.ndarray
    p_WA: np.ndarray


class WatchedPairs:
    """The watched segment pairs of a plant, by body, with their shapes.

    A segment may carry several shapes: the pair's distance is then the smallest
    over its shape pairs. Pairs of capsules and spheres are computed in closed
    form; other shapes are asked of SceneGraph.

    Attributes:
        names: per pair (link a, link b), in the documented order of the ports.
        body_a, body_b: (Nc,) index of each segment in `bodies`.
        bodies: the bodies that carry watched shapes.
        axes: per body in `bodies` its capsule axes.
        gather: (4 N,) of N shape pairs in closed form, places in `proximity`'s axes:
            starts of a, of b, vectors of a, of b.
        shape_pairs: (Nc, most) the shape pairs of each pair; the first fills up.
        capsules: the sizes of the N shape pairs.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        inspector: SceneGraphInspector,
        pairs: Sequence[tuple[RigidBody, RigidBody]],
        distances: str = "closed_form",
    ) -> None:
        """
        Args:
            plant: finalized, registered with the SceneGraph of `inspector`.
            inspector: of that SceneGraph.
            pairs: the bodies of each watched pair.
            distances: "closed_form" where there is one, or "scene_graph" for all.

        Raises:
            ModelError: a segment has no collision shape, or is watched against
                itself.
        """
        if distances not in DISTANCES:
            raise ModelError(f"distances: {distances!r} is none of {DISTANCES}")
        for a, b in pairs:
            if a.index() == b.index():
                raise ModelError(f"link {a.name()!r} is watched against itself")
        self.names = tuple((a.name(), b.name()) for a, b in pairs)
        self.bodies: list[RigidBody] = []
        self.axes: list[list[CapsuleAxis]] = []
        index_of: dict[int, int] = {}
        shapes: list[list[tuple[GeometryId, int | None]]] = []
        for body in (body for pair in pairs for body in pair):
            if int(body.index()) in index_of:
                continue
            index_of[int(body.index())] = len(self.bodies)
            self.bodies.append(body)
            ids = plant.GetCollisionGeometriesForBody(body)
            if not ids:
                raise ModelError(
                    f"link {body.name()!r} is in a watched pair but has no collision "
                    "geometry"
                )
            axes: list[CapsuleAxis] = []
            entries: list[tuple[GeometryId, int | None]] = []
            for geometry in ids:
                axis = None
                if distances == "closed_form":
                    axis = capsule_axis(
                        inspector.GetShape(geometry),
                        inspector.GetPoseInFrame(geometry).GetAsMatrix34(),
                    )
                entries.append((geometry, len(axes) if axis else None))
                if axis:
                    axes.append(axis)
            self.axes.append(axes)
            shapes.append(entries)

        self.body_a = np.array([index_of[int(a.index())] for a, _ in pairs], dtype=int)
        self.body_b = np.array([index_of[int(b.index())] for _, b in pairs], dtype=int)

        # Shape pairs, those of one segment pair side by side.
        first_axis = np.cumsum([0] + [len(axes) for axes in self.axes])
        axis_a, axis_b, closed, queried, members = [], [], [], [], []
        row = 0
        for a, b in zip(self.body_a, self.body_b, strict=True):
            start = row
            for geometry_a, local_a in shapes[a]:
                for geometry_b, local_b in shapes[b]:
                    if local_a is not None and local_b is not None:
                        axis_a.append(first_axis[a] + local_a)
                        axis_b.append(first_axis[b] + local_b)
                        closed.append(row)
                    else:
                        queried.append((row, geometry_a, geometry_b))
                    row += 1
            members.append(list(range(start, row)))
        axis_a = np.array(axis_a, dtype=int)
        axis_b = np.array(axis_b, dtype=int)
        # The starts and then the vectors of the axes, each first of a, then of b.
        num_axes = sum(map(len, self.axes))
        self.gather = np.concatenate(
            [axis_a, axis_b, num_axes + axis_a, num_axes + axis_b]
        )
        self._closed = np.array(closed, dtype=int)
        self._queried = queried
        # Rectangular: a pair with fewer shape pairs repeats its first one.
        most = max(map(len, members), default=1)
        self.shape_pairs = np.array(
            [rows + rows[:1] * (most - len(rows)) for rows in members], dtype=int
        ).reshape(-1, most)
        self._shape_pair_rows = most * np.arange(len(pairs))
        self._num_shape_pairs = row
        every = [axis for axes in self.axes for axis in axes]
        radii = np.array([axis.radius for axis in every])
        lengths = np.array([np.linalg.norm(axis.p_B1 - axis.p_B0) for axis in every])
        self.capsules = CapsulePairs(
            lengths[axis_a], radii[axis_a], lengths[axis_b], radii[axis_b]
        )

    def __len__(self) -> int:
        return len(self.names)

    @property
    def needs_query(self) -> bool:
        """Whether `proximity` asks SceneGraph for some shape pair."""
        return bool(self._queried)

    def proximity(
        self, axes: np.ndarray, queries: Sequence[QueryObject] = ()
    ) -> Proximity:
        """The nearest points of every watched pair in K configurations.

        Args:
            axes: (K, 3, 2 Na) in W, the starts of all axes [m], those of `axes[0]`
                first, and then the vectors from there to their ends.
            queries: SceneGraph's answers in each configuration; only if
                `needs_query`.
        """
        K, N = len(axes), len(self.gather) // 4
        gathered = axes.take(self.gather, axis=2).reshape(K, 3, 4, N)
        p_a, p_b, u, v = (gathered[:, :, i] for i in range(4))
        d, normal, p_WA, _ = self.capsules(p_a, u, p_b, v)
        if self._queried:
            d, normal, p_WA = self._add_queried(queries, d, normal, p_WA)
        if self._num_shape_pairs != len(self):
            # The nearest shape pair of each segment pair.
            best = d.take(self.shape_pairs, axis=1).argmin(axis=2)
            keep = self.shape_pairs.take(best + self._shape_pair_rows)
            start = self._num_shape_pairs * np.arange(3 * K)[:, None]
            places = start.reshape(K, 3, 1) + keep[:, None]
            d = d.take(start[:K] + keep)
            normal, p_WA = normal.take(places), p_WA.take(places)
        return Proximity(d, normal, p_WA)

    def _add_queried(self, queries, d, normal, p_WA):
        """Puts SceneGraph's answers between the closed-form rows."""
        K, n = len(d), self._num_shape_pairs
        all_d = np.empty((K, n))
        all_normal, all_a = np.empty((K, 3, n)), np.empty((K, 3, n))
        all_d[:, self._closed] = d
        all_normal[:, :, self._closed] = normal
        all_a[:, :, self._closed] = p_WA
        for k, query in enumerate(queries):
            for row, geometry_a, geometry_b in self._queried:
                all_d[k, row], all_normal[k, :, row], all_a[k, :, row] = _ask(
                    query, geometry_a, geometry_b
                )
        return all_d, all_normal, all_a


def _ask(
    query: QueryObject, geometry_a: GeometryId, geometry_b: GeometryId
) -> tuple[float, np.ndarray, np.ndarray]:
    """SceneGraph's distance, unit normal from b towards a, and point on a, in W."""
    result = query.ComputeSignedDistancePairClosestPoints(geometry_a, geometry_b)
    X_WA = query.GetPoseInWorld(geometry_a)
    p_ACa, normal = result.p_ACa, np.array(result.nhat_BA_W)
    if result.id_A != geometry_a:
        # The answer has an order of its own.
        p_ACa, normal = result.p_BCb, -normal
    if not np.isfinite(normal).all() or not normal.any():
        # At an exact touch the library has no normal: take the line between the
        # shapes' origins.
        X_WB = query.GetPoseInWorld(geometry_b)
        normal = X_WA.translation() - X_WB.translation()
        if not normal.any():
            normal = np.array([0.0, 0.0, 1.0])
    return result.distance, normal / np.linalg.norm(normal), X_WA.multiply(p_ACa)


def capsule_axis(shape: Shape, X_BG: np.ndarray) -> CapsuleAxis | None:
    """The axis of a capsule or sphere; None for any other shape.

    Args:
        shape: SceneGraph's shape in the geometry frame G.
        X_BG: (3, 4) pose of G in the link's frame B.
    """
    if isinstance(shape, Capsule):
        half = 0.5 * shape.length() * X_BG[:, 2]
        return CapsuleAxis(X_BG[:, 3] - half, X_BG[:, 3] + half, shape.radius())
    if isinstance(shape, Sphere):
        return CapsuleAxis(X_BG[:, 3].copy(), X_BG[:, 3].copy(), shape.radius())
    return None
