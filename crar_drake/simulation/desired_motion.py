"""What a scenario's robot is to follow: from a motion or from keyframes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import TrajectorySource

from crar_drake.errors import ScenarioError
from crar_drake.motion.formats.asf_amc import Clip
from crar_drake.robot.model import ControlModel
from crar_drake.simulation.scenario import Scenario
from crar_drake.targets.keyframes import KeyframeTrajectory
from crar_drake.targets.motion import load_motion_targets
from crar_drake.targets.sources import PoseTrajectorySource


@dataclass(frozen=True)
class DesiredMotion:
    """The desired motion of one scenario, as functions of time and as systems.

    Attributes:
        duration: of the motion [s].
        tasks_at: time [s] to [x_d; v_d; a_d] (layout.size,).
        prescribed_at: time [s] to the prescribed joints' positions (n_p,).
        MakeTaskSource: makes the system that emits `desired_tasks`.
        MakePrescribedSource: makes that of `desired_prescribed`; None without
            prescribed joints.
        clip: the motion file's contents; None with keyframes.
    """

    duration: float  # [s]
    tasks_at: Callable[[float], np.ndarray]
    prescribed_at: Callable[[float], np.ndarray]
    MakeTaskSource: Callable[[], LeafSystem]
    MakePrescribedSource: Callable[[], LeafSystem] | None
    clip: Clip | None = None


def load_desired_motion(scenario: Scenario, model: ControlModel) -> DesiredMotion:
    """Loads the scenario's motion, or its keyframes, for the robot.

    Raises:
        MotionError: the motion cannot be found, read or scaled.
        ScenarioError: tasks and motion or keyframes do not fit each other.
    """
    if scenario.keyframes:
        return _from_keyframes(scenario, model)
    motion = load_motion_targets(
        scenario.motion,
        model,
        skeleton=scenario.skeleton,
        frame_rate=scenario.frame_rate,
        cutoff=scenario.cutoff,
    )

    tasks = motion.tasks
    if isinstance(tasks, dict):
        ways = tasks
        tasks_at = PoseTrajectorySource(model.layout, ways).at

        def MakeTaskSource() -> LeafSystem:
            return PoseTrajectorySource(model.layout, ways)

    else:

        def tasks_at(time: float) -> np.ndarray:
            derivatives = [tasks.EvalDerivative(time, k) for k in range(3)]
            return np.concatenate(derivatives).ravel()

        def MakeTaskSource() -> LeafSystem:
            return TrajectorySource(tasks, 2)

    prescribed = motion.prescribed
    if prescribed is None:
        return DesiredMotion(
            motion.duration,
            tasks_at,
            lambda time: np.zeros(0),
            MakeTaskSource,
            None,
            motion.clip,
        )
    return DesiredMotion(
        motion.duration,
        tasks_at,
        lambda time: prescribed.value(time).ravel(),
        MakeTaskSource,
        lambda: TrajectorySource(prescribed, 2),
        motion.clip,
    )


def _from_keyframes(scenario: Scenario, model: ControlModel) -> DesiredMotion:
    if model.n_p:
        raise ScenarioError(
            f"robot {model.description.name}: its prescribed joints need a motion; "
            "keyframes drive robots without prescribed joints"
        )
    ways = {
        name: KeyframeTrajectory(name, frames)
        for name, frames in scenario.keyframes.items()
    }
    source = PoseTrajectorySource(model.layout, ways)
    return DesiredMotion(
        source.duration,
        source.at,
        lambda time: np.zeros(0),
        lambda: PoseTrajectorySource(model.layout, ways),
        None,
    )
