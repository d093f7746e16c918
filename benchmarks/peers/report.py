"""The tables of the comparison."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.page import Table
from benchmarks.peers.judge import Figures


@dataclass(frozen=True)
class Row:
    """One controller on one case.

    Attributes:
        name: of the controller.
        case: key of CASES.
        settings: what it was run with.
        versions: distribution to version, and that of Python.
        figures: what it was judged by.
        median_time, p99_time: of a step [s].
    """

    name: str
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
    "OSCBF, velocities": "barriers of velocities by cbfpy over frax's kinematics, a "
    "step compiled by JAX; distances of capsules are written for it here, and the "
    "twelve nearest become rows",
    "OSCBF, accelerations": "the same with barriers of second order, as for torques",
    "embodik": "prioritised velocities in C++, called from Python once a step; all "
    "points in the first priority",
    "lookahead, default": "what `LookaheadParameters()` has: accelerations are planned "
    "0.1 s ahead",
    "the paper's law, made safe": "a feedback of the present error, its gains the "
    "paper's",
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


TITLES = {
    "crossing": "Hands swung through each other and the chest",
    "start_inside": "The same swing, from a start 15 mm inside",
    "target_inside": "A target that stays inside",
}


def tables(rows: Sequence[Row], chosen: dict[str, dict[str, dict]]) -> list[Table]:
    """The figures of all controllers and cases, how they were set, and versions.

    Args:
        rows: of all controllers and cases.
        chosen: what tuning kept.
    """
    found = [
        Table(HEADER, [cells(row) for row in rows if row.case == case], title)
        for case, title in TITLES.items()
    ]
    found.insert(1, _grids(chosen))
    names = dict.fromkeys(row.name for row in rows)
    notes = [[name, NOTES[name]] for name in names if name in NOTES]
    found.append(Table(["controller", "what it is"], notes, "Controllers"))
    return [*found, _settings(rows), _versions(rows)]


def _grids(chosen: dict[str, dict[str, dict]]) -> Table:
    """What the grids reached on the first case."""

    def both(figures: dict[str, float] | None) -> str:
        if figures is None:
            return "–"
        error, acceleration = 1e3 * figures["error"], figures["acceleration"]
        return f"{error:.1f} mm, {acceleration:.1f} rad/s²"

    return Table(
        ("controller", "tried", "held", "least error", "least rms acceleration"),
        [
            [name, str(one["tried"]), str(one["held"])]
            + [both(one["least_error"]), both(one["least_acceleration"])]
            for name, one in ((n, cases["crossing"]) for n, cases in chosen.items())
        ],
        "What the grids of settings reach in that case",
    )


def _settings(rows: Sequence[Row]) -> Table:
    """The settings of each controller, once where all cases have the same."""
    lines = []
    for name in dict.fromkeys(row.name for row in rows):
        own = [row for row in rows if row.name == name]
        if all(row.settings == own[0].settings for row in own):
            lines.append([name, "all cases", _as_code(own[0].settings)])
        else:
            lines += [[name, row.case, _as_code(row.settings)] for row in own]
    return Table(["controller", "case", "settings"], lines, "Settings")


def _as_code(settings: dict) -> str:
    """One line in code quotes."""
    return f"`{json.dumps(settings)}`" if settings else "as they come"


def _versions(rows: Sequence[Row]) -> Table:
    """Distributions that took part; some in several environments."""
    found: dict[str, set[str]] = {}
    for name, number in (pair for row in rows for pair in row.versions.items()):
        found.setdefault(name, set()).add(number)
    lines = [[name, ", ".join(sorted(found[name]))] for name in sorted(found)]
    return Table(["package", "versions"], lines, "Versions")


def _share(share: float) -> str:
    if share == 0.0:
        return "0"
    return "<1 %" if share < 0.01 else f"{100.0 * share:.0f} %"
