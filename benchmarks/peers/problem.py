"""Writes the one problem that all controllers are given, to a folder.

The folder holds the robot (`robot.urdf` for Drake, `robot_pinocchio.urdf`,
`robot_mujoco.xml`), `collisions.json` (the watched pairs, in PlaCo's format),
`problem.json` (names, limits, gains that are common) and, for each case, `CASE.npz`:

    time (T,) [s], every millisecond; q_start (n,) [rad];
    p, v, a (T, 7, 3) of the targets [m, m/s, m/s^2]; q_reference (T, n) [rad].

The drivers of the peers read these and need nothing else of this project.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.peers import motions, robot_files
from benchmarks.peers.peers import MARGIN
from crar_drake import (
    EXPERIMENTS,
    ControlModel,
    RobotDescription,
    load_robot_description,
    position_tasks,
)
from crar_drake.files import whole_file, write_whole

ROBOT = "upper_body"  # of `CASES`
ROBOTS = {
    "upper_body": EXPERIMENTS["upper-body"],
    "g1": EXPERIMENTS["upper-body"],
    "obstacle_arm": ["tool"],
}  # to the points that are tasks
BASE = {"reach": 1.0, "fastest": 0.5}  # [m], [m/s and rad/s]
SAMPLE = 1e-3  # [s]
START_DEPTH = 0.015  # [m] of the start in penetration
CASES = {
    "crossing": "hands swung through each other and the chest, from a clear start",
    "start_inside": "the same swing from a start in penetration",
    "target_inside": "a target that goes into the chest and stays there",
}


def write_problem(folder: Path, robot: str = ROBOT, on_a_base: bool = False) -> None:
    """Writes a robot of `ROBOTS`, and all cases if it is `ROBOT`.

    Args:
        folder: is made.
        robot: which.
        on_a_base: whether it slides and turns on the floor, as `BASE` says.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shipped, tasks = load_robot_description(robot), ROBOTS[robot]
    links = [robot_files.unscoped(shipped.task_frames[task]) for task in tasks]
    base = write_robot(folder, shipped, links, on_a_base)
    description = describe(folder, shipped)
    model = ControlModel.FromDescription(description, position_tasks(tasks))
    problem = {
        "robot": robot,
        "base": base,
        "joints": list(model.joint_names),
        "lower": finite_or_none(model.lower),
        "upper": finite_or_none(model.upper),
        "velocity_limits": model.plant.GetVelocityUpperLimits().tolist(),
        "tasks": tasks,
        "task_links": links,
        "pairs": description.pairs,
        "rest": model.rest_positions().tolist(),
        "cases": CASES if robot == ROBOT else {},
    }
    write_whole(folder / "problem.json", json.dumps(problem, indent=1))
    if robot != ROBOT:
        return
    for name, motion in joint_motions(model).items():
        _write_case(folder / f"{name}.npz", model, motion)


def write_robot(
    folder: Path,
    robot: RobotDescription,
    links: Sequence[str],
    on_a_base: bool = False,
) -> str:
    """Writes the robot for every peer, its prescribed joints welded at rest.

    Args:
        folder: is there.
        robot: whose shapes are capsules and spheres.
        links: whose origins are tasks.
        on_a_base: as of `write_problem`.

    Returns:
        Its root link.
    """
    urdf = robot_files.simplified_urdf(
        Path(robot.folder) / robot.model,
        {
            joint: robot.rest_posture.get(joint, 0.0)
            for joint in robot.prescribed_joints
        },
        links,
    )
    if on_a_base:
        robot_files.on_a_base(urdf, **BASE)
    write_whole(folder / "robot.urdf", robot_files.drake_urdf(urdf))
    write_whole(folder / "robot_pinocchio.urdf", robot_files.pinocchio_urdf(urdf))
    write_whole(folder / "robot_mujoco.xml", robot_files.mjcf(urdf, links))
    write_whole(
        folder / "collisions.json", json.dumps(_unscoped_pairs(robot), indent=1)
    )
    return robot_files.root_link(urdf)


def write_crossings(folder: Path, seeds: Iterable[int]) -> list[str]:
    """Writes a random crossing for each seed, to a folder that has the problem.

    Returns:
        The names of the cases.
    """
    robot = json.loads((folder / "problem.json").read_text())["robot"]
    model = ControlModel.FromDescription(
        describe(folder, load_robot_description(robot)), position_tasks(ROBOTS[robot])
    )
    rest = model.rest_positions()

    # Neighbours that are never farther apart need no more than the margin.
    near = model.signed_distances(rest) < motions.APART
    less = np.where(near, motions.APART - MARGIN, 0.0)

    def smallest(q: np.ndarray) -> float:
        return float((model.signed_distances(q) + less).min())

    names = []
    for seed in seeds:
        motion = motions.random_crossing(seed, rest, model.lower, model.upper, smallest)
        names.append(f"crossing_{seed}")
        _write_case(folder / f"{names[-1]}.npz", model, motion)
    return names


def _write_case(path: Path, model: ControlModel, motion: motions.JointMotion) -> None:
    time = SAMPLE * np.arange(round(motion.duration / SAMPLE) + 1)
    q, v, a = motion.at(time)
    with whole_file(path) as temporary:
        np.savez(
            temporary,
            time=time,
            q_start=q[0],
            q_reference=q,
            **task_targets(model, q, v, a),
        )


def describe(folder: Path, shipped: RobotDescription) -> RobotDescription:
    """What crar_drake needs to know of the robot in the problem's folder."""
    return RobotDescription(
        name="peers",
        model="robot.urdf",
        base=robot_files.root_link(robot_files.read(folder / "robot.urdf")),
        task_frames={
            task: robot_files.unscoped(frame)
            for task, frame in shipped.task_frames.items()
        },
        pairs=_unscoped_pairs(shipped),
        rest_posture={
            joint: angle
            for joint, angle in shipped.rest_posture.items()
            if joint not in shipped.prescribed_joints
        },
        folder=str(folder),
    )


def _unscoped_pairs(robot: RobotDescription) -> list[list[str]]:
    return [[robot_files.unscoped(link) for link in pair] for pair in robot.pairs]


def joint_motions(model: ControlModel) -> dict[str, motions.JointMotion]:
    """The joint-space reference of every case."""
    rest = model.rest_positions()
    none = np.zeros(model.n)

    def pose(angles: dict[str, float], base: np.ndarray) -> np.ndarray:
        q = base.copy()
        for joint, angle in angles.items():
            q[model.joint_names.index(joint)] = angle
        return q

    crossed = pose(motions.ARMS_CROSSED, rest)
    swing = pose(motions.SWING, none)
    inside = penetrating_pose(
        model, pose(motions.ARMS_APART, rest), pose(motions.ARMS_IN_CHEST, rest)
    )
    deep = pose(motions.ARM_DEEP_IN_CHEST, rest)
    return {
        "crossing": motions.JointMotion(rest, crossed, swing, 0.5, 1.5, 6.0),
        "start_inside": motions.JointMotion(inside, crossed, swing, 0.5, 1.5, 6.0),
        "target_inside": motions.JointMotion(rest, deep, none, 0.5, 1.5, 4.0),
    }


def penetrating_pose(
    model: ControlModel, q_clear: np.ndarray, q_inside: np.ndarray
) -> np.ndarray:
    """The pose between the two whose smallest distance is -START_DEPTH."""
    low, high = 0.0, 1.0
    for _ in range(50):
        share = 0.5 * (low + high)
        q = q_clear + share * (q_inside - q_clear)
        if model.signed_distances(q).min() > -START_DEPTH:
            low = share
        else:
            high = share
    return q


def task_targets(
    model: ControlModel, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> dict[str, np.ndarray]:
    """Positions, velocities and accelerations (T, tasks, 3) of the task points."""
    workspace = model.MakeWorkspace()
    positions, velocities, accelerations = [], [], []
    for q_k, v_k, a_k in zip(q, v, a, strict=True):
        state = model.evaluate(workspace, q_k, v_k)
        positions.append(state.p)
        velocities.append(state.v.reshape(-1, 3))
        accelerations.append((state.J @ a_k + state.Jdot_qdot).reshape(-1, 3))
    return {
        "p": np.array(positions),
        "v": np.array(velocities),
        "a": np.array(accelerations),
    }


def finite_or_none(values: np.ndarray) -> list[float | None]:
    """JSON has no infinity."""
    return [float(x) if np.isfinite(x) else None for x in values]
