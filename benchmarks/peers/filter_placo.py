"""PlaCo's kinematics solver as a filter: reference joints in, configurations out."""

from __future__ import annotations

import numpy as np
import placo

from benchmarks.peers.driver import Filter, NoAnswer, main
from benchmarks.peers.run_placo import FLOATING_BASE


class PlacoFilter(Filter):
    """Settings: steps; margin and trigger [m] of the self-collision constraint, hard or
    soft with a weight; foot and foot_turn weights, a joint's is 1."""

    packages = ("placo", "pin", "coal", "numpy")

    def set_up(self, settings: dict) -> None:
        problem = self.problem
        self.robot = robot = placo.RobotWrapper(
            str(problem.folder / "robot_pinocchio.urdf")
        )
        assert list(robot.joint_names()) == problem.joints
        robot.load_collision_pairs(str(problem.folder / "collisions.json"))
        self.solver = solver = placo.KinematicsSolver(robot)
        solver.dt = self.period
        solver.mask_fbase(True)
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        self.posture = solver.add_joints_task()
        self.posture.configure("posture", "soft", 1.0)
        self.feet = []
        for link in problem.links:
            task = solver.add_frame_task(link, np.eye(4))
            # Of squares: those of the others' costs.
            task.configure(
                link, "soft", settings["foot"] ** 2, settings["foot_turn"] ** 2
            )
            self.feet.append(task)
        avoid = solver.add_avoid_self_collisions_constraint()
        avoid.self_collisions_margin = settings["margin"]
        avoid.self_collisions_trigger = settings["trigger"]
        avoid.configure("collisions", settings["priority"], settings["weight"])

    def solve(self, q: np.ndarray, v: np.ndarray, targets: np.ndarray) -> np.ndarray:
        robot = self.robot
        self._put(targets)
        for task, link in zip(self.feet, self.problem.links, strict=True):
            task.T_world_frame = robot.get_T_world_frame(link)
        self.posture.set_joints(dict(zip(self.problem.joints, targets, strict=True)))
        self._put(q)
        try:
            return self.solver.solve(False)[FLOATING_BASE:] / self.period
        except RuntimeError as error:
            raise NoAnswer from error

    def _put(self, q: np.ndarray) -> None:
        state = self.robot.state.q
        state[FLOATING_BASE + 1 :] = q
        self.robot.state.q = state
        self.robot.update_kinematics()


if __name__ == "__main__":
    main(PlacoFilter)
