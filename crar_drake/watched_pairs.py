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

from crar_drake.equations.capsule_distances import capsule_distances
from crar_drake.errors import ModelError

DISTANCES = ("closed_form", "scene_graph")


@dataclass(frozen=True)
class CapsuleAxis:
    """A capsule's or sphere's axis, fixed in its link's frame B."""

    p_B0: np.ndarray  # (3,) [m]
    p_B1: np.ndarray  # (3,) [m]
    radius: float  # [m]


@dataclass(frozen=True)
class Proximity:
    """Where the segments of each watched pair are nearest.

    Attributes:
        d: (Nc,) signed distances [m].
        normal: (Nc, 3) unit vectors from segment b to segment a, in W.
        p_WA, p_WB: (Nc, 3) points fixed to a and b on the line of the shortest
            distance [m]: on the axes of capsules, else on the surfaces.
    """

    d: np.ndarray
    normal: np.ndarray
    p_WA: np.ndarray
    p_WB: np.ndarray


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
        self._axis_a = np.array(axis_a, dtype=int)
        self._axis_b = np.array(axis_b, dtype=int)
        self._closed = np.array(closed, dtype=int)
        self._queried = queried
        # Rectangular: a pair with fewer shape pairs repeats its first one.
        most = max(map(len, members), default=1)
        self._shape_pairs = np.array(
            [rows + rows[:1] * (most - len(rows)) for rows in members], dtype=int
        ).reshape(-1, most)
        self._num_shape_pairs = row
        radii = np.array([axis.radius for axes in self.axes for axis in axes])
        self._radius_a = radii[self._axis_a] if len(radii) else np.empty(0)
        self._radius_b = radii[self._axis_b] if len(radii) else np.empty(0)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def needs_query(self) -> bool:
        """Whether `proximity` asks SceneGraph for some shape pair."""
        return bool(self._queried)

    def proximity(
        self, p_W0: np.ndarray, p_W1: np.ndarray, query: QueryObject | None
    ) -> Proximity:
        """The nearest points of every watched pair.

        Args:
            p_W0, p_W1: (Na, 3) ends of all axes, those of `axes[0]` first, in W [m].
            query: SceneGraph's answers at the same state; only if `needs_query`.
        """
        d, normal, p_WA, p_WB = capsule_distances(
            p_W0[self._axis_a],
            p_W1[self._axis_a],
            self._radius_a,
            p_W0[self._axis_b],
            p_W1[self._axis_b],
            self._radius_b,
        )
        if self._queried:
            d, normal, p_WA, p_WB = self._add_queried(query, d, normal, p_WA, p_WB)
        if self._num_shape_pairs != len(self):
            # The nearest shape pair of each segment pair.
            best = np.argmin(d[self._shape_pairs], axis=1)
            keep = self._shape_pairs[np.arange(len(self)), best]
            d, normal, p_WA, p_WB = d[keep], normal[keep], p_WA[keep], p_WB[keep]
        return Proximity(d, normal, p_WA, p_WB)

    def _add_queried(self, query, d, normal, p_WA, p_WB):
        """Puts SceneGraph's answers between the closed-form rows."""
        n = self._num_shape_pairs
        all_d = np.empty(n)
        all_normal, all_a, all_b = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
        all_d[self._closed], all_normal[self._closed] = d, normal
        all_a[self._closed], all_b[self._closed] = p_WA, p_WB
        for row, geometry_a, geometry_b in self._queried:
            result = query.ComputeSignedDistancePairClosestPoints(
                geometry_a, geometry_b
            )
            X_WA = query.GetPoseInWorld(geometry_a)
            X_WB = query.GetPoseInWorld(geometry_b)
            p_ACa, p_BCb, normal_W = result.p_ACa, result.p_BCb, result.nhat_BA_W
            if result.id_A != geometry_a:
                # The answer has an order of its own.
                p_ACa, p_BCb, normal_W = p_BCb, p_ACa, -normal_W
            all_a[row] = X_WA.multiply(p_ACa)
            all_b[row] = X_WB.multiply(p_BCb)
            all_d[row] = result.distance
            direction = np.array(normal_W)
            if not np.isfinite(direction).all() or not direction.any():
                # At an exact touch the library has no normal: take the line
                # between the shapes' origins.
                direction = X_WA.translation() - X_WB.translation()
                if not direction.any():
                    direction = np.array([0.0, 0.0, 1.0])
            all_normal[row] = direction / np.linalg.norm(direction)
        return all_d, all_normal, all_a, all_b


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
