"""The comparison as tables for the terminal and as the page in docs/."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.peers.judge import Figures
from benchmarks.peers.problem import CASES
from crar_drake.studies.tables import markdown_table


@dataclass(frozen=True)
class Row:
    """One controller on one case.

    Attributes:
        name: of the controller.
        python: whether Python assembles each of its steps.
        case: key of CASES.
        settings: what it was run with.
        versions: distribution to version, and that of Python.
        figures: what it was judged by.
        median_time, p99_time: of a step [s].
    """

    name: str
    python: bool
    case: str
    settings: dict
    versions: dict[str, str]
    figures: Figures
    median_time: float
    p99_time: float


HEADER = (
    "controller",
    "step time (p99)",
    "smallest distance",
    "penetrating",
    "beyond a limit",
    "failed, frozen",
    "rms error",
    "rms (peak) acceleration",
)

NOTES = {
    "PlaCo, kinematics": "velocities from a QP in C++, called from Python once a step",
    "PlaCo, dynamics": "accelerations and torques from a QP in C++, called from Python "
    "once a step",
    "Pink": "velocities from a QP that Python assembles; its `SelfCollisionBarrier`. "
    "The barrier takes its direction from the two nearest points, which swap places in "
    "a penetration, so that it then points inwards",
    "mink": "velocities from a QP that Python assembles; its "
    "`CollisionAvoidanceLimit`. It leaves out pairs of parent and child links (each "
    "hand with its own upper arm), and its bound on a displacement is divided by the "
    "period, so that gains as small as the period are in the grid besides those that "
    "its documentation names",
    "lookahead, defaults": "what `CrarParameters()` has",
    "lookahead, tuned, compiled": "the same law where Numba is installed",
    "lookahead, defaults, compiled": "likewise",
    "Drake, differential IK": "`DifferentialInverseKinematicsSystem` with "
    "`CollisionConstraint` and `JointVelocityLimitConstraint`, its port evaluated from "
    "Python once a step",
}


def cells(row: Row) -> list[str]:
    """A row as text, in the order of HEADER."""
    f = row.figures
    limit = "0"
    if f.beyond_limit:
        limit = f"{_share(f.beyond_limit)}, {np.degrees(f.limit_excess):.2f}°"
    penetrating = _share(f.penetrating)
    if row.case == "start_inside" and f.penetrating:
        until = "never out" if np.isinf(f.clear_at) else f"out at {f.clear_at:.2f} s"
        penetrating += f", {until}"
    return [
        row.name,
        f"{1e3 * row.median_time:.2f} ({1e3 * row.p99_time:.2f}) ms",
        f"{1e3 * f.smallest_distance:.1f} mm",
        penetrating,
        limit,
        f"{f.failed}, {f.frozen}",
        f"{1e3 * f.error:.1f} mm",
        f"{f.rms_acceleration:.1f} ({f.peak_acceleration:.0f}) rad/s²",
    ]


def tables(rows: Sequence[Row]) -> list[Table]:
    """A table per case, for the terminal."""
    made = []
    for case, what in CASES.items():
        table = Table(title=f"{case}: {what}", title_justify="left")
        for column in HEADER:
            table.add_column(column)
        for row in rows:
            if row.case == case:
                table.add_row(*cells(row))
        made.append(table)
    return made


def page(rows: Sequence[Row], chosen: dict[str, dict[str, dict]]) -> str:
    """docs/measurements/peers.md, from the rows and from what tuning kept."""
    template = (Path(__file__).parent / "page.md").read_text()
    parts = {
        f"{{{{{case}}}}}": markdown_table(
            HEADER, [cells(row) for row in rows if row.case == case]
        )
        for case in CASES
    }
    parts["{{grids}}"] = _grids(chosen)
    parts["{{settings}}"] = _settings(rows)
    parts["{{machine}}"] = machine()
    parts["{{versions}}"] = _versions(rows)
    for mark, text in parts.items():
        template = template.replace(mark, text.rstrip("\n"))
    return template


def machine() -> str:
    """Processor and cores of this machine."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(x.split(":", 1)[1] for x in lines if x.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return f"{model.strip()}, {os.cpu_count()} cores, {platform.system()}"


def _grids(chosen: dict[str, dict[str, dict]]) -> str:
    """What the grids reached on the first case."""

    def both(figures: dict[str, float] | None) -> str:
        if figures is None:
            return "–"
        error, acceleration = 1e3 * figures["error"], figures["acceleration"]
        return f"{error:.1f} mm, {acceleration:.1f} rad/s²"

    return markdown_table(
        ("controller", "tried", "held", "least error", "least rms acceleration"),
        [
            [name, str(one["tried"]), str(one["held"])]
            + [both(one["least_error"]), both(one["least_acceleration"])]
            for name, one in ((n, cases["crossing"]) for n, cases in chosen.items())
        ],
    )


def _settings(rows: Sequence[Row]) -> str:
    """The settings of each controller, once where all cases have the same."""
    text = ""
    for name in dict.fromkeys(row.name for row in rows):
        own = [row for row in rows if row.name == name]
        note = NOTES.get(name, "")
        text += f"* **{name}**{': ' + note if note else ''}.\n"
        if all(row.settings == own[0].settings for row in own):
            text += f"  * all cases: {_as_code(own[0].settings)}\n"
        else:
            for row in own:
                text += f"  * {row.case}: {_as_code(row.settings)}\n"
    return text


def _as_code(settings: dict) -> str:
    """One line in code quotes."""
    return f"`{json.dumps(settings)}`" if settings else "as they come"


def _versions(rows: Sequence[Row]) -> str:
    """Distributions and versions that took part."""
    found = {pair for row in rows for pair in row.versions.items()}
    ordered = sorted(found, key=lambda pair: (pair[0] != "python", pair))
    return ", ".join(f"{name} {number}" for name, number in ordered)


def _share(share: float) -> str:
    if share == 0.0:
        return "0"
    return "<1 %" if share < 0.01 else f"{100.0 * share:.0f} %"
