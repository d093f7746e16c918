"""What a scenario's robot is to follow: from a motion or from keyframes."""

from pydrake.systems.primitives import ConstantVectorSource

from crar_drake.errors import ScenarioError
from crar_drake.robot.model import ControlModel
from crar_drake.simulation.scenario import Scenario
from crar_drake.targets.desired_motion import DesiredMotion
from crar_drake.targets.keyframes import KeyframeTrajectory
from crar_drake.targets.motion import load_motion_targets
from crar_drake.targets.sources import PoseTrajectorySource


def load_desired_motion(scenario: Scenario, model: ControlModel) -> DesiredMotion:
    """Loads the scenario's motion, or its keyframes, for the robot.

    Raises:
        MotionError: the motion cannot be found, read or scaled.
        ScenarioError: tasks and motion or keyframes do not fit each other.
    """
    if scenario.keyframes:
        return _from_keyframes(scenario, model)
    return load_motion_targets(
        scenario.motion,
        model,
        options=scenario.motion_options(),
        cutoff=scenario.cutoff,
    )


def _from_keyframes(scenario: Scenario, model: ControlModel) -> DesiredMotion:
    sources = model.description.prescribed_joints
    if any(source != "hold" for source in sources.values()):
        raise ScenarioError(
            f"robot {model.description.name}: its prescribed joints need a motion; "
            "keyframes drive robots whose prescribed joints hold"
        )
    held = model.prescribed_at(model.rest_positions())
    ways = {
        name: KeyframeTrajectory(name, frames)
        for name, frames in scenario.keyframes.items()
    }
    source = PoseTrajectorySource(model.layout, ways)
    return DesiredMotion(
        source.duration,
        source.at,
        lambda time: held[: len(model.prescribed_positions)],
        lambda: PoseTrajectorySource(model.layout, ways),
        (lambda: ConstantVectorSource(held)) if model.n_p else None,
    )
