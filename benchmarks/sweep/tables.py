"""What a sweep shows: a column a mode; and the lookahead beside the paper's mode."""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from benchmarks.page import Table
from benchmarks.sweep.cases import Result, clip_label

_MISSING = "–"


def sweep_tables(results: Iterable[Result]) -> list[Table]:
    """A table per experiment, with a column per mode and control period; and clip by
    clip, where there are both, the lookahead beside the paper's mode."""
    modes: dict[str, dict[tuple, list[Result]]] = {}
    for r in results:
        of = modes.setdefault(r.experiment, {})
        of.setdefault((r.constraints, r.level, r.period), []).append(r)
    tables = []
    for experiment, columns in modes.items():
        cells = [_rows(of) for of in columns.values()]
        rows = [
            [row[0][0], *(text for _, text in row)] for row in zip(*cells, strict=True)
        ]
        tables.append(Table(["", *map(_mode, columns)], rows, f"Modes, {experiment}"))
    for experiment, columns in modes.items():
        for (constraints, level, period), of in columns.items():
            papers = [mode for mode in columns if mode[:2] == ("paper", level)]
            if constraints == "lookahead" and papers:
                # At the same period if there is such a run, else the shortest.
                paper = min(papers, key=lambda mode: (mode[2] != period, mode[2]))
                periods = dict.fromkeys(map(milliseconds, (period, paper[2])))
                title = f"{experiment}, {' / '.join(periods)}"
                tables.append(_clips(title, of, columns[paper]))
    return tables


def _clips(title: str, ahead: list[Result], papers: list[Result]) -> Table:
    """Clip by clip, lookahead / paper, of those that ran in both."""
    of_paper = {r.motion: r for r in papers if not r.error}
    columns: tuple[tuple[str, str, float, int], ...] = (
        ("task error [mm]", "rms_task_error", 1e3, 1),
        ("peak torque [Nm]", "peak_torque", 1.0, 0),
        ("rms acceleration [rad/s²]", "rms_acceleration", 1.0, 1),
        ("smallest distance [mm]", "smallest_distance", 1e3, 1),
        ("samples penetrating", "penetrating", 1.0, 0),
        ("samples beyond a limit", "beyond_limit", 1.0, 0),
    )

    def row(r: Result) -> list[str]:
        both = r, of_paper[r.motion]
        return [
            clip_label(r.motion),
            f"{r.duration:.1f} s",
            *(
                " / ".join(_number(k * getattr(x, name), "", digits) for x in both)
                for _, name, k, digits in columns
            ),
        ]

    header = ("clip", "duration", *(column[0] for column in columns))
    rows = [row(r) for r in ahead if not r.error and r.motion in of_paper]
    return Table(header, rows, f"Clip by clip, lookahead / paper: {title}")


def headline(result: Result) -> str:
    """One line for one result, as it comes in."""
    place = (
        f"{clip_label(result.motion)} {result.experiment} {result.constraints} "
        f"{milliseconds(result.period)}"
    )
    if result.error:
        return f"{place}: failed: {result.error}"
    unclear = f", braking path not clear at {result.unclear} steps"
    return (
        f"{place}: {_number(1e3 * result.smallest_distance, 'mm', 1)} near, error "
        f"{_number(1e3 * result.rms_task_error, 'mm', 1)}"
        + ", in violation" * result.violated
        + ", beyond a speed limit" * bool(result.beyond_speed)
        + unclear * bool(result.unclear)
    )


def failures(results: Iterable[Result]) -> list[str]:
    """A line for every case that could not be run."""
    return [headline(r) for r in results if r.error]


def _rows(results: Sequence[Result]) -> list[tuple[str, str]]:
    """Name and text of everything that is reported of a mode."""
    ran = [r for r in results if not r.error]

    def finite(name: str, above: float = -math.inf) -> list[Result]:
        return [r for r in ran if above < getattr(r, name) < math.inf]

    def total(name: str) -> str:
        return f"{sum(getattr(r, name) for r in ran)}"

    def over_clips(reduce: Callable, name: str, factor: float, *form) -> str:
        values = [getattr(r, name) for r in finite(name)]
        return _number(factor * float(reduce(values)), *form) if values else _MISSING

    def at(choose: Callable, name: str, factor: float, *form, above=-math.inf) -> str:
        """A figure, if one is above that, and the clip that it is of."""
        r = choose(finite(name, above), key=lambda r: getattr(r, name), default=None)
        if r is None:
            return _MISSING
        return f"{_number(factor * getattr(r, name), *form)} ({clip_label(r.motion)})"

    nearest = min(
        finite("smallest_distance"), key=lambda r: r.smallest_distance, default=None
    )
    return [
        ("clips", f"{len(ran)}"),
        ("clips in violation", total("violated")),
        ("samples", total("samples")),
        ("samples penetrating", total("penetrating")),
        ("samples beyond a limit", total("beyond_limit")),
        ("smallest distance", at(min, "smallest_distance", 1e3, "mm", 1)),
        ("of the pair", nearest.smallest_pair if nearest else _MISSING),
        (
            "farthest beyond a limit",
            at(max, "largest_excess", 180.0 / math.pi, "°", 2, above=0.0),
        ),
        ("samples beyond a speed limit", total("beyond_speed")),
        (
            "most beyond a speed limit",
            at(max, "largest_speed_excess", 1.0, "rad/s", 2, above=0.0),
        ),
        ("steps corrected", over_clips(np.mean, "corrected", 100.0, "%", 2)),
        ("steps scaled", over_clips(np.mean, "scaled", 100.0, "%", 2)),
        ("steps with a path not clear", total("unclear")),
        ("smallest path clearance", at(min, "path_clearance", 1e3, "mm", 1)),
        ("longest held back", at(max, "longest_held_back", 1.0, "s", 2)),
        ("mean task error", over_clips(np.mean, "rms_task_error", 1e3, "mm", 1)),
        ("worst task error", at(max, "rms_task_error", 1e3, "mm", 1)),
        ("mean power", over_clips(np.mean, "mean_power", 1.0, "W", 1)),
        ("median peak torque", over_clips(np.median, "peak_torque", 1.0, "Nm", 0)),
        (
            "median rms acceleration",
            over_clips(np.median, "rms_acceleration", 1.0, "rad/s²", 1),
        ),
        ("failed", f"{len(results) - len(ran)}"),
    ]


def _mode(mode: tuple[str, str, float]) -> str:
    """Constraints, the level where it is not the usual one, and the period."""
    constraints, level, period = mode
    named = "" if level == "acceleration" else f", {level} level"
    return f"{constraints}{named}, {milliseconds(period)}"


def milliseconds(period: float) -> str:
    """For people."""
    return f"{1e3 * period:g} ms"


def _number(value: float, unit: str, digits: int) -> str:
    if not math.isfinite(value):
        return _MISSING
    return f"{value:.{digits}f}" + (unit if unit == "°" else f" {unit}" if unit else "")
