"""PlaCo's dynamics solver with planar contacts at both feet (C++, one call a step)."""

from __future__ import annotations

import numpy as np
import placo

from benchmarks.peers.driver import NoAnswer, Targets, main
from benchmarks.peers.floating import Floating, from_pinocchio, to_pinocchio


class Placo(Floating):
    """Settings besides: kp of the wrists [1/s^2]; com, weight of the centre of mass;
    posture, weight of the rest posture; collisions, whether it keeps pairs apart."""

    packages = ("placo", "pin", "numpy")

    def set_up(self, settings: dict) -> None:
        problem, standing = self.problem, self.standing
        self.robot = robot = placo.RobotWrapper(
            str(problem.folder / "robot_pinocchio.urdf")
        )
        robot.load_collision_pairs(str(problem.folder / "collisions.json"))
        names = list(robot.joint_names())
        self.order = [problem.joints.index(name) for name in names]
        self.back = np.argsort(self.order)
        self._place(*self.rest())
        self.solver = solver = placo.DynamicsSolver(robot)
        solver.dt = self.period
        robot.compute_jacobian_time_variation = True
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        solver.enable_torque_limits(True)
        solver.torque_cost = 1e-6
        for joint in names:
            solver.set_qdd_safe(joint, 20.0)
        for sole in standing["soles"]:
            at = robot.get_T_world_frame(sole["frame"])
            foot = solver.add_frame_task(sole["frame"], at)
            foot.configure(sole["frame"], "hard", 1.0, 1.0)
            contact = solver.add_planar_contact(foot)
            contact.mu = self.pyramid
            contact.length = sole["length"] - 2.0 * settings["inside"]
            contact.width = sole["width"] - 2.0 * settings["inside"]
        self.wrists = []
        for link in problem.links:
            task = solver.add_position_task(link, np.zeros(3))
            task.configure(link, "soft", 1.0)
            self._gains(task, settings["kp"])
            self.wrists.append(task)
        com = solver.add_com_task(robot.com_world())
        com.configure("com", "soft", settings["com"])
        self._gains(com, 100.0)
        trunk = solver.add_orientation_task(problem.base, np.eye(3))
        trunk.configure("trunk", "soft", 0.1)
        self._gains(trunk, 100.0)
        posture = solver.add_joints_task()
        posture.set_joints(dict(zip(problem.joints, problem.rest, strict=True)))
        posture.configure("posture", "soft", settings["posture"])
        self._gains(posture, 100.0)
        if settings["collisions"]:
            avoid = solver.add_avoid_self_collisions_constraint()
            avoid.self_collisions_margin = 0.005
            avoid.self_collisions_trigger = 0.1
            avoid.configure("collisions", "hard", 1.0)

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        self._place(q, v)
        for i, task in enumerate(self.wrists):
            task.target_world = targets.p[i]
            task.dtarget_world = targets.v[i]
            task.ddtarget_world = targets.a[i]
        try:
            result = self.solver.solve()
        except RuntimeError as error:
            raise NoAnswer from error
        if not result.success:
            raise NoAnswer
        a = np.array(result.qdd)
        a[6:] = a[6:][self.back]
        return from_pinocchio(q, v, a)

    def _place(self, q: np.ndarray, v: np.ndarray) -> None:
        at, speed = to_pinocchio(q, v)
        at[7:], speed[6:] = at[7:][self.order], speed[6:][self.order]
        self.robot.state.q, self.robot.state.qd = at, speed
        self.robot.update_kinematics()

    @staticmethod
    def _gains(task, kp: float) -> None:
        task.kp, task.kd = kp, 2.0 * np.sqrt(kp)


if __name__ == "__main__":
    main(Placo)
