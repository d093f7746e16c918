"""mink per frame: where a person's points are in, a robot's root and joints out.

The frames are solved one after the other, each from the one before, by a few
Gauss-Newton steps: what most retargeting does. Imports NumPy and mink only.

    python -m benchmarks.peers.retarget_mink FOLDER \
        '[{"case": "x.npz", "settings": {"collisions": true, ...}, "out": "y.npz"}]'
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import mink
import mujoco
import numpy as np

from benchmarks.peers.driver import Problem
from benchmarks.peers.run_mink import collision_limit

ROOT = "root"
_FIRST = 50  # steps of the first frame


def main() -> None:
    folder, cases = Path(sys.argv[1]), json.loads(sys.argv[2])
    problem = Problem(folder)
    for case in cases:
        data = dict(np.load(folder / case["case"]))
        np.savez(folder / case["out"], **retarget(problem, data, case["settings"]))


def retarget(problem: Problem, data: dict, settings: dict) -> dict[str, np.ndarray]:
    """The motion.

    Args:
        problem: the robot, with its root free.
        data: points (T, P, 3) where the problem's links are to be [m], costs (P,);
            root_positions (T, 3) [m], root_quaternions (T, 4) w x y z.
        settings: stages, those of GMR's law; or steps per frame, the costs root, turn,
            posture, and lm_damping; and of the bound of distances, if `collisions`,
            those of `collision_limit`.

    Returns:
        qpos (T, 7 + n), seconds of a processor, and the number of frames without an
        answer.
    """
    model = mujoco.MjModel.from_xml_path(str(problem.folder / "robot_mujoco.xml"))
    configuration = mink.Configuration(model)
    damping = {"lm_damping": settings["lm_damping"]}
    points = [
        mink.FrameTask(link, "site", cost, 0.0, **damping)
        for link, cost in zip(problem.links, data["costs"], strict=True)
    ]
    root = mink.FrameTask(
        problem.base, "body", settings["root"], settings["turn"], **damping
    )
    posture = mink.PostureTask(model, cost=settings["posture"])
    q = np.concatenate(
        [data["root_positions"][0], data["root_quaternions"][0], problem.rest]
    )
    posture.set_target(q)
    limits = [mink.ConfigurationLimit(model)]
    if settings["collisions"]:
        limits.append(collision_limit(model, problem, settings))
    tasks = [root, *points, posture]
    identity = mink.SO3.identity()
    configuration.update(q)
    made, unsolved, began = [], 0, time.process_time()
    stages = [Stage(model, problem, data, one) for one in settings.get("stages", ())]
    for k in range(len(data["points"])):
        if stages:
            for stage in stages:
                stage.aim(k)
                unsolved += not stage.solve(configuration)
            made.append(configuration.q.copy())
            continue
        turn = mink.SO3(data["root_quaternions"][k])
        root.set_target(
            mink.SE3.from_rotation_and_translation(turn, data["root_positions"][k])
        )
        for task, p in zip(points, data["points"][k], strict=True):
            task.set_target(mink.SE3.from_rotation_and_translation(identity, p))
        for _ in range(settings["steps"] if k else _FIRST):
            try:
                step = mink.solve_ik(configuration, tasks, 1.0, "daqp", limits=limits)
            except mink.NoSolutionFound:
                unsolved += 1
                break
            configuration.integrate_inplace(step, 1.0)
            if np.abs(step).max() < settings["enough"]:
                break
        made.append(configuration.q.copy())
    return {
        "qpos": np.array(made),
        "seconds": np.array(time.process_time() - began),
        "unsolved": np.array(unsolved),
    }


class Stage:
    """One of the two problems that GMR solves of each frame, one after the other: the
    turns of links with where the feet are, and then where all points are besides.

    Its law is that of https://github.com/YanjieZe/GMR, `motion_retarget.py`, written
    anew: damping 0.5 and Levenberg-Marquardt damping 1, joint limits, and at most
    eleven steps, until the errors fall by no more than 1e-3.
    """

    DAMPING, LM_DAMPING, STEPS, ENOUGH = 0.5, 1.0, 11, 1e-3

    def __init__(
        self, model: mujoco.MjModel, problem: Problem, data: dict, costs: dict
    ) -> None:
        """
        Args:
            model: MuJoCo's.
            problem: the robot, with its root free.
            data: as of `retarget`, with link_names (L,) and link_quaternions (T, L, 4).
            costs: root, turn of the root; points, as many; links, as many.
        """
        self.data, self.dt = data, model.opt.timestep
        damping = {"lm_damping": self.LM_DAMPING}
        self.root = mink.FrameTask(
            problem.base, "body", costs["root"], costs["turn"], **damping
        )
        self.points = [
            (i, mink.FrameTask(link, "site", cost, 0.0, **damping))
            for i, (link, cost) in enumerate(
                zip(problem.links, costs["points"], strict=True)
            )
            if cost
        ]
        self.links = [
            mink.FrameTask(str(link), "body", 0.0, cost, **damping)
            for link, cost in zip(data["link_names"], costs["links"], strict=True)
        ]
        self.tasks = [self.root, *(task for _, task in self.points), *self.links]
        self.limits = [mink.ConfigurationLimit(model)]

    def aim(self, k: int) -> None:
        """At frame k."""
        data, pose = self.data, mink.SE3.from_rotation_and_translation
        turn = mink.SO3(data["root_quaternions"][k])
        self.root.set_target(pose(turn, data["root_positions"][k]))
        for i, task in self.points:
            task.set_target(pose(mink.SO3.identity(), data["points"][k, i]))
        for task, turned in zip(self.links, data["link_quaternions"][k], strict=True):
            task.set_target(pose(mink.SO3(turned), np.zeros(3)))

    def solve(self, configuration: mink.Configuration) -> bool:
        """Moves the configuration; whether every step had an answer."""
        before = self._error(configuration)
        for _ in range(self.STEPS):
            try:
                v = mink.solve_ik(
                    configuration,
                    self.tasks,
                    self.dt,
                    "daqp",
                    damping=self.DAMPING,
                    limits=self.limits,
                )
            except mink.NoSolutionFound:
                return False
            configuration.integrate_inplace(v, self.dt)
            after = self._error(configuration)
            if before - after <= self.ENOUGH:
                break
            before = after
        return True

    def _error(self, configuration: mink.Configuration) -> float:
        errors = [task.compute_error(configuration) for task in self.tasks]
        return float(np.linalg.norm(np.concatenate(errors)))


if __name__ == "__main__":
    main()
