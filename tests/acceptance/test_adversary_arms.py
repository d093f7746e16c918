"""Whatever an arm beside a post or an odd robot is asked for, nothing is touched.

As in `test_adversary_humanoid`; posts stand in the way, and one of them is moved by
somebody else, as the law is told.
"""

import numpy as np
import product
import pytest
from attacks import (
    ATTACKS,
    assert_apart,
    assert_nothing_is_violated,
    assert_torques_are_kept,
    attack,
    judge_of,
    worst_of,
)
from own_robots import odd_robot

PERIODS = [(1e-3, 0.0), (2e-3, 1e-3), (5e-3, 0.0), (0.01, 1e-3), (0.02, 0.0)]
# Seeds of robots that come near to themselves and to posts, each at one period.
ODD = [(seed, *PERIODS[i % 5]) for i, seed in enumerate((0, 12, 2, 10, 4, 30, 31, 7))]
MOST = 200  # periods of an episode


@pytest.mark.parametrize("motors", [True, False], ids=["motors", "no motors"])
@pytest.mark.parametrize("period, plant_step", PERIODS)
def test_an_arm_keeps_off_the_post_and_itself(period, plant_step, motors):
    judge = judge_of(product.ARM, time_step=plant_step)
    law = product.Law(
        product.ARM, ["tool"], period=period, plant_step=plant_step, motors=motors
    )
    nearest, fastest = np.inf, 0.0
    for number, kind in enumerate(ATTACKS):
        seed = 20 * round(1e3 * period) + number
        count = min(300, round(1.0 / period))
        found = attack(law, judge, kind, seed, count, plant_step=plant_step)
        assert_nothing_is_violated(judge, law, found)
        if motors:
            assert_torques_are_kept(judge, law, found, kind)
        nearest = min(nearest, judge.distances(found.q).min())
        fastest = max(fastest, (np.abs(found.v) / judge.speeds).max())
    assert nearest < 0.1 and fastest > 0.9


@pytest.mark.parametrize("motors", [True, False], ids=["motors", "no motors"])
@pytest.mark.parametrize("seed, period, plant_step", ODD)
def test_an_odd_robot_touches_nothing(tmp_path, seed, period, plant_step, motors):
    robot, points = odd_robot(tmp_path, seed)
    judge = judge_of(robot, time_step=plant_step)
    law = product.Law(
        robot, points, period=period, plant_step=plant_step, motors=motors
    )
    moved = swinging_post(law, period, MOST, seed)
    fastest = 0.0
    for kind in ATTACKS:
        found = attack(
            *(law, judge, kind, seed, MOST), plant_step=plant_step, prescribed=moved
        )
        assert_nothing_is_violated(judge, law, found)
        fastest = max(fastest, np.abs(found.v[:, law.controlled]).max())
    assert fastest > 0.3


def swinging_post(law: product.Law, period: float, count: int, seed: int) -> np.ndarray:
    """(count, 3, 1) positions, velocities and accelerations of the post that is moved,
    as the law's exact loop can follow them."""
    omega = 2.0 * np.pi * np.random.default_rng(seed).uniform(0.5, 2.0)
    t, size = period * np.arange(count), 0.1
    sine, cosine = size * np.sin(omega * t), size * np.cos(omega * t)
    motion = np.array([sine, omega * cosine, -(omega**2) * sine]).T
    return motion[:, :, None]


def test_a_robot_that_errs_by_its_bound_keeps_the_distance():
    """In the worst direction of the nearest pairs, by finite differences; told of no
    error, the same robot comes nearer."""
    E = 0.01
    judge = judge_of(product.ARM)
    smallest = {}
    for error in (0.0, E):
        law = product.Law(
            product.ARM, ["tool"], period=5e-3, motors=False, tracking_error=error
        )
        least = np.inf
        for seed in (2, 3):
            found = attack(law, judge, "teleports", seed, 250)
            worst = worst_of(judge, found.q[:: found.instants], E)
            least = min(least, judge.distances(worst).min())
            if error:
                assert_apart(judge, worst)
                room = np.minimum(found.q - judge.lower, judge.upper - found.q)
                assert room.min() >= E - 1e-9
        smallest[error] = least
    assert smallest[E] < 0.05 and smallest[0.0] < product.SAFETY_DISTANCE - 1e-3
