"""From a motion's name to what a robot is to follow."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import BsplineTrajectory

from crar_drake.errors import ScenarioError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.conditioning import spline
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.orientations import HANDS, smooth_hands
from crar_drake.motion.performer import JOINT_CENTRES, Performer
from crar_drake.motion.quaternion_spline import QuaternionSpline
from crar_drake.motion.retarget import (
    SEGMENTS,
    RetargetedMotion,
    SegmentLengths,
    retarget,
)
from crar_drake.robot.description import find_frame, zero_positions
from crar_drake.robot.model import ControlModel
from crar_drake.targets.desired_motion import DesiredMotion
from crar_drake.targets.sources import PoseTrajectorySource
from crar_drake.targets.ways import CarriedTrajectory, PointTrajectory, head_way

_WAIST_AXES = ("waist.x", "waist.y", "waist.z")

HEAD = "head"

# What a motion gives the position of; of HANDS it gives the whole pose.
_POINTS = (*JOINT_CENTRES, HEAD)


def segment_lengths(model: ControlModel) -> SegmentLengths:
    """The robot's own lengths, read off its task frames at zero joint angles.

    The waist's height is that of the rest posture.

    Raises:
        ScenarioError: the description lacks a task frame that a motion needs.
    """
    frames = model.description.task_frames
    missing = [name for name in JOINT_CENTRES if name not in frames]
    if missing:
        raise ScenarioError(
            f"robot {model.description.name}: a motion needs the task_frames "
            f"{', '.join(missing)}; add them to its robot.yaml"
        )
    plant = model.plant
    context = model.MakeWorkspace().plant_context

    def positions(q: np.ndarray) -> dict[str, np.ndarray]:
        plant.SetPositions(context, q)
        return {
            name: find_frame(plant, frame).CalcPoseInWorld(context).translation()
            for name, frame in frames.items()
        }

    waist_height = float(_waist_at_rest(model)[2])
    p = positions(zero_positions(plant))

    def length(a: str, b: str) -> float:
        return float(np.linalg.norm(p[a] - p[b]))

    lengths = {field: length(a, b) for a, b, field in SEGMENTS}
    return SegmentLengths(**lengths, waist_height=waist_height)


def _waist_at_rest(model: ControlModel) -> np.ndarray:
    """(3,) where the task frame is in the rest posture [m]."""
    waist = find_frame(model.plant, model.description.task_frames["waist"])
    context = model.MakeWorkspace().plant_context
    model.plant.SetPositions(context, model.rest_positions())
    return waist.CalcPoseInWorld(context).translation()


def load_motion_targets(
    motion: str,
    model: ControlModel,
    *,
    options: MotionOptions | None = None,
    cutoff: float = 6.0,
) -> DesiredMotion:
    """Loads, filters and scales a motion to the robot's tasks.

    Args:
        motion: a name of `motion.catalogue`: built-in, `cmu:05_02` or a path.
        model: the robot, with position tasks of JOINT_CENTRES and the head, and tasks
            of HANDS of any kind; of a robot that stands, tasks of JOINT_CENTRES alone,
            which it follows as seen from the hips.
        options: what is known of the motion beyond its file.
        cutoff: of the low-pass [Hz].

    Raises:
        MotionError: the motion cannot be found, read or scaled, or its skeleton
            lacks hands or a head that a task needs.
        ScenarioError: a task is none that a motion can drive.
    """
    _check_tasks(model)
    if model.description.stands:
        _check_standing_tasks(model)
    performer = load_performer(motion, options)
    # A run's report alone is left to be made of it, which needs none of these.
    for_report = replace(performer, orientations={}, hands={})
    lengths = segment_lengths(model)
    retargeted = retarget(performer, lengths, cutoff=cutoff)
    if model.description.stands:
        retargeted = retargeted.standing_at(_waist_at_rest(model))
    tasks_at, MakeTaskSource = _tasks(model, performer, retargeted, cutoff)
    prescribed_at, MakePrescribedSource = _prescribed(model, retargeted)
    return DesiredMotion(
        retargeted.duration,
        tasks_at,
        prescribed_at,
        MakeTaskSource,
        MakePrescribedSource,
        for_report,
    )


def _check_tasks(model: ControlModel) -> None:
    """Raises ScenarioError unless a motion gives what each task tracks."""
    for task, name in zip(model.tasks, model.layout.names, strict=True):
        if task.kind == "joint":
            raise ScenarioError(
                f"task {name}: a motion gives points of a person, no joint positions; "
                "leave the joint out, or use keyframes"
            )
        if task.frame in HANDS:
            if task.frame not in model.description.task_frames:
                raise ScenarioError(
                    f"task {name}: robot {model.description.name} has no task_frame "
                    f"{task.frame}; to follow a motion's hand, add it to its "
                    f"robot.yaml (import.yaml of an imported robot), x to the "
                    f"fingertips and z to the thumb's side"
                )
        elif task.frame not in _POINTS:
            raise ScenarioError(
                f"task {name}: a motion has no {task.frame}; it gives positions of "
                f"{', '.join(_POINTS)}, and position and orientation of "
                f"{', '.join(HANDS)}; track one of these, or use keyframes"
            )
        elif task.kind != "position":
            raise ScenarioError(
                f"task {name}: a motion gives no orientation of {task.frame}, only "
                f"of {', '.join(HANDS)}; track one of these, take kind position, or "
                f"use keyframes"
            )
        elif task.frame == HEAD and HEAD not in model.description.task_frames:
            raise ScenarioError(
                f"task {name}: robot {model.description.name} has no task_frame head; "
                "add it to its robot.yaml (import.yaml of an imported robot)"
            )


def _check_standing_tasks(model: ControlModel) -> None:
    """Raises ScenarioError if a task is none of a robot whose hips and feet stay."""
    others = [task.frame for task in model.tasks if task.frame not in JOINT_CENTRES]
    if others:
        raise ScenarioError(
            f"tasks: {', '.join(others)}: a robot that stands follows positions of "
            f"{', '.join(JOINT_CENTRES)}, as seen from the person's hips; leave the "
            "others out, or take standing out (soles, where the root is fixed)"
        )


def _tasks(
    model: ControlModel,
    performer: Performer,
    retargeted: RetargetedMotion,
    cutoff: float,
) -> tuple[Callable[[float], np.ndarray], Callable[[], LeafSystem]]:
    """`tasks_at` and `MakeTaskSource` of a `DesiredMotion`."""
    frames = [task.frame for task in model.tasks]
    if any(frame not in JOINT_CENTRES for frame in frames):
        ways = _task_ways(model, performer, retargeted, cutoff)
        return (
            PoseTrajectorySource(model.layout, ways).at,
            lambda: PoseTrajectorySource(model.layout, ways),
        )
    positions = retargeted.trajectory(frames)

    def tasks_at(time: float) -> np.ndarray:
        derivatives = [positions.EvalDerivative(time, k) for k in range(3)]
        return np.concatenate(derivatives).ravel()

    return tasks_at, lambda: TrajectorySource(positions, 2)


def _task_ways(
    model: ControlModel,
    performer: Performer,
    retargeted: RetargetedMotion,
    cutoff: float,
) -> dict[str, PointTrajectory | CarriedTrajectory]:
    """The way of each task, by its name."""
    quaternions = {}
    if any(task.frame in HANDS for task in model.tasks):
        quaternions = smooth_hands(performer, cutoff)

    def way(frame: str) -> PointTrajectory | CarriedTrajectory:
        if frame == HEAD:
            length = _distance(model, "neck", HEAD)
            return head_way(performer, retargeted, length, cutoff)
        if frame not in HANDS:
            return PointTrajectory(retargeted.trajectory([frame]))
        wrist = frame.replace("hand", "wrist")
        return CarriedTrajectory(
            PointTrajectory(retargeted.trajectory([wrist])),
            QuaternionSpline(retargeted.time, quaternions[frame]),
            # Along the hand's first axis, the one to the fingertips.
            np.array([_distance(model, wrist, frame), 0.0, 0.0]),
        )

    names = model.layout.names
    return {
        name: way(task.frame) for name, task in zip(names, model.tasks, strict=True)
    }


def _distance(model: ControlModel, a: str, b: str) -> float:
    """Between two task frames at zero joint angles [m]."""
    plant, frames = model.plant, model.description.task_frames
    context = model.MakeWorkspace().plant_context
    plant.SetPositions(context, zero_positions(plant))
    p_a, p_b = (
        find_frame(plant, frames[name]).CalcPoseInWorld(context).translation()
        for name in (a, b)
    )
    return float(np.linalg.norm(p_b - p_a))


def _prescribed(
    model: ControlModel, retargeted: RetargetedMotion
) -> tuple[Callable[[float], np.ndarray], Callable[[], LeafSystem] | None]:
    """`prescribed_at` and `MakePrescribedSource` of a `DesiredMotion`."""
    if not model.n_p:
        return lambda time: np.zeros(0), None
    trajectory = _prescribed_trajectory(model, retargeted)
    return (
        lambda time: trajectory.value(time).ravel(),
        lambda: TrajectorySource(trajectory, 2),
    )


def _prescribed_trajectory(model: ControlModel, retargeted) -> BsplineTrajectory:
    """Positions of the prescribed joints: the performer's heading, and each its share
    of the waist's position, less where the waist is while these joints are at zero."""
    sources = list(model.description.prescribed_joints.values())
    rest = model.rest_positions()[model.prescribed_positions]
    positions = np.tile(rest, (retargeted.num_frames, 1))
    for column, source in enumerate(sources):
        if source == "waist.heading":
            positions[:, column] = retargeted.heading
    offset = _waist_offset(model, sources, positions)
    for column, source in enumerate(sources):
        if source in _WAIST_AXES:
            axis = _WAIST_AXES.index(source)
            waist = retargeted.positions["waist"][:, axis]
            positions[:, column] = waist - offset[:, axis]
    return spline(retargeted.time, positions)


def _waist_offset(
    model: ControlModel, sources: list[str], positions: np.ndarray
) -> np.ndarray:
    """(T, 3) where the waist is with all joints at zero but the heading [m]."""
    plant = model.plant
    context = model.MakeWorkspace().plant_context
    waist = find_frame(plant, model.description.task_frames["waist"])
    turning = [i for i, source in enumerate(sources) if source == "waist.heading"]
    q = zero_positions(plant)

    def offset(heading: np.ndarray) -> np.ndarray:
        q[model.prescribed_positions[turning]] = heading
        plant.SetPositions(context, q)
        return waist.CalcPoseInWorld(context).translation()

    if not turning:
        return np.tile(offset(np.zeros(0)), (len(positions), 1))
    return np.array([offset(row) for row in positions[:, turning]])
