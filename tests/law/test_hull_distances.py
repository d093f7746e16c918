"""Distances of convex hulls against SciPy's solvers and hulls of differences.

Outside, the distance is the minimum of a convex quadratic in the shares of both hulls'
corners, which `nnls` finds. Inside, it is how deep the origin is in the hull of all
differences of corners, which Qhull knows.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from crar_drake.errors import ModelError
from crar_drake.judging.referee_distances import (
    axis_polytope,
    polytope,
    polytope_distance,
)
from crar_drake.law.hull_distances import (
    Hulls,
    hull_distance,
    no_hulls,
)
from crar_drake.robot.hulls import Hull, hull_of, numbers_of_hulls


class Placed(NamedTuple):
    """Two shapes: points as the equations want them, and where they are."""

    at: np.ndarray
    a: tuple[int, int]
    b: tuple[int, int]
    hulls: Hulls


def place(a: np.ndarray | Hull, b: np.ndarray | Hull) -> Placed:
    """Hulls, or (2, 3) ends of axes."""
    starts, vectors, corners, of, hulls = [], [], [], [], []
    for shape in (a, b):
        if isinstance(shape, Hull):
            starts.append(shape.corners.mean(axis=0))
            vectors.append(np.zeros(3))
            corners.append(shape.corners)
            of.append(len(hulls))
            hulls.append(shape)
        else:
            starts.append(shape[0])
            vectors.append(shape[1] - shape[0])
            corners.append(np.zeros((0, 3)))
            of.append(-1)
    after = [4 + sum(map(len, corners[:k])) - k for k in (0, 1) if of[k] >= 0]
    at = np.concatenate([starts, vectors, *corners])
    numbers = numbers_of_hulls(hulls, after)
    return Placed(at, (0, of[0]), (1, of[1]), numbers)


def distance(a, b) -> tuple[float, np.ndarray, np.ndarray]:
    placed = place(a, b)
    return hull_distance(placed.at, *placed.a, *placed.b, 2, placed.hulls)


def points_of(shape: np.ndarray | Hull) -> np.ndarray:
    return shape.corners if isinstance(shape, Hull) else np.asarray(shape)


def outside_by_least_squares(p: np.ndarray, q: np.ndarray) -> float:
    """The distance of two hulls that are apart, within some 1e-8 of their size."""
    weight = 1e5  # of both sums of shares, which are to be 1
    sums = np.zeros((2, len(p) + len(q)))
    sums[0, : len(p)], sums[1, len(p) :] = weight, weight
    A = np.vstack([np.concatenate([p, -q]).T, sums])
    shares, _ = nnls(A, np.array([0.0, 0.0, 0.0, weight, weight]), maxiter=10_000)
    return float(np.linalg.norm(A[:3] @ shares))


def inside_by_differences(p: np.ndarray, q: np.ndarray) -> float:
    """Minus the depth of two hulls that meet; positive of such as do not."""
    hull = ConvexHull((p[:, None] - q).reshape(-1, 3))
    return float(hull.equations[:, 3].max())


def random_shape(rng: np.random.Generator, kind: int) -> np.ndarray | Hull:
    """A segment, a point, a box, or any hull, of some centimetres to a metre."""
    size = 10.0 ** rng.uniform(-1.5, 0.0)
    if kind < 2:
        end = size * rng.normal(size=3)
        return np.array([np.zeros(3), end * kind])
    if kind == 2:
        signs = np.indices((2, 2, 2)).reshape(3, -1).T - 0.5
        return hull_of(signs * size * rng.uniform(0.02, 1.0, 3))
    return hull_of(size * rng.normal(size=(int(rng.integers(4, 40)), 3)))


def moved(shape: np.ndarray | Hull, by: np.ndarray, turn: np.ndarray):
    if isinstance(shape, Hull):
        corners = np.ascontiguousarray(shape.corners @ turn.T + by)
        return Hull(corners, shape.faces, shape.edges)
    return shape @ turn.T + by


def random_turn(rng: np.random.Generator) -> np.ndarray:
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return Q * np.sign(np.linalg.det(Q))


def random_pair(seed: int):
    rng = np.random.default_rng(seed)
    a = random_shape(rng, int(rng.integers(2, 4)))
    b = random_shape(rng, int(rng.integers(4)))
    far = rng.choice([0.0, 0.05, 0.3, 1.5])
    return a, moved(b, far * rng.normal(size=3), random_turn(rng)), rng


@pytest.mark.parametrize("batch", range(4))
def test_distances_are_those_of_least_squares_and_of_hulls_of_differences(batch):
    met = apart = 0
    for seed in range(100 * batch, 100 * batch + 100):
        a, b, _ = random_pair(seed)
        d, n, x = distance(a, b)
        p, q = points_of(a), points_of(b)
        depth = inside_by_differences(p, q)
        if depth < 0.0:
            assert d == pytest.approx(depth, abs=1e-9)
            met += 1
        else:
            assert d == pytest.approx(outside_by_least_squares(p, q), abs=1e-7)
            apart += 1
        # The normal bounds it from below, and both nearest points are on its line.
        assert (p @ n).min() - (q @ n).max() == pytest.approx(d, abs=1e-9)
        assert np.linalg.norm(n) == pytest.approx(1.0)
        y = x - d * n
        assert (p @ n).min() == pytest.approx(x @ n, abs=1e-8)
        assert (q @ n).max() == pytest.approx(y @ n, abs=1e-8)
        for point, hull in ((x, p), (y, q)):
            off = nnls(
                np.vstack([hull.T, np.full(len(hull), 1e4)]), np.append(point, 1e4)
            )[1]
            assert off < 1e-7
    assert met > 15 and apart > 15


@pytest.mark.parametrize("seed", range(60))
def test_the_order_does_not_matter_and_the_referee_agrees(seed):
    a, b, _ = random_pair(1000 + seed)
    d, n, x = distance(a, b)
    back, m, y = distance(b, a)
    assert back == pytest.approx(d, abs=1e-10)
    if abs(d) > 1e-3 and d > 0.0:  # inside, two ways out may be as short
        np.testing.assert_allclose(m, -n, atol=1e-6)
    judged = [
        polytope(s.corners) if isinstance(s, Hull) else axis_polytope(*s)
        for s in (a, b)
    ]
    assert polytope_distance(*judged) == pytest.approx(d, abs=1e-9)


BOX = hull_of(np.indices((2, 2, 2)).reshape(3, -1).T - 0.5)


@pytest.mark.parametrize(
    ("by", "expected"),
    [
        ((1.25, 0.0, 0.0), 0.25),  # face to face
        ((1.0, 0.0, 0.0), 0.0),  # touching
        ((1.25, 1.25, 0.3), 0.25 * 2**0.5),  # edge to edge, parallel
        ((1.25, 1.25, 1.25), 0.25 * 3**0.5),  # corner to corner
        ((0.9, 0.2, 0.1), -0.1),
        ((0.0, 0.0, 0.0), -1.0),  # the same
        ((1.0 + 1e-6, 0.0, 0.0), 1e-6),
        ((1.0 - 1e-12, 0.0, 0.0), -1e-12),
    ],
)
def test_cubes_in_line(by, expected):
    d, n, _ = distance(BOX, moved(BOX, np.array(by), np.eye(3)))
    assert d == pytest.approx(expected, abs=1e-10)
    assert np.linalg.norm(n) == pytest.approx(1.0)


@pytest.mark.parametrize("height", [0.7, 0.5, 0.499999, 0.2])
def test_an_axis_over_an_edge_and_through_a_face(height):
    over = np.array([[-2.0, 0.1, height], [2.0, 0.1, height]])
    d, n, _ = distance(BOX, over)
    assert d == pytest.approx(height - 0.5, abs=1e-12)
    np.testing.assert_allclose(n, [0.0, 0.0, -1.0], atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_distance_changes_by_no_more_than_a_shape_moves(seed):
    """Through contact, too: a straight way into the other hull and out again."""
    a, b, rng = random_pair(2000 + seed)
    way = 2.0 * (points_of(a).mean(axis=0) - points_of(b).mean(axis=0))
    way += 0.1 * rng.normal(size=3)
    steps = 200
    d = [
        distance(a, moved(b, t * way, np.eye(3)))[0]
        for t in np.linspace(0.0, 1.0, steps + 1)
    ]
    assert np.abs(np.diff(d)).max() <= np.linalg.norm(way) / steps + 1e-9


def test_what_is_no_number_has_no_distance():
    placed = place(BOX, np.array([[2.0, np.nan, 0.0], [3.0, 0.0, 0.0]]))
    d, _, _ = hull_distance(placed.at, *placed.a, *placed.b, 2, placed.hulls)
    assert np.isnan(d)


def test_flat_points_have_no_hull():
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
    for points in (flat, flat[:3]):
        with pytest.raises(ModelError, match=r"flat.*thickness"):
            hull_of(points)


def test_capsules_alone_have_no_hulls():
    found = no_hulls(3)
    assert (found["hull_a"] == -1).all() and (found["hull_b"] == -1).all()
    assert len(found["hulls"].value.corners) == 0
