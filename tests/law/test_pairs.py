"""The constraint of pairs, of a ball that slides in a plane: all is known by hand.

Its two positions are its place, and the post is where they are 0.
"""

import numpy as np
import pytest
from sliding_balls import BOTH, among_posts

from crar_drake.law.compilation import Held
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.pairs import PathNumbers, keep_distance, relaxed_distances

T, PERIOD = 0.1, 0.02
NOTHING = np.zeros(0)


@pytest.fixture(scope="module")
def shapes() -> Held:
    return ControlLaw(among_posts([[0.0, 0.0]]))._constraints.pairs.shapes


def is_safe(shapes: Held, q, v, s, *gains: float) -> bool:
    """Of a step that begins on a clear path; gains are T, period, step and floor."""
    return keep_distance(q, v, s, NOTHING, PathNumbers(*gains), shapes)[0]


@pytest.mark.parametrize("d", [-1e-3, 1e-3, 3.9e-3, 4.1e-3, 0.1])
def test_at_rest_a_pair_keeps_the_floor_or_what_it_has(shapes, d) -> None:
    q, still = np.array([0.6, 0.8]) * (d + BOTH), np.zeros(2)
    kept = relaxed_distances(q, still, T, 4e-3, shapes)
    assert len(kept) == (d < 4e-3)
    np.testing.assert_allclose(kept, d, atol=1e-12)
    gains = PathNumbers(T, PERIOD, PERIOD, 4e-3)
    for aside, safe in ((0.0, True), (1e-3, True), (-1e-3, d > 4.05e-3)):
        s = aside * q / np.linalg.norm(q)
        assert keep_distance(q, still, s, kept, gains, shapes)[0] == safe


def from_way(place: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """How far a place is from a straight way."""
    along = end - start
    share = np.clip((place - start) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(start + share * along - place))


@pytest.mark.parametrize("step", [0.0, 2e-3])
@pytest.mark.parametrize("seed", range(12))
def test_a_bent_way_keeps_clear_by_its_own_distance(shapes, seed, step) -> None:
    """And by that of its chord. The floor up to which it does, by bisection: the
    smallest distance of all samples; of the parabola through what a plant that moves
    in steps comes by."""
    rng = np.random.default_rng(seed)
    period, t = T, np.linspace(0.0, 1.0, 1001)[:, None]
    while True:
        v = np.array([rng.choice([1.0, 3.0, 8.0]), 0.0])
        s = np.array([rng.uniform(-2.0, 8.0), rng.uniform(1.0, 5.0)])
        qddot = (s - v) / T
        way = t * period * v + 0.5 * t * period * (t * period + step) * qddot
        start, end = way[-1], way[-1] + T * (v + period * qddot)
        post = rng.uniform(-1.0, 1.0, 2)
        others = min(from_way(post, way[0], T * v), from_way(post, start, end))
        nearest = np.linalg.norm(way - post, axis=1).min()
        nearest = min(nearest, from_way(post, way[0], start))
        if 0.02 < nearest - BOTH and nearest + 0.01 < others:
            break
    low, high = 0.0, others - BOTH
    for _ in range(16):
        floor = 0.5 * (low + high)
        clear = is_safe(shapes, -post, v, s, T, period, step, floor)
        low, high = (floor, high) if clear else (low, floor)
    assert low == pytest.approx(nearest - BOTH, abs=1e-3)
    assert low < nearest - BOTH + 1e-5


def test_a_way_that_leaves_a_surface_may_begin_on_it(shapes) -> None:
    """However hard the ball is pushed off: the way is nowhere nearer than its start."""
    q = np.array([4e-3 + BOTH + 1e-6, 0.0])
    for push in (0.1, 1.0, 8.0):
        for along in (0.0, 0.5):
            v, s = np.array([0.0, along]), np.array([push, along])
            assert is_safe(shapes, q, v, s, T, PERIOD, 1e-3, 4e-3)


def test_what_has_no_distance_is_not_safe(shapes) -> None:
    """An overflow makes a NaN of it; and the law brakes then."""
    q, v, s = np.array([1.0, 1.0]), np.array([np.nan, 0.0]), np.array([0.1, 0.0])
    for step in (0.0, PERIOD):
        assert not is_safe(shapes, q, v, s, T, PERIOD, step, 4e-3)


@pytest.mark.parametrize("below", [4e-16, 1e-12, 9e-10])
def test_what_rounding_takes_from_the_floor_is_no_licence(shapes, below) -> None:
    """The way to the next state is examined as it is from the floor itself."""
    q, v = np.array([BOTH + 4e-3, 0.0]), np.zeros(2)
    floor = float(np.linalg.norm(q) - BOTH) + below
    assert not len(relaxed_distances(q, v, T, floor, shapes))
    # Through the post and out at its other side, in a period.
    s = np.array([-4.0 * q[0] / PERIOD * T / PERIOD, 0.0])
    for step in (0.0, PERIOD):
        assert not is_safe(shapes, q, v, s, T, PERIOD, step, floor)
        # And one that stays is taken.
        assert is_safe(shapes, q, v, 0.0 * s, T, PERIOD, step, floor)
