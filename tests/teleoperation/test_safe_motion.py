"""What the filter commands of a robot whose root floats."""

import json

import numpy as np
import pytest
from floating_robots import make_floater, root_entries

from crar_drake.control.parameters import CrarParameters
from crar_drake.teleoperation.safe_motion import SafeMotion
from crar_drake.teleoperation.server import TeleoperationServer

PERIOD = 1e-2


@pytest.fixture(scope="module")
def motion() -> SafeMotion:
    model = make_floater(time_step=PERIOD)
    return SafeMotion(model, CrarParameters(period=PERIOD))


def test_the_root_stands_still_while_the_hands_move(motion: SafeMotion) -> None:
    at, by = root_entries(motion.model)
    rest, aim = motion.q.copy(), motion.q.copy()
    aim[motion.model.controlled_positions] = [0.2, -0.4, 0.5, 0.2, 0.4, -0.5]
    there = motion.model.tasks_at(aim)
    assert np.abs(there - motion.where()).max() > 0.1
    for _ in range(120):
        solution = motion.advance(there)
    assert np.abs(solution.task_error).max() < 0.01
    assert np.abs(motion.q - rest).max() > 0.05
    np.testing.assert_allclose(motion.q[at], rest[at], atol=1e-12)
    np.testing.assert_array_equal(motion.v[by], 0.0)


def test_positions_and_velocities_have_names_of_their_own(motion: SafeMotion) -> None:
    server = TeleoperationServer(motion)
    try:
        said = json.loads(server._description())
    finally:
        server.close()
    assert len(said["positions"]) == len(motion.q) == 13
    assert len(said["velocities"]) == len(motion.v) == 12
    assert said["velocities"][0] == "body.wx" and said["positions"][0] == "body.qw"
