"""Capsules and spheres that are close around a link's real shape.

A fit is good if every vertex of the mesh lies inside of a capsule or within 5 mm, and
no capsule sticks out of the mesh's convex hull by more than the excess that is asked
for. How far a capsule sticks out is exact: the distance to a convex set is a convex
function, so that it is largest at one of the two balls that end the capsule, and of a
ball it is the radius plus the signed distance of its centre.

Few capsules are fitted to parts of the link, each with the least volume. Where these
stick out too far, a cover is sought: a capsule whose ends lie inside the hull, the less
deep one at `depth`, may have the radius `excess + depth` and keeps the bound. Of many
such capsules the one that holds the most points is taken, until all are held.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, QhullError

from crar_drake.robot_import.meshes import Part, vertices_of

TOLERANCE = 5e-3  # [m] that a vertex may lie outside
EXCESS = 0.02  # [m] that a capsule may stick out of the hull, if nothing else is said
MOST_CAPSULES = 16
SMALLEST_RADIUS = 4e-3  # [m]

# What fits leave vertices outside by: tight first, and the looser one where no small
# number of capsules keeps the bound.
_SLACKS = (1e-3, 4e-3)  # [m]
_FEW = 3  # capsules, at most, that are fitted to parts of a link; more are a cover
_POINTS = 4000  # on the surface, that a fit looks at
_COVERED = 600  # of them, that a cover looks at first
_DEEP, _ANY = 20, 24  # points inside the hull that a cover's first capsules join
_OWN = 8  # and of those that are not held yet
_ROUNDS, _KEPT, _TRIED = 10, 3, 24  # of a random search around the best of these
# What the bound is multiplied by where so many capsules do not keep it.
_LOOSENED = (1.0, 1.4, 2.0, 2.8)
_DIRECTIONS = 250  # whose farthest vertices a cover's hull is of
_CELLS = 40  # of the grid that volumes are counted on, along the longest edge
# A larger radius shortens the axis: up to the sphere, a few are tried.
_ROUNDING = 1e-9  # [m]
_WIDER = np.array([1.0, 1.02, 1.06, 1.12, 1.2, 1.35, 1.6])


@dataclass(frozen=True)
class FittedCapsule:
    """A capsule in the link's frame; a sphere where both ends are the same."""

    p_L0: np.ndarray  # (3,) one end of the axis [m]
    p_L1: np.ndarray  # (3,) the other
    radius: float  # [m]

    @property
    def length(self) -> float:
        """Of the axis, without the caps [m]."""
        return float(np.linalg.norm(self.p_L1 - self.p_L0))

    def distance(self, p_L: np.ndarray) -> np.ndarray:
        """Signed distances (N,) of points (N, 3) to the surface [m]."""
        axis = self.p_L1 - self.p_L0
        square = axis @ axis
        s = (p_L - self.p_L0) @ axis / square if square > 0.0 else np.zeros(len(p_L))
        nearest = self.p_L0 + np.clip(s, 0.0, 1.0)[:, None] * axis
        return np.linalg.norm(p_L - nearest, axis=1) - self.radius


Capsules = Mapping[str, Sequence[FittedCapsule]]  # link to its shapes, in its frame


@dataclass(frozen=True)
class Fit:
    """Capsules of one link and how close they are."""

    capsules: tuple[FittedCapsule, ...]  # the shapes
    coverage: float  # share of the mesh's vertices inside or within 5 mm
    volume_ratio: float  # volume of the capsules' union over that of the convex hull
    farthest: float  # how far the farthest vertex is outside [m]; 0 if none is
    excess: float  # how far a capsule sticks out of the convex hull, at most [m]

    def good(self, excess: float) -> bool:
        """Whether all vertices are held, and by what bound on the excess [m]."""
        return self.farthest <= TOLERANCE and self.excess <= excess + _ROUNDING

    def imaged(self, image: np.ndarray, parts: Sequence[Part]) -> Fit:
        """The same capsules on another link, whose frame an orthogonal matrix (3, 3)
        takes this one's to, with figures of that link's parts."""
        capsules = tuple(
            FittedCapsule(image @ c.p_L0, image @ c.p_L1, c.radius)
            for c in self.capsules
        )
        return judged(capsules, parts)


def fit_link(
    parts: Sequence[Part],
    most: int = MOST_CAPSULES,
    excess: float = EXCESS,
    image: Sequence[Part] = (),
) -> Fit | None:
    """Fits capsules to all parts of a link together.

    Args:
        excess: that a capsule may stick out of the convex hull [m].
        image: the look of the link's mirror image, brought into its frame. Capsules
            then hold both, and keep the bound to both hulls.

    Returns:
        The good fit of the fewest capsules, else the best there was; None where
        the link has no volume to fit anything to. Its figures are those of `parts`.
    """
    both = [*parts, *image]
    vertices = vertices_of(both)
    try:
        hulls = Hulls([vertices_of(shape) for shape in (parts, image) if shape])
    except QhullError:
        return None
    points = _surface_points(both)
    best: Fit | None = None
    tried: dict[int, list] = {}
    for slack in _SLACKS:
        for number in range(1, min(_FEW, most) + 1):
            if number not in tried:
                splits = _splits(points, number)
                tried[number] = [_fit_clusters(points, labels) for labels in splits]
            good = []
            for enclosing in tried[number]:
                capsules = tuple(_shrunk(capsule, slack) for capsule in enclosing)
                fit = _judge(capsules, vertices, hulls)
                good += [fit] if fit.good(excess) else []
                if best is None or _badness(fit, excess) < _badness(best, excess):
                    best = fit
            if good:
                least = min(good, key=lambda fit: fit.volume_ratio)
                return judged(least.capsules, parts)
    everywhere = np.concatenate([points, vertices])
    for loosened in _LOOSENED:
        bound = loosened * excess
        if best.good(bound):
            break
        fit = _judge(_cover(everywhere, hulls, bound, most), vertices, hulls)
        if _badness(fit, excess) < _badness(best, excess):
            best = fit
    return judged(best.capsules, parts)


def judged(capsules: tuple[FittedCapsule, ...], parts: Sequence[Part]) -> Fit:
    """Some capsules with their figures for a link's parts."""
    vertices = vertices_of(parts)
    return _judge(capsules, vertices, Hulls([vertices]))


def coverage(capsules: Sequence[FittedCapsule], vertices: np.ndarray) -> float:
    """Share of vertices (N, 3) inside of a capsule or within 5 mm."""
    return float(np.mean(_outside(capsules, vertices) <= TOLERANCE))


class Hulls:
    """What convex hulls have in common: one link's, or that of its image as well."""

    def __init__(self, shapes: Sequence[np.ndarray]) -> None:
        """
        Args:
            shapes: (V, 3) vertices of each [m].

        Raises:
            QhullError: one is flat.
        """
        hulls = [ConvexHull(vertices) for vertices in shapes]
        # (F, 4) normals outwards and offsets.
        self._planes = np.concatenate([hull.equations for hull in hulls])
        self._triangles = [hull.points[hull.simplices] for hull in hulls]
        self.volume: float = hulls[0].volume

    def inner(self) -> Hulls:
        """Hulls of fewer vertices, inside of these: what keeps a bound to them keeps it
        to these. They are the farthest ones in some directions."""
        directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, 3))
        return Hulls(
            [
                points[np.unique((points @ directions.T).argmax(axis=0))]
                for points in (t.reshape(-1, 3) for t in self._triangles)
            ]
        )

    def depth(self, points: np.ndarray) -> np.ndarray:
        """How deep points (N, 3) are inside, exactly; outside, negative (N,) [m]."""
        return -self._above_planes(points).max(axis=1)

    def below(self, points: np.ndarray, depth: float) -> np.ndarray:
        """Points (N, 3), moved away from the plane that is nearest [m]."""
        nearest = self._above_planes(points).argmax(axis=1)
        return points - depth * self._planes[nearest, :3]

    def excess(self, capsule: FittedCapsule) -> float:
        """How far a capsule sticks out of one of the hulls, at most [m]."""
        ends = np.stack([capsule.p_L0, capsule.p_L1])
        out = [
            -depth if depth >= 0.0 else self._distance(end)
            for end, depth in zip(ends, self.depth(ends), strict=True)
        ]
        return max(0.0, max(out) + capsule.radius)

    def _above_planes(self, points: np.ndarray) -> np.ndarray:
        return np.c_[points, np.ones(len(points))] @ self._planes.T

    def _distance(self, point: np.ndarray) -> float:
        """Of a point outside: from a plane is less than from the hull [m]."""
        import trimesh

        apart = []
        for triangles in self._triangles:
            tiled = np.broadcast_to(point, (len(triangles), 3))
            nearest = trimesh.triangles.closest_point(triangles, tiled)
            apart.append(np.linalg.norm(nearest - point, axis=1).min())
        return float(max(apart))


def _judge(capsules, vertices, hulls: Hulls) -> Fit:
    d = _outside(capsules, vertices)
    return Fit(
        capsules,
        float(np.mean(d <= TOLERANCE)),
        _volume_of_union(capsules) / hulls.volume,
        float(max(0.0, d.max())),
        max(hulls.excess(capsule) for capsule in capsules),
    )


def _badness(fit: Fit, excess: float) -> tuple[float, float]:
    """First by how far a bound is missed, then by volume."""
    missed = 10.0 * max(0.0, fit.farthest - TOLERANCE)
    return missed + max(0.0, fit.excess - excess - _ROUNDING), fit.volume_ratio


def _cover(
    points: np.ndarray, hulls: Hulls, excess: float, most: int
) -> tuple[FittedCapsule, ...]:
    """Capsules within the bound that hold all points, if `most` of them can."""
    rng = np.random.default_rng(0)
    slack = _SLACKS[-1]
    inner = hulls.inner()
    chosen = points[rng.permutation(len(points))[:_COVERED]]
    ends = _points_inside(points, inner, rng)
    found: list[FittedCapsule] = []
    while len(found) < most:
        missing = chosen[_outside(found, chosen) > slack]
        if not len(missing):
            # What was not looked at so far, if it is farther out than is allowed.
            out = points[_outside(found, points) > TOLERANCE]
            if not len(out):
                break
            missing = chosen = out[:_COVERED]
        found.append(_best_capsule(missing, ends, inner, excess, slack, rng))
    d = np.array([capsule.distance(points) for capsule in found])
    for index in range(len(found) - 2, -1, -1):
        others = np.delete(d, index, axis=0)
        if len(others) and (others.min(axis=0) <= np.maximum(d.min(0), slack)).all():
            d = others
            del found[index]
    # Each as small as what it holds lets it be.
    nearest = np.argmin(d, axis=0)
    smaller = []
    for index, capsule in enumerate(found):
        own = points[nearest == index]
        if not len(own):
            continue
        radius = capsule.radius + min(0.0, d[index, nearest == index].max() - slack)
        smaller.append(
            FittedCapsule(capsule.p_L0, capsule.p_L1, max(radius, SMALLEST_RADIUS))
        )
        least = _shrunk(_fit_capsule(own), slack)
        volumes = [_volume(c.length, c.radius) for c in (least, smaller[-1])]
        if volumes[0] < volumes[1] and hulls.excess(least) <= excess:
            smaller[-1] = least
    return tuple(smaller)


def _outside(capsules: Sequence[FittedCapsule], points: np.ndarray) -> np.ndarray:
    """(N,) signed distances of points (N, 3) to the nearest capsule [m]."""
    if not capsules:
        return np.full(len(points), np.inf)
    return np.min([capsule.distance(points) for capsule in capsules], axis=0)


def _points_inside(points, hulls: Hulls, rng: np.random.Generator) -> np.ndarray:
    """Some of the deepest points inside, and some of all; the middle at least."""
    inner = rng.uniform(points.min(axis=0), points.max(axis=0), size=(4000, 3))
    depth = hulls.depth(inner)
    inner = inner[depth > 0.0][np.argsort(-depth[depth > 0.0])]
    deep = inner[: max(1, len(inner) // 4)]
    return np.concatenate(
        [
            points.mean(axis=0, keepdims=True),
            deep[:: max(1, len(deep) // _DEEP)][:_DEEP],
            inner[rng.permutation(len(inner))[:_ANY]],
        ]
    )


def _best_capsule(
    missing, ends, hulls: Hulls, excess: float, slack: float, rng
) -> FittedCapsule:
    """The capsule within the bound that was found to hold the most points."""

    def best(p_0: np.ndarray, p_1: np.ndarray, depth_0, depth_1):
        radius = excess + np.minimum(depth_0, depth_1)
        held = _distances_to_axes(missing, p_0, p_1) <= (radius + slack)[:, np.newaxis]
        count = np.where(radius >= SMALLEST_RADIUS, held.sum(axis=1), -1)
        order = np.argsort(-count, kind="stable")[:_KEPT]
        return p_0[order], p_1[order], radius[order]

    # A ball below a point's own place holds it, so that every capsule holds some.
    own = missing[rng.permutation(len(missing))[:_OWN]]
    below = [hulls.below(own, depth) for depth in (0.0, excess, 3.0 * excess)]
    ends = np.concatenate([ends, *below])
    first, second = np.triu_indices(len(ends))
    depth = hulls.depth(ends)
    p_0, p_1, radius = best(ends[first], ends[second], depth[first], depth[second])
    spread = 0.15 * np.ptp(missing, axis=0).max()
    for _ in range(_ROUNDS):
        moved = [
            np.concatenate(
                [p, (p + spread * rng.normal(size=(_TRIED, *p.shape))).reshape(-1, 3)]
            )
            for p in (p_0, p_1)
        ]
        p_0, p_1, radius = best(*moved, *map(hulls.depth, moved))
        spread *= 0.7
    return FittedCapsule(p_0[0], p_1[0], float(radius[0]))


def _distances_to_axes(points, p_0, p_1) -> np.ndarray:
    """(M, N) of N points from M segments [m]."""
    u = p_1 - p_0
    square = np.einsum("mx,mx->m", u, u)[:, np.newaxis]
    along = u @ points.T - np.einsum("mx,mx->m", p_0, u)[:, np.newaxis]
    s = np.clip(along / np.maximum(square, 1e-12), 0.0, 1.0)
    apart = np.einsum("nx,nx->n", points, points) - 2.0 * p_0 @ points.T
    apart += np.einsum("mx,mx->m", p_0, p_0)[:, np.newaxis]
    return np.sqrt(np.maximum(apart + s * (s * square - 2.0 * along), 0.0))


def _volume_of_union(capsules: Sequence[FittedCapsule]) -> float:
    """Of some capsules together, counted on a regular grid [m^3]."""
    ends = [(c.p_L0, c.p_L1, c.radius) for c in capsules]
    lower = np.min([np.minimum(a, b) - r for a, b, r in ends], axis=0)
    upper = np.max([np.maximum(a, b) + r for a, b, r in ends], axis=0)
    cell = (upper - lower).max() / _CELLS
    axes = [
        np.arange(lo + cell / 2, up, cell) for lo, up in zip(lower, upper, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.zeros(len(points), dtype=bool)
    for capsule in capsules:
        outside = np.flatnonzero(~inside)
        inside[outside] = capsule.distance(points[outside]) <= 0.0
    return float(inside.sum() * cell**3)


def _surface_points(parts: Sequence[Part]) -> np.ndarray:
    """All vertices, thinned out, and points between them on large triangles."""
    import trimesh

    areas = [trimesh.Trimesh(p.vertices, p.faces, process=False).area for p in parts]
    rng = np.random.default_rng(0)
    chosen = []
    for part, area in zip(parts, areas, strict=True):
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        count = max(50, round(_POINTS * area / max(sum(areas), 1e-12)))
        sampled, _ = trimesh.sample.sample_surface(mesh, count, seed=0)
        vertices = part.vertices
        if len(vertices) > count:
            vertices = vertices[rng.choice(len(vertices), count, replace=False)]
        chosen += [np.asarray(sampled), vertices, hull_vertices(part.vertices)]
    return np.concatenate(chosen)


def _splits(points: np.ndarray, number: int):
    """Ways to share the points out: along each principal axis, and by k-means."""
    if number == 1:
        yield np.zeros(len(points), dtype=int)
        return
    centred = points - points.mean(axis=0)
    _, _, principal = np.linalg.svd(centred, full_matrices=False)
    for axis in principal:
        along = centred @ axis
        edges = np.linspace(along.min(), along.max(), number + 1)[1:-1]
        yield np.searchsorted(edges, along)
    _, labels = kmeans2(centred, number, minit="++", seed=0)
    yield labels


def _fit_clusters(points, labels) -> list[FittedCapsule]:
    return [_fit_capsule(points[labels == label]) for label in np.unique(labels)]


def _shrunk(capsule: FittedCapsule, slack: float) -> FittedCapsule:
    """The capsule that leaves out what lies within `slack` of its surface [m]."""
    radius = max(capsule.radius - slack, SMALLEST_RADIUS)
    return FittedCapsule(capsule.p_L0, capsule.p_L1, radius)


def _fit_capsule(points: np.ndarray) -> FittedCapsule:
    """The smallest capsule found that encloses all points."""
    corners = hull_vertices(points)
    centre = corners.mean(axis=0)
    # Of fewer than three corners the reduced factorization lacks directions; of many
    # the full one has a matrix with as many columns as corners.
    few = len(corners) < 3
    _, _, principal = np.linalg.svd(corners - centre, full_matrices=few)
    start = np.zeros(4)

    def volume(x: np.ndarray, frame: np.ndarray) -> float:
        p_0, p_1, radius = _capsule_at(x, frame, centre, corners)
        return float(_volume(np.linalg.norm(p_1 - p_0), radius))

    frame = min(map(_frame, principal), key=lambda frame: volume(start, frame))
    found = minimize(
        volume,
        start,
        args=(frame,),
        method="Nelder-Mead",
        options={
            "maxfev": 160,
            "initial_simplex": np.vstack([start, np.diag([0.2, 0.2, 0.01, 0.01])]),
        },
    )
    return FittedCapsule(*_capsule_at(found.x, frame, centre, corners))


def _capsule_at(x, frame, centre, corners):
    """The smallest capsule about all corners whose axis is tilted by x[:2] and
    shifted by x[2:] from the frame's z axis through the centre."""
    direction = frame @ np.array([x[0], x[1], 1.0])
    direction /= np.linalg.norm(direction)
    origin = centre + frame[:, :2] @ x[2:]
    from_origin = corners - origin
    t = from_origin @ direction
    square = np.sum(from_origin**2, axis=1) - t**2
    least = np.sqrt(max(square.max(), 1e-10))
    radius = least * _WIDER
    reach = np.sqrt(np.maximum(radius[:, np.newaxis] ** 2 - square, 0.0))
    low, high = (t + reach).min(axis=1), (t - reach).max(axis=1)
    crossed = low > high
    if crossed.any():  # wider than a sphere needs: the sphere about the middle
        middle = (low[crossed] + high[crossed]) / 2.0
        low[crossed] = high[crossed] = middle
        apart = square + (t - middle[:, np.newaxis]) ** 2
        radius[crossed] = np.sqrt(np.max(apart, axis=1))
    best = np.argmin(_volume(high - low, radius))
    return origin + low[best] * direction, origin + high[best] * direction, radius[best]


def _volume(length, radius):
    return np.pi * radius**2 * (length + 4.0 / 3.0 * radius)


def _frame(direction: np.ndarray) -> np.ndarray:
    """A rotation whose z axis is the direction."""
    other = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(other, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)


def hull_vertices(points: np.ndarray) -> np.ndarray:
    """(V, 3) those of points (N, 3) that their hull has; all where there is none."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # flat, or too few
        return points
