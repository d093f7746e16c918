"""Whoever drives the hands of a robot that stands: it stays balanced."""

import numpy as np
from standing_robots import standing_robot

from crar_drake.teleoperation.serving import make_server

SCENARIO = """robot: {folder}
tasks: [{{frame: hand}}]
keyframes: {{hand: [{{time: 0.0, xyz: [0.4, 0.0, 0.8]}}]}}
standing: {{friction: 0.8}}
controller: {{braking_time: 0.1, balance: {{}}}}
"""


def test_a_scenario_that_stands_is_served_on_its_feet(tmp_path):
    standing_robot(tmp_path / "stander")
    path = tmp_path / "scenario.yaml"
    path.write_text(SCENARIO.format(folder=tmp_path / "stander"))
    server = make_server(str(path), rate=100.0)
    try:
        motion = server.motion
        assert not motion.model.floats
        tasks = motion.where().copy()
        tasks[:3] += [0.3, 0.3, 0.2]
        hows, start = set(), motion.q.copy()
        for _ in range(100):
            solution = motion.law.step(
                motion.q, motion.v, tasks, motion.model.prescribed_at(start)
            )
            hows.add(solution.balance[0])
            motion.q = motion.q + 0.01 * motion.v + 1e-4 * solution.acceleration
            motion.v = motion.v + 0.01 * solution.acceleration
        assert {0.0, 1.0} & hows and np.abs(motion.q - start).max() > 0.05
    finally:
        server.close()
