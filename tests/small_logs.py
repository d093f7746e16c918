"""A small log with round numbers, for tests of what is made of logs."""

from dataclasses import replace

import numpy as np

from crar_drake.results.log import SimulationLog

SCENARIO = """
description: a test
motion: some/waltz.amc
experiment: wrists
controller: {level: velocity, constraints: none, period: 0.5}
"""


def small_log(**changes) -> SimulationLog:
    """Three samples of a rail (prescribed) and two controlled joints, swing and turn.

    The actuators are in another order than the joints; turn has no limits. A hand
    has a position task, a tool a pose task; two pairs are watched.
    """
    log = SimulationLog(
        time=np.array([0.0, 0.5, 1.0]),
        q=np.array([[9.0, 0.5, 0.0], [9.0, 1.25, 7.0], [9.0, 1.0, 14.0]]),
        v=np.array([[5.0, 1.0, 2.0], [5.0, -2.0, 0.0], [5.0, 0.0, 4.0]]),
        # turn, rail, swing
        actuation=np.array([[3.0, 900.0, 10.0], [5.0, 900.0, -30.0], [-8.0, 900, 1.0]]),
        desired_acceleration=np.array(
            [[70.0, 1.0, 2.0], [70.0, 3.0, 1.0], [70.0, 0.0, -3.0]]
        ),
        desired_tasks=np.zeros((3, 28)),
        task_error=np.array(
            [
                # hand [m]; tool [rad], [m]
                [0.003, 0.004, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, -0.012, 0.0],
                [0.0, 0.0, 0.0, 0.0, 0.0, -0.2, 0.003, 0.0, 0.004],
            ]
        ),
        signed_distances=np.array([[0.2, 0.1], [0.05, -0.01], [-0.03, -0.02]]),
        constraint_weights=np.ones((3, 2)),
        status=np.zeros((3, 1)),
        admission=np.full((3, 4), np.nan),
        balance=np.full((3, 3), np.nan),
        torque_limit=np.array([[1.0, 0.0], [0.4, 0.0], [0.0, 0.25]]),
        obstacles=np.empty((3, 0)),
        position_names=np.array(["rail", "swing", "turn"]),
        velocity_names=np.array(["rail", "swing", "turn"]),
        actuator_names=np.array(["turn", "rail", "swing"]),
        controlled_names=np.array(["swing", "turn"]),
        controlled_units=np.array(["rad", "rad"]),
        task_names=np.array(["hand", "tool"]),
        task_kinds=np.array(["position", "pose"]),
        pair_names=np.array(["left - right", "hand - torso"]),
        lower=np.array([-np.inf, -1.0, -np.inf]),
        upper=np.array([np.inf, 1.0, np.inf]),
        velocity_limits=np.array([np.inf, 2.0, np.inf]),
        effort_limits=np.array([10.0, np.inf, 40.0]),
        scenario=SCENARIO,
    )
    return replace(log, **changes)
