"""The recorded page of a run, or of several side by side, made from their logs."""

import os
from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Meshcat

from crar_drake.errors import CrarError
from crar_drake.results import marks
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_robot, load_logged_scenario
from crar_drake.results.obstacles import judge_obstacles
from crar_drake.results.recorded_page import (
    ShownRun,
    empty_scene,
    figure,
    robot_prefix,
    write_page,
)
from crar_drake.results.recorded_run import DrawnRobot, record_run
from crar_drake.results.summary import Summary, motion_name, robot_name, summarize
from crar_drake.robot.description import RobotDescription
from crar_drake.simulation.scenario import Scenario

_MODES = {
    "none": "no constraints",
    "paper": "the paper's constraints",
    "lookahead": "lookahead constraints",
}


def record_logs(
    logs: Sequence[SimulationLog],
    path: str | os.PathLike[str],
    *,
    labels: Sequence[str] = ("",),
    overlay: bool = False,
    frames_per_second: float = 32.0,
    meshcat: Meshcat | None = None,
    robot: str = "",
    scenario: Scenario | None = None,
    description: RobotDescription | None = None,
    note: str = "",
) -> list[str]:
    """Writes the page of a run from its log, or one of several with one time line,
    without simulating again.

    Args:
        logs: from `SimulationLog.load`, or of a run just made; at most as many as
            `marks.RUNS`.
        path: of the .html file; appears whole or not at all.
        labels: what to call each of several runs, see `distinct_labels`.
        overlay: whether the robots are laid over each other when the page opens; else
            they are side by side. The page has a button for it.
        frames_per_second: of the recording; the logs are interpolated to them.
        meshcat: to draw into; by default one of its own.
        robot: where the robot is now, or its name; by default what the logs say.
        scenario: of the only log, if it is at hand; by default the log's text is
            parsed.
        description: of the robot, if it is at hand; by default it is loaded.
        note: what else the page says below its title.

    Returns:
        The models whose collision shapes were drawn, for want of anything else.

    Raises:
        CrarError: there are too many logs, one is empty or does not fit its robot any
            more, or `frames_per_second` is not positive.
        ModelError, ScenarioError: its robot or its scenario is not there any more.
        WriteError: the file cannot be written.
    """
    if not 1 <= len(logs) <= len(marks.RUNS):
        raise CrarError(
            f"{len(logs)} runs cannot be compared: name up to {len(marks.RUNS)} logs"
        )
    meshcat = empty_scene(meshcat)
    robots: list[DrawnRobot] = []
    shown: list[ShownRun] = []
    summaries: list[Summary] = []
    for log, label in zip(logs, labels, strict=True):
        if not len(log.time):
            raise CrarError("the log is empty: there is nothing to play back")
        of = scenario or load_logged_scenario(log)
        drawn = description or load_logged_robot(log, robot, of)
        spheres = tuple(log.obstacles[0].reshape(-1, 4)[:, 3].tolist())
        known = [(each.description, each.spheres) for each in robots]
        if (drawn, spheres) not in known:
            colour = of.visualization.default_illustration_color
            place = robot_prefix(len(robots))
            robots.append(DrawnRobot(drawn, meshcat, place, colour, spheres))
            known.append((drawn, spheres))
        number = known.index((drawn, spheres))
        own = robots[number]
        recorded = record_run(log, own, of, frames_per_second)
        found = judge_obstacles(log, of, own.plant, own.scene_graph, drawn.pairs)
        summaries.append(summarize(log, scenario=of, obstacles=found))
        shown.append(ShownRun(recorded, number, label, _figures(summaries[-1])))
    write_page(
        path,
        meshcat,
        robots,
        shown,
        title=_title(summaries),
        subtitle=" · ".join(filter(None, (_subtitle(summaries), note))),
        overlay=overlay,
    )
    return sorted({name for each in robots for name in each.unseen})


def distinct_labels(logs: Sequence[SimulationLog], names: Sequence[str]) -> list[str]:
    """What to call each of several runs: that in which they differ.

    Args:
        names: of each log, such as its folder; added where nothing else differs.

    Raises:
        ScenarioError: a scenario in the logs is not one of this version.
    """
    scenarios = [load_logged_scenario(log) for log in logs]
    traits = [
        [scenario.controller.constraints for scenario in scenarios],
        [f"{scenario.controller.level} level" for scenario in scenarios],
        [scenario.experiment or "own tasks" for scenario in scenarios],
        [motion_name(scenario.motion) for scenario in scenarios],
        [robot_name(scenario.robot) for scenario in scenarios],
    ]
    differing = [trait for trait in traits if len(set(trait)) > 1]
    labels = [", ".join(parts) for parts in zip(*differing, strict=True)]
    labels = labels or [""] * len(logs)
    if len(set(labels)) == len(labels):
        return labels
    named = [
        f"{label} ({name})" if label else name
        for label, name in zip(labels, names, strict=True)
    ]
    # The same folder twice.
    return [
        f"{label} {i + 1}" if named.count(label) > 1 else label
        for i, label in enumerate(named)
    ]


def _title(summaries: Sequence[Summary]) -> str:
    """Robots and motions of all runs, each once."""
    robots = dict.fromkeys(robot_name(summary.robot) for summary in summaries)
    motions = dict.fromkeys(motion_name(summary.motion) for summary in summaries)
    return f"{', '.join(robots)} following {', '.join(motions)}"


def _subtitle(summaries: Sequence[Summary]) -> str:
    """Mode, level, tracked points and duration, as far as all runs share them."""
    traits = [
        _MODES[summaries[0].constraints],
        f"{summaries[0].level} level",
        f"{summaries[0].experiment or 'its own tasks'}",
        f"{summaries[0].duration:.1f} s",
    ]
    shared = zip(
        traits, ("constraints", "level", "experiment", "duration"), strict=True
    )
    return " · ".join(
        text
        for text, name in shared
        if len({getattr(summary, name) for summary in summaries}) == 1
    )


def _figures(summary: Summary) -> list[dict]:
    """The figures of a run in the caption."""
    figures = []
    if summary.smallest_distance is not None:
        nearest = f"{1e3 * summary.smallest_distance:.1f} mm".replace("-", "−")
        figures.append(figure("nearest", nearest, summary.smallest_distance < 0.0))
    if summary.rms_task_error is not None:
        figures.append(figure("rms error", f"{1e3 * summary.rms_task_error:.1f} mm"))
    if summary.rms_orientation_error is not None:
        angle = np.degrees(summary.rms_orientation_error)
        figures.append(figure("rms orientation error", f"{angle:.1f}°"))
    for name, one in summary.obstacles.items():
        if one.contact_samples:
            fastest = f"{1e3 * one.fastest_contact:.0f} mm/s"
            of = figure(
                f"{name} touches links at up to", fastest, one.fast_contacts > 0
            )
        else:
            of = figure(f"{name} at least", f"{1e3 * one.smallest_distance:.1f} mm")
        figures.append(of)
    share = 100.0 * summary.violated_samples / summary.samples
    if summary.violated_samples:
        few = "< 0.1" if share < 0.05 else f"{share:.1f}"
        figures.append(figure("violations", f"{few} % of the time", True))
    else:
        figures.append(figure("violations", "none"))
    if summary.stopped:
        figures.append(figure("stopped", summary.stopped, True))
    return figures
