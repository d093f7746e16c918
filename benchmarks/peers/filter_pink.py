"""Pink as a filter: reference joints and feet in, configurations out."""

from __future__ import annotations

import numpy as np
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import FrameTask, PostureTask

from benchmarks.peers.driver import Filter, main
from benchmarks.peers.run_pink import collision_barrier, robot_with_shapes, solved


class PinkFilter(Filter):
    """Settings: steps, barrier_gain, safe_displacement, collision_distance [m] and how
    many of the nearest pairs count; foot and foot_turn costs, a joint's is 1."""

    packages = ("pin-pink", "pin", "coal", "daqp", "qpsolvers", "numpy")

    def set_up(self, settings: dict) -> None:
        problem = self.problem
        self.configuration = configuration = robot_with_shapes(problem)
        model = configuration.model
        self.feet = [
            FrameTask(
                link,
                position_cost=settings["foot"],
                orientation_cost=settings["foot_turn"],
            )
            for link in problem.links
        ]
        self.posture = PostureTask(cost=1.0)
        self.limits = [
            ConfigurationLimit(model),
            VelocityLimit(model, problem.velocity_limits),
        ]
        self.barriers = [collision_barrier(settings["pairs"], settings)]

    def solve(self, q: np.ndarray, v: np.ndarray, targets: np.ndarray) -> np.ndarray:
        configuration = self.configuration
        configuration.update(targets)
        self.posture.set_target(targets)
        for task in self.feet:
            task.set_target_from_configuration(configuration)
        configuration.update(q)
        tasks = [self.posture, *self.feet]
        return solved(configuration, tasks, self.period, self.limits, self.barriers)


if __name__ == "__main__":
    main(PinkFilter)
