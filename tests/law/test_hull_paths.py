"""Bounds of whole paths, of boxes and other hulls: by dense samples and the referee."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from small_robots import chain_urdf, make_model

from crar_drake.judging.referee import Referee
from crar_drake.law.compilation import hold
from crar_drake.law.kinematics import link_poses, place_points
from crar_drake.law.path_bounds import LOWEST, Bounds, path_bounds, travel
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import find_reaches
from crar_drake.robot.task import Task

BOX = '<box size="0.05 0.07 0.2"/>'
WALL = """
  <link name="post"><collision><origin xyz="0.35 0.35 0.1" rpy="0.3 0.2 0.5"/>
    <geometry><box size="0.3 0.1 0.4"/></geometry></collision></link>
  <joint name="post_weld" type="fixed"><parent link="base"/><child link="post"/></joint>
"""
PAIRS = [["l0", "l2"], ["l1", "l3"], ["l3", "l0"], ["l2", "post"], ["post", "l3"]]


def boxes() -> ControlModel:
    """Boxes against boxes, on a rail: of each link one shape, a row for each pair."""
    return make_model(
        chain_urdf("zyxy", rail="y", shapes=(BOX,), extra=WALL),
        prescribed_joints={"rail": "hold"},
        pairs=PAIRS,
    )


def shelf() -> ControlModel:
    return ControlModel.FromDescription(
        load_robot_description("shelf_arm"), [Task(frame="tool")]
    )


class Paths:
    """A robot's path bounds, and its distances by the referee."""

    def __init__(self, model: ControlModel) -> None:
        self.model = model
        plant = model.plant
        limits = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        found = find_reaches(model.joints, model.pairs, model.order, *limits)
        self.reaches, self.robot = hold(found), model.robot.value
        self.of = model.pairs.pair_of_shapes
        self.rows = np.arange(len(self.of))
        self.referee = Referee(plant, model.scene_graph, model.description.pairs)

    def bounds(self, start, x, bend, level: np.ndarray) -> Bounds:
        """Of the whole of a path, of all pairs of shapes."""
        whole = np.ones((1, len(self.rows)), dtype=bool)
        of = start, x, bend, self.rows, level
        return path_bounds(*of, self.robot, self.reaches, whole, LOWEST)

    def judged(self, path: np.ndarray) -> np.ndarray:
        """(Nc,) the smallest distances of the watched pairs at (K, nv) places."""
        found = []
        for q in path:
            in_plant = np.empty(len(q))
            in_plant[self.model.positions] = q
            found.append(self.referee.distances(in_plant))
        return np.min(found, axis=0)

    def by_pair(self, rows: np.ndarray) -> np.ndarray:
        """(Nc,) the smallest of the rows of each watched pair."""
        low = np.full(len(self.model.pairs), np.inf)
        np.minimum.at(low, self.of, rows)
        return low


@pytest.fixture(scope="module", params=[boxes, shelf])
def paths(request) -> Paths:
    return Paths(request.param())


def drawn(paths: Paths, seed: int):
    rng = np.random.default_rng(seed)
    n = len(paths.robot.order)
    start = rng.uniform(-1.2, 1.2, n)
    x = rng.normal(size=n) * rng.choice([0.02, 0.2, 0.6])
    bend = rng.normal(size=n) * rng.choice([0.0, 0.01, 0.1])
    return start, x, bend


@given(st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_no_distance_on_a_path_is_below_what_is_found(paths, seed) -> None:
    """Nor is a pair said to be clear whose distance is below its level somewhere."""
    start, x, bend = drawn(paths, seed)
    level = np.full(len(paths.of), np.random.default_rng(seed).choice([0.004, 0.03]))
    bounds = paths.bounds(start, x, bend, level)
    t = np.linspace(0.0, 1.0, 16)[:, None]
    judged = paths.judged(start + t * x + t * t * bend)
    clear = paths.by_pair(np.where(bounds.at < 0.0, 1.0, 0.0)) > 0.0
    assert (judged[clear] >= paths.by_pair(bounds.low)[clear] - 1e-9).all()
    assert (judged[clear] >= level[0] - 1e-9).all()


def test_most_that_is_clear_is_found_to_be(paths) -> None:
    """The bound is of use: of pairs that keep 5 mm more, hardly any is not decided."""
    kept = found = 0
    for seed in range(12):
        start, x, bend = drawn(paths, seed)
        level = np.full(len(paths.of), 0.004)
        bounds = paths.bounds(start, x, bend, level)
        t = np.linspace(0.0, 1.0, 15)[:, None]
        far = paths.judged(start + t * x + t * t * bend) > 0.009
        clear = paths.by_pair(np.where(bounds.at < 0.0, 1.0, 0.0)) > 0.0
        kept += far.sum()
        found += (far & clear).sum()
    assert kept > 40 and found >= 0.98 * kept


@given(st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_no_distance_changes_by_more_than_the_travel(paths, seed) -> None:
    start, x, _ = drawn(paths, seed)
    most = np.zeros(len(paths.model.pairs))
    np.maximum.at(most, paths.of, travel(x, paths.reaches.value.reach))
    change = paths.judged(start[None]) - paths.judged((start + x)[None])
    assert (np.abs(change) <= most + 1e-9).all()


def test_balls_hold_their_shapes(paths) -> None:
    r = paths.robot
    pairs, tree = r.pairs.value, r.tree.value
    for seed in range(10):
        q, _, _ = drawn(paths, seed)
        in_plant = np.empty((1, len(q)))
        in_plant[0, paths.model.positions] = q
        X = link_poses(in_plant, tree, tree.every)
        points = place_points(X, r.selection, r.first)[0]
        middle = points + 0.5 * np.roll(points, -pairs.to_vector, axis=0)
        between = middle[pairs.start_a] - middle[pairs.start_b]
        apart = np.linalg.norm(between, axis=1) - pairs.balls
        judged = paths.judged(q[None])
        outside = judged > 0.0  # deep inside, a depth may be more than the balls'
        assert (paths.by_pair(apart)[outside] <= judged[outside] + 1e-12).all()
