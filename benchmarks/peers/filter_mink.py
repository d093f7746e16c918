"""mink as a filter: reference joints and feet in, configurations out."""

from __future__ import annotations

import mink
import mujoco
import numpy as np

from benchmarks.peers.driver import Filter, NoAnswer, main


class MinkFilter(Filter):
    """Settings: steps, collision_gain, collision_distance, detection_distance and
    relaxation of the bound [m]; foot and foot_turn costs, a joint's is 1."""

    packages = ("mink", "mujoco", "daqp", "qpsolvers", "numpy")

    def set_up(self, settings: dict) -> None:
        problem = self.problem
        model = mujoco.MjModel.from_xml_path(str(problem.folder / "robot_mujoco.xml"))
        assert [model.joint(i).name for i in range(model.nq)] == problem.joints
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
        geoms: dict[str, list[str]] = {}
        for i in range(model.ngeom):
            body = model.body(model.geom_bodyid[i]).name
            geoms.setdefault(body, []).append(model.geom(i).name)
        limits = dict(zip(problem.joints, problem.velocity_limits, strict=True))
        self.limits = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, limits),
            mink.CollisionAvoidanceLimit(
                model,
                [(geoms[a], geoms[b]) for a, b in problem.pairs],
                gain=settings["collision_gain"],
                minimum_distance_from_collisions=settings["collision_distance"],
                collision_detection_distance=settings["detection_distance"],
                bound_relaxation=settings["relaxation"],
            ),
        ]

    def solve(self, q: np.ndarray, v: np.ndarray, targets: np.ndarray) -> np.ndarray:
        configuration = self.configuration
        configuration.update(targets)
        self.posture.set_target(targets)
        for task in self.feet:
            task.set_target_from_configuration(configuration)
        configuration.update(q)
        try:
            return mink.solve_ik(
                configuration,
                [self.posture, *self.feet],
                self.period,
                "daqp",
                limits=self.limits,
            )
        except mink.NoSolutionFound as error:
            raise NoAnswer from error


if __name__ == "__main__":
    main(MinkFilter)
