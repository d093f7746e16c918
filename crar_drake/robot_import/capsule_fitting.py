"""Capsules and spheres that are close around a link's real shape.

A fit is good if at least 95 % of the mesh's vertices lie inside of a capsule or
within 5 mm, and the volume of all capsules together is at most 1.6 times that of
the mesh's convex hull. The fewest capsules that do it are taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, QhullError

from crar_drake.robot_import.meshes import Part

REQUIRED_COVERAGE = 0.95  # share of vertices
TOLERANCE = 5e-3  # [m] that a vertex may lie outside
LARGEST_RATIO = 1.6  # volume of the capsules over that of the hull
MOST_CAPSULES = 8
SMALLEST_RADIUS = 4e-3  # [m]

# What fits leave vertices outside by: tight first, and the looser one where no small
# number of capsules reaches the volume.
_SLACKS = (1e-3, 4e-3)  # [m]
_FEW = 4  # capsules: rather a looser fit of so few than a tight one of more
_POINTS = 4000  # on the surface, that a fit looks at
_CELLS = 40  # of the grid that volumes are counted on, along the longest edge
# A larger radius shortens the axis: up to the sphere, a few are tried.
_WIDER = np.array([1.0, 1.02, 1.06, 1.12, 1.2, 1.35, 1.6])


@dataclass(frozen=True)
class FittedCapsule:
    """A capsule in the link's frame; a sphere where both ends are the same.

    Attributes:
        p_L0, p_L1: (3,) ends of the axis [m].
        radius: [m].
    """

    p_L0: np.ndarray
    p_L1: np.ndarray
    radius: float

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


@dataclass(frozen=True)
class Fit:
    """Capsules of one link and how close they are.

    Attributes:
        capsules: the shapes.
        coverage: share of the mesh's vertices inside or within 5 mm.
        volume_ratio: volume of the capsules' union over that of the convex hull.
        farthest: how far the farthest vertex is outside [m]; 0 if none is.
    """

    capsules: tuple[FittedCapsule, ...]
    coverage: float
    volume_ratio: float
    farthest: float

    @property
    def good(self) -> bool:
        """Whether both bounds hold."""
        return self.coverage >= REQUIRED_COVERAGE and self.volume_ratio <= LARGEST_RATIO


def fit_link(parts: list[Part], most: int = MOST_CAPSULES) -> Fit | None:
    """Fits capsules to all parts of a link together.

    Args:
        parts: the link's real look.
        most: number of capsules.

    Returns:
        The good fit of the fewest capsules, else the best there was; None where
        the link has no volume to fit anything to.
    """
    vertices = np.concatenate([part.vertices for part in parts])
    try:
        hull_volume = ConvexHull(vertices).volume
    except QhullError:
        return None
    points = _surface_points(parts)
    grid = _Grid(vertices)
    best: Fit | None = None
    few = min(_FEW, most)
    for numbers in (range(1, few + 1), range(few + 1, most + 1)):
        tried: dict[int, list] = {}
        for slack in _SLACKS:
            for number in numbers:
                if number not in tried:
                    splits = _splits(points, number)
                    tried[number] = [_fit_clusters(points, labels) for labels in splits]
                for enclosing in tried[number]:
                    capsules = tuple(_shrunk(capsule, slack) for capsule in enclosing)
                    fit = _judge(capsules, vertices, hull_volume, grid)
                    if best is None or _badness(fit) < _badness(best):
                        best = fit
                if best.good:
                    return best
    return best


def coverage(capsules: tuple[FittedCapsule, ...], vertices: np.ndarray) -> float:
    """Share of vertices inside of a capsule or within 5 mm."""
    if not capsules:
        return 0.0
    d = np.min([capsule.distance(vertices) for capsule in capsules], axis=0)
    return float(np.mean(d <= TOLERANCE))


def _judge(capsules, vertices, hull_volume, grid: _Grid) -> Fit:
    d = np.min([capsule.distance(vertices) for capsule in capsules], axis=0)
    return Fit(
        capsules,
        float(np.mean(d <= TOLERANCE)),
        grid.volume(capsules) / hull_volume,
        float(max(0.0, d.max())),
    )


def _badness(fit: Fit) -> tuple[float, float]:
    """First by how far a bound is missed, then by volume."""
    missed = max(0.0, REQUIRED_COVERAGE - fit.coverage) * 10.0
    missed += max(0.0, fit.volume_ratio - LARGEST_RATIO)
    return missed, fit.volume_ratio


class _Grid:
    """Counts the volume of a union of capsules on a regular grid."""

    def __init__(self, vertices: np.ndarray) -> None:
        self._lower, self._upper = vertices.min(axis=0), vertices.max(axis=0)

    def volume(self, capsules: tuple[FittedCapsule, ...]) -> float:
        ends = [(c.p_L0, c.p_L1, c.radius) for c in capsules]
        lower = np.min([np.minimum(a, b) - r for a, b, r in ends], axis=0)
        upper = np.max([np.maximum(a, b) + r for a, b, r in ends], axis=0)
        cell = (upper - lower).max() / _CELLS
        axes = [
            np.arange(lo + cell / 2, up, cell)
            for lo, up in zip(lower, upper, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        inside = np.zeros(len(points), dtype=bool)
        for capsule in capsules:
            outside = np.flatnonzero(~inside)
            inside[outside] = capsule.distance(points[outside]) <= 0.0
        return float(inside.sum() * cell**3)


def _surface_points(parts: list[Part]) -> np.ndarray:
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
        chosen += [np.asarray(sampled), vertices, _hull_vertices(part.vertices)]
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
    # Across both shorter axes: bundles of parallel capsules, for boxes.
    for columns in (2, 3):
        if number % columns == 0 and number > columns:
            labels = np.zeros(len(points), dtype=int)
            for axis, pieces in (
                (principal[1], columns),
                (principal[2], number // columns),
            ):
                along = centred @ axis
                edges = np.linspace(along.min(), along.max(), pieces + 1)[1:-1]
                labels = labels * pieces + np.searchsorted(edges, along)
            yield labels
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
    corners = _hull_vertices(points)
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
    t = (corners - origin) @ direction
    square = np.sum((corners - origin) ** 2, axis=1) - t**2
    least = np.sqrt(max(square.max(), 1e-10))
    radius = least * _WIDER
    reach = np.sqrt(np.maximum(radius[:, np.newaxis] ** 2 - square, 0.0))
    low, high = (t + reach).min(axis=1), (t - reach).max(axis=1)
    # Wider than a sphere needs: the sphere about the middle.
    middle = (low + high) / 2.0
    sphere = np.sqrt(np.max(square + (t - middle[:, np.newaxis]) ** 2, axis=1))
    crossed = low > high
    low, high = np.where(crossed, middle, low), np.where(crossed, middle, high)
    radius = np.where(crossed, sphere, radius)
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


def _hull_vertices(points: np.ndarray) -> np.ndarray:
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # flat, or too few
        return points
