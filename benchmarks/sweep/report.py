"""What a sweep shows: tables."""

import math
from collections.abc import Iterable

from benchmarks.page import Table
from benchmarks.sweep.cases import Result
from benchmarks.sweep.figures import (
    Comparison,
    ModeFigures,
    clip_label,
    compare,
    merge,
    milliseconds,
    mode_figures,
)

_MISSING = "–"


def sweep_tables(results: Iterable[Result]) -> list[Table]:
    """A table per experiment, with a column per mode and control period; and clip by
    clip, where there are both, the lookahead beside the paper's mode."""
    results = merge(results)
    experiments: dict[str, list[ModeFigures]] = {}
    for figures in mode_figures(results):
        experiments.setdefault(figures.experiment, []).append(figures)
    tables = []
    for experiment, columns in experiments.items():
        header = ["", *(f"{f.mode}, {milliseconds(f.period)}" for f in columns)]
        cells = [_rows(figures) for figures in columns]
        rows = [
            [name, *(column[i][1] for column in cells)]
            for i, (name, _) in enumerate(cells[0])
        ]
        tables.append(Table(header, rows, f"Modes, {experiment}"))
    pages: dict[tuple, list[Comparison]] = {}
    for c in compare(results):
        key = (c.lookahead.experiment, c.lookahead.period, c.paper.period)
        pages.setdefault(key, []).append(c)
    return tables + [_clips(*key, page) for key, page in pages.items()]


def _clips(
    experiment: str, period: float, paper_period: float, page: list[Comparison]
) -> Table:
    """Clip by clip, lookahead / paper."""
    periods = dict.fromkeys((milliseconds(period), milliseconds(paper_period)))
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
    header = (
        "clip",
        "duration",
        "task error [mm]",
        "peak torque [Nm]",
        "rms acceleration [rad/s²]",
        "smallest distance [mm]",
        "samples penetrating",
        "samples beyond a limit",
    )
    title = f"Clip by clip, lookahead / paper: {experiment}, {' / '.join(periods)}"
    return Table(header, rows, title)


def _both(comparison: Comparison, name: str, factor: float, digits: int) -> str:
    """`lookahead / paper`."""
    return " / ".join(
        _number(factor * getattr(result, name), "", digits)
        for result in (comparison.lookahead, comparison.paper)
    )


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
