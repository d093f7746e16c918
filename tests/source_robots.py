"""Positions of robots that were read from a file."""

import numpy as np

from crar_drake.robot_import.source_robot import SourceRobot


def random_positions(robot: SourceRobot) -> dict[str, float]:
    """Of the joints that move, within their limits; the same at every call."""
    rng = np.random.default_rng(7)
    return {
        joint.name: rng.uniform(max(joint.lower, -3.0), min(joint.upper, 3.0))
        for joint in robot.joints.values()
        if joint.moves
    }
