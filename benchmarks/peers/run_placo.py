"""PlaCo: its kinematics solver (velocities) and its dynamics solver (torques).

Both are C++ with a Python interface that is called once a step. `solver` in the
settings says which.
"""

from __future__ import annotations

import numpy as np
import placo

from benchmarks.peers.driver import Controller, NoAnswer, Problem, Targets, main

FLOATING_BASE = 6  # leading velocities of PlaCo's state


class Placo(Controller):
    """Settings: solver "kinematics" or "dynamics"; margin and trigger [m] of the
    self-collision constraint, hard or soft with a weight; and those of each solver."""

    packages = ("placo", "pin", "coal", "numpy")

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        self.period = period
        self.dynamics = settings["solver"] == "dynamics"
        self.commands = "acceleration" if self.dynamics else "velocity"
        self.robot = robot = placo.RobotWrapper(
            str(problem.folder / "robot_pinocchio.urdf")
        )
        assert list(robot.joint_names()) == problem.joints
        # Its own list of pairs, from collisions.json.
        robot.load_collision_pairs(str(problem.folder / "collisions.json"))
        self.solver = solver = (
            placo.DynamicsSolver(robot)
            if self.dynamics
            else placo.KinematicsSolver(robot)
        )
        solver.dt = period
        solver.mask_fbase(True)
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(settings["velocity_limits"])
        self.tasks = []
        for link in problem.links:
            task = solver.add_position_task(link, np.zeros(3))
            task.configure(link, "soft", 1.0)
            self.tasks.append(task)
        avoid = solver.add_avoid_self_collisions_constraint()
        avoid.self_collisions_margin = settings["margin"]
        avoid.self_collisions_trigger = settings["trigger"]
        avoid.configure("collisions", settings["priority"], settings["weight"])
        posture = solver.add_joints_task()
        posture.set_joints(dict(zip(problem.joints, problem.rest, strict=True)))
        posture.configure("posture", "soft", settings["posture"])
        if self.dynamics:
            robot.compute_jacobian_time_variation = True
            solver.enable_torque_limits(False)
            solver.torque_cost = settings["torque_cost"]
            for task in self.tasks:
                task.kp = settings["kp"]
                task.kd = 2.0 * np.sqrt(settings["kp"])
            posture.kp = settings["posture_kp"]
            posture.kd = 2.0 * np.sqrt(settings["posture_kp"])
            for joint in problem.joints:
                solver.set_qdd_safe(joint, settings["qdd_safe"])
        else:
            self.gain = settings["gain"]
            solver.add_regularization_task(settings["regularization"])
        self.links = problem.links

    def reset(self, q: np.ndarray) -> None:
        self.robot.reset()

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        robot, solver = self.robot, self.solver
        state_q, state_v = robot.state.q, robot.state.qd
        state_q[FLOATING_BASE + 1 :] = q
        state_v[FLOATING_BASE:] = v
        robot.state.q, robot.state.qd = state_q, state_v
        robot.update_kinematics()
        if self.dynamics:
            for i, task in enumerate(self.tasks):
                task.target_world = targets.p[i]
                task.dtarget_world = targets.v[i]
                task.ddtarget_world = targets.a[i]
            result = solver.solve()
            if not result.success:
                raise NoAnswer
            return result.qdd[FLOATING_BASE:]
        for i, (task, link) in enumerate(zip(self.tasks, self.links, strict=True)):
            # The task is met within one step: give it what one step should do.
            p = robot.get_T_world_frame(link)[:3, 3]
            wanted = targets.v_step[i] + self.gain * (targets.p[i] - p)
            task.target_world = p + self.period * wanted
        try:
            return solver.solve(False)[FLOATING_BASE:] / self.period
        except RuntimeError as error:
            raise NoAnswer from error


if __name__ == "__main__":
    main(Placo)
