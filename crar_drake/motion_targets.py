"""From a motion's name to the trajectories that a robot is to follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.trajectories import BsplineTrajectory

from crar_drake.errors import ScenarioError
from crar_drake.motion.catalogue import load_clip
from crar_drake.motion.conditioning import spline
from crar_drake.motion.joint_centres import JOINT_CENTRES, joint_centres
from crar_drake.motion.retarget import SegmentLengths, retarget
from crar_drake.robot import ControlModel
from crar_drake.robot_description import find_frame

_WAIST_AXES = ("waist.x", "waist.y", "waist.z")


@dataclass(frozen=True)
class MotionTargets:
    """Trajectories of one motion for one robot, over [0, duration].

    Attributes:
        tasks: positions p_WT of the tasks, three rows each, in their order [m].
        prescribed: positions of the prescribed joints; None if there are none.
        duration: [s].
    """

    tasks: BsplineTrajectory
    prescribed: BsplineTrajectory | None
    duration: float  # [s]


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

    waist_height = float(positions(model.rest_positions())["waist"][2])
    p = positions(np.zeros(plant.num_positions()))

    def length(a: str, b: str) -> float:
        return float(np.linalg.norm(p[a] - p[b]))

    return SegmentLengths(
        waist_neck=length("waist", "neck"),
        left_neck_shoulder=length("neck", "left_shoulder"),
        left_shoulder_elbow=length("left_shoulder", "left_elbow"),
        left_elbow_wrist=length("left_elbow", "left_wrist"),
        right_neck_shoulder=length("neck", "right_shoulder"),
        right_shoulder_elbow=length("right_shoulder", "right_elbow"),
        right_elbow_wrist=length("right_elbow", "right_wrist"),
        waist_height=waist_height,
    )


def load_motion_targets(
    motion: str, model: ControlModel, *, skeleton: str = "", cutoff: float = 6.0
) -> MotionTargets:
    """Loads, filters and scales a motion to the robot's tasks.

    Args:
        motion: a name of `motion.catalogue`: built-in, `cmu:05_02` or a path.
        model: the robot, with position tasks named like joint centres.
        skeleton: path of the .asf, where it is not beside the motion.
        cutoff: of the low-pass [Hz].

    Raises:
        MotionError: the motion cannot be found, read or scaled.
        ScenarioError: a task is none that a motion of joint centres can drive.
    """
    for task, name in zip(model.tasks, model.layout.names, strict=True):
        if task.kind != "position" or task.frame not in JOINT_CENTRES:
            raise ScenarioError(
                f"task {name}: a motion gives positions of {', '.join(JOINT_CENTRES)}; "
                f"track one of these with kind position, or use keyframes"
            )
    centres = joint_centres(load_clip(motion, skeleton or None))
    retargeted = retarget(centres, segment_lengths(model), cutoff=cutoff)
    prescribed = None
    if model.n_p:
        prescribed = _prescribed_trajectory(model, retargeted)
    return MotionTargets(
        retargeted.trajectory([task.frame for task in model.tasks]),
        prescribed,
        retargeted.duration,
    )


def _prescribed_trajectory(model: ControlModel, retargeted) -> BsplineTrajectory:
    """Positions of the prescribed joints: the performer's heading, and each its share
    of the waist's position, less where the waist is while these joints are at zero."""
    sources = list(model.description.prescribed_joints.values())
    rest = model.rest_positions()[model.prescribed]
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
    q = np.zeros(plant.num_positions())

    def offset(heading: np.ndarray) -> np.ndarray:
        q[model.prescribed[turning]] = heading
        plant.SetPositions(context, q)
        return waist.CalcPoseInWorld(context).translation()

    if not turning:
        return np.tile(offset(np.zeros(0)), (len(positions), 1))
    return np.array([offset(row) for row in positions[:, turning]])
