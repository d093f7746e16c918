"""Gaps between convex hulls: closed forms, another method, and what overlaps."""

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from crar_drake.equations.hull_distances import nearest_apart
from crar_drake.references.hull_gaps import hull_corners, hull_gaps


def hull_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    hull = ConvexHull(points)
    number = np.empty(len(points), dtype=int)
    number[hull.vertices] = np.arange(len(hull.vertices))
    return points[hull.vertices], number[hull.simplices]


def test_boxes_have_the_gap_of_their_faces_or_none():
    box = hull_of(np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]))
    flat = np.zeros((0, 3)), np.zeros((0, 3), dtype=int)
    corners = hull_corners([box, flat, box])
    p = np.array([[1.25, 0.1, -0.2], [0.9, 0.1, 0.2], [2.0, 2.0, 2.0], [5.0, 0.0, 0.0]])
    pairs = np.array([[0, 2], [0, 2], [2, 0], [0, 1]])
    gaps, nearest = hull_gaps(pairs, np.tile(np.eye(3), (4, 1, 1)), p, corners)
    np.testing.assert_allclose(gaps, [0.25, -np.inf, np.sqrt(3.0), -np.inf], rtol=1e-9)
    np.testing.assert_allclose(nearest[2], [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]])
    np.testing.assert_allclose(nearest[0, 1] - nearest[0, 0], [0.25, 0, 0], atol=1e-9)


def test_gaps_are_shown_by_a_plane_and_are_the_distance():
    rng = np.random.default_rng(3)
    hulls = [hull_of(rng.normal(size=(400, 3))) for _ in range(3)]
    corners, count = hull_corners(hulls), 60
    pairs = np.array([(k % 3, (k + 1) % 3) for k in range(count)])
    R = Rotation.random(count, random_state=4).as_matrix()
    p = rng.normal(size=(count, 3)) * 5.0
    gaps, nearest = hull_gaps(pairs, R, p, corners)
    apart = 0
    for (i, j), X, x, gap, points in zip(pairs, R, p, gaps, nearest, strict=True):
        a, b = hulls[i][0], hulls[j][0] @ X.T + x
        is_apart, d, _, _ = nearest_apart(a, b, np.zeros(3))
        if not is_apart:
            assert gap == -np.inf
            continue
        apart += 1
        n = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
        assert gap <= (b @ n).min() - (a @ n).max() + 1e-12
        assert abs(gap - d) < 1e-8
    assert 20 < apart < count
