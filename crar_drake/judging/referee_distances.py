"""Distances of capsules for the referee: a way of its own, by plain numbers."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform

from crar_drake.judging.referee_hulls import Polytope, axis_polytope, polytope_distance


def capsule_distance(
    p_a0: Sequence[float],
    p_a1: Sequence[float],
    radius_a: float,
    p_b0: Sequence[float],
    p_b1: Sequence[float],
    radius_b: float,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Signed distance of two capsules, and where their axes are nearest.

    The signed distance is the distance of the two axis segments minus both radii.
    Outside it is exactly the distance of the surfaces. Inside it is exactly minus
    the penetration depth, the shortest translation that parts the capsules: along
    the line between the nearest axis points, or, where the axes cross, along their
    common normal.

    The axis distance is the minimum over the unit square of the convex quadratic
    |a(s) - b(t)|², with a(s) = p_a0 + s (p_a1 - p_a0) and b(t) likewise. Its
    minimum lies either at a stationary point inside, or on one of the four edges,
    each a point against a segment. Every candidate is a pair of points of the
    segments, so that none can be too small, and one of them is the minimum. For
    parallel and for degenerate segments the edges alone contain a minimum.

    Args:
        p_a0, p_a1: (3,) ends of the axis of a [m], equal for a sphere.
        radius_a: radius of a [m].
        p_b0, p_b1, radius_b: likewise for b, in the same frame.

    Returns:
        The signed distance [m], and the (3,) witness points on the axes of a and
        of b, in the frame of the arguments. Where several are equally near
        (parallel axes), it is one of them.
    """
    a0, a1, b0, b1 = (tuple(map(float, p)) for p in (p_a0, p_a1, p_b0, p_b1))

    # The four edges: an end of one segment against the whole other one.
    candidates = [
        (a0, _nearest_on_segment(a0, b0, b1)),
        (a1, _nearest_on_segment(a1, b0, b1)),
        (_nearest_on_segment(b0, a0, a1), b0),
        (_nearest_on_segment(b1, a0, a1), b1),
    ]

    # Inside: w + s u - t v is along the common normal u x v of both lines. Crossed
    # with v and projected on the normal, t drops out and s remains. Where s is
    # inaccurate (nearly parallel), the point is still one of the segment, and the
    # nearest point of b to it makes it a fair candidate.
    u, v, w = _minus(a1, a0), _minus(b1, b0), _minus(a0, b0)
    normal = _cross(u, v)
    normal_squared = _dot(normal, normal)
    if normal_squared > 0.0:
        s = -_dot(_cross(w, v), normal) / normal_squared
        p_a = _point_at(a0, a1, s)
        candidates.append((p_a, _nearest_on_segment(p_a, b0, b1)))

    p_a, p_b = min(candidates, key=lambda pair: math.dist(*pair))
    distance = math.dist(p_a, p_b) - radius_a - radius_b
    return distance, np.array(p_a), np.array(p_b)


class Axis(NamedTuple):
    """The axis of a capsule (or sphere) with its radius; or a hull, whose middle it is.

    Of a half space `start` is on its surface, `end` straight above, and the radius is
    infinite.
    """

    start: np.ndarray  # (3,) [m]
    end: np.ndarray  # (3,) [m]
    radius: float  # [m]
    hull: Polytope | None = None

    @property
    def ends(self) -> np.ndarray:
        """(N, 3) points of which the axis is the hull [m]."""
        if self.hull is not None:
            return self.hull.points
        return np.array([self.start, self.end])

    @property
    def ball(self) -> float:
        """The radius of a ball about the axis' middle with all of the shape [m]."""
        if self.hull is not None:
            return float(np.linalg.norm(self.hull.points - self.start, axis=1).max())
        return math.dist(self.start, self.end) / 2.0 + self.radius

    def moved(self, X: RigidTransform) -> "Axis":
        """The shape in the frame that X leads to."""
        hull = self.hull
        if hull is not None:
            hull = hull._replace(points=X.multiply(hull.points.T).T)
        return Axis(X.multiply(self.start), X.multiply(self.end), self.radius, hull)


def distance_of_axes(a: Axis, b: Axis, enough: float = math.inf) -> float:
    """The signed distance of two shapes; of which one may be a half space [m].

    Args:
        a, b: in the world.
        enough: of hulls that are as far apart a bound will do, which is no less [m].
    """
    if math.isinf(a.radius):
        a, b = b, a
    if math.isinf(b.radius):
        # A shape is lowest at an end.
        up = b.end - b.start
        return min(float(up @ (end - b.start)) for end in a.ends) - a.radius
    if a.hull is None and b.hull is None:
        return capsule_distance(*a[:3], *b[:3])[0]
    a_hull, b_hull = (x.hull or axis_polytope(x.start, x.end) for x in (a, b))
    radii = a.radius + b.radius
    return polytope_distance(a_hull, b_hull, enough + radii) - radii


# Three coordinates as plain floats: as short as NumPy here, and ten times faster.
_Vector = tuple[float, float, float]


def _minus(x: _Vector, y: _Vector) -> _Vector:
    return (x[0] - y[0], x[1] - y[1], x[2] - y[2])


def _dot(x: _Vector, y: _Vector) -> float:
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def _cross(x: _Vector, y: _Vector) -> _Vector:
    return (
        x[1] * y[2] - x[2] * y[1],
        x[2] * y[0] - x[0] * y[2],
        x[0] * y[1] - x[1] * y[0],
    )


def _point_at(start: _Vector, end: _Vector, s: float) -> _Vector:
    """The point at share s of a segment; s is clamped to [0, 1]."""
    s = min(max(s, 0.0), 1.0)
    direction = _minus(end, start)
    return (
        start[0] + s * direction[0],
        start[1] + s * direction[1],
        start[2] + s * direction[2],
    )


def _nearest_on_segment(point: _Vector, start: _Vector, end: _Vector) -> _Vector:
    """The point of a segment (perhaps of no length) that is nearest to a point."""
    direction = _minus(end, start)
    length_squared = _dot(direction, direction)
    if length_squared == 0.0:
        return start
    return _point_at(start, end, _dot(_minus(point, start), direction) / length_squared)
