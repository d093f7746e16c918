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
        settings: steps per frame, the costs root, turn, posture, and lm_damping; and of
            the bound of distances, if `collisions`, those of `collision_limit`.

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
    for k in range(len(data["points"])):
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


if __name__ == "__main__":
    main()
