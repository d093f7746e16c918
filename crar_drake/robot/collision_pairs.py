"""Signed distances of the watched segment pairs, from SceneGraph's shapes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from pydrake.geometry import (
    Capsule,
    GeometryId,
    HalfSpace,
    QueryObject,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from crar_drake.errors import ModelError
from crar_drake.law.capsule_distances import ShapePairs, WatchedRows
from crar_drake.law.compilation import hold
from crar_drake.robot.description import GROUND, link_names
from crar_drake.robot.hulls import (
    Hull,
    hull_of,
    is_round,
    numbers_of_hulls,
    shape_corners,
)


@dataclass(frozen=True)
class CapsuleAxis:
    """A capsule's or sphere's axis, fixed in its link's frame B.

    That of a half space leads from a point of its surface into it, by 1 m. Of a hull
    it is a point in its middle.
    """

    p_B0: np.ndarray  # (3,) [m]
    p_B1: np.ndarray  # (3,) [m]
    radius: float  # [m]
    flat: bool = False  # whether it is that of a half space
    hull: Hull | None = None  # that is in the place of an axis, in B
    round: bool = False  # whether the shape within the hull is smaller

    @property
    def ends(self) -> np.ndarray:
        """(N, 3) points of which the axis is the hull, in B [m]."""
        if self.hull is not None:
            return self.hull.corners
        return np.array([self.p_B0, self.p_B1])

    @property
    def extent(self) -> float:
        """From its middle to its farthest end or corner [m]."""
        middle = 0.5 * (self.p_B0 + self.p_B1)
        return float(np.linalg.norm(self.ends - middle, axis=1).max())


class WatchedPairs:
    """The watched segment pairs of a plant, by body, with their shapes.

    A segment may carry several shapes: the pair's distance is then the smallest
    over its shape pairs. What is measured is what SceneGraph answers of all shape
    pairs; whole paths are bounded in closed form: of capsules, spheres, boxes and
    convex hulls (of meshes, too), and of hulls about what is round otherwise. Against a
    half space, which must be one of the world's own shapes, the ends of a capsule and
    the corners of a hull count as shapes of their own, in closed form in any case:
    SceneGraph answers for spheres alone.

    Attributes:
        names: per pair (link a, link b), in the documented order of the ports; the
            world is called "ground" if it has half spaces alone.
        body_a, body_b: (Nc,) index of each segment in `bodies`; a segment with a half
            space is b, whatever its place in the name.
        bodies: the bodies that carry watched shapes.
        axes: per body in `bodies` its capsule axes, and the points (axes of no length)
            that stand above half spaces.
        shape_pairs: (Nc, most) the shape pairs of each pair; the first fills up.
        pair_of_shapes: (Ns,) the pair that each shape pair belongs to.
        shape_axes: (Ns,), (Ns,) their two axes, among those of `axes`, one after the
            other.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        inspector: SceneGraphInspector,
        pairs: Sequence[tuple[RigidBody, RigidBody]],
    ) -> None:
        """
        Args:
            plant: finalized, registered with the SceneGraph of `inspector`.
            inspector: of that SceneGraph.
            pairs: the bodies of each watched pair.

        Raises:
            ModelError: a segment has no collision shape, or is watched against
                itself; a mesh cannot be read, or is flat; or a half space is on another
                link than the world, or is watched against a shape that is neither
                sphere, capsule nor hull.
        """
        for a, b in pairs:
            if a.index() == b.index():
                raise ModelError(f"link {a.name()!r} is watched against itself")
        bodies = {int(body.index()): body for pair in pairs for body in pair}
        self.bodies: list[RigidBody] = list(bodies.values())
        shapes = [_shapes_of(body, plant) for body in self.bodies]
        self.axes = [
            [_axis_of(body, geometry, inspector) for geometry in of]
            for body, of in zip(self.bodies, shapes, strict=True)
        ]
        flat = [any(axis.flat for axis in axes) for axes in self.axes]
        for body, is_flat in zip(self.bodies, flat, strict=True):
            if is_flat and body.index() != plant.world_body().index():
                raise ModelError(
                    f"link {body.name()!r} carries a half space: register it on "
                    "plant.world_body() (on a link, welded or not, it makes Drake's "
                    "collision engine crash now and then), or give the link a box"
                )
        places = {index: place for place, index in enumerate(bodies)}
        of = [tuple(places[int(body.index())] for body in pair) for pair in pairs]
        links = link_names(plant)
        known = [
            GROUND if all(axis.flat for axis in axes) else links[body.index()]
            for body, axes in zip(self.bodies, self.axes, strict=True)
        ]
        self.names = tuple((known[a], known[b]) for a, b in of)
        of = [(b, a) if flat[a] else (a, b) for a, b in of]
        self.body_a = np.array([a for a, _ in of], dtype=int)
        self.body_b = np.array([b for _, b in of], dtype=int)
        standing = {a: self._stand(inspector, a, shapes[a]) for a, b in of if flat[b]}

        # Shape pairs, those of one segment pair side by side.
        first_axis = np.cumsum([0, *map(len, self.axes)])
        axis_a, axis_b, members = [], [], []
        # Of each row its two shapes; or the one that stands on a half space, that, and
        # by which of its points.
        self._shapes: list[tuple[GeometryId, GeometryId, int | None]] = []
        for a, b in of:
            start = len(self._shapes)
            for i, j in product(range(len(shapes[a])), range(len(shapes[b]))):
                on_ground = self.axes[b][j].flat
                for point, axis in enumerate(standing[a][i] if on_ground else [i]):
                    of_both = shapes[a][i], shapes[b][j]
                    self._shapes.append((*of_both, point if on_ground else None))
                    axis_a.append(first_axis[a] + axis)
                    axis_b.append(first_axis[b] + j)
            members.append(list(range(start, len(self._shapes))))
        self.shape_axes = np.array(axis_a, dtype=int), np.array(axis_b, dtype=int)
        # Rectangular: a pair with fewer shape pairs repeats its first one.
        most = max(map(len, members), default=1)
        self.shape_pairs = np.array(
            [rows + rows[:1] * (most - len(rows)) for rows in members], dtype=int
        ).reshape(-1, most)
        self.pair_of_shapes = np.repeat(
            np.arange(len(members)), list(map(len, members))
        )

    def _stand(
        self, inspector: SceneGraphInspector, body: int, geometries: list[GeometryId]
    ) -> list[list[int]]:
        """Adds the points by which a body's shapes stand on the ground to its axes.

        Returns:
            Of each shape, which these are.
        """
        found = []
        for geometry in geometries:
            points = standing_points(inspector.GetShape(geometry))
            if points is None:
                raise ModelError(
                    f"link {self.bodies[body].name()!r} is watched against a half "
                    "space, on which it does not stand; give it another shape"
                )
            axes = self.axes[body]
            found.append(list(range(len(axes), len(axes) + len(points))))
            X_BG = inspector.GetPoseInFrame(geometry)
            for p_G, radius in points:
                p_B = X_BG.multiply(p_G)
                axes.append(CapsuleAxis(p_B, p_B, radius))
        return found

    def __len__(self) -> int:
        return len(self.names)

    def for_equations(
        self, first: int, moves: np.ndarray
    ) -> tuple[ShapePairs, WatchedRows]:
        """The pairs for `law.capsule_distances`.

        Args:
            first: of all points the first axis' start; all axes' starts stand there,
                those of `axes[0]` first, then the vectors from there to their ends, and
                then the corners of hulls.
            moves: (Nc, nv) 1 where a velocity moves segment a alone, -1 where b alone.
        """
        every = [axis for axes in self.axes for axis in axes]
        radii = np.array([axis.radius for axis in every])
        sizes = np.array([axis.extent + axis.radius for axis in every])
        flat = np.array([axis.flat for axis in every], dtype=bool)
        exact = np.array([not axis.round for axis in every], dtype=bool)
        hulls, after, of_axis = [], [], np.full(len(every), -1)
        corner = first + 2 * len(every)
        for i, axis in enumerate(every):
            if axis.hull is not None:
                of_axis[i] = len(hulls)
                hulls.append(axis.hull)
                after.append(corner - (first + i))
                corner += len(axis.hull.corners)
        a, b = self.shape_axes
        moves = np.ascontiguousarray(moves)
        pairs = ShapePairs(
            start_a=first + a,
            start_b=first + b,
            to_vector=len(every),
            radii=radii[a] + radii[b],
            balls=sizes[a] + sizes[b],
            flat=flat[b],
            moves=moves[self.pair_of_shapes],
            hull_a=of_axis[a],
            hull_b=of_axis[b],
            hulls=hold(numbers_of_hulls(hulls, after)),
        )
        return pairs, WatchedRows(self.shape_pairs, exact[a] & exact[b], moves)

    def ask_distances(self, query: QueryObject) -> np.ndarray:
        """`ask` for the distances alone, several times as fast; the rest is 0."""
        ask = query.ComputeSignedDistancePairClosestPoints
        answers = np.zeros((len(self._shapes), 7))
        answers[:, 0] = [
            ask(a, b).distance if point is None else _height(query, a, point, b)[0]
            for a, b, point in self._shapes
        ]
        return answers

    def ask(self, query: QueryObject, rows: Iterable[int] | None = None) -> np.ndarray:
        """SceneGraph's answers for shape pairs.

        Args:
            rows: which of them, K; by default all.

        Returns:
            (K, 7) distance [m], normal from b to a, point on a, in W.
        """
        rows = list(range(len(self._shapes)) if rows is None else rows)
        ask = query.ComputeSignedDistancePairClosestPoints
        answers, at, poses = np.empty((len(rows), 7)), np.empty(len(rows), int), {}
        for k, (a, b, point) in enumerate(map(self._shapes.__getitem__, rows)):
            at[k] = poses.setdefault(a, len(poses))
            if point is not None:
                answers[k] = _height(query, a, point, b)
                at[k] = -1
                continue
            found = ask(a, b)
            answers[k, 0], answers[k, 1:4] = found.distance, found.nhat_BA_W
            if found.id_A == a:
                answers[k, 4:] = found.p_ACa
            else:  # the answer has an order of its own
                answers[k, 4:] = found.p_BCb
                answers[k, 1:4] *= -1.0
        X = np.array([query.GetPoseInWorld(a).GetAsMatrix34() for a in poses])
        X = X.reshape(-1, 3, 4)
        asked = np.flatnonzero(at >= 0)
        R, p = X[at[asked], :, :3], X[at[asked], :, 3]
        points = np.einsum("kij,kj->ki", R, answers[asked, 4:]) + p
        answers[asked, 4:] = points
        normals = answers[asked, 1:4]
        lengths = np.linalg.norm(normals, axis=1)
        for k in np.flatnonzero(~(lengths > 0.0)):
            # At an exact touch the library has no normal: take the line between the
            # shapes' origins.
            _, b, _ = self._shapes[rows[asked[k]]]
            normals[k] = p[k] - query.GetPoseInWorld(b).translation()
            lengths[k] = np.linalg.norm(normals[k])
            if not lengths[k]:
                normals[k], lengths[k] = (0.0, 0.0, 1.0), 1.0
        answers[asked, 1:4] = normals / lengths[:, None]
        return answers


def _shapes_of(body: RigidBody, plant: MultibodyPlant) -> list[GeometryId]:
    """The collision shapes of a link; ModelError if it has none."""
    found = plant.GetCollisionGeometriesForBody(body)
    if not found:
        raise ModelError(
            f"link {body.name()!r} is in a watched pair but has no collision geometry"
        )
    return found


def _axis_of(
    body: RigidBody, geometry: GeometryId, inspector: SceneGraphInspector
) -> CapsuleAxis:
    """`shape_axis` of a link's shape; its error names both."""
    X_BG = inspector.GetPoseInFrame(geometry).GetAsMatrix34()
    try:
        return shape_axis(inspector.GetShape(geometry), X_BG)
    except ModelError as error:
        raise ModelError(
            f"link {body.name()!r}: collision geometry "
            f"{inspector.GetName(geometry)!r}: {error}"
        ) from error


def _height(
    query: QueryObject, geometry_a: GeometryId, point: int, geometry_b: GeometryId
) -> np.ndarray:
    """(7,) as `_ask`: of one of the points by which a shape stands on a half space."""
    p_G, radius = standing_points(query.inspector().GetShape(geometry_a))[point]
    p_W = query.GetPoseInWorld(geometry_a).multiply(p_G)
    X_WB = query.GetPoseInWorld(geometry_b)
    normal = X_WB.rotation().col(2)
    height = normal @ (p_W - X_WB.translation()) - radius
    return np.concatenate([[height], normal, p_W - radius * normal])


def shape_axis(shape: Shape, X_BG: np.ndarray) -> CapsuleAxis:
    """The axis of a capsule, a sphere or a half space; of any other a hull about it.

    Args:
        X_BG: (3, 4) the shape's pose in the link's frame B.

    Raises:
        ModelError: a mesh cannot be read, or has no volume; or there is no hull.
    """
    if isinstance(shape, Capsule):
        half = 0.5 * shape.length() * X_BG[:, 2]
        return CapsuleAxis(X_BG[:, 3] - half, X_BG[:, 3] + half, shape.radius())
    if isinstance(shape, Sphere):
        return CapsuleAxis(X_BG[:, 3].copy(), X_BG[:, 3].copy(), shape.radius())
    if isinstance(shape, HalfSpace):
        return CapsuleAxis(X_BG[:, 3].copy(), X_BG[:, 3] - X_BG[:, 2], 0.0, flat=True)
    corners = shape_corners(shape)
    if corners is None:
        raise ModelError(
            f"nothing bounds distances of a {type(shape).__name__}: give a sphere, a "
            "capsule, a box, a cylinder, an ellipsoid or a convex mesh"
        )
    hull = hull_of(corners @ X_BG[:, :3].T + X_BG[:, 3])
    middle = hull.corners.mean(axis=0)
    return CapsuleAxis(middle, middle, 0.0, hull=hull, round=is_round(shape))


def standing_points(shape: Shape) -> list[tuple[np.ndarray, float]] | None:
    """The spheres of which one is a shape's lowest part above any plane.

    Returns:
        (3,) centre in G [m] and radius [m] of the ends of a capsule, a sphere itself,
        the corners of a box or of a mesh's hull; None for any other shape.
    """
    if isinstance(shape, Sphere):
        return [(np.zeros(3), shape.radius())]
    if isinstance(shape, Capsule):
        half = np.array([0.0, 0.0, 0.5 * shape.length()])
        return [(-half, shape.radius()), (half, shape.radius())]
    corners = shape_corners(shape)
    return None if corners is None else [(corner, 0.0) for corner in corners]
