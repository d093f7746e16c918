"""The normal equations of a motion, against dense matrices."""

import numpy as np
import pytest

from crar_drake.trajectory.bands import (
    Normal,
    add_rows,
    add_squares,
    add_steps,
    add_wide,
)


def dense(normal: Normal) -> np.ndarray:
    frames, m = normal.b.shape
    columns = normal.H.reshape(frames * m, -1)
    H = np.zeros((frames * m, frames * m))
    for c, below in enumerate(columns):
        below = below[: len(H) - c]
        H[c : c + len(below), c] = H[c, c : c + len(below)] = below
    return H


def some_normal(frames: int, m: int, seed: int) -> Normal:
    rng = np.random.default_rng(seed)
    H = np.zeros((frames, m, 2 * m + 1))
    for k in range(frames):
        D, S = rng.normal(size=(2, m, m))
        D = D @ D.T + 10.0 * np.eye(m)
        for c in range(m):
            H[k, c, : m - c] = D[c:, c]
            H[k, c, m - c : 2 * m - c] = S[:, c]
            H[k, c, 2 * m] = rng.normal()
    return Normal(H, rng.normal(size=(frames, m)))


@pytest.mark.parametrize("frames", [1, 2, 3, 7])
@pytest.mark.parametrize("m", [1, 4])
def test_the_solution_is_that_of_the_dense_matrix(frames, m):
    normal = some_normal(frames, m, 10 * frames + m)
    expected = np.linalg.solve(dense(normal), normal.b.ravel())
    np.testing.assert_allclose(normal.solve().ravel(), expected, rtol=1e-9, atol=1e-12)


def test_what_is_not_positive_definite_has_no_solution():
    normal = some_normal(3, 2, 1)
    normal.H[1, :, 0] -= 100.0
    assert np.linalg.eigvalsh(dense(normal)).min() < 0.0
    assert normal.solve() is None


def test_rows_are_least_squares_of_frames_and_places_between(monkeypatch):
    """Of both forms of the function, held frames among them."""
    rng = np.random.default_rng(5)
    frames, m = 4, 3
    #        frame 0, between 0 and 1, between 2 and a held one, held and 0, frame 3
    left = np.array([0, 0, 0, 2, -1, 3])
    right = np.array([-1, 1, 1, -1, 0, -1])
    share = np.array([0.0, 0.25, 0.25, 0.5, 0.5, 0.0])
    g, weight = rng.normal(size=(6, m)), rng.uniform(1.0, 2.0, 6)
    g[1, 0] = 0.0
    target = rng.normal(size=6)
    A = np.zeros((6, frames, m))
    for r in range(6):
        if left[r] >= 0:
            A[r, left[r]] += (1.0 - share[r]) * g[r]
        if right[r] >= 0:
            A[r, right[r]] += share[r] * g[r]
    A = A.reshape(6, -1)

    for form in forms(add_rows):
        found = some_normal(frames, m, 2)
        before = dense(found), found.b.copy()
        form(found.H, found.b, left, right, share, g, weight, target)
        np.testing.assert_allclose(
            dense(found) - before[0], A.T @ (weight[:, None] * A), atol=1e-12
        )
        np.testing.assert_allclose(
            (found.b - before[1]).ravel(), A.T @ (weight * target), atol=1e-12
        )


def forms(function) -> list:
    """As it is compiled, and as it is written."""
    return [function] + ([function.py_func] if hasattr(function, "py_func") else [])


def some_sparse(rng, *shape: int) -> np.ndarray:
    return rng.normal(size=shape) * (rng.random(shape) < 0.4)


def test_squares_of_frames_are_those_of_the_dense_matrix():
    rng = np.random.default_rng(6)
    J, r = some_sparse(rng, 3, 5, 4), rng.normal(size=(3, 5))
    for form in forms(add_squares):
        found = some_normal(3, 4, 3)
        before = dense(found), found.b.copy()
        form(found.H, found.b, J, r)
        A = np.zeros((3, 5, 3, 4))
        for k in range(3):
            A[k, :, k] = J[k]
        A = A.reshape(15, 12)
        np.testing.assert_allclose(dense(found) - before[0], A.T @ A, atol=1e-12)
        pull = (found.b - before[1]).ravel()
        np.testing.assert_allclose(pull, -A.T @ r.ravel(), atol=1e-12)


def test_squares_of_steps_are_those_of_the_dense_matrix():
    """Frame 2 has a neighbour that is held, on either side of it one."""
    rng = np.random.default_rng(7)
    A, B = some_sparse(rng, 4, 3, 4), some_sparse(rng, 4, 3, 4)
    r = rng.normal(size=(4, 3))
    before, after = np.array([0, 1, -1, 2]), np.array([1, -1, 2, -1])
    rows = np.zeros((4, 3, 3, 4))
    for k in range(4):
        if before[k] >= 0:
            rows[k, :, before[k]] -= A[k]
        if after[k] >= 0:
            rows[k, :, after[k]] += B[k]
    rows = rows.reshape(12, 12)
    for form in forms(add_steps):
        found = some_normal(3, 4, 4)
        was = dense(found), found.b.copy()
        form(found.H, found.b, before, after, A, B, r)
        np.testing.assert_allclose(dense(found) - was[0], rows.T @ rows, atol=1e-12)
        pull = (found.b - was[1]).ravel()
        np.testing.assert_allclose(pull, -rows.T @ r.ravel(), atol=1e-12)


def test_bands_times_a_vector_and_some_frames_alone_are_of_the_dense_matrix():
    normal, rng = some_normal(8, 3, 9), np.random.default_rng(9)
    x, H = rng.normal(size=(8, 3)), dense(normal)
    np.testing.assert_allclose(
        normal.times(x).ravel(), H @ x.ravel(), rtol=1e-12, atol=1e-12
    )
    some = np.array([0, 1, 3, 5, 6, 7])
    part = normal.of_frames(some, rng.normal(size=(6, 3)))
    columns = (3 * some[:, None] + np.arange(3)).ravel()
    expected = H[np.ix_(columns, columns)]
    # Frames 1 and 3, and 3 and 5, are coupled past one that is held.
    np.testing.assert_array_equal(dense(part)[:9, :6], _gaps(expected, some)[:9, :6])
    np.testing.assert_array_equal(dense(part), _gaps(expected, some))


def _gaps(H: np.ndarray, some: np.ndarray) -> np.ndarray:
    H = H.copy()
    for a in range(len(some)):
        for b in range(len(some)):
            if abs(some[a] - some[b]) == 2 and abs(a - b) == 1:
                H[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] = 0.0
    return H


@pytest.mark.parametrize("width", [3, 5])
def test_squares_of_frames_in_a_row_are_those_of_the_dense_matrix(width):
    """Of all frames of a row, and of some the first, the last or the middle of which
    are held, so that others are neighbours."""
    rng, frames = np.random.default_rng(8), width + 2
    whole = np.arange(width)
    gap = np.where(
        whole == width // 2, -1, np.where(whole > width // 2, whole - 1, whole)
    )
    places = np.array(
        [
            whole,
            whole + 2,
            np.where(whole < 1, -1, whole - 1),
            np.where(whole > 1, -1, whole + frames - 2),
            gap,
        ]
    )
    g, target = rng.normal(size=(5, width, 2)), rng.normal(size=5)
    g[0, 1, 0] = 0.0
    A = np.zeros((5, frames, 2))
    for r, some in enumerate(places):
        for a, k in enumerate(some):
            if k >= 0:
                A[r, k] += g[r, a]
    A = A.reshape(5, -1)
    for form in forms(add_wide):
        narrow = some_normal(frames, 2, 4)
        normal = narrow.of_frames(np.arange(frames), narrow.b.copy(), width)
        before, pull = dense(narrow), narrow.b
        form(normal.H, normal.b, places, g, 1.7, target)
        H = dense(normal)
        np.testing.assert_allclose(H - before, 1.7 * A.T @ A, atol=1e-12)
        np.testing.assert_allclose(
            (normal.b - pull).ravel(), 1.7 * A.T @ target, atol=1e-12
        )
        expected = np.linalg.solve(H, normal.b.ravel())
        np.testing.assert_allclose(normal.solve().ravel(), expected, rtol=1e-8)
