"""What a sweep shows: tables for the terminal and the documentation, and a plot.

python -m benchmarks.sweep.report results.csv [more.csv ...]
    [--reasons reasons.json] [--out sweep.md] [--plot sweep.png]
"""

import argparse
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rich.table import Table

from benchmarks.page import Table as PageTable
from benchmarks.sweep.cases import Result, read_results
from benchmarks.sweep.figures import (
    Comparison,
    ModeFigures,
    clip_label,
    compare,
    experiment_order,
    merge,
    milliseconds,
    mode_figures,
    without_folders,
)
from benchmarks.sweep.plot import plot_sweep
from crar_drake.files import write_whole

_MISSING = "–"


# --- the terminal -----------------------------------------------------------------


def sweep_tables(results: Iterable[Result]) -> list[Table]:
    """A table per experiment and control period, with a column per mode."""
    pages: dict[tuple[str, float], list[ModeFigures]] = {}
    for figures in mode_figures(results):
        pages.setdefault((figures.experiment, figures.period), []).append(figures)
    tables = []
    for (experiment, period), modes in sorted(
        pages.items(), key=lambda page: (experiment_order(page[0][0]), page[0][1])
    ):
        table = Table(
            title=f"{experiment}, control period {milliseconds(period)}",
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
        f"{milliseconds(result.period)}"
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
        f"{milliseconds(r.period)}: {r.error}"
        for r in merge(results)
        if r.error
    ]


def _rows(figures: ModeFigures) -> list[tuple[str, str]]:
    """Name and text of everything that is reported of a mode."""
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
        "This page is written by `python -m benchmarks.sweep.report`, "
        "from the CSV files of `python -m benchmarks.sweep`.\n"
    )
    modes = mode_figures(results)
    for experiment in dict.fromkeys(figures.experiment for figures in modes):
        columns = [figures for figures in modes if figures.experiment == experiment]
        header = ["", *(f"{f.mode}, {milliseconds(f.period)}" for f in columns)]
        cells = [_rows(figures) for figures in columns]
        rows = [
            [name, *(column[i][1] for column in cells)]
            for i, (name, _) in enumerate(cells[0])
        ]
        text += f"\n## Modes, {experiment}\n\n{PageTable(header, rows).markdown()}"
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
            f"{milliseconds(period)} / {milliseconds(paper_period)}"
            if paper_period != period
            else milliseconds(period)
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
        text += f"\n### {experiment}, {against}\n\n{PageTable(header, rows).markdown()}"
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


# --- small helpers ----------------------------------------------------------------


def _place(result: Result) -> str:
    return (
        f"`{clip_label(result.motion)}`, {result.experiment}, "
        f"{result.constraints}, {milliseconds(result.period)}"
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
    text = markdown_report(results, reasons)
    print(text)
    if arguments.out:
        write_whole(arguments.out, text)
    if arguments.plot:
        plot_sweep(results, arguments.plot)


if __name__ == "__main__":
    main()
