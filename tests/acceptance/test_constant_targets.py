"""Targets that stay where they are and can be reached: how many of twenty are.

Each is where a robot's points are in a random posture that is clear, and so is the
straight way of the joints there from the rest posture, where the robot begins. Of each
sort some are chosen that are not reached today, mostly since a joint comes to its limit
on the way: they show when that is mended. On the way nothing is violated.
"""

from itertools import islice

import numpy as np
import product
import pytest
import record
from tracking import PERIOD, WAY, Robot

COUNT = round(3.0 / PERIOD)  # of periods that it may take
REACHED = 1e-3  # [m], of all points

# Robot, points, seed, and which of the targets that it draws.
CASES = {
    "wrists": (product.BUILT_IN, product.points_of("wrists"), 0, (6, 14)),
    "seven": (product.BUILT_IN, product.points_of("seven"), 0, (4, 12)),
    "tool": (product.ARM, ["tool"], 0, (0, 4)),
}


@pytest.mark.parametrize("case", CASES)
def test_as_many_are_reached_as_ever(case):
    name, points, seed, which = CASES[case]
    robot, left = Robot(name, points), []
    for target in islice(reachable(robot, seed), *which):
        targets = np.zeros((COUNT, 3, *target.shape))
        targets[:, 0] = target
        errors, _ = robot.follow(targets)
        assert errors[0].max() > 10.0 * REACHED
        left.append(errors[-1].max())
    print(f"errors at the end [mm]: {np.round(1e3 * np.array(left), 2)}")
    reached = sum(error < REACHED for error in left)
    counts = {f"reached of {len(left)}": reached}
    record.assert_no_fewer("tracking", f"constant targets, {case}", counts)


def reachable(robot: Robot, seed: int):
    """Targets (P, 3) without end [m]."""
    rng = np.random.default_rng(seed)
    while True:
        (q,) = robot.postures(rng, 1)
        way = robot.rest + WAY[:, None] * (q - robot.rest)
        if robot.is_clear(robot.judge.distances(way)).all():
            yield robot.points(q[None])[0]
