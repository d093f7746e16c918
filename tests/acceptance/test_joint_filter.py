"""The filter of joint commands: what is safe passes bit by bit, the rest comes safe.

The judge sees commands, the straight ways between them, and the braking path of each.
"""

import numpy as np
import product
import pytest
from attacks import ROUNDING, TORQUE_ROUNDING, assert_apart, judge_of, worst_of

PERIOD = 0.02
SHARES = np.linspace(0.0, 1.0, 5)


def smooth(rest: np.ndarray, steps: int, size: float, seed: int = 3) -> np.ndarray:
    """(K, n) positions that begin and end at rest."""
    t = np.linspace(0.0, 1.0, steps)
    share = np.sin(np.pi * t) ** 2 * np.sin(5.0 * t)
    return rest + size * share[:, None] * np.random.default_rng(seed).uniform(
        -1.0, 1.0, len(rest)
    )


class Episode:
    """A filter from a start on, and what came of it."""

    def __init__(self, robot: str, period: float = PERIOD, **chosen: object) -> None:
        self.judge = judge_of(robot)
        self.filter = product.JointFilter(robot, period, **chosen)
        self.begin()

    def begin(self, q: np.ndarray | None = None, v: np.ndarray | None = None) -> None:
        rest = self.filter.rest
        self.filter.restart(q, v)
        self.start = rest if q is None else q, 0.0 * rest if v is None else v
        self.steps: list[product.FilterStep] = []

    def give(self, **desired: object) -> product.FilterStep:
        with np.errstate(all="ignore"):
            self.steps.append(self.filter.step(**desired))
        step = self.steps[-1]
        for name in "qv":  # what is said to be passed on is so, bit by bit
            if step.passed and desired.get(name) is not None and "v" not in desired:
                np.testing.assert_array_equal(getattr(step, name), desired[name])
        return step

    def reasons(self) -> set[str]:
        return {step.why for step in self.steps}

    def assert_safe(self) -> None:
        """Distances, limits and speeds of all that was commanded, and of braking."""
        judge, T = self.judge, self.filter.braking_time
        q = np.array([self.start[0], *(step.q for step in self.steps)])
        v = np.array([self.start[1], *(step.v for step in self.steps)])
        np.testing.assert_allclose(
            np.diff(q, axis=0), self.filter.period * v[1:], rtol=0.0, atol=1e-12
        )
        ways = [q[:-1] + share * np.diff(q, axis=0) for share in SHARES]
        brakes = [q + share * T * v for share in SHARES]
        assert_apart(judge, np.concatenate(ways + brakes))
        for positions in (*ways, brakes[-1]):
            assert (positions >= judge.lower - ROUNDING).all()
            assert (positions <= judge.upper + ROUNDING).all()
        assert (np.abs(v) <= judge.speeds * (1.0 + ROUNDING)).all()

    def torques(self) -> np.ndarray:
        """(K, n) of the motors over their limits, by Drake's inverse dynamics."""
        q = [self.start[0], *(step.q for step in self.steps[:-1])]
        v = [self.start[1], *(step.v for step in self.steps[:-1])]
        a = [step.a for step in self.steps]
        found = self.judge.torques(*map(np.array, (q, v, a)))
        return np.abs(found) / self.judge.efforts


@pytest.fixture(scope="module")
def arm() -> Episode:
    """An arm beside a post; tests begin it anew."""
    return Episode(product.ARM)


# --- what is safe -------------------------------------------------------------------


@pytest.mark.parametrize("robot", [product.ARM, product.BUILT_IN])
@pytest.mark.parametrize("kind", ["q", "q and v", "v"])
def test_what_is_safe_passes_bit_by_bit(robot, kind):
    episode = Episode(robot)
    desired = smooth(episode.filter.rest, 200, 0.3)
    rates = np.gradient(desired, PERIOD, axis=0)
    rates[0] = 0.0
    for q, v in zip(desired[1:], rates[1:], strict=True):
        given = {"q": {"q": q}, "v": {"v": v}, "q and v": {"q": q, "v": v}}[kind]
        step = episode.give(**given)
        assert step.passed and not step.braking and step.why == ""
        assert step.safe_start and step.clearance >= product.SAFETY_DISTANCE
        name = kind[0]
        np.testing.assert_array_equal(getattr(step, name), given[name])
    episode.assert_safe()


def test_safe_accelerations_pass(arm):
    arm.begin()
    v = np.gradient(smooth(arm.filter.rest, 200, 0.3), PERIOD, axis=0)
    v[0] = 0.0
    for k, a in enumerate(np.diff(v, axis=0) / PERIOD):
        step = arm.give(a=a)
        assert step.passed
        np.testing.assert_allclose(step.a, a, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(step.v, v[k + 1], rtol=0.0, atol=1e-9)
    arm.assert_safe()


def test_a_command_by_name_leaves_the_other_joints(arm):
    arm.begin()
    desired = arm.filter.rest.copy()
    desired[1] += 0.01
    step = arm.filter.step(q={arm.filter.joints[1]: desired[1]})
    np.testing.assert_array_equal(step.q, desired)


# --- ten episodes that it holds back -------------------------------------------------


def into_the_post(episode: Episode, rng: np.random.Generator) -> None:
    """Where the arm is sent it is within the post; one joint has nothing to do with it,
    and goes on."""
    rest = episode.filter.rest
    pairs = {tuple(x.split("::")[-1] for x in pair) for pair in episode.judge.pairs}
    way = rest + np.linspace(0.0, 1.0, 101)[:, None] * [1.5, 0.3, 0, 0, 0, 0, 0]
    depths = episode.judge.distances(way).min(axis=1)
    assert depths.min() < -0.01
    into = way[np.argmin(depths)]
    for k in range(200):
        desired = rest + min(1.0, k / 75) * (into - rest)
        desired[6] = rest[6] + 0.3 * np.sin(0.1 * k)
        step = episode.give(q=desired)
        assert abs(step.q[6] - desired[6]) < 1e-9
        if step.why == product.PAIR:
            assert step.pair in pairs
    nearest = episode.judge.distances(step.q[None]).min()
    assert nearest < 8e-3
    for k in range(150):  # and it goes back when it may
        step = episode.give(q=rest + max(0.0, 1.0 - k / 75) * (into - rest))
    assert step.passed and np.array_equal(step.q, rest)


def beyond_a_limit(episode: Episode, rng: np.random.Generator) -> None:
    rest, upper = episode.filter.rest, episode.judge.upper
    for k in range(300):
        desired = rest.copy()
        desired[6] += min(1.0, k / 200) * 1.2 * (upper[6] - rest[6])
        step = episode.give(q=desired)
        if step.why == product.LIMIT:
            assert step.joint == episode.filter.joints[6]
    assert abs(step.q[6] - upper[6]) < 1e-6


def too_fast(episode: Episode, rng: np.random.Generator) -> None:
    desired = episode.filter.rest.copy()
    for k in range(200):
        desired[0] += PERIOD * 1.5 * episode.judge.speeds[0] * np.sin(k / 5)
        desired[4] += 0.01 * np.sin(k / 8)
        step = episode.give(q=desired.copy())
        if step.why == product.SPEED:
            assert step.joint == episode.filter.joints[0]


def inside(episode: Episode, q: np.ndarray) -> np.ndarray:
    """Within limits, so that nothing but pairs and speeds are in the way."""
    return np.clip(q, episode.judge.lower, episode.judge.upper)


def jumps(episode: Episode, rng: np.random.Generator) -> None:
    rest = episode.filter.rest
    for k in range(400):
        if k % 15 == 0:
            desired = inside(episode, rest + rng.uniform(-1.5, 1.5, len(rest)))
        episode.give(q=desired)


def noise(episode: Episode, rng: np.random.Generator) -> None:
    desired = episode.filter.rest
    for _ in range(400):
        step = rng.normal(0.0, 0.03, len(desired))
        desired = inside(episode, desired + step)
        episode.give(q=desired)


def swings(episode: Episode, rng: np.random.Generator) -> None:
    rest = episode.filter.rest
    omega = 2.0 * np.pi * rng.uniform(0.2, 1.0, len(rest))
    for k in range(400):
        episode.give(q=inside(episode, rest + 1.5 * np.sin(omega * k * PERIOD)))


def velocities(episode: Episode, rng: np.random.Generator) -> None:
    for k in range(400):
        if k % 8 == 0:
            desired = rng.normal(0.0, 4.0, len(episode.filter.rest))
        episode.give(v=desired)


def accelerations(episode: Episode, rng: np.random.Generator) -> None:
    for _ in range(400):
        episode.give(a=rng.normal(0.0, 300.0, len(episode.filter.rest)))


def no_numbers(episode: Episode, rng: np.random.Generator) -> None:
    desired = smooth(episode.filter.rest, 300, 1.0)
    T = episode.filter.braking_time
    for k, q in enumerate(desired):
        if k // 20 % 2 == 0:
            before = episode.give(q=q)
            continue
        q[k % len(q)] = (np.nan, np.inf, -np.inf)[k % 3]
        step = episode.give(q=q)
        assert step.braking and step.why == product.NO_NUMBER
        slower = (1.0 - PERIOD / T) * before.v
        np.testing.assert_allclose(step.v, slower, rtol=1e-9, atol=1e-15)
        before = step


def numbers_beyond_sense(episode: Episode, rng: np.random.Generator) -> None:
    n = len(episode.filter.rest)
    for k in range(300):
        size = rng.choice([1e6, 1e30, 1e200, 1e308])
        desired = size * rng.uniform(-1.0, 1.0, n)
        if k % 4 == 3:
            episode.give(q=desired, v=-desired)
        else:
            episode.give(**{("q", "v", "a")[k % 4]: desired})


PAIR, LIMIT, SPEED = product.PAIR, product.LIMIT, product.SPEED
EPISODES = [  # what is desired, and reasons that must be given
    (into_the_post, product.ARM, {PAIR}),
    (beyond_a_limit, product.ARM, {LIMIT}),
    (too_fast, product.ARM, {SPEED}),
    (jumps, product.ARM, {SPEED, product.RETURNING}),
    (noise, product.BUILT_IN, {PAIR}),
    (swings, product.BUILT_IN, {LIMIT, SPEED}),
    (velocities, product.BUILT_IN, {PAIR, LIMIT}),
    (accelerations, product.ARM, {LIMIT, SPEED}),
    (no_numbers, product.BUILT_IN, {product.NO_NUMBER}),
    (numbers_beyond_sense, product.ARM, {LIMIT}),
]


@pytest.mark.parametrize("hostile, robot, reasons", EPISODES)
def test_what_is_not_safe_is_held_back_and_it_says_why(hostile, robot, reasons):
    episode = Episode(robot)
    hostile(episode, np.random.default_rng(7))
    assert reasons <= episode.reasons(), episode.reasons()
    assert all(step.safe_start for step in episode.steps)
    for step in episode.steps:
        assert step.passed == (step.why == "")
    episode.assert_safe()


@pytest.mark.parametrize("period", [1e-3, 5e-3, 0.02])
def test_motors_are_kept_by_drakes_dynamics(period):
    """Of each command; and what motors can do passes bit by bit."""
    episode, rng = Episode(product.ARM, period, motors=True), np.random.default_rng(0)
    desired = rest = episode.filter.rest
    for k in range(400):
        if k % 80 == 40:
            desired = rest + rng.uniform(-0.8, 0.8, len(rest))
        episode.give(q=desired)
    episode.assert_safe()
    assert product.MOTOR in episode.reasons()
    shares = episode.torques()
    assert 0.8 < shares.max() <= 1.0 + 1e3 * TORQUE_ROUNDING
    episode.begin()
    for q in smooth(rest, 400, 0.2):
        assert episode.give(q=q).passed


def test_a_start_too_near_gets_no_nearer_and_comes_free(arm):
    rest, judge = arm.filter.rest, arm.judge
    way = rest + np.linspace(0.0, 1.0, 2001)[:, None] * [1.5, 0.3, 0, 0, 0, 0, 0]
    d = judge.distances(way).min(axis=1)
    start = way[np.argmax(d < -2e-3)]
    arm.begin(start)
    deepest = judge.distances(start[None]).min()
    for k in range(200):
        step = arm.give(q=start if k < 40 else rest)
        d = judge.distances(step.q[None]).min()
        assert d >= deepest - ROUNDING
        deepest = min(d, product.SAFETY_DISTANCE)
    assert not arm.steps[0].safe_start and arm.steps[-1].safe_start
    assert deepest == product.SAFETY_DISTANCE
    np.testing.assert_allclose(step.q, rest, atol=1e-6)


def test_a_start_beyond_a_limit_goes_no_farther_and_comes_back(arm):
    start = arm.filter.rest.copy()
    start[6] = arm.judge.upper[6] + 0.05
    arm.begin(start)
    farther = start + np.eye(7)[6]
    for k in range(200):
        step = arm.give(q=farther if k < 40 else arm.filter.rest)
        assert step.q[6] <= start[6] + ROUNDING
    assert not arm.steps[0].passed and step.passed


# --- a robot that errs --------------------------------------------------------------


def test_a_robot_that_errs_by_its_bound_keeps_distances_and_limits():
    """In the worst direction of each pair; told of no error it comes nearer."""
    E, nearest = 0.01, {}
    for error in (0.0, E):
        episode = Episode(product.ARM, tracking_error=error)
        jumps(episode, np.random.default_rng(11))
        judge, q = episode.judge, np.array([step.q for step in episode.steps])
        worst = worst_of(judge, q, E)
        nearest[error] = judge.distances(worst).min()
        if error:
            assert_apart(judge, worst)
            room = np.minimum(q - judge.lower, judge.upper - q)
            assert room.min() >= E - ROUNDING
    assert nearest[E] < 0.05 and nearest[0.0] < product.SAFETY_DISTANCE - 1e-3


def test_how_far_the_robot_is_from_its_command_is_told(arm):
    q = arm.filter.rest + 0.05
    v = np.full(len(q), 0.1)
    arm.begin(q, v)
    lags = q.copy()
    lags[2] -= 0.03
    step = arm.filter.step(q + PERIOD * v, measured=(lags, v))
    np.testing.assert_array_equal(step.q, q + PERIOD * v)  # on its own command
    assert step.error == pytest.approx(0.03)
    assert step.error_joint == arm.filter.joints[2]


# --- mistakes -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "given, words",
    [
        ({}, ["q", "v"]),
        ({"q": np.zeros(7), "a": np.zeros(7)}, ["a"]),
        ({"q": np.zeros(6)}, ["q", "(6,)", "(7,)"]),
        ({"v": np.zeros((7, 1))}, ["v", "(7, 1)"]),
        ({"q": "up"}, ["q"]),
        ({"q": {"joint8": 0.0}}, ["joint8", "joint7"]),
        ({"q": {"joint1": None}}, ["joint1"]),
        ({"q": np.zeros(7), "measured": (np.zeros(7), np.zeros(3))}, ["measured"]),
    ],
)
def test_a_command_that_is_none_is_refused_and_changes_nothing(arm, given, words):
    arm.begin()
    with pytest.raises(product.mistake()) as caught:
        arm.filter.step(**given)
    for word in words:
        assert word in str(caught.value)
    assert arm.give(q=arm.filter.rest).passed


@pytest.mark.parametrize(
    "robot, period, chosen, words",
    [
        ("obstacle_amr", PERIOD, {}, ["obstacle_amr", product.ARM]),
        (product.ARM, 0.0, {}, ["period"]),
        (product.ARM, np.nan, {}, ["period"]),
        (product.ARM, 0.5, {}, ["period", "0.5"]),
        (product.ARM, PERIOD, {"tracking_error": 3.0}, ["tracking_error", "3"]),
        (product.ARM, PERIOD, {"speeds": {"joint9": 1.0}}, ["joint9"]),
        (product.ARM, PERIOD, {"speeds": {"joint1": -1.0}}, ["joint1", "-1"]),
    ],
)
def test_a_filter_that_cannot_be_made_says_why(robot, period, chosen, words):
    with pytest.raises(product.mistake()) as caught:
        product.JointFilter(robot, period, **chosen)
    for word in words:
        assert word in str(caught.value)


def test_a_start_without_numbers_is_refused(arm):
    with pytest.raises(product.mistake(), match=arm.filter.joints[1]):
        arm.filter.restart([0.0, np.nan, 0.0, 0.0, 0.0, 0.0, 0.0])
