"""Whatever hands are asked for, a floor can give what standing takes.

The wrench that must hold the base is Drake's inverse dynamics of the robot's own file
with a base that floats. The floor gives forces inside friction cones at the corners of
the soles' hull, less a margin.
"""

from pathlib import Path

import numpy as np
import product
import pytest
from attacks import ATTACKS, Run, assert_nothing_is_violated, attack, judge_of
from judges import Ground, RobotJudge
from own_robots import standing_robot

PERIOD, COUNT = 5e-3, 120
TOO_MUCH = 1e-9  # [m], [1]


class Standing:
    """A robot on its feet, its judge, and the floor."""

    def __init__(self, robot: str | Path, points: list[str], stands: bool) -> None:
        self.robot, self.points, self.stands = robot, points, stands
        self.judge: RobotJudge = judge_of(robot, stands=stands)
        rest = self.law(balance=True).rest[None]
        soles = product.facts(robot).soles
        corners = [self.judge.link_points(s, c, rest)[0] for s, c in soles.items()]
        self.ground = Ground(
            np.concatenate(corners), product.GROUND_MARGIN, product.GROUND_FRICTION
        )

    def law(self, balance: bool) -> product.Law:
        return product.Law(
            *(self.robot, self.points),
            period=PERIOD,
            stands=self.stands,
            balance=balance,
        )

    def needs(self, found: Run) -> np.ndarray:
        """(N, 6) wrenches, at all instants and just before each next step."""
        last = slice(found.instants, None, found.instants)
        before = slice(found.instants - 1, -1, found.instants)
        each = [
            np.concatenate((found.q, found.q[last])),
            np.concatenate((found.v, found.v[last])),
            np.concatenate((found.a, found.a[before])),
        ]
        return self.judge.ground_wrenches(*each)


@pytest.fixture(scope="module", params=["on two soles", "on a frame"])
def standing(request, tmp_path_factory) -> Standing:
    if request.param == "on a frame":
        return Standing(product.TIPPING, product.points_of("wrists"), stands=False)
    robot, points = standing_robot(tmp_path_factory.mktemp("robot"))
    return Standing(robot, points, stands=True)


def test_whatever_is_asked_the_floor_can_give_it(standing):
    law, moved, nearest = standing.law(balance=True), 0.0, np.inf
    for number, kind in enumerate(ATTACKS):
        found = attack(law, standing.judge, kind, 30 + number, COUNT)
        assert_nothing_is_violated(standing.judge, law, found)
        wrenches = standing.needs(found)
        outside = standing.ground.outside(wrenches)
        assert outside.max() <= TOO_MUCH, f"{kind}: {1e3 * outside.max():.3f} mm"
        slopes = standing.ground.slopes(wrenches)
        assert slopes.max() <= standing.ground.friction + TOO_MUCH
        assert standing.ground.lacks(wrenches[::5]).max() <= TOO_MUCH
        moved = max(moved, np.abs(found.v).max())
        nearest = min(nearest, -outside.max())
    # A robot that does not dare to move would be safe, too.
    assert moved > 1.0 and nearest < 0.03


def test_without_balance_it_would_fall(standing):
    """So that the test above could fail."""
    found = attack(standing.law(balance=False), standing.judge, "swings", 31, COUNT)
    wrenches = standing.needs(found)
    assert standing.ground.outside(wrenches).max() > 0.02
    assert standing.ground.lacks(wrenches).max() > 1e-3
