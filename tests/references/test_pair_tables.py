"""What is known of a pair in boxes of its two joints: closed forms, and the cache."""

import numpy as np
import pytest
import trimesh
from test_mesh_clearance import robot_of

from crar_drake.references import pair_tables
from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.mesh_pairs import ROUNDING


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def robot_of_balls(folder, halvings, **options):
    """Balls of 0.1 m: one 1 m from the axis, the other 1 m and what it slides."""
    ball = trimesh.creation.icosphere(halvings, radius=0.1)
    ball.apply_translation([1.0, 0.0, 0.0])
    folder.mkdir()
    return robot_of(folder, ball, ball, **options)


@pytest.fixture
def balls(tmp_path, cache):
    """Round to 0.3 mm."""
    return robot_of_balls(tmp_path / "balls", 4)


@pytest.fixture
def coarse(tmp_path, cache):
    """For what holds of any mesh."""
    return robot_of_balls(tmp_path / "coarse", 2)


def apart(turn, slide):
    """Of the balls [m]."""
    r = 1.0 + slide
    return np.sqrt(1.0 + r**2 - 2.0 * r * np.cos(turn)) - 0.2


def random_ways(seed: int, number: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """(K, 2) turn and slide where ways begin and end, among others where balls meet."""
    rng = np.random.default_rng(seed)
    start = rng.uniform([-1.0, -0.4], [1.0, 0.4], size=(number, 2))
    return start, start + rng.normal(size=start.shape) * [0.2, 0.1]


def table_of(body):
    return ClearanceOfMeshes(body).tables[0]


def bounds(table, body, start, end):
    return table.bounds(body.configurations(start), body.configurations(end))


def test_bounds_hold_on_ways_and_are_close(balls):
    """Triangles are within the balls by 0.3 mm at most, and sampled ways keep more than
    the bounds."""
    start, end = random_ways(0)
    low, done = bounds(table_of(balls), balls, start, end)
    u = np.linspace(0.0, 1.0, 400)[:, None, None]
    d = apart(*np.moveaxis((1.0 - u) * start + u * end, 2, 0)).min(axis=0)
    assert np.all(low <= np.maximum(d, 0.0) + 6e-4)
    assert np.all(done[d > 1e-3]) and not np.any(done[d < -1e-3])
    assert 10 < done.sum() < len(done)
    least = np.minimum(pair_tables.ENOUGH, pair_tables.SHARE * d) - 2.0 * ROUNDING
    assert np.all(low[done] >= least[done])


def test_bounds_do_not_depend_on_what_was_asked_before(coarse):
    one, other = random_ways(1), random_ways(2)
    first, second = table_of(coarse), table_of(coarse)
    expected = bounds(first, coarse, *one)
    bounds(second, coarse, *other)
    np.testing.assert_array_equal(bounds(second, coarse, *one), expected)


def test_what_is_interrupted_goes_on_later(coarse, monkeypatch):
    """Right after boxes were copied, which takes the longest."""
    one, other = table_of(coarse), table_of(coarse)
    start, end = random_ways(3)

    def interrupted(*_):
        raise KeyboardInterrupt

    bounds(one, coarse, *random_ways(4))
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(pair_tables.np, "concatenate", interrupted)
        bounds(one, coarse, start, end)
    for found in zip(
        *(bounds(x, coarse, start, end) for x in (one, other)), strict=True
    ):
        np.testing.assert_array_equal(*found)


def test_beyond_the_first_box_nothing_is_said(coarse):
    start = np.array([[0.5, 0.0], [0.5, 0.0], [40.0, 0.0]])
    end = np.array([[0.5, 0.1], [17.0, 0.0], [41.0, 0.0]])
    low, done = bounds(table_of(coarse), coarse, start, end)
    assert done.tolist() == [True, False, False]
    assert low[0] > 0.0 and np.all(low[1:] == -np.inf)


def test_what_was_measured_is_kept(coarse, cache):
    """For the next process; a file that is damaged is measured again, and another
    robot's is not taken."""
    q = np.concatenate(random_ways(3, 10))
    first = ClearanceOfMeshes(coarse)
    found = first.find(q)
    assert found.num_measured > 100
    again = ClearanceOfMeshes(coarse)
    assert again.num_in_tables == first.num_in_tables > 0
    known = again.find(q)
    assert again.num_in_tables == first.num_in_tables
    np.testing.assert_array_equal(known.on_ways, found.on_ways)
    (file,) = (cache / "crar-drake" / "meshes").iterdir()
    whole = file.read_bytes()
    for damaged in (whole[:-100], whole.replace(b"}", b" ", 1), b"PK\x03\x04" + whole):
        file.write_bytes(damaged)
        assert ClearanceOfMeshes(coarse).num_in_tables == 0


def test_another_joint_is_another_table(tmp_path, coarse):
    q = np.concatenate(random_ways(3, 5))
    ClearanceOfMeshes(coarse).find(q)
    assert ClearanceOfMeshes(coarse).num_in_tables > 0
    other = robot_of_balls(tmp_path / "other", 2, axis="0 1 0")
    assert ClearanceOfMeshes(other).num_in_tables == 0


def test_a_cache_that_cannot_be_written_to_is_done_without(coarse, cache):
    cache.mkdir(parents=True)
    (cache / "crar-drake").write_text("in the way")
    assert ClearanceOfMeshes(coarse).find(np.zeros((2, 2)) + 0.5).num_measured > 0
