"""The one-page plot of a run."""

import os

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from crar_drake.figures import save_figure
from crar_drake.results import marks
from crar_drake.results.controlled_joints import ControlledJoints, controlled_joints
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_scenario
from crar_drake.results.summary import Summary, summarize
from crar_drake.robot.description import LIMIT_TOLERANCE, SPEED_TOLERANCE

# Pairs farther apart than this are of no interest [m].
_FAR = 0.3

_FIGURE_WIDTH = 0.05  # of a written distance, as a share of the picture's width

# Half the height of a joint's lane between its limits; 0.5 is the whole lane.
_HALF_BAND = 0.38

_DISTANCE_TICKS = (-300, -100, -50, -20, -5, 0, 5, 20, 50, 100, 300)  # [mm]

# Torque is drawn in at most this many columns, the largest of each.
_TORQUE_COLUMNS = 600

_SHARE = LinearSegmentedColormap.from_list("share", ["#f4f7f9", marks.JOINT, "#0b2540"])
_SHARE = _SHARE.with_extremes(over=marks.VIOLATION)


def plot_run(log: SimulationLog, path: str | os.PathLike[str]) -> None:
    """Draws a run on one page, see `draw_run`.

    Args:
        path: the figure's file; its suffix (.png, .pdf, .svg) chooses the format.

    Raises:
        ScenarioError: the scenario in the log is not one of this version.
        CrarError: there is no such format, or the file cannot be written.
    """
    save_figure(draw_run(log), path, dpi=150)


def draw_run(log: SimulationLog) -> Figure:
    """Task error, distances, joint angles and torque against their limits, and power.

    Axes, from the top: when the controller blended onto targets, braked, or was limited
    in torque, if it ever was; the length of each task's error [mm] (and, if there are
    such tasks, of the orientation errors [deg]); signed distances of the watched pairs
    [mm] on a scale that is logarithmic from a few millimetres on; a lane per controlled
    joint, whose shaded band lies between its limits; a row per controlled joint, the
    darker the nearer the torque is to its limit; the power of the controlled joints
    [W]. The colours are those of the recorded page, see `marks`.
    """
    scenario, summary = load_logged_scenario(log), summarize(log)
    joints = controlled_joints(log)
    layout = log.layout
    has = {
        "error": layout.linear_rows.size > 0,
        "orientation": layout.angular_rows.size > 0,
        "distance": log.signed_distances.size > 0,
    }
    spans = {name: s for name, s in marks.marked_spans(log).items() if s}
    n = len(joints.names)
    heights = [0.14 * len(spans)] if spans else []
    heights += [1.0] * (has["error"] + has["orientation"]) + [1.5] * has["distance"]
    heights += [0.22 * n + 0.3, 0.13 * n + 0.2, 0.7]
    figure = Figure(figsize=(8.3, 11.7), layout="constrained")
    figure.suptitle(summary.title)
    axes = list(
        figure.subplots(len(heights), 1, sharex=True, height_ratios=heights).flat
    )
    remaining = iter(axes)
    if spans:
        _draw_spans(next(remaining), spans)
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
    _draw_torque(next(remaining), log.time, joints)
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
    ax.set_title(text, loc="left", fontsize="small")


def _legend(ax: Axes) -> None:
    """Beside the axes, where it hides no line."""
    ax.legend(
        loc="upper left", bbox_to_anchor=(1.0, 1.05), fontsize="x-small", frameon=False
    )


def _draw_errors(
    ax: Axes, time: np.ndarray, errors: dict[str, np.ndarray], label: str, headline: str
) -> None:
    """Lengths of the errors (T, 3), task by task; right-hand ones are light."""
    bases: list[str] = []
    for name, error in errors.items():
        base = name.removeprefix("left_").removeprefix("right_")
        if base not in bases:
            bases.append(base)
        right = name.startswith("right_")
        ax.plot(
            time,
            np.linalg.norm(error, axis=1),
            color=marks.TARGETS[bases.index(base) % len(marks.TARGETS)][right],
            linestyle="-" if bases.index(base) < len(marks.TARGETS) else "--",
            linewidth=0.9,
            label=name.replace("_", " "),
        )
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel(label)
    _legend(ax)
    _headline(ax, headline)


def _draw_spans(ax: Axes, spans: dict[str, list[tuple[float, float]]]) -> None:
    """A row for each kind of span that occurs."""
    for row, (name, pieces) in enumerate(spans.items()):
        ax.broken_barh(
            [(start, end - start) for start, end in pieces],
            (row - 0.35, 0.7),
            # Short ones are seen, too.
            linewidth=0.8,
            color=marks.SPANS[name],
        )
    ax.set_yticks(range(len(spans)), list(spans), fontsize="small")
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(spans) - 0.4, -0.6)


def _draw_distances(
    ax: Axes, log: SimulationLog, summary: Summary, warning_distance: float
) -> None:
    shown = np.flatnonzero(log.between_links)
    millimetres, names = 1e3 * log.signed_distances[:, shown], log.pair_names[shown]
    least = millimetres.min(axis=0)
    nearest = np.argsort(least, kind="stable")
    near = 1e3 * marks.NEARNESS_STEPS[0] * warning_distance
    named = [i for i in nearest[: len(marks.NEAR_PAIRS)] if least[i] < near]
    others = len(nearest) - len(named)
    for i in nearest[len(named) :]:
        label = f"{others} others" if i == nearest[-1] else ""
        ax.plot(log.time, millimetres[:, i], color="0.8", linewidth=0.5, label=label)
    smallest = millimetres.min(axis=1)
    ax.plot(log.time, smallest, color=marks.SMALLEST, linewidth=1.8, label="smallest")
    labelled: list[float] = []  # when
    for colour, i in zip(marks.NEAR_PAIRS, named, strict=False):
        ax.plot(
            log.time,
            millimetres[:, i],
            color=colour,
            linewidth=1.0,
            label=str(names[i]).replace("_", " "),
        )
        at = np.argmin(millimetres[:, i])
        ax.plot(log.time[at], least[i], ".", color=colour, markersize=5)
        # Below those that would be written over; all of them are near the bottom.
        distance = np.abs(np.array(labelled) - log.time[at])
        close = distance < _FIGURE_WIDTH * np.ptp(log.time)
        labelled.append(log.time[at])
        ax.annotate(
            f"{least[i]:.1f}".replace("-", "−"),
            (log.time[at], least[i]),
            xytext=(3, -3 - 10 * np.count_nonzero(close)),
            textcoords="offset points",
            va="top",
            fontsize="x-small",
            color=colour,
        )
    ax.set_yscale(
        "function",
        functions=(
            lambda mm: marks.distance_height(1e-3 * np.asarray(mm)),
            lambda height: 1e3 * marks.distance_at(np.asarray(height)),
        ),
    )
    # The floor shows some of the forbidden side, and all of what was visited.
    floor = min(2.5 * smallest.min(), -1.0)
    top = min(1e3 * _FAR, max(1.05 * millimetres.max(), 100.0))
    ax.set_yticks([tick for tick in _DISTANCE_TICKS if floor <= tick <= top])
    ax.set_yticklabels([f"{tick}".replace("-", "−") for tick in ax.get_yticks()])
    ax.set_yticks([], minor=True)
    ax.set_ylim(floor, top)
    ax.grid(axis="y", linewidth=0.4, alpha=0.5)
    ax.axhspan(floor, 0.0, color=marks.VIOLATION, alpha=0.13, linewidth=0.0)
    ax.axhline(0.0, color=marks.VIOLATION, linewidth=0.8)
    ax.axhline(
        1e3 * warning_distance, color=marks.NEARNESS[1], linewidth=0.7, linestyle=":"
    )
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
                lane - _HALF_BAND, lane + _HALF_BAND, color=marks.JOINT, alpha=0.1
            )
        else:
            lower, upper = q.min(), q.max()
        span = max(upper - lower, 1e-9)
        # Upwards is towards the upper limit, though the lanes count downwards.
        height = lane - _HALF_BAND * (2.0 * q - (upper + lower)) / span
        ax.plot(time, height, color=marks.JOINT, linewidth=1.0)
        violated = joints.excess[:, lane] > LIMIT_TOLERANCE
        if violated.any():
            outside = np.where(violated, height, np.nan)
            ax.plot(time, outside, color=marks.VIOLATION, linewidth=2.0)
        too_fast = joints.speed_excess[:, lane] > SPEED_TOLERANCE
        if too_fast.any():
            where = np.where(too_fast, height, np.nan)
            ax.plot(
                time, where, color=marks.TOO_FAST, linewidth=0, marker=".", markersize=3
            )
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
        excess += f"; magenta: too fast, {summary.beyond_speed_samples} samples"
    _headline(ax, f"Joint angles, bands between the limits{excess}")


def _draw_torque(ax: Axes, time: np.ndarray, joints: ControlledJoints) -> None:
    """One row a joint, as dark as its torque's share of the limit is high; without a
    limit, of the largest torque that occurred."""
    effort = np.abs(joints.torque)
    peak, limited = effort.max(axis=0), np.isfinite(joints.effort_limits)
    limits = np.where(limited, joints.effort_limits, np.maximum(peak, 1e-9))
    columns = min(_TORQUE_COLUMNS, len(time))
    starts = np.arange(columns) * len(time) // columns
    share = np.maximum.reduceat(effort / limits, starts, axis=0)
    edges = np.append(time[starts], time[-1])
    if columns == len(time):  # a sample is drawn around its time
        edges = np.concatenate([time[:1], 0.5 * (time[1:] + time[:-1]), time[-1:]])
    if edges[-1] > edges[0]:
        ax.pcolormesh(
            edges,
            np.arange(len(limits) + 1) - 0.5,
            share.T,
            cmap=_SHARE,
            vmin=0.0,
            vmax=1.0 + 1e-6,  # at the limit is not beyond it
            rasterized=True,
        )
    for row, limit in enumerate(limits):
        ax.text(
            1.01,
            row,
            f"{100.0 * peak[row] / limit:.0f} % of {limit:.3g}"
            if limited[row]
            else f"{peak[row]:.3g}, no limit",
            transform=ax.get_yaxis_transform(),
            va="center",
            fontsize="x-small",
        )
    ax.set_yticks(
        range(len(limits)),
        [name.replace("_", " ") for name in joints.names],
        fontsize="x-small",
    )
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(limits) - 0.5, -0.5)
    most = np.where(limited, peak / limits, 0.0)
    worst = int(np.argmax(most))
    about = (
        f"at most {100.0 * most[worst]:.0f} %, {joints.names[worst]}; white: none, "
        "dark: all of it, red: beyond"
        if limited.any()
        else "the model states no limits; dark: the joint's largest"
    )
    unit = "Nm; N where joints slide" if "m" in joints.units else "Nm"
    _headline(ax, f"Torque [{unit}], share of the limit: {about}")


def _draw_power(
    ax: Axes, time: np.ndarray, joints: ControlledJoints, summary: Summary
) -> None:
    ax.plot(time, joints.power, color=marks.JOINT, linewidth=0.9)
    ax.axhline(summary.mean_power, color=marks.JOINT, linewidth=0.8, linestyle="--")
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel("power [W]")
    _headline(
        ax,
        f"Power of the controlled joints: mean {summary.mean_power:.1f} W; "
        f"peak torque {summary.peak_torque:.1f} {summary.peak_torque_unit}, "
        f"{summary.peak_torque_joint}",
    )
