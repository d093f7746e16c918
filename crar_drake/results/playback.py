"""The recorded page of a run, or of several side by side, made from their logs."""

import os
from collections.abc import Sequence

import numpy as np

from crar_drake.errors import CrarError
from crar_drake.results import marks
from crar_drake.results.drawn_robot import DrawnRobot, outermost
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import (
    check_logged_robot,
    load_logged_robot,
    load_logged_scenario,
)
from crar_drake.results.obstacles import judge_obstacles
from crar_drake.results.recorded_page import (
    RecordedRun,
    empty_scene,
    figure,
    robot_prefix,
    write_page,
)
from crar_drake.results.summary import (
    Summary,
    motion_name,
    robot_name,
    summarize,
)
from crar_drake.simulation.scenario import Scenario

# The curves of the time line have at most this many points.
_CURVE_POINTS = 1500

# The view has obstacles where they are so near to the robot [m].
_NEAR = 0.2

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
    robot: str = "",
    note: str = "",
) -> list[str]:
    """Writes the page of a run from its log, or one of several with one time line,
    without simulating again.

    Its frames are as far apart as the scenario says (`visualization.publish_period`);
    the logs are interpolated to them.

    Args:
        logs: from `SimulationLog.load`, or of a run just made; at most as many as
            `marks.RUNS`.
        path: of the .html file; appears whole or not at all.
        labels: what to call each of several runs.
        overlay: whether the robots are laid over each other when the page opens; else
            they are side by side. The page has a button for it.
        robot: where the robot is now, or its name; by default what the logs say.
        note: what else the page says below its title.

    Returns:
        The models whose collision shapes were drawn, for want of anything else.

    Raises:
        CrarError: there are too many logs, or one is empty, has no finite positions or
            does not fit its robot any more.
        ModelError, ScenarioError: its robot or its scenario is not there any more.
        WriteError: the file cannot be written.
    """
    if not 1 <= len(logs) <= len(marks.RUNS):
        raise CrarError(
            f"{len(logs)} runs cannot be compared: name up to {len(marks.RUNS)} logs"
        )
    meshcat = empty_scene()
    robots: list[DrawnRobot] = []
    runs: list[RecordedRun] = []
    summaries: list[Summary] = []
    for log, label in zip(logs, labels, strict=True):
        if not len(log.time):
            raise CrarError("the log is empty: there is nothing to play back")
        scenario = load_logged_scenario(log)
        description = load_logged_robot(log, robot)
        radii = tuple(log.obstacles[0].reshape(-1, 4)[:, 3].tolist())
        same = [r for r in robots if (r.description, r.spheres) == (description, radii)]
        if not same:
            place = robot_prefix(len(robots))
            colour = scenario.visualization.default_illustration_color
            same = [DrawnRobot(description, meshcat, place, colour, radii)]
            robots += same
        drawn = same[0]
        check_logged_robot(log, drawn.plant, description)
        found = judge_obstacles(
            log, scenario, drawn.plant, drawn.scene_graph, description.pairs
        )
        summaries.append(summarize(log, obstacles=found))
        figures = _figures(summaries[-1])
        runs.append(_record_run(log, scenario, drawn, label, figures))
    write_page(
        path,
        meshcat,
        runs,
        title=_title(summaries),
        subtitle=" · ".join(filter(None, (_subtitle(summaries), note))),
        overlay=overlay,
    )
    return sorted({name for each in robots for name in each.unseen})


def _record_run(
    log: SimulationLog,
    scenario: Scenario,
    robot: DrawnRobot,
    label: str,
    figures: Sequence[dict],
) -> RecordedRun:
    """A run, frame by frame."""
    known = np.isfinite(log.q).all(axis=1)
    if not known.any():
        raise CrarError("the log has no finite positions: there is nothing to draw")
    layout = log.layout
    time, rate = log.time - log.time[0], 1.0 / scenario.visualization.publish_period
    frames = np.arange(np.floor(time[-1] * rate + 1e-6) + 1.0) / rate
    # Where a simulation went to infinity, the last pose that can be drawn stays.
    q = _resample(frames, time[known], log.q[known])
    desired = log.desired_tasks[:, layout.position_entries.ravel()]
    error = log.task_error[:, layout.linear_rows.ravel()]
    targets = _resample(frames, time, desired).reshape(len(frames), -1, 3)
    reached = targets - _resample(frames, time, error).reshape(len(frames), -1, 3)
    targets[np.isnan(reached)] = np.nan
    distances = _resample(frames, time, log.signed_distances)
    distances[:, ~log.between_links] = np.inf
    spheres = _resample(frames, time, log.obstacles).reshape(len(frames), -1, 4)
    below = marks.NEARNESS_STEPS[0] * scenario.warning_distance
    recorded = robot.record(q, distances, below, spheres[..., :3])
    seen = np.vstack([recorded["outline"], targets.reshape(-1, 3)])
    seen = seen[np.isfinite(seen).all(axis=1)]
    near_spheres = _near_spheres(seen, spheres.reshape(-1, 4))
    recorded["outline"] = outermost(np.vstack([seen, near_spheres]))
    return RecordedRun(
        robot=robot,
        label=label,
        figures=figures,
        warning_distance=scenario.warning_distance,
        rate=rate,
        **recorded,
        pair_names=log.pair_names.tolist(),
        **_curves(log),
        spans={
            name: [(a - log.time[0], b - log.time[0]) for a, b in spans]
            for name, spans in marks.marked_spans(log).items()
        },
        target_names=[layout.names[i] for i in layout.linear_tasks],
        targets=targets,
        reached=reached,
    )


def _near_spheres(points: np.ndarray, spheres: np.ndarray) -> np.ndarray:
    """(P, 3) the corners of the boxes about those of (N, 4) spheres, centre and radius,
    that are near the box about (P, 3) points [m]."""
    if not len(points) or not len(spheres):
        return np.empty((0, 3))
    centres, radii = spheres[:, :3], spheres[:, 3:]
    low, high = points.min(axis=0) - _NEAR, points.max(axis=0) + _NEAR
    near = ((centres + radii > low) & (centres - radii < high)).all(axis=1)
    corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    boxes = centres[near, None] + radii[near, None] * corners
    return boxes.reshape(-1, 3)


def _resample(frames: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolates the columns of `values` (T, k), sampled at `time` (T,)."""
    columns = [np.interp(frames, time, column) for column in values.T]
    return np.column_stack(columns) if columns else np.empty((len(frames), 0))


def _curves(log: SimulationLog) -> dict:
    """The curves of a `RecordedRun`.

    Of each piece of time the smallest distance and the largest error are kept, so
    that no peak is lost.
    """
    layout = log.layout
    rows, unit = layout.linear_rows, "m"
    if not rows.size:
        rows, unit = layout.angular_rows, "rad"
    pieces = min(_CURVE_POINTS, len(log.time))
    starts = np.arange(pieces) * len(log.time) // pieces
    distance = error = np.empty(0)
    if log.signed_distances.size:
        smallest = log.signed_distances[:, log.between_links].min(axis=1)
        distance = np.minimum.reduceat(smallest, starts)
    if rows.size:
        largest = np.linalg.norm(log.task_error[:, rows], axis=2).max(axis=1)
        error = np.fmax.reduceat(largest, starts)
    return {
        "curve_time": log.time[starts] - log.time[0],
        "distance_curve": distance,
        "error_curve": error,
        "error_unit": unit if rows.size else "",
    }


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
    return figures
