"""The recorded page: a run, or several side by side, as one HTML file to play back.

`record_log` and `compare_logs` make it from logs, without simulating again. Meshcat's
own page holds the robots; what `results/page/` holds is put into it: it moves them, and
draws targets, distances and the time line.
"""

from __future__ import annotations

import html
import json
import os
import re
from collections.abc import Sequence
from importlib import resources

import numpy as np
from pydrake.geometry import Meshcat

from crar_drake.errors import CrarError
from crar_drake.files import whole_file
from crar_drake.results import marks
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_robot, load_logged_scenario
from crar_drake.results.packed_page import packed_array, packed_page
from crar_drake.results.recorded_run import DrawnRobot, RecordedRun, record_run
from crar_drake.results.summary import Summary, motion_name, robot_name
from crar_drake.robot.description import RobotDescription
from crar_drake.simulation.scenario import Scenario
from crar_drake.simulation.visualization import (
    GRID,
    VIEW_PITCH,
    VIEW_YAW,
    set_surroundings,
)

_SCRIPTS = ("view.js", "marks.js", "timeline.js", "page.js")

# What the page's numbers are rounded to, far below a pixel: poses and points [m, 1],
# and where links are near each other [m].
_STEPS = {"poses": 2**-14, "targets": 2**-14, "reached": 2**-14, "near": 2**-17}

_MODES = {
    "none": "no constraints",
    "paper": "the paper's constraints",
    "lookahead": "lookahead constraints",
}


def record_log(
    log: SimulationLog,
    path: str | os.PathLike[str],
    *,
    frames_per_second: float = 32.0,
    meshcat: Meshcat | None = None,
    robot: str = "",
    scenario: Scenario | None = None,
    description: RobotDescription | None = None,
    note: str = "",
) -> list[str]:
    """Writes the page of a run from its log, without simulating again.

    Args:
        log: from `SimulationLog.load`, or of a run just made.
        path: of the .html file; appears whole or not at all.
        frames_per_second: of the recording; the log is interpolated to them.
        meshcat: to draw into; by default one of its own.
        robot: where the robot is now, or its name; by default what the log says.
        scenario: of the log, if it is at hand; by default the log's text is parsed.
        description: of the robot, if it is at hand; by default it is loaded.
        note: what else its caption says.

    Returns:
        The models whose collision shapes were drawn, for want of anything else.

    Raises:
        CrarError: the log is empty, does not fit its robot any more, or
            `frames_per_second` is not positive.
        ModelError, ScenarioError: its robot or its scenario is not there any more.
        WriteError: the file cannot be written.
    """
    scenario = scenario or load_logged_scenario(log)
    description = description or load_logged_robot(log, robot, scenario)
    runs = [(log, scenario, description)]
    return _write_page(runs, [""], path, frames_per_second, meshcat, False, note)


def compare_logs(
    logs: Sequence[SimulationLog],
    path: str | os.PathLike[str],
    *,
    labels: Sequence[str],
    overlay: bool = False,
    frames_per_second: float = 32.0,
    meshcat: Meshcat | None = None,
    robot: str = "",
) -> list[str]:
    """Writes one page of several runs, with one time line.

    Args:
        logs: of the runs, at least two and at most as many as `marks.RUNS`.
        path, frames_per_second, meshcat, robot: as of `record_log`.
        labels: what to call each run, see `distinct_labels`.
        overlay: whether the robots are laid over each other when the page opens; else
            they are side by side. The page has a button for it.

    Returns:
        As `record_log`.

    Raises:
        CrarError: there are too few or too many logs, or as `record_log`.
        ModelError, ScenarioError, WriteError: as `record_log`.
    """
    if not 2 <= len(logs) <= len(marks.RUNS):
        raise CrarError(
            f"{len(logs)} runs cannot be compared: name 2 to {len(marks.RUNS)} logs"
        )
    runs = []
    for log in logs:
        scenario = load_logged_scenario(log)
        runs.append((log, scenario, load_logged_robot(log, robot, scenario)))
    return _write_page(runs, labels, path, frames_per_second, meshcat, overlay)


def distinct_labels(logs: Sequence[SimulationLog], names: Sequence[str]) -> list[str]:
    """What to call each of several runs: that in which they differ.

    Args:
        logs: of the runs.
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
    told = [
        f"{label} ({name})" if label else name
        for label, name in zip(labels, names, strict=True)
    ]
    # The same folder twice.
    return [
        f"{label} {i + 1}" if told.count(label) > 1 else label
        for i, label in enumerate(told)
    ]


def _write_page(
    runs: Sequence[tuple[SimulationLog, Scenario, RobotDescription]],
    labels: Sequence[str],
    path: str | os.PathLike[str],
    frames_per_second: float,
    meshcat: Meshcat | None,
    overlay: bool,
    note: str = "",
) -> list[str]:
    """Draws each robot once, and lets the page show all runs of it."""
    meshcat = meshcat or Meshcat()
    meshcat.Delete()
    set_surroundings(meshcat)
    robots: list[DrawnRobot] = []
    entries, recorded = [], []
    arrays: list[bytes] = []
    for (log, scenario, description), label in zip(runs, labels, strict=True):
        if not len(log.time):
            raise CrarError("the log is empty: there is nothing to play back")
        known = [drawn.description for drawn in robots]
        if description not in known:
            robots.append(
                DrawnRobot(description, meshcat, _prefix(len(robots)), scenario)
            )
            known.append(description)
        number = known.index(description)
        run = record_run(log, robots[number], scenario, frames_per_second)
        recorded.append(run)
        colour = marks.RUNS[len(entries)]
        entries.append(
            {"label": label, "robot": number, "colour": colour}
            | _run_entry(run, frames_per_second, arrays)
        )
    summaries = [run.summary for run in recorded]
    data = {
        "title": _title(summaries),
        "subtitle": " · ".join(filter(None, (_subtitle(summaries), note))),
        "overlay": overlay,
        **page_look(),
        "spans": marks.SPANS,
        "robots": [
            {"prefix": _prefix(i), "paths": robot.paths}
            for i, robot in enumerate(robots)
        ],
        "runs": entries,
        "outline": _rounded(np.vstack([run.outline for run in recorded]).ravel(), 4),
    }
    page = packed_page(_page(meshcat.StaticHtml(), data), arrays)
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return sorted({name for robot in robots for name in robot.unseen})


def page_look() -> dict:
    """What the scripts of a page read of how it looks: view, grid, colours, scales."""
    return {
        "grid": GRID,
        "view": {
            "azimuth": float(np.degrees(VIEW_YAW)),
            "elevation": float(np.degrees(VIEW_PITCH)),
        },
        "colours": {
            "target": marks.TARGET,
            "violation": marks.VIOLATION,
            "smallest": marks.SMALLEST,
        },
        "nearness": {"colours": marks.NEARNESS, "steps": marks.NEARNESS_STEPS},
        "scaleUnit": marks.SCALE_UNIT,
    }


def _prefix(robot: int) -> str:
    return f"/crar/robot{robot}"


def _run_entry(run: RecordedRun, frames_per_second: float, arrays: list[bytes]) -> dict:
    """What the page's scripts read of a run; its arrays are added to the others."""
    packed = {}
    for name, step in _STEPS.items():
        packed[name] = len(arrays)
        arrays.append(packed_array(getattr(run, name), step))
    return {
        **packed,
        "rate": frames_per_second,
        "frames": len(run.time),
        "most": run.near.shape[1],
        "warning": run.warning_distance,
        "figures": _figures(run.summary),
        "pairNames": [spoken(name) for name in run.pair_names],
        "targetNames": [spoken(name) for name in run.target_names],
        "curve": {
            "time": _rounded(run.curve_time, 3),
            "distance": _rounded(run.distance_curve, 5),
            "error": _rounded(run.error_curve, 5),
            "unit": run.error_unit,
        },
        "spans": {
            name: [[round(a, 3), round(b, 3)] for a, b in spans]
            for name, spans in run.spans.items()
        },
    }


def _rounded(values: np.ndarray, digits: int) -> list[float | None]:
    return [round(float(v), digits) if np.isfinite(v) else None for v in values]


def spoken(name: str) -> str:
    return name.replace("_", " ").replace(" - ", " – ")


def _title(summaries: Sequence[Summary]) -> str:
    """Robots and motions of all runs, each once."""
    robots = dict.fromkeys(robot_name(summary.robot) for summary in summaries)
    motions = dict.fromkeys(motion_name(summary.motion) for summary in summaries)
    return f"{', '.join(robots)} following {', '.join(motions)}"


def _subtitle(summaries: Sequence[Summary]) -> str:
    """Mode, level, tracked points and duration, as far as all runs share them."""
    told = [
        _MODES[summaries[0].constraints],
        f"{summaries[0].level} level",
        f"{summaries[0].experiment or 'its own tasks'}",
        f"{summaries[0].duration:.1f} s",
    ]
    shared = zip(
        told,
        ("constraints", "level", "experiment", "duration"),
        strict=True,
    )
    return " · ".join(
        text
        for text, name in shared
        if len({getattr(summary, name) for summary in summaries}) == 1
    )


def _figures(summary: Summary) -> list[dict]:
    """The figures of a run in the caption; `bad` ones stand out."""
    figures = []

    def tell(name: str, value: str, bad: bool = False) -> None:
        figures.append({"name": name, "value": value, "bad": bad})

    if summary.smallest_distance is not None:
        tell(
            "nearest",
            f"{1e3 * summary.smallest_distance:.1f} mm".replace("-", "−"),
            summary.smallest_distance < 0.0,
        )
    if summary.rms_task_error is not None:
        tell("rms error", f"{1e3 * summary.rms_task_error:.1f} mm")
    if summary.rms_orientation_error is not None:
        angle = np.degrees(summary.rms_orientation_error)
        tell("rms orientation error", f"{angle:.1f}°")
    share = 100.0 * summary.violated_samples / summary.samples
    if summary.violated_samples:
        few = "< 0.1" if share < 0.05 else f"{share:.1f}"
        tell("violations", f"{few} % of the time", True)
    else:
        tell("violations", "none")
    if summary.stopped:
        tell("stopped", summary.stopped, True)
    return figures


def _page(meshcat_page: str, data: dict) -> str:
    """Meshcat's page with ours in it."""
    # What stands in a script ends at the first "</script", wherever that is.
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    text = text.replace("<", "\\u003c").replace("\u2028", "\\u2028")
    page = re.sub(
        r"<title>.*?</title>",
        lambda _: (
            f"<title>{html.escape(data['title'])}</title>\n"
            '  <meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"  <style>\n{page_resource('page.css')}  </style>"
        ),
        meshcat_page,
        count=1,
    )
    scripts = "\n".join(page_resource(name) for name in _SCRIPTS)
    body, end, rest = page.rpartition("</body>")
    return (
        f"{body}{page_resource('page.html')}"
        f'<script type="application/json" id="crar-data">{text}</script>\n'
        f'<script>\n(() => {{\n"use strict";\n{scripts}}})();\n</script>\n{end}{rest}'
    )


def page_resource(name: str) -> str:
    folder = resources.files("crar_drake.results") / "page"
    return (folder / name).read_text(encoding="utf-8")
