"""embodik: prioritised velocities over Pinocchio, all in C++, with its constraint of
collisions; called from Python once a step."""

from __future__ import annotations

import embodik
import numpy as np

from benchmarks.peers.driver import Controller, NoAnswer, Problem, Targets, main


class Embodik(Controller):
    """Settings: gain [1/s] of the tasks, posture weight [1/s], damping, tolerance of
    its pseudoinverse, mode of its tasks, margin [m], constraints (rows at most), and
    recovery: the share of the way out that it asks for inside the margin."""

    packages = ("embodik", "numpy")

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        self.gain = settings["gain"]
        self.robot = robot = embodik.RobotModel(
            str(problem.folder / "robot_pinocchio.urdf")
        )
        assert list(robot.get_joint_names()) == problem.joints
        self.solver = solver = embodik.KinematicsSolver(robot)
        solver.dt = period
        solver.enable_position_limits(True)
        solver.enable_velocity_limits(True)
        solver.enable_acceleration_limits(False)
        solver.set_damping(settings["damping"])
        solver.set_tolerance(settings["tolerance"])
        mode = getattr(embodik.TaskSolveMode, settings["mode"])
        self.tasks = []
        for link in problem.links:
            task = solver.add_frame_task(link, link, embodik.TaskType.FRAME_POSITION)
            task.priority, task.weight, task.solve_mode = 0, self.gain, mode
            self.tasks.append(task)
        posture = solver.add_posture_task("posture")
        posture.set_target_configuration(problem.rest)
        posture.priority, posture.weight = 1, settings["posture"]
        posture.solve_mode = embodik.TaskSolveMode.MIN_ERROR
        shapes: dict[str, list[str]] = {}
        for shape in robot.get_collision_geometries():
            shapes.setdefault(shape["parent_frame"], []).append(shape["name"])
        solver.configure_collision_constraint(
            settings["margin"],
            [
                (one, other)
                for a, b in problem.pairs
                for one in shapes[a]
                for other in shapes[b]
            ],
            max_constraints=settings["constraints"],
        )
        tuning = getattr(embodik.CollisionTuningMode, settings["tuning"])
        solver.set_collision_tuning_mode(tuning)
        solver.set_collision_recovery_scale(settings["recovery"])

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        # As in run_mink.py: the feedforward shifts the target.
        goals = targets.p + targets.v_step / self.gain
        for task, goal in zip(self.tasks, goals, strict=True):
            task.set_target_position(goal)
        result = self.solver.solve_velocity(q)
        # What a failed solve leaves behind is no command.
        if result.status != embodik.SolverStatus.SUCCESS:
            raise NoAnswer
        return result.joint_velocities


if __name__ == "__main__":
    main(Embodik)
