"""mink: velocities from a QP over MuJoCo's kinematics, with its collision limit."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import mujoco
import numpy as np

from benchmarks.peers.driver import Controller, NoAnswer, Problem, Targets, main


class Mink(Controller):
    """Settings: gain [1/s], posture and damping costs, collision_gain,
    collision_distance, detection_distance and relaxation of the bound [m]."""

    packages = ("mink", "mujoco", "daqp", "qpsolvers", "numpy")

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        self.period, self.gain = period, settings["gain"]
        model = load_model(problem)
        self.configuration = mink.Configuration(model)
        self.tasks = [
            mink.FrameTask(
                link,
                "site",
                position_cost=1.0,
                orientation_cost=0.0,
                gain=min(1.0, self.gain * period),
            )
            for link in problem.links
        ]
        self.posture = mink.PostureTask(model, cost=settings["posture"])
        self.posture.set_target(problem.rest)
        self.damping = mink.DampingTask(model, cost=settings["damping"])
        self.limits = [
            mink.ConfigurationLimit(model),
            collision_limit(model, problem, settings),
        ]
        if settings["velocity_limits"]:
            limits = zip(problem.joints, problem.velocity_limits, strict=True)
            self.limits.append(mink.VelocityLimit(model, dict(limits)))

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        configuration = self.configuration
        configuration.update(q)
        # The task's law is gain * (target - p): shifted by the feedforward. It is a
        # pose error; with the present orientation as target, a position error.
        goals = targets.p + targets.v_step / self.gain
        for task, goal in zip(self.tasks, goals, strict=True):
            pose = configuration.get_transform_frame_to_world(task.frame_name, "site")
            task.set_target(
                mink.SE3.from_rotation_and_translation(pose.rotation(), goal)
            )
        tasks = [*self.tasks, self.posture, self.damping]
        return solved(configuration, tasks, self.period, self.limits)


def load_model(problem: Problem) -> mujoco.MjModel:
    """The robot with its capsules."""
    model = mujoco.MjModel.from_xml_path(str(problem.folder / "robot_mujoco.xml"))
    assert [model.joint(i).name for i in range(model.nq)] == problem.joints
    return model


def geoms_of(model: mujoco.MjModel) -> dict[str, list[str]]:
    """Link to its geoms."""
    geoms: dict[str, list[str]] = {}
    for i in range(model.ngeom):
        body = model.body(model.geom_bodyid[i]).name
        geoms.setdefault(body, []).append(model.geom(i).name)
    return geoms


def collision_limit(
    model: mujoco.MjModel,
    problem: Problem,
    settings: dict,
    others: Sequence[tuple[list[str], list[str]]] = (),
) -> mink.CollisionAvoidanceLimit:
    """Of the watched pairs, and of other pairs of geoms, by the settings that runs and
    filters share."""
    geoms = geoms_of(model)
    return mink.CollisionAvoidanceLimit(
        model,
        [*((geoms[a], geoms[b]) for a, b in problem.pairs), *others],
        gain=settings["collision_gain"],
        minimum_distance_from_collisions=settings["collision_distance"],
        collision_detection_distance=settings["detection_distance"],
        bound_relaxation=settings["relaxation"],
    )


def solved(
    configuration: mink.Configuration, tasks: list, period: float, limits: list
) -> np.ndarray:
    """(n,) velocities; raises NoAnswer."""
    try:
        return mink.solve_ik(configuration, tasks, period, "daqp", limits=limits)
    except mink.NoSolutionFound as error:
        raise NoAnswer from error


if __name__ == "__main__":
    main(Mink)
