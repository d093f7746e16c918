"""How closely and how calmly points follow persons, and hands that are to cross.

Errors are distances of points from their targets. Nothing is violated on the way.
"""

import numpy as np
import product
import pytest
import record
from tracking import PERIOD, WAY, Robot

LEAD = 1.0  # not judged: the robot gets there from its rest posture [s]
SECONDS = LEAD + 5.0
TIME = PERIOD * np.arange(round(SECONDS / PERIOD))
# Recordings, and from when on they are followed [s].
CLIPS = {"05_02": 1.0, "13_17": 18.0, "13_29": 14.0, "14_07": 9.0}
UNNOTICED = {"mm": 0.02}

DEEPEST = 0.1  # of hands in one another, halfway of a crossing [m]
SHALLOWEST = 0.01
FASTEST = 4.0  # joint of a crossing [rad/s]
STEP = 1e-3  # of differences in time [s]


@pytest.mark.parametrize("points", ["wrists", "seven"])
@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.usefixtures("mocap")
def test_a_person_is_followed(tmp_path, clip, points):
    robot = Robot(product.BUILT_IN, product.points_of(points))
    given = product.persons_targets(clip, points, tmp_path, CLIPS[clip] + TIME)
    assert_followed(f"{clip}, {points}", robot, *given)


@pytest.mark.parametrize("seed", [2, 5])
def test_hands_that_are_to_cross(seed):
    robot = Robot(product.BUILT_IN, product.points_of("wrists"))
    assert_followed(f"hands {seed}", robot, crossing(robot, seed, "left", "right"))


@pytest.mark.parametrize("seed", [4, 6])
def test_an_arm_that_is_to_go_through_a_post(seed):
    robot = Robot(product.ARM, ["tool"])
    assert_followed(f"arm {seed}", robot, crossing(robot, seed, "arm", "post"))


@pytest.mark.parametrize("seed", [0, 4])
def test_hands_of_a_real_humanoid_that_are_to_cross(humanoid, seed):
    robot = Robot(humanoid, product.points_of("wrists"), stands=True)
    assert_followed(f"humanoid {seed}", robot, crossing(robot, seed, "left", "right"))


def assert_followed(
    name: str,
    robot: Robot,
    targets: np.ndarray,
    prescribed: np.ndarray | None = None,
) -> None:
    """No worse than it is recorded; the targets move."""
    errors, found = robot.follow(targets, prescribed)
    judged = slice(round(LEAD / PERIOD), None)
    assert np.linalg.norm(targets[judged, 1], axis=2).mean() > 0.1
    a = np.array([step.a for step in found.steps])[judged, robot.law.controlled]
    figures = {
        "mean error mm": 1e3 * errors[judged].mean(),
        "rms acceleration rad/s2": np.sqrt(np.mean(a**2)),
    }
    record.assert_no_worse("tracking", name, figures, UNNOTICED)


def crossing(robot: Robot, seed: int, this: str, that: str) -> np.ndarray:
    """Targets that lead links of this through links of that; they begin at rest.

    They are where the points were if the joints went from a posture where such links
    are in each other to one that is clear, back, to another one, and so on.
    """
    rng = np.random.default_rng(seed)
    through, ends = crossed_postures(robot, rng, this, that)
    # No joint is faster than 1.16 omega times its way.
    fastest = 1.16 * np.abs(ends - through).max()
    omega = min(2.0 * np.pi * rng.uniform(0.4, 1.2), FASTEST / fastest)

    def at(time: np.ndarray) -> np.ndarray:
        x = np.clip(time[:, None] / LEAD, 0.0, 1.0)
        begun = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        swing = np.sin(omega * time)[:, None]
        away = np.where(swing > 0.0, *ends) - through
        q = through + np.abs(swing) ** 3 * away
        return robot.points(robot.rest + begun * (q - robot.rest))

    before, now, after = (at(TIME + h) for h in (-STEP, 0.0, STEP))
    rates = (after - before) / (2.0 * STEP)
    return np.stack([now, rates, (after - 2.0 * now + before) / STEP**2], axis=1)


def crossed_postures(
    robot: Robot, rng: np.random.Generator, this: str, that: str
) -> tuple[np.ndarray, np.ndarray]:
    """A posture (n,) where a link of this is in one of that, and two (2, n) that are
    clear; nothing is deep in anything on the straight ways between."""
    meet = [
        (this in a and that in b) or (that in a and this in b)
        for a, b in robot.judge.pairs
    ]
    inside, clear = [], []
    while True:
        q = robot.postures(rng, 1000)
        far = robot.judge.distances(q)
        clear += list(q[robot.is_clear(far)])
        inside += list(q[far[:, meet].min(axis=1) < -SHALLOWEST])
        while inside and len(clear) > 1:
            through, ends = inside.pop(), rng.choice(clear, 2, replace=False)
            ways = through + WAY[:, None, None] * (ends - through)
            far = robot.judge.distances(ways.reshape(-1, len(through)))
            if far.min() > -DEEPEST:
                return through, ends
