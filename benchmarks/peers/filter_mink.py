"""mink as a filter: reference joints and feet in, configurations out."""

from __future__ import annotations

import mink
import numpy as np

from benchmarks.peers.driver import Filter, main
from benchmarks.peers.run_mink import collision_limit, load_model, solved


class MinkFilter(Filter):
    """Settings: steps, collision_gain, collision_distance, detection_distance and
    relaxation of the bound [m]; foot and foot_turn costs, a joint's is 1."""

    packages = ("mink", "mujoco", "daqp", "qpsolvers", "numpy")

    def set_up(self, settings: dict) -> None:
        problem = self.problem
        model = load_model(problem)
        self.configuration = mink.Configuration(model)
        self.feet = [
            mink.FrameTask(
                link,
                "site",
                position_cost=settings["foot"],
                orientation_cost=settings["foot_turn"],
            )
            for link in problem.links
        ]
        self.posture = mink.PostureTask(model, cost=1.0)
        limits = dict(zip(problem.joints, problem.velocity_limits, strict=True))
        self.limits = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, limits),
            collision_limit(model, problem, settings),
        ]

    def solve(self, q: np.ndarray, v: np.ndarray, targets: np.ndarray) -> np.ndarray:
        configuration = self.configuration
        configuration.update(targets)
        self.posture.set_target(targets)
        for task in self.feet:
            task.set_target_from_configuration(configuration)
        configuration.update(q)
        tasks = [self.posture, *self.feet]
        return solved(configuration, tasks, self.period, self.limits)


if __name__ == "__main__":
    main(MinkFilter)
