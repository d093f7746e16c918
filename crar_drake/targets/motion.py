"""From a motion's name to what a robot is to follow."""

from dataclasses import replace
from functools import partial

import numpy as np
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import BsplineTrajectory

from crar_drake.errors import ScenarioError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.conditioning import spline
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.orientations import HANDS, smooth_hands
from crar_drake.motion.performer import JOINT_CENTRES, Performer
from crar_drake.motion.quaternion_spline import QuaternionSpline
from crar_drake.motion.retarget import HANGS_ON, RetargetedMotion, retarget
from crar_drake.robot.description import find_frame, zero_positions
from crar_drake.robot.model import ControlModel
from crar_drake.targets.desired_motion import DesiredMotion
from crar_drake.targets.sources import PoseTrajectorySource
from crar_drake.targets.ways import TaskWay, carried_way, head_way, point_way

_WAIST_AXES = ("waist.x", "waist.y", "waist.z")

HEAD = "head"

# What a motion gives the position of; of HANDS it gives the whole pose.
_POINTS = (*JOINT_CENTRES, HEAD)


class _Places:
    """Where the task frames of a robot are."""

    def __init__(self, model: ControlModel) -> None:
        self.plant, self._frames = model.plant, model.description.task_frames
        self._context = model.MakeWorkspace().plant_context
        self._zero = zero_positions(model.plant)

    def at(self, name: str, q: np.ndarray | None = None) -> np.ndarray:
        """p_W (3,) of a task frame at positions q (nq,), by default zero [m]."""
        self.plant.SetPositions(self._context, self._zero if q is None else q)
        frame = find_frame(self.plant, self._frames[name])
        return frame.CalcPoseInWorld(self._context).translation()

    def apart(self, a: str, b: str) -> float:
        """Distance of two task frames at zero joint angles [m]."""
        return float(np.linalg.norm(self.at(a) - self.at(b)))


def segment_lengths(model: ControlModel) -> dict[str, float]:
    """The robot's own lengths, as `retarget` takes them: read off its task frames at
    zero joint angles, and of the rest posture the waist's height.

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
    places = _Places(model)
    lengths = {"waist": float(places.at("waist", model.rest_positions())[2])}
    return lengths | {end: places.apart(start, end) for end, start in HANGS_ON.items()}


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
        waist = _Places(model).at("waist", model.rest_positions())
        retargeted = retargeted.standing_at(waist)
    frames = [task.frame for task in model.tasks]
    if all(frame in JOINT_CENTRES for frame in frames):
        points = retargeted.trajectory(frames)
        MakeTaskSource = partial(TrajectorySource, points, 2)
    else:
        ways = _task_ways(model, performer, retargeted, cutoff)
        MakeTaskSource = partial(PoseTrajectorySource, model.layout, ways)
    MakePrescribedSource = None
    if model.n_p:
        prescribed = _prescribed_trajectory(model, retargeted)
        MakePrescribedSource = partial(TrajectorySource, prescribed, 2)
    return DesiredMotion(
        retargeted.duration, MakeTaskSource, MakePrescribedSource, for_report
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


def _task_ways(
    model: ControlModel,
    performer: Performer,
    retargeted: RetargetedMotion,
    cutoff: float,
) -> dict[str, TaskWay]:
    """The way of each task, by its name."""
    quaternions, places = {}, _Places(model)
    if any(task.frame in HANDS for task in model.tasks):
        quaternions = smooth_hands(performer, cutoff)

    def way(frame: str) -> TaskWay:
        if frame == HEAD:
            length = places.apart("neck", HEAD)
            return head_way(performer, retargeted, length, cutoff)
        if frame not in HANDS:
            return point_way(retargeted.trajectory([frame]))
        wrist = frame.replace("hand", "wrist")
        return carried_way(
            point_way(retargeted.trajectory([wrist])),
            QuaternionSpline(retargeted.time, quaternions[frame]),
            # Along the hand's first axis, the one to the fingertips.
            np.array([places.apart(wrist, frame), 0.0, 0.0]),
        )

    names = model.layout.names
    return {
        name: way(task.frame) for name, task in zip(names, model.tasks, strict=True)
    }


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
    places, q = _Places(model), zero_positions(model.plant)
    turning = [i for i, source in enumerate(sources) if source == "waist.heading"]

    def offset(heading: np.ndarray) -> np.ndarray:
        q[model.prescribed_positions[turning]] = heading
        return places.at("waist", q)

    if not turning:
        return np.tile(offset(np.zeros(0)), (len(positions), 1))
    return np.array([offset(row) for row in positions[:, turning]])
