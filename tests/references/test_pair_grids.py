"""What is interpolated between the corners of cells: closed forms, and the cache."""

import numpy as np
import pytest
import trimesh
from test_mesh_clearance import robot_of

from crar_drake.references import nearest_points
from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.pair_grids import PairGrid


@pytest.fixture
def balls(tmp_path, monkeypatch):
    """Balls of 0.1 m: one 1 m from the axis, the other 1 m and what it slides."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    ball = trimesh.creation.icosphere(4, radius=0.1)
    ball.apply_translation([1.0, 0.0, 0.0])
    return robot_of(tmp_path, ball, ball)


def grid_of(body) -> PairGrid:
    return PairGrid(ClearanceOfMeshes(body).tables[0])


def places(count: int) -> np.ndarray:
    """(K, 2) turn and slide: balls are clear, or up to 20 mm deep in each other."""
    rng = np.random.default_rng(0)
    turn = rng.uniform(0.18, 0.22, size=count) * rng.choice([-1.0, 1.0], size=count)
    return np.column_stack([turn, rng.uniform(-0.01, 0.01, size=count)])


def test_distances_and_derivatives_are_those_of_balls(balls):
    """Triangles are within the balls by 0.3 mm at most; cells are off by a tenth."""
    at = places(300)
    d, slopes = grid_of(balls).find(at)
    turn, r = at[:, 0], 1.0 + at[:, 1]
    apart = np.sqrt(1.0 + r**2 - 2.0 * r * np.cos(turn))
    assert (apart < 0.195).any() and (apart > 0.205).any()
    assert np.all(np.abs(d - (apart - 0.2)) < 1e-3 + 0.1 * np.abs(apart - 0.2))
    exact = np.column_stack([r * np.sin(turn), r - np.cos(turn)]) / apart[:, None]
    assert np.all(np.abs(slopes - exact) < 0.1)


def test_what_is_known_does_not_depend_on_what_was_asked_before(balls):
    one, other = grid_of(balls), grid_of(balls)
    at = places(40)
    d, slopes = one.find(at)
    each = [other.find(x[None]) for x in at[::-1]]
    np.testing.assert_array_equal(d[::-1], [x[0] for x, _ in each])
    np.testing.assert_array_equal(slopes[::-1], [x[0] for _, x in each])


def test_the_next_process_measures_nothing(balls, monkeypatch):
    grid, at = grid_of(balls), places(40)
    found = grid.find(at)
    grid.keep()
    again = grid_of(balls)

    def measured(*_):
        raise AssertionError

    monkeypatch.setattr(nearest_points.NearestPoints, "signed", measured)
    for one, other in zip(found, again.find(at), strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(AssertionError):
        again.find(np.array([[1.0, 0.3]]))


def test_what_is_no_number_or_beyond_all_cells_has_no_distance(balls):
    """Cells beyond would have the numbers of others."""
    at = [[np.nan, 0.0], [0.2, np.inf], [1e300, 0.0], [0.0, -1.1e3], [1.1e4, 0.0]]
    grid = grid_of(balls)
    d, _ = grid.find(np.array(at))
    assert np.isnan(d).all()
    far = np.array([[0.2, 1e3], [0.2, -1e3], [1e4, 0.0], [-1e4, 0.0]])
    d, _ = grid.find(far)
    turn, r = far[:, 0], 1.0 + far[:, 1]
    apart = np.sqrt(1.0 + r**2 - 2.0 * r * np.cos(turn))
    np.testing.assert_allclose(d, apart - 0.2, rtol=0.01)
