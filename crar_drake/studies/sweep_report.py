"""What a sweep shows: tables for the terminal and the documentation, and a plot.

python -m crar_drake.studies.sweep_report results.csv [more.csv ...]
    [--reasons reasons.json] [--out docs/sweep.md] [--plot sweep.png]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from rich.table import Table

from crar_drake.control.parameters import CONSTRAINTS, LEVELS
from crar_drake.figures import save_figure
from crar_drake.studies.sweep import Case, Result, read_results
from crar_drake.studies.tables import markdown_table, write_report

_COLOURS = {"none": "0.6", "paper": "tab:orange", "lookahead": "tab:blue"}
_MARKERS = "oDs^vP"
_MISSING = "–"


@dataclass(frozen=True)
class ModeFigures:
    """What one mode did on all clips of an experiment.

    Attributes:
        experiment, constraints, level, period: as of `Result`; period [s].
        ran: results of the clips that ran, by clip.
        failed: results of those that could not be run.
    """

    experiment: str
    constraints: str
    level: str
    period: float
    ran: tuple[Result, ...]
    failed: tuple[Result, ...]

    @property
    def mode(self) -> str:
        """Constraint mode, and the level where it is not the usual one."""
        usual = self.level == "acceleration"
        return self.constraints + ("" if usual else f", {self.level} level")

    @property
    def violated_clips(self) -> int:
        """Clips with a sample in violation."""
        return sum(r.violated for r in self.ran)

    def total(self, name: str) -> int:
        """Sum of a count over the clips."""
        return sum(getattr(r, name) for r in self.ran)

    def mean(self, name: str) -> float:
        """Mean of a figure over the clips that have it; NaN if none has."""
        return _reduce(np.mean, self._values(name))

    def median(self, name: str) -> float:
        """Median, likewise."""
        return _reduce(np.median, self._values(name))

    def extreme(self, name: str, choose: Callable) -> Result | None:
        """The result with the smallest or largest (`choose` is min or max)."""
        known = [r for r in self.ran if math.isfinite(getattr(r, name))]
        return choose(known, key=lambda r: getattr(r, name), default=None)

    def _values(self, name: str) -> list[float]:
        values = [getattr(r, name) for r in self.ran]
        return [value for value in values if math.isfinite(value)]


@dataclass(frozen=True)
class Comparison:
    """One clip under the lookahead and under the paper's mode.

    Attributes:
        lookahead: its result.
        paper: the paper's, at the same control period if there is such a result,
            else at the shortest that there is.
    """

    lookahead: Result
    paper: Result

    @property
    def not_better(self) -> list[str]:
        """Fields of `Result` in which the lookahead does not do better.

        Peak torque and rms acceleration should be below the paper's; the task error
        should not be above it, where the paper's mode holds its constraints.
        """
        worse = [
            name
            for name in ("peak_torque", "rms_acceleration")
            if not getattr(self.lookahead, name) < getattr(self.paper, name)
        ]
        if (
            not self.paper.violated
            and self.lookahead.rms_task_error > self.paper.rms_task_error
        ):
            worse.append("rms_task_error")
        return worse


def merge(results: Iterable[Result]) -> list[Result]:
    """One result a case, in reading order: by experiment, mode, period and clip.

    Of several the last counts, but one that ran is not replaced by a failed one.
    """
    by_case: dict[Case, Result] = {}
    for result in results:
        known = by_case.get(result.case)
        if known is None or known.error or not result.error:
            by_case[result.case] = result
    return sorted(by_case.values(), key=_reading_order)


def mode_figures(results: Iterable[Result]) -> list[ModeFigures]:
    """The results by mode, in reading order."""
    groups: dict[tuple, list[Result]] = {}
    for r in merge(results):
        key = (r.experiment, r.constraints, r.level, r.period)
        groups.setdefault(key, []).append(r)
    return [
        ModeFigures(
            *key,
            ran=tuple(r for r in group if not r.error),
            failed=tuple(r for r in group if r.error),
        )
        for key, group in groups.items()
    ]


def compare(results: Iterable[Result]) -> list[Comparison]:
    """Every clip that ran in both modes, for each control period of the lookahead."""
    ran = [r for r in merge(results) if not r.error]
    papers: dict[tuple, list[Result]] = {}
    for r in ran:
        if r.constraints == "paper":
            papers.setdefault((r.motion, r.experiment, r.level), []).append(r)
    comparisons = []
    for r in ran:
        found = papers.get((r.motion, r.experiment, r.level))
        if r.constraints == "lookahead" and found:
            paper = min(found, key=lambda p: (p.period != r.period, p.period))
            comparisons.append(Comparison(r, paper))
    return comparisons


def clip_label(motion: str) -> str:
    """A motion's short name: `05_02` of any path to it, and of `cmu:05_02`."""
    return PurePath(motion).stem.removeprefix("cmu:")


def without_folders(text: str, motion: str = "") -> str:
    """A message without this machine's folders; files keep their names."""
    for folder in PurePath(motion).parents:
        if folder.name:
            text = text.replace(f"{folder}{os.sep}", "")
    # Absolute paths that have nothing to do with the motion's.
    return re.sub(r"""(?<![\w./])~?/(?:[^\s:;,()'"]*/)?""", "", text)


# --- the terminal -----------------------------------------------------------------


def sweep_tables(results: Iterable[Result]) -> list[Table]:
    """A table per experiment and control period, with a column per mode."""
    pages: dict[tuple[str, float], list[ModeFigures]] = {}
    for figures in mode_figures(results):
        pages.setdefault((figures.experiment, figures.period), []).append(figures)
    tables = []
    for (experiment, period), modes in sorted(
        pages.items(), key=lambda page: (_experiment_order(page[0][0]), page[0][1])
    ):
        table = Table(
            title=f"{experiment}, control period {_milliseconds(period)}",
            title_justify="left",
        )
        table.add_column("")
        for figures in modes:
            table.add_column(figures.mode, justify="right")
        columns = [_rows(figures) for figures in modes]
        for i, (name, _) in enumerate(columns[0]):
            cells = [column[i][1] for column in columns]
            table.add_row(name, *cells)
        tables.append(table)
    return tables


def headline(result: Result) -> str:
    """One line for one result, as it comes in."""
    place = (
        f"{clip_label(result.motion)} {result.experiment} {result.constraints} "
        f"{_milliseconds(result.period)}"
    )
    if result.error:
        return f"{place}: failed: {result.error}"
    violated = result.penetrating + result.beyond_limit
    return (
        f"{place}: {_number(1e3 * result.smallest_distance, 'mm', 1)} near, error "
        f"{_number(1e3 * result.rms_task_error, 'mm', 1)}"
        + (", in violation" if violated else "")
        + (", beyond a speed limit" if result.beyond_speed else "")
        + (
            f", braking path not clear at {result.unclear} steps"
            if result.unclear
            else ""
        )
    )


def failures(results: Iterable[Result]) -> list[str]:
    """A line for every case that could not be run."""
    return [
        f"{clip_label(r.motion)}, {r.experiment}, {r.constraints}, "
        f"{_milliseconds(r.period)}: {r.error}"
        for r in merge(results)
        if r.error
    ]


def _rows(figures: ModeFigures) -> list[tuple[str, str]]:
    """Name and text of everything that is told of a mode."""
    nearest = figures.extreme("smallest_distance", min)
    farthest = figures.extreme("largest_excess", max)
    worst = figures.extreme("rms_task_error", max)
    fastest = figures.extreme("largest_speed_excess", max)
    beyond = farthest is not None and farthest.largest_excess > 0.0
    too_fast = fastest is not None and fastest.largest_speed_excess > 0.0
    return [
        ("clips", f"{len(figures.ran)}"),
        ("clips in violation", f"{figures.violated_clips}"),
        ("samples", f"{figures.total('samples')}"),
        ("samples penetrating", f"{figures.total('penetrating')}"),
        ("samples beyond a limit", f"{figures.total('beyond_limit')}"),
        ("smallest distance", _at(nearest, "smallest_distance", 1e3, "mm", 1)),
        ("of the pair", nearest.smallest_pair if nearest else _MISSING),
        (
            "farthest beyond a limit",
            _at(farthest, "largest_excess", 180.0 / math.pi, "°", 2)
            if beyond
            else _MISSING,
        ),
        ("samples beyond a speed limit", f"{figures.total('beyond_speed')}"),
        (
            "most beyond a speed limit",
            _at(fastest, "largest_speed_excess", 1.0, "rad/s", 2)
            if too_fast
            else _MISSING,
        ),
        *_admission_rows(figures),
        ("mean task error", _number(1e3 * figures.mean("rms_task_error"), "mm", 1)),
        ("worst task error", _at(worst, "rms_task_error", 1e3, "mm", 1)),
        ("mean power", _number(figures.mean("mean_power"), "W", 1)),
        ("median peak torque", _number(figures.median("peak_torque"), "Nm", 0)),
        (
            "median rms acceleration",
            _number(figures.median("rms_acceleration"), "rad/s²", 1),
        ),
        ("failed", f"{len(figures.failed)}"),
    ]


def _admission_rows(figures: ModeFigures) -> list[tuple[str, str]]:
    """How control steps were admitted; clips whose steps do not tell do not count."""
    nearest = figures.extreme("path_clearance", min)
    slowest = figures.extreme("longest_held_back", max)
    return [
        ("steps corrected", _number(100.0 * figures.mean("corrected"), "%", 2)),
        ("steps scaled", _number(100.0 * figures.mean("scaled"), "%", 2)),
        ("steps with a path not clear", f"{figures.total('unclear')}"),
        ("smallest path clearance", _at(nearest, "path_clearance", 1e3, "mm", 1)),
        ("longest held back", _at(slowest, "longest_held_back", 1.0, "s", 2)),
    ]


# --- the documentation ------------------------------------------------------------


def markdown_report(
    results: Iterable[Result], reasons: Mapping[str, str] | None = None
) -> str:
    """The documentation's page; it names clips, and no folder of this machine.

    Args:
        results: of one sweep or several.
        reasons: "clip, experiment" to why the lookahead does not do better there.
    """
    results = merge(results)
    ran = [r for r in results if not r.error]
    clips = {r.motion for r in ran}
    simulated = sum(r.duration for r in ran)
    text = (
        "# Sweep over motion clips\n\n"
        f"{len(clips)} clips, {len(ran)} simulations, {simulated:.0f} s of "
        "simulated time.\nDistances and limits are judged by the referee at every "
        "logged sample; a joint counts as beyond its limit from 1e-6 rad on. "
        "Clips in violation are those that penetrate or pass a joint limit; speed "
        "limits are counted apart. Task "
        "error, power, peak torque and rms acceleration are computed per clip; the "
        "tables then give their mean or median over the clips.\n\n"
        "This page is written by `python -m crar_drake.studies.sweep_report`, "
        "from the CSV files of `crar-drake sweep`.\n"
    )
    modes = mode_figures(results)
    for experiment in dict.fromkeys(figures.experiment for figures in modes):
        columns = [figures for figures in modes if figures.experiment == experiment]
        header = ["", *(f"{f.mode}, {_milliseconds(f.period)}" for f in columns)]
        cells = [_rows(figures) for figures in columns]
        rows = [
            [name, *(column[i][1] for column in cells)]
            for i, (name, _) in enumerate(cells[0])
        ]
        text += f"\n## Modes, {experiment}\n\n{markdown_table(header, rows)}"
    comparisons = compare(results)
    if comparisons:
        text += _clip_tables(comparisons) + _exceptions(comparisons, reasons or {})
    failed: dict[tuple[str, str], int] = {}
    for r in results:
        if r.error:
            reason = clip_label(r.motion), without_folders(r.error, r.motion)
            failed[reason] = failed.get(reason, 0) + 1
    if failed:
        text += "\n## Failed\n\n"
    for (clip, error), count in failed.items():
        text += f"- `{clip}`, {count} {'case' if count == 1 else 'cases'}: {error}\n"
    return text


def _clip_tables(comparisons: Sequence[Comparison]) -> str:
    """Clip by clip, lookahead / paper."""
    text = (
        "\n## Clip by clip, lookahead / paper\n\n"
        "Bold: the lookahead does not do better (torque and acceleration not below, "
        "or error above where the paper's mode holds its constraints).\n"
    )
    pages: dict[tuple, list[Comparison]] = {}
    for c in comparisons:
        key = (c.lookahead.experiment, c.lookahead.period, c.paper.period)
        pages.setdefault(key, []).append(c)
    for (experiment, period, paper_period), page in pages.items():
        against = (
            f"{_milliseconds(period)} / {_milliseconds(paper_period)}"
            if paper_period != period
            else _milliseconds(period)
        )
        rows = [
            [
                clip_label(c.lookahead.motion),
                f"{c.lookahead.duration:.1f} s",
                _both(c, "rms_task_error", 1e3, 1),
                _both(c, "peak_torque", 1.0, 0),
                _both(c, "rms_acceleration", 1.0, 1),
                _both(c, "smallest_distance", 1e3, 1),
                f"{c.lookahead.penetrating} / {c.paper.penetrating}",
                f"{c.lookahead.beyond_limit} / {c.paper.beyond_limit}",
            ]
            for c in page
        ]
        header = [
            "clip",
            "duration",
            "task error [mm]",
            "peak torque [Nm]",
            "rms acceleration [rad/s²]",
            "smallest distance [mm]",
            "samples penetrating",
            "samples beyond a limit",
        ]
        text += f"\n### {experiment}, {against}\n\n{markdown_table(header, rows)}"
    return text


def _exceptions(comparisons: Sequence[Comparison], reasons: Mapping[str, str]) -> str:
    """Every clip on which the lookahead does not do better, and in what."""
    text = "\n## Where the lookahead does not do better\n\n"
    units = {
        "peak_torque": ("peak torque", 1.0, "Nm", 0),
        "rms_acceleration": ("rms acceleration", 1.0, "rad/s²", 1),
        "rms_task_error": ("task error", 1e3, "mm", 1),
    }
    lines = ""
    for c in comparisons:
        parts = []
        for name in c.not_better:
            title, factor, unit, digits = units[name]
            here, there = (
                _number(factor * getattr(r, name), unit, digits)
                for r in (c.lookahead, c.paper)
            )
            more = getattr(c.lookahead, name) - getattr(c.paper, name)
            share = more / max(getattr(c.paper, name), 1e-12)
            parts.append(f"{title} {here}, paper {there} ({100 * share:+.1f} %)")
        if parts:
            holds = "violates" if c.paper.violated else "holds"
            parts.append(f"paper {holds} its constraints")
            place = f"{clip_label(c.lookahead.motion)}, {c.lookahead.experiment}"
            if place in reasons:
                parts.append(reasons[place])
            lines += f"- {_place(c.lookahead)}: {'; '.join(parts)}\n"
    return text + (lines or "Nowhere.\n")


# --- the plot ---------------------------------------------------------------------


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
            key=_clip_order,
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
                    label=f"{figures.mode}, {_milliseconds(figures.period)}",
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


# --- small helpers ----------------------------------------------------------------


def _place(result: Result) -> str:
    return (
        f"`{clip_label(result.motion)}`, {result.experiment}, "
        f"{result.constraints}, {_milliseconds(result.period)}"
    )


def _both(comparison: Comparison, name: str, factor: float, digits: int) -> str:
    """`lookahead / paper`, bold where the lookahead does not do better."""
    here, there = (
        _number(factor * getattr(r, name), "", digits)
        for r in (comparison.lookahead, comparison.paper)
    )
    return (
        f"**{here}** / {there}"
        if name in comparison.not_better
        else f"{here} / {there}"
    )


def _at(result: Result | None, name: str, factor: float, unit: str, digits: int) -> str:
    """A figure and the clip that it is of."""
    if result is None:
        return _MISSING
    value = _number(factor * getattr(result, name), unit, digits)
    return f"{value} ({clip_label(result.motion)})"


def _number(value: float, unit: str, digits: int) -> str:
    if not math.isfinite(value):
        return _MISSING
    return f"{value:.{digits}f}" + (unit if unit == "°" else f" {unit}" if unit else "")


def _milliseconds(period: float) -> str:
    return f"{1e3 * period:g} ms"


def _reduce(function: Callable, values: Sequence[float]) -> float:
    return float(function(values)) if len(values) else math.nan


def _clip_order(motion: str) -> tuple:
    """Trials by number: 05_02 before 13_29 before 127_23."""
    parts = re.split(r"(\d+)", clip_label(motion))
    return ([int(part) if part.isdigit() else part for part in parts], motion)


def _experiment_order(experiment: str) -> tuple:
    return (experiment != "wrists", experiment)


def _reading_order(r: Result) -> tuple:
    return (
        _experiment_order(r.experiment),
        CONSTRAINTS.index(r.constraints),
        -LEVELS.index(r.level),
        r.period,
        _clip_order(r.motion),
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Writes the report of the CSV files that are there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", nargs="+", type=Path, help="CSV files of sweeps")
    parser.add_argument("--out", help="Markdown file for the report")
    parser.add_argument(
        "--reasons",
        type=Path,
        help='JSON file, "clip, experiment" to why the lookahead is not better',
    )
    parser.add_argument("--plot", help="picture (.png, .pdf, .svg) to draw as well")
    arguments = parser.parse_args(argv)
    for path in arguments.results:
        if not path.is_file():
            parser.error(f"{path}: there is no such file")
    results = merge(r for path in arguments.results for r in read_results(path))
    if not results:
        parser.error("there are no results in these files")
    reasons = {}
    if arguments.reasons:
        try:
            reasons = json.loads(arguments.reasons.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            parser.error(f"{arguments.reasons}: {error}")
    write_report(markdown_report(results, reasons), arguments.out)
    if arguments.plot:
        plot_sweep(results, arguments.plot)


if __name__ == "__main__":
    main()
