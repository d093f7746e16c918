"""Gaps between convex hulls: closed forms, the law's own, and what overlaps or lacks
edges."""

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


def test_no_gap_is_too_large_whatever_the_climb_finds():
    """Without edges, or with few, the farthest corner is not found: nearest points are
    other ones, and the plane across them has to count with every corner."""
    rng, count = np.random.default_rng(5), 60
    none = np.zeros((0, 3), dtype=int)
    points = [
        rng.normal(size=(60, 3)),
        rng.normal(size=(2, 3)),
        rng.normal(size=(1, 3)),
    ]
    hulls = [(x, none) for x in points] + [
        (points[0], np.array([[0, 1, 2], [2, 3, 4]]))
    ]
    corners = hull_corners(hulls)
    pairs = np.array([(k % 4, (k // 4) % 4) for k in range(count)])
    R = Rotation.random(count, random_state=6).as_matrix()
    p = rng.normal(size=(count, 3)) * 3.0
    gaps, _ = hull_gaps(pairs, R, p, corners)
    missed = overlapping = 0
    for (i, j), X, x, gap in zip(pairs, R, p, gaps, strict=True):
        is_apart, d, _, _ = nearest_apart(
            hulls[i][0], hulls[j][0] @ X.T + x, np.zeros(3)
        )
        overlapping += not is_apart
        missed += is_apart and gap < d - 1e-6
        assert gap <= (d if is_apart else 0.0) + 1e-9
    assert missed > 10 and overlapping > 5


def test_neither_poses_nor_pairs_that_are_no_numbers_stay():
    box = hull_of(np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]))
    p = np.array([[1.25, 0.1, -0.2], [np.inf, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    R = np.tile(np.eye(3), (3, 1, 1))
    gaps, _ = hull_gaps(np.tile([[0, 0]], (3, 1)), R, p, hull_corners([box]))
    assert gaps[0] > 0.2 and not (gaps[1:] > 0.0).any()
