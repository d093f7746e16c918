"""A picture of many runs."""

import math
import os
from collections.abc import Iterable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from benchmarks.sweep.cases import Result
from benchmarks.sweep.figures import (
    clip_label,
    clip_order,
    milliseconds,
    mode_figures,
)
from crar_drake.figures import save_figure

_COLOURS = {"none": "0.6", "paper": "tab:orange", "lookahead": "tab:blue"}
_MARKERS = "oDs^vP"


def plot_sweep(results: Iterable[Result], path: str | os.PathLike[str]) -> None:
    """Draws one result or more, see `draw_sweep`; the suffix chooses the format."""
    save_figure(draw_sweep(results), path, dpi=150)


def draw_sweep(results: Iterable[Result]) -> Figure:
    """A row of axes per experiment, with a lane per clip and a mark per mode.

    From the left: smallest distance [mm], largest excess beyond a joint limit
    [deg], rms task error [mm], peak torque [Nm]. A failed case is a red cross.
    """
    modes = mode_figures(results)
    experiments = list(dict.fromkeys(figures.experiment for figures in modes))
    series = list(dict.fromkeys((f.constraints, f.level, f.period) for f in modes))
    variants = sorted({(level, period) for _, level, period in series})
    clips = {
        experiment: sorted(
            {
                r.motion
                for figures in modes
                if figures.experiment == experiment
                for r in figures.ran + figures.failed
            },
            key=clip_order,
        )
        for experiment in experiments
    }
    heights = [0.6 + 0.2 * max(3, len(clips[experiment])) for experiment in experiments]
    figure = Figure(figsize=(11.0, 0.9 + sum(heights)), layout="constrained")
    rows = figure.subplots(
        len(experiments), 4, sharex="col", squeeze=False, height_ratios=heights
    )
    quantities = (
        ("smallest_distance", 1e3, "smallest distance [mm]"),
        ("largest_excess", 180.0 / math.pi, "largest excess of a joint limit [deg]"),
        ("rms_task_error", 1e3, "rms task error [mm]"),
        ("peak_torque", 1.0, "peak torque [Nm]"),
    )
    for experiment, axes in zip(experiments, rows, strict=True):
        lanes = {motion: lane for lane, motion in enumerate(clips[experiment])}
        for ax, (name, factor, label) in zip(axes, quantities, strict=True):
            for figures in (f for f in modes if f.experiment == experiment):
                mode = (figures.constraints, figures.level, figures.period)
                variant = variants.index((figures.level, figures.period))
                # Side by side in the lane, so that equal figures stay visible.
                shift = 0.5 * ((series.index(mode) + 0.5) / len(series) - 0.5)
                values = [factor * getattr(r, name) for r in figures.ran]
                ax.plot(
                    [v if math.isfinite(v) else math.nan for v in values],
                    [lanes[r.motion] + shift for r in figures.ran],
                    linestyle="none",
                    marker=_MARKERS[variant % len(_MARKERS)],
                    markersize=4.0,
                    markeredgewidth=0.0,
                    color=_COLOURS.get(figures.constraints, "tab:green"),
                    alpha=0.85,
                    label=f"{figures.mode}, {milliseconds(figures.period)}",
                )
            _dress(ax, list(lanes), label if experiment == experiments[-1] else "")
        _mark_violations(axes)
        failed = {
            r.motion for f in modes if f.experiment == experiment for r in f.failed
        }
        axes[0].plot(
            [0.02] * len(failed),
            [lanes[motion] for motion in failed],
            "x",
            color="tab:red",
            transform=axes[0].get_yaxis_transform(),
        )
        axes[0].set_yticklabels([clip_label(motion) for motion in lanes])
        axes[0].set_title(experiment, loc="left", fontsize="medium")
    by_label: dict[str, object] = {}
    for ax in rows[:, 0]:
        by_label |= dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
    if by_label:
        figure.legend(
            by_label.values(),
            by_label.keys(),
            loc="outside upper center",
            ncols=min(6, len(by_label)),
            fontsize="small",
            frameon=False,
        )
    return figure


def _dress(ax: Axes, motions: Sequence[str], label: str) -> None:
    ax.set_yticks(range(len(motions)), [""] * len(motions), fontsize="x-small")
    ax.set_ylim(len(motions) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="y", linewidth=0.4, alpha=0.5)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(axis="x", labelsize="x-small")
    ax.set_xlabel(label, fontsize="small")


def _mark_violations(axes: Sequence[Axes]) -> None:
    """Scales, and red where a constraint is violated."""
    distance, excess, error, torque = axes
    low, high = distance.get_xlim()
    distance.set_xlim(min(low, -2.0), max(high, 2.0))
    distance.axvspan(-1e4, 0.0, color="tab:red", alpha=0.1, linewidth=0.0)
    excess.set_xscale("symlog", linthresh=0.1)
    excess.set_xlim(-0.03, max(1.0, 1.5 * excess.get_xlim()[1]))
    excess.axvspan(0.0, 1e4, color="tab:red", alpha=0.1, linewidth=0.0)
    excess.set_xticks([0.0, 0.1, 1.0, 10.0], ["0", "0.1", "1", "10"])
    excess.xaxis.set_minor_locator(NullLocator())
    for ax in (error, torque):
        if not math.isfinite(ax.dataLim.minposx):
            continue  # nothing ran, so that there is nothing to scale
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_locator(NullLocator())
