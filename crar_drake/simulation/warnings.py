"""What a run can report to its user that is no mistake, but perhaps not meant."""

import shlex
from collections.abc import Iterator

import numpy as np

from crar_drake.motion.report import MotionReport
from crar_drake.robot.description import (
    FLOOR_TOLERANCE,
    LIMIT_TOLERANCE,
    RobotDescription,
)
from crar_drake.robot.joints import joint_units
from crar_drake.simulation.diagram import Setup
from crar_drake.simulation.scenario import Scenario
from crar_drake.simulation.visuals import models_without_visuals

_MOST = 2  # findings and joints that a line names
_LOOKS = 201  # at the targets, in equal steps


def run_warnings(
    scenario: Scenario, setup: Setup, report: MotionReport | None, *, recorded: bool
) -> list[str]:
    """Lines to show beside a run's figures, most often none.

    Args:
        report: of its motion; None with keyframes.
        recorded: whether there is a recording.
    """
    lines = [*_of_the_motion(scenario, report), *_of_the_duration(scenario, setup)]
    lines += _of_the_rest_posture(scenario, setup)
    lines += _of_targets_below_the_floor(scenario, setup)
    if recorded:
        model = setup.model
        for name in models_without_visuals(
            model.plant, model.scene_graph.model_inspector()
        ):
            lines.append(
                f"model {name} has no visual geometry: the recording draws its "
                "collision shapes"
            )
    return lines


def _of_the_motion(scenario: Scenario, report: MotionReport | None) -> Iterator[str]:
    findings = report.findings if report is not None else ()
    if not findings:
        return
    text = "; ".join(findings[:_MOST])
    if len(findings) > _MOST:
        text += f"; and {len(findings) - _MOST} more"
    command = ["crar-drake", "show", scenario.motion]
    if scenario.skeleton:
        command += ["--skeleton", scenario.skeleton]
    if scenario.frame_rate is not None:
        command += ["--frame-rate", f"{scenario.frame_rate:g}"]
    for name in ("unit", "up", "facing", "joints"):
        if getattr(scenario, name):
            command.append(f"--{name}={getattr(scenario, name)}")
    plural = "s" if len(findings) > 1 else ""
    yield f"motion: {len(findings)} finding{plural}: {text}; see {shlex.join(command)}"


def _of_the_duration(scenario: Scenario, setup: Setup) -> Iterator[str]:
    end = setup.motion.duration
    if scenario.duration is not None and scenario.duration > end + 1e-9:
        what = "keyframes end" if scenario.keyframes else "motion ends"
        yield (
            f"duration: the {what} at {end:.2f} s; from there to "
            f"{scenario.duration:g} s the targets stand still where they were"
        )


def _of_the_rest_posture(scenario: Scenario, setup: Setup) -> Iterator[str]:
    model = setup.simulated
    joints = model.controlled_positions
    rest, start = model.rest_positions()[joints], setup.start_positions[joints]
    low, high = model.lower - LIMIT_TOLERANCE, model.upper + LIMIT_TOLERANCE
    beyond = [i for i in range(len(rest)) if not low[i] <= rest[i] <= high[i]]
    if not beyond:
        return
    named = []
    for i in beyond[:_MOST]:
        limit = model.lower[i] if rest[i] < low[i] else model.upper[i]
        name = model.joint_names[i]
        (unit,) = joint_units(model.plant, [name])
        named.append(f"{name} at {rest[i]:.3f} is beyond its limit {limit:.3f} {unit}")
    more = f", and {len(beyond) - _MOST} more" if len(beyond) > _MOST else ""
    if any(not low[i] <= start[i] <= high[i] for i in beyond):
        then = "the run starts beyond, too"
        if scenario.controller.constraints == "lookahead":
            then += ", and the controller brings it back"
    else:
        then = "the start pose is within"
    yield f"rest_posture: {', '.join(named)}{more}; {then}; correct robot.yaml"


def _of_targets_below_the_floor(scenario: Scenario, setup: Setup) -> Iterator[str]:
    """Of a robot whose root a motion moves, over the floor z = 0."""
    model, motion = setup.model, setup.motion
    tasks = model.layout.linear_tasks
    if not (moves_root(scenario, model.description) and len(tasks)):
        return
    end = min(scenario.duration or motion.duration, motion.duration)
    times = np.linspace(0.0, end, _LOOKS)
    z = np.array([model.layout.unpack(motion.tasks_at(t)).p[:, 2] for t in times])
    k, task = np.unravel_index(int(np.argmin(z)), z.shape)
    if z[k, task] < -FLOOR_TOLERANCE:
        yield (
            f"targets BELOW THE FLOOR: that of {model.layout.names[tasks[task]]} is "
            f"{-1e3 * z[k, task]:.0f} mm below it at {times[k]:.2f} s; is the motion's "
            "unit, or the height at which the robot stands, a wrong one?"
        )


def moves_root(scenario: Scenario, robot: RobotDescription) -> bool:
    """Whether a motion moves the robot's root, over the floor z = 0 then."""
    driven = any(by != "hold" for by in robot.prescribed_joints.values())
    return bool(scenario.motion) and driven
