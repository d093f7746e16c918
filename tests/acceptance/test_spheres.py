"""Spheres that move by themselves: no link is touched while its surface is fast.

While a link is nearer to a sphere than the safety distance, none of its surface is
faster than the promised speed: by the judge's distances and speeds, between commands,
too.
"""

import numpy as np
import product
import pytest
from attacks import ROUNDING, judge_of
from judges import RobotJudge

PERIOD = 0.02
SHARES = np.linspace(0.0, 1.0, 5)  # of the way from command to command


class Comers:
    """Spheres that run through links that move and back, each on a line of its own.

    Attributes:
        speeds: (M,) [m/s]; radii: (M,) [m].
    """

    def __init__(self, judge: RobotJudge, q: np.ndarray, seed: int, count: int = 3):
        rng = np.random.default_rng(seed)
        start, end = judge.segments(q[None])[0].swapaxes(0, 1)
        places = 0.5 * (start + end)[movable(judge, q, links=False)]
        self._at = places[rng.integers(len(places), size=count)]
        way = rng.normal(size=(count, 3)) * [1.0, 1.0, 0.3]
        self._way = way / np.linalg.norm(way, axis=1, keepdims=True)
        self._far = rng.uniform(0.8, 1.6, count)
        self.speeds = rng.uniform(0.3, 2.0, count)
        self.radii = rng.uniform(0.05, 0.25, count)

    def at(self, time: np.ndarray) -> np.ndarray:
        """(N, M, 3) centres at times (N,) [m]."""
        gone = self.speeds * np.asarray(time)[:, None]
        # From its far end through the middle to the other end, and back.
        along = self._far - np.abs(gone % (4.0 * self._far) - 2.0 * self._far)
        return self._at - along[..., None] * self._way

    def told(self, time: float) -> product.Spheres:
        names = tuple(f"comer {i}" for i in range(len(self.radii)))
        return product.Spheres(self.at([time])[0], self.radii, self.speeds, names)


def movable(judge: RobotJudge, q: np.ndarray, links: bool = True) -> np.ndarray:
    """Which links, or which shapes, joints move by much, at q (n,)."""
    each = np.eye(len(q))
    if links:
        return judge.surface_speeds(q + 0.0 * each, each).max(axis=0) > 0.3
    ends = [judge.segments(q + sign * 1e-3 * each) for sign in (1, -1)]
    return np.abs(ends[0] - ends[1]).max(axis=(0, 2, 3)) > 0.3 * 2e-3


def judged(judge: RobotJudge, comers: Comers, q: np.ndarray, v: np.ndarray):
    """(N, L, M) distances and (N, L, 1) speeds at commands (K, n) and in between, where
    velocities are those of the command to come."""
    ways = [q[:-1] + share * np.diff(q, axis=0) for share in SHARES]
    times = [PERIOD * (np.arange(len(q) - 1) + share) for share in SHARES]
    at, v = np.concatenate(ways), np.tile(v[1:], (len(SHARES), 1))
    d, _ = judge.to_spheres(at, comers.at(np.concatenate(times)), comers.radii)
    return d, judge.surface_speeds(at, v)[..., None]


def assert_slow_where_near(d: np.ndarray, speed: np.ndarray) -> None:
    near = d < product.SAFETY_DISTANCE - ROUNDING
    fast = speed > product.TOUCHING_SPEED + 1e-7
    assert not (near & fast).any(), f"{np.where(near, speed, 0.0).max():.3f} m/s"


def swing(filter: product.JointFilter, k: int) -> np.ndarray:
    share = min(1.0, k * PERIOD / 0.4)
    turn = 2.5 * k * PERIOD + np.arange(len(filter.rest))
    return filter.rest + share * 0.4 * np.sin(turn)


def run(filter, comers: Comers, count: int, desired=swing):
    """Commands (K + 1, n) q and v, and the steps."""
    filter.restart()
    q, v, steps = [filter.rest], [0.0 * filter.rest], []
    for k in range(count):
        step = filter.step(desired(filter, k), spheres=comers.told(k * PERIOD))
        steps.append(step)
        q.append(step.q)
        v.append(step.v)
    return np.array(q), np.array(v), steps


ROBOTS = [product.ARM, product.BUILT_IN]


@pytest.mark.parametrize("evade", [False, True], ids=["stays", "evades"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_whoever_runs_at_it_touches_nothing_that_is_fast(robot, evade):
    judge = judge_of(robot)
    filter = product.JointFilter(robot, PERIOD, evade=evade)
    touched, named = 0, set()
    for seed in range(6):
        comers = Comers(judge, filter.rest, seed)
        q, v, steps = run(filter, comers, 150)
        d, speed = judged(judge, comers, q, v)
        assert_slow_where_near(d, speed)
        own = judge.distances(q)
        assert own.min() >= product.SAFETY_DISTANCE - ROUNDING
        assert (q >= judge.lower - ROUNDING).all()
        assert (q <= judge.upper + ROUNDING).all()
        touched += (d < 0.0).any(axis=(1, 2)).sum()
        for step in steps:
            assert step.too_fast == ()
            if step.why == product.SPHERE:
                assert not step.passed
                named.add(step.blocked[0])
    assert touched > 10 and named == {"comer 0", "comer 1", "comer 2"}


def test_told_of_nobody_it_is_fast_where_it_is_touched():
    """So that the test above could fail."""
    judge, filter = judge_of(product.ARM), product.JointFilter(product.ARM, PERIOD)
    comers = Comers(judge, filter.rest, 0)
    filter.restart()
    steps = [filter.step(swing(filter, k)) for k in range(150)]
    q = np.array([filter.rest, *(step.q for step in steps)])
    v = np.array([0.0 * filter.rest, *(step.v for step in steps)])
    with pytest.raises(AssertionError, match="m/s"):
        assert_slow_where_near(*judged(judge, comers, q, v))


def test_links_get_out_of_the_way_and_are_touched_less():
    """Also while nothing is desired but to stay."""
    judge = judge_of(product.ARM)
    touched = {}
    for evade in (False, True):
        filter = product.JointFilter(product.ARM, PERIOD, evade=evade)
        touched[evade] = moved = 0
        free = movable(judge, filter.rest)
        for seed in range(20, 28):
            comers = Comers(judge, filter.rest, seed, count=1)
            q, v, _ = run(filter, comers, 120, lambda filter, k: filter.rest)
            d, speed = judged(judge, comers, q, v)
            assert_slow_where_near(d, speed)
            touched[evade] += int((d[:, free] < 0.0).any(axis=(1, 2)).sum())
            moved = max(moved, np.abs(q - filter.rest).max())
        assert (moved > 0.1) == evade
    assert touched[True] < 0.75 * touched[False]


@pytest.mark.parametrize("robot", ROBOTS)
def test_who_is_far_or_gone_changes_nothing(robot):
    filter = product.JointFilter(robot, PERIOD)
    far = product.Spheres([[30.0, 0.0, 0.0], [0.0, -20.0, 1.0]], 0.3, 2.0)
    gone = product.Spheres([], [], [])
    commands = []
    for given in (None, far, gone):
        filter.restart()
        steps = [filter.step(swing(filter, k), spheres=given) for k in range(80)]
        assert all(step.blocked is None for step in steps)
        commands.append([step.q for step in steps])
    np.testing.assert_array_equal(commands[1], commands[0])
    np.testing.assert_array_equal(commands[2], commands[0])


def test_who_is_not_heard_of_may_come_and_who_leaves_frees_it():
    judge, filter = judge_of(product.ARM), product.JointFilter(product.ARM, PERIOD)
    filter.restart()
    hand = judge.segments(filter.rest[None])[0].reshape(-1, 3)[-1]
    once = product.Spheres([hand + [1.0, 0.0, 0.0]], 0.1, 1.5, ("person",))
    filter.step(swing(filter, 0), spheres=once)
    whys = [filter.step(swing(filter, k)).why for k in range(1, 60)]
    assert product.SPHERE in whys and whys[-1] == product.SPHERE
    nobody = product.Spheres([], [], [])
    steps = [filter.step(filter.rest, spheres=nobody) for _ in range(150)]
    assert steps[-1].passed and np.array_equal(steps[-1].q, filter.rest)


def test_who_breaks_the_bound_of_its_speed_is_named():
    filter = product.JointFilter(product.ARM, PERIOD)
    filter.restart()
    for k, far in enumerate([2.0, 1.98, 1.5]):
        given = product.Spheres([[far, 0.0, 0.5]], 0.1, 1.0, ("runner",))
        step = filter.step(filter.rest, spheres=given)
        assert step.too_fast == (("runner",) if k == 2 else ())


@pytest.mark.parametrize("robot, points", [(product.ARM, ["tool"]), (ROBOTS[1], None)])
def test_the_law_of_tasks_touches_nothing_that_is_fast_either(robot, points):
    """Its plant's step is the period, as it asks for."""
    judge = judge_of(robot)
    law = product.Law(
        *(robot, points or product.points_of("wrists")),
        period=PERIOD,
        plant_step=PERIOD,
        motors=False,
        spheres=True,
    )
    near = False
    for seed in range(3):
        comers = Comers(judge, law.rest, 50 + seed)
        law.restart()
        q, v = [law.rest], [0.0 * law.rest]
        for k in range(150):
            t = k * PERIOD
            points_d = law.home + 0.15 * np.sin(4.0 * t + np.arange(3))
            step = law.step(q[-1], v[-1], points_d, spheres=comers.told(t))
            q.append(step.next_q)
            v.append(step.next_v)
            near |= step.blocked is not None
        q, v = np.array(q), np.array(v)
        np.testing.assert_allclose(np.diff(q, axis=0), PERIOD * v[1:], atol=1e-9)
        assert_slow_where_near(*judged(judge, comers, q, v))
        assert judge.distances(q).min() >= product.SAFETY_DISTANCE - ROUNDING
    assert near


@pytest.mark.parametrize(
    "spheres, words",
    [
        (product.Spheres([[0.0, 0.0]], 0.1, 1.0), ["centres", "3"]),
        (product.Spheres([[0.0, np.nan, 0.0]], 0.1, 1.0), ["centres", "0"]),
        (product.Spheres([[0.0, 0.0, 1.0]], -0.1, 1.0), ["radii", "-0.1"]),
        (product.Spheres([[0.0, 0.0, 1.0]], 0.1, np.inf), ["speeds", "inf"]),
        (product.Spheres([[0.0, 0.0, 1.0]], 0.1, 1.0, ("a", "b")), ["names"]),
    ],
)
def test_spheres_that_are_none_are_refused(spheres, words):
    filter = product.JointFilter(product.ARM, PERIOD)
    with pytest.raises(product.mistake()) as caught:
        filter.step(filter.rest, spheres=spheres)
    for word in words:
        assert word in str(caught.value)
