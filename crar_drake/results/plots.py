"""The one-page plot of a run."""

from __future__ import annotations

import os

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crar_drake.figures import save_figure
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_scenario
from crar_drake.results.summary import (
    ControlledJoints,
    Summary,
    controlled_joints,
    summarize,
    task_layout,
)
from crar_drake.robot.description import LIMIT_TOLERANCE, SPEED_TOLERANCE
from crar_drake.simulation.scenario import Scenario

# Pairs farther apart than this are of no interest [m].
_FAR = 0.3

# This many of the nearest pairs get a colour and a name; the others are grey.
_NAMED_PAIRS = 4

# Half the height of a joint's lane between its limits; 0.5 is the whole lane.
_HALF_BAND = 0.38

_COLOURS = matplotlib.colormaps["tab10"].colors
_VIOLATION = "tab:red"
_TOO_FAST = "tab:orange"


def plot_run(
    log: SimulationLog,
    path: str | os.PathLike[str],
    scenario: Scenario | None = None,
) -> None:
    """Draws a run on one page, see `draw_run`.

    Args:
        log: of the run.
        path: the figure's file; its suffix (.png, .pdf, .svg) chooses the format.
        scenario: of the log, if it is at hand; by default the log's text is parsed.

    Raises:
        ScenarioError: the scenario in the log is not one of this version.
        CrarError: there is no such format, or the file cannot be written.
    """
    save_figure(draw_run(log, scenario), path, dpi=150)


def draw_run(log: SimulationLog, scenario: Scenario | None = None) -> Figure:
    """Task error, distances, joint angles against their limits, and power over time.

    Axes, from the top: the length of each task's error [mm] (and, if there are such
    tasks, of the orientation errors [deg]); signed distances of the watched pairs
    [mm]; a lane per controlled joint, whose shaded band lies between its limits, and
    whose line is orange where it is faster than its speed limit; the power of the
    controlled joints [W].
    """
    scenario = scenario or load_logged_scenario(log)
    summary = summarize(log, scenario=scenario)
    joints = controlled_joints(log)
    layout = task_layout(log)
    has = {
        "error": layout.linear_rows.size > 0,
        "orientation": layout.angular_rows.size > 0,
        "distance": log.signed_distances.size > 0,
    }
    heights = [1.0] * sum(has.values()) + [0.25 * len(joints.names) + 0.3, 0.8]
    figure = Figure(figsize=(8.3, 11.7), layout="constrained")
    figure.suptitle(summary.title)
    axes = list(
        figure.subplots(len(heights), 1, sharex=True, height_ratios=heights).flat
    )
    remaining = iter(axes)
    if has["error"]:
        _draw_errors(
            next(remaining),
            log.time,
            {
                layout.names[i]: 1e3 * log.task_error[:, rows]
                for i, rows in zip(layout.linear_tasks, layout.linear_rows, strict=True)
            },
            "task error [mm]",
            f"Task error: rms {_times(1e3, summary.rms_task_error):.1f} mm",
        )
    if has["orientation"]:
        _draw_errors(
            next(remaining),
            log.time,
            {
                layout.names[i]: np.degrees(log.task_error[:, rows])
                for i, rows in zip(
                    layout.angular_tasks, layout.angular_rows, strict=True
                )
            },
            "orientation error [deg]",
            "Orientation error, Eq. (11): rms "
            f"{_times(np.degrees(1.0), summary.rms_orientation_error):.2f}°",
        )
    if has["distance"]:
        _draw_distances(next(remaining), log, summary, scenario.warning_distance)
    _draw_joints(next(remaining), log.time, joints, summary)
    _draw_power(next(remaining), log.time, joints, summary)
    axes[-1].set_xlabel("time [s]")
    for ax in axes:
        ax.margins(x=0.0)
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(axis="x", linewidth=0.4, alpha=0.5)
    figure.align_ylabels([ax for ax in axes if ax.get_ylabel()])
    return figure


def _times(factor: float, value: float | None) -> float:
    """NaN where a figure is not known, because all samples are without targets."""
    return np.nan if value is None else factor * value


def _headline(ax: Axes, text: str) -> None:
    ax.set_title(text, loc="left", fontsize="medium")


def _legend(ax: Axes) -> None:
    """Beside the axes, where it hides no line."""
    ax.legend(
        loc="upper left", bbox_to_anchor=(1.0, 1.05), fontsize="x-small", frameon=False
    )


def _draw_errors(
    ax: Axes,
    time: np.ndarray,
    errors: dict[str, np.ndarray],
    label: str,
    headline: str,
) -> None:
    """Lengths of the errors (T, 3), task by task; right-hand ones are dashed."""
    bases: list[str] = []
    for name, error in errors.items():
        base = name.removeprefix("left_").removeprefix("right_")
        if base not in bases:
            bases.append(base)
        ax.plot(
            time,
            np.linalg.norm(error, axis=1),
            color=_COLOURS[bases.index(base) % len(_COLOURS)],
            linestyle="--" if name.startswith("right_") else "-",
            linewidth=0.9,
            label=name.replace("_", " "),
        )
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel(label)
    _legend(ax)
    _headline(ax, headline)


def _draw_distances(
    ax: Axes, log: SimulationLog, summary: Summary, warning_distance: float
) -> None:
    millimetres = 1e3 * log.signed_distances
    nearest = np.argsort(millimetres.min(axis=0), kind="stable")
    for i in nearest[_NAMED_PAIRS:]:
        ax.plot(log.time, millimetres[:, i], color="0.75", linewidth=0.5)
    smallest = millimetres.min(axis=1)
    ax.plot(log.time, smallest, color="black", linewidth=1.8, label="smallest")
    for colour, i in enumerate(nearest[:_NAMED_PAIRS]):
        ax.plot(
            log.time,
            millimetres[:, i],
            color=_COLOURS[colour],
            linewidth=0.9,
            label=str(log.pair_names[i]).replace("_", " "),
        )
    # The floor shows some of the forbidden side, and all of what was visited.
    floor = min(1.15 * smallest.min(), -0.05 * 1e3 * _FAR)
    ax.set_ylim(floor, min(1e3 * _FAR, 1.05 * millimetres.max()))
    ax.axhspan(floor, 0.0, color=_VIOLATION, alpha=0.12, linewidth=0.0)
    ax.axhline(0.0, color=_VIOLATION, linewidth=0.8)
    ax.axhline(1e3 * warning_distance, color="tab:orange", linewidth=0.7, linestyle=":")
    ax.set_ylabel("distance [mm]")
    _legend(ax)
    _headline(
        ax,
        f"Watched pairs ({len(log.pair_names)}): smallest distance "
        f"{1e3 * summary.smallest_distance:.1f} mm, {summary.smallest_distance_pair}, "
        f"at {summary.smallest_distance_time:.2f} s",
    )


def _draw_joints(
    ax: Axes, time: np.ndarray, joints: ControlledJoints, summary: Summary
) -> None:
    """One lane a joint: its band is between the limits, or what it visited."""
    lanes = np.arange(len(joints.names))
    for lane in lanes:
        q = joints.q[:, lane]
        lower, upper = joints.lower[lane], joints.upper[lane]
        limited = np.isfinite(lower) and np.isfinite(upper) and lower < upper
        if limited:
            ax.axhspan(
                lane - _HALF_BAND, lane + _HALF_BAND, color="tab:blue", alpha=0.1
            )
        else:
            lower, upper = q.min(), q.max()
        span = max(upper - lower, 1e-9)
        # Upwards is towards the upper limit, though the lanes count downwards.
        height = lane - _HALF_BAND * (2.0 * q - (upper + lower)) / span
        ax.plot(time, height, color="tab:blue", linewidth=1.0)
        violated = joints.excess[:, lane] > LIMIT_TOLERANCE
        if violated.any():
            outside = np.where(violated, height, np.nan)
            ax.plot(time, outside, color=_VIOLATION, linewidth=2.0)
        too_fast = joints.speed_excess[:, lane] > SPEED_TOLERANCE
        if too_fast.any():
            where = np.where(too_fast, height, np.nan)
            ax.plot(time, where, color=_TOO_FAST, linewidth=0, marker=".", markersize=3)
        ax.text(
            1.01,
            lane,
            f"{np.degrees(lower):.0f}° … {np.degrees(upper):.0f}°"
            + ("" if limited else " visited,\nno limits"),
            transform=ax.get_yaxis_transform(),
            va="center",
            fontsize="x-small",
        )
    ax.set_yticks(
        lanes, [name.replace("_", " ") for name in joints.names], fontsize="small"
    )
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(lanes) - 0.45, -0.55)  # the first joint on top
    excess = (
        f"; farthest beyond: {summary.largest_excess_joint}, "
        f"{np.degrees(summary.largest_excess):.2g}°"
        if summary.beyond_limit_samples
        else "; none is exceeded"
    )
    if summary.beyond_speed_samples:
        excess += f"; orange: too fast, {summary.beyond_speed_samples} samples"
    _headline(ax, f"Joint angles, bands between the limits{excess}")


def _draw_power(
    ax: Axes, time: np.ndarray, joints: ControlledJoints, summary: Summary
) -> None:
    ax.plot(time, joints.power, color="tab:purple", linewidth=0.9)
    ax.axhline(summary.mean_power, color="tab:purple", linewidth=0.8, linestyle="--")
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel("power [W]")
    _headline(
        ax,
        f"Power of the controlled joints: mean {summary.mean_power:.1f} W; "
        f"peak torque {summary.peak_torque:.1f} Nm, {summary.peak_torque_joint}",
    )
