"""The numbers behind the report, as CSV files."""

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path

from benchmarks.section_iv.figures import (
    Bars,
    bar_data,
    frame_samples,
    violation_counts,
)
from benchmarks.section_iv.findings import Finding
from benchmarks.section_iv.plan import (
    EXPERIMENT_1,
    EXPERIMENT_2,
    SERIES,
    Plan,
)
from benchmarks.section_iv.simulate import Details, Outcome
from benchmarks.sweep.cases import Result
from crar_drake.files import write_whole
from crar_drake.results.log import SimulationLog

TABLES = "tables"


def write_tables(
    plan: Plan,
    outcomes: Mapping[str, Outcome],
    findings: Sequence[Finding],
    log: Callable[[str, str], SimulationLog],
    frame_rate: float,
    out: Path,
) -> list[str]:
    """Writes every table into `out`/tables and returns their names.

    Args:
        plan, outcomes, findings: of the reproduction.
        log: loads the dance's log of an experiment and a series.
        frame_rate: of the dance [1/s].
        out: folder of the reproduction.
    """
    tables = {
        "findings": _findings(findings),
        "results": _results(outcomes),
        "figure-2": _violations(log(EXPERIMENT_1, "raw"), frame_rate),
    }
    for name in ("raw", *SERIES):
        tables[f"figure-3-{name}"] = _distances(log(EXPERIMENT_2, name), frame_rate)
    for name, data in bar_data(plan, outcomes).items():
        tables[name] = _bars(data)
    tables["damping"] = _damping(plan, outcomes)
    for name, rows in tables.items():
        write_whole(out / TABLES / f"{name}.csv", _text(rows))
    return list(tables)


def _text(rows: Iterable[Sequence]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def _findings(findings: Sequence[Finding]) -> list[list]:
    names = ["source", "statement", "criterion", "verdict", "figures", "reason"]
    return [
        names,
        *([getattr(finding, name) for name in names] for finding in findings),
    ]


def _results(outcomes: Mapping[str, Outcome]) -> list[list]:
    """Every simulation: `Result` and `Details`, SI units."""
    figures = [f.name for f in fields(Result)]
    details = [f.name for f in fields(Details)]
    rows: list[list] = [["name", "series", *figures, *details]]
    for name, outcome in outcomes.items():
        more = asdict(outcome.details) if outcome.details else {}
        rows.append(
            [
                name,
                outcome.simulation.series,
                *(getattr(outcome.result, figure) for figure in figures),
                *(more.get(detail, "") for detail in details),
            ]
        )
    return rows


def _violations(raw: SimulationLog, frame_rate: float) -> list[list]:
    counts = violation_counts(raw)[frame_samples(raw, frame_rate)]
    return [["frame", "violations"], *enumerate(counts.tolist())]


def _distances(log: SimulationLog, frame_rate: float) -> list[list]:
    """Per frame, every pair's distance [m]."""
    shown = frame_samples(log, frame_rate)
    rows = [[f"{d:.6f}" for d in row] for row in log.signed_distances[shown]]
    header = ["frame", *log.pair_names.tolist()]
    return [header, *([i, *row] for i, row in enumerate(rows))]


def _bars(data: Bars) -> list[list]:
    return [
        ["motion", *(f"{name} [{data.unit}]" for name in data.series)],
        *(
            [motion, *row]
            for motion, row in zip(data.motions, data.values.tolist(), strict=True)
        ),
    ]


def _damping(plan: Plan, outcomes: Mapping[str, Outcome]) -> list[list]:
    header = ["level", "constraints", "lambda [m]", "rms task error [m]", "power [W]"]
    rows: list[list] = [header]
    for (level, constraints, value), name in plan.damping.items():
        result = outcomes[name].result
        rows.append(
            [level, constraints, value, result.rms_task_error, result.mean_power]
        )
    return rows
