"""Whatever a humanoid's hands are asked for, it touches nothing of itself.

The promise is of the exact loop; everything between two steps is judged, too.
"""

import numpy as np
import product
import pytest
from attacks import (
    ATTACKS,
    ROUNDING,
    assert_nothing_is_violated,
    assert_torques_are_kept,
    attack,
    judge_of,
)

# Period, and the plant's step: 0 if it is continuous [s].
PERIODS = [(1e-3, 1e-3), (2e-3, 0.0), (5e-3, 1e-3), (0.01, 0.0), (0.02, 1e-3)]
SECONDS = 0.8
MOST = 300  # periods of an episode


def steps_of(period: float) -> int:
    return min(MOST, round(SECONDS / period))


@pytest.mark.parametrize("motors", [True, False], ids=["motors", "no motors"])
@pytest.mark.parametrize("period, plant_step", PERIODS)
@pytest.mark.parametrize("points", ["wrists", "seven"])
def test_nothing_is_violated(points, period, plant_step, motors):
    robot = product.BUILT_IN
    judge = judge_of(robot, time_step=plant_step)
    law = product.Law(
        *(robot, product.points_of(points)),
        period=period,
        plant_step=plant_step,
        motors=motors,
    )
    nearest, fastest = np.inf, 0.0
    for number, kind in enumerate(ATTACKS):
        seed = 10 * round(1e3 * period) + number
        found = attack(law, judge, kind, seed, steps_of(period), plant_step=plant_step)
        assert_nothing_is_violated(judge, law, found)
        if motors:
            assert_torques_are_kept(judge, law, found, kind)
        nearest = min(nearest, judge.distances(found.q).min())
        fastest = max(fastest, np.abs(found.v).max())
        braking = {step.braking for step in found.steps}
        assert (True in braking) == (kind == "lost")
    # A robot that does not dare to move would violate nothing, too.
    assert nearest < 0.03 and fastest > 5.0


def test_without_its_constraints_it_is_violated():
    """So that the test above could fail: the paper's law without a projection."""
    judge = judge_of(product.BUILT_IN)
    points = product.points_of("wrists")
    law = product.Law(product.BUILT_IN, points, period=5e-3, paper="acceleration")
    found = attack(law, judge, "teleports", 1, 200)
    assert judge.distances(found.q).min() < -0.01
    with pytest.raises(AssertionError, match=r"mm in state"):
        assert_nothing_is_violated(judge, law, found)


def test_it_comes_to_rest_wherever_targets_are_lost():
    """At full speed, with all watched pairs apart until it rests."""
    judge = judge_of(product.BUILT_IN)
    points = product.points_of("wrists")
    law = product.Law(product.BUILT_IN, points, period=5e-3)
    rng = np.random.default_rng(3)
    for episode in range(6):
        moving = attack(law, judge, "swings", 100 + episode, 40 + 7 * episode)
        q, v = moving.q[-1], moving.v[-1]
        away = np.full(law.home.shape, rng.choice([np.nan, np.inf]))
        followed = []
        for _ in range(200):
            step = law.step(q, v, away)
            assert step.braking
            q, v = step.next_q, step.next_v
            followed.append(q)
        assert np.abs(v).max() < 1e-3
        d = judge.distances(np.array(followed))
        assert d.min() >= product.SAFETY_DISTANCE - ROUNDING
