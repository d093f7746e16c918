"""Rows of pairs that are near: against the referee, and finite differences."""

import numpy as np
import pytest
from small_reference_robots import write_robot

from crar_drake.judging.referee import Referee
from crar_drake.references.cleaning import Cleaner
from crar_drake.robot.description import load_robot_description
from crar_drake.trajectory import distance_rows


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = write_robot(tmp_path_factory.mktemp("robot"))
    return Cleaner(load_robot_description(folder), 30.0).model


def find_near_rows(q, enough, robot, room=0.0, before=0):
    rooms = np.full(len(robot.value.pairs.value.moves), room)
    return distance_rows.find_near_rows(q, enough, rooms, before, robot)


def test_rows_are_the_referees_distances_of_what_is_near(model):
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (40, 3))
    enough = np.linspace(0.0, 0.5, 40)
    sample, row, d, _ = find_near_rows(q, enough, model.robot_ahead)
    assert (np.diff(sample) >= 0).all()
    count = len(model.pairs.pair_of_shapes)
    found = np.full((40, count), np.inf)
    found[sample, row] = d
    assert np.isfinite(found).sum() == len(d) and 20 < len(d) < 40 * count
    assert (d < enough[sample]).all()
    by_pair = found[:, model.pairs.shape_pairs].min(axis=2)
    expected = np.array([referee.distances(each) for each in q])
    near = expected < enough[:, None]
    np.testing.assert_allclose(by_pair[near], expected[near], atol=1e-9)
    assert np.isinf(by_pair[~near]).all()


def test_gradients_are_how_distances_change(model):
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (30, 3))
    far, h = np.full(30, 10.0), 1e-6
    _, _, d, g = find_near_rows(q, far, model.robot_ahead)
    for j in range(3):
        step = h * np.eye(3)[j]
        ahead = find_near_rows(q + step, far, model.robot_ahead)[2]
        behind = find_near_rows(q - step, far, model.robot_ahead)[2]
        change = (ahead - behind) / (2.0 * h)
        smooth = np.abs(ahead - 2.0 * d + behind) < 1e-9
        assert smooth.mean() > 0.95
        np.testing.assert_allclose(change[smooth], g[smooth, j], atol=2e-6)


def test_more_rows_than_there_was_room_for(model, monkeypatch):
    q = np.tile([[0.3, 0.2, 0.1]], (3000, 1))
    sample, _, d, g = find_near_rows(q, np.full(3000, 10.0), model.robot_ahead)
    assert len(d) > 4096
    each = len(d) // 3000
    np.testing.assert_array_equal(sample, np.repeat(np.arange(3000), each))
    np.testing.assert_array_equal(d.reshape(3000, each), np.tile(d[:each], (3000, 1)))
    np.testing.assert_array_equal(g[-each:], g[:each])


def test_rows_with_more_room_and_other_unknowns_before(model):
    q = np.random.default_rng(2).uniform(-2.0, 2.0, (40, 3))
    near = find_near_rows(q, np.full(40, 0.2), model.robot_ahead)
    roomy = find_near_rows(q, np.full(40, 0.05), model.robot_ahead, 0.15, 4)
    for a, b in zip(near[:3], roomy[:3], strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(roomy[3], np.pad(near[3], ((0, 0), (4, 0))))
    assert len(near[2]) > 20
