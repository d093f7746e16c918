"""Pink: velocities from a QP over Pinocchio, with its self-collision barrier."""

from __future__ import annotations

import numpy as np
import pink
import pinocchio
from pink.barriers import SelfCollisionBarrier
from pink.limits import AccelerationLimit, ConfigurationLimit, VelocityLimit
from pink.tasks import DampingTask, FrameTask, PostureTask

from benchmarks.peers.driver import Controller, NoAnswer, Problem, Targets, main


class Pink(Controller):
    """Settings: gain [1/s], posture and damping costs, barrier_gain,
    safe_displacement, collision_distance [m], acceleration_limit [rad/s^2] or null."""

    packages = ("pin-pink", "pin", "coal", "daqp", "qpsolvers", "numpy")

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        self.period, self.gain = period, settings["gain"]
        self.configuration = robot_with_shapes(problem)
        model = self.configuration.model
        self.frames = [
            FrameTask(
                link,
                position_cost=1.0,
                orientation_cost=0.0,
                gain=min(1.0, self.gain * period),
            )
            for link in problem.links
        ]
        posture = PostureTask(cost=settings["posture"])
        posture.set_target(problem.rest)
        self.tasks = [*self.frames, posture, DampingTask(cost=settings["damping"])]
        self.limits = [ConfigurationLimit(model)]
        if settings["velocity_limits"]:
            self.limits.append(VelocityLimit(model, problem.velocity_limits))
        self.acceleration_limit = None
        if settings["acceleration_limit"] is not None:
            largest = np.full(model.nv, settings["acceleration_limit"])
            self.acceleration_limit = AccelerationLimit(model, largest)
            self.limits.append(self.acceleration_limit)
        pairs = len(self.configuration.collision_model.collisionPairs)
        self.barriers = [collision_barrier(pairs, settings)]

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        configuration = self.configuration
        configuration.update(q)
        # As in run_mink.py: the feedforward shifts the target, and the present
        # orientation as target makes the pose error a position error.
        goals = targets.p + targets.v_step / self.gain
        for task, goal in zip(self.frames, goals, strict=True):
            pose = configuration.get_transform_frame_to_world(task.frame)
            task.set_target(pinocchio.SE3(pose.rotation, goal))
        if self.acceleration_limit is not None:
            self.acceleration_limit.set_last_integration(v, self.period)
        return solved(
            configuration, self.tasks, self.period, self.limits, self.barriers
        )


def collision_barrier(pairs: int, settings: dict) -> SelfCollisionBarrier:
    """Of so many of the nearest pairs, by the settings that runs and filters share."""
    return SelfCollisionBarrier(
        n_collision_pairs=pairs,
        gain=settings["barrier_gain"],
        safe_displacement_gain=settings["safe_displacement"],
        d_min=settings["collision_distance"],
    )


def solved(
    configuration: pink.Configuration,
    tasks: list,
    period: float,
    limits: list,
    barriers: list,
) -> np.ndarray:
    """(n,) velocities; raises NoAnswer."""
    try:
        return pink.solve_ik(
            configuration,
            tasks,
            period,
            "daqp",
            limits=limits,
            barriers=barriers,
            safety_break=False,
        )
    except pink.exceptions.NoSolutionFound as error:
        raise NoAnswer from error


def robot_with_shapes(problem: Problem) -> pink.Configuration:
    """The robot at rest, with its capsules and the watched pairs of them."""
    urdf = str(problem.folder / "robot_pinocchio.urdf")
    model = pinocchio.buildModelFromUrdf(urdf)
    assert list(model.names)[1:] == problem.joints
    geometry = pinocchio.buildGeomFromUrdf(
        model, urdf, pinocchio.GeometryType.COLLISION
    )
    shapes: dict[str, list[int]] = {}
    for i, shape in enumerate(geometry.geometryObjects):
        shapes.setdefault(model.frames[shape.parentFrame].name, []).append(i)
    for a, b in problem.pairs:
        for i in shapes[a]:
            for j in shapes[b]:
                geometry.addCollisionPair(pinocchio.CollisionPair(i, j))
    return pink.Configuration(
        model,
        model.createData(),
        problem.rest,
        collision_model=geometry,
        collision_data=pinocchio.GeometryData(geometry),
    )


if __name__ == "__main__":
    main(Pink)
