"""The page of what became of each robot."""

import importlib.metadata
import math
from collections.abc import Sequence

from benchmarks.page import Table
from benchmarks.robots.catalogue import SUBJECTS, Subject
from benchmarks.robots.trial import TOOL, Outcome
from benchmarks.robots.verdicts import NOT_LOOKED_AT, verdict

_HEADER = (
    "robot",
    "package",
    "task",
    "dances",
    "import / run",
    "rms error",
    "of size",
    "capsules",
    "meshes",
    "violations",
    "at top speed",
    "warnings",
)

_PAIRS = 2  # whose meshes penetrate, that are named


def tables(tried: Sequence[tuple[Subject, Outcome]]) -> list[Table]:
    """A row for each robot; who dances, arms, and who could not."""
    ran = [(s, o) for s, o in tried if not o.why]
    dancing = [_row(s, o) for s, o in ran if o.task != TOOL]
    arms = [_short(_row(s, o)) for s, o in ran if o.task == TOOL]
    stopped = [[s.name, s.package, s.kind, o.why] for s, o in tried if o.why]
    shown = [
        Table(_HEADER, dancing, "Dancing"),
        Table(_short(_HEADER), arms, "Arms"),
        Table(
            ("robot", "package", "what it is", "why"), stopped, "Those that could not"
        ),
    ]
    return [table for table in shown if table.rows]


def told(tried: Sequence[tuple[Subject, Outcome]]) -> str:
    """How many robots did what, in sentences."""
    ran = [(s, o) for s, o in tried if not o.why]
    dancing = [(s, o) for s, o in ran if o.task != TOOL]
    arms, clean = len(ran) - len(dancing), sum(not o.violations for _, o in ran)
    said = [verdict(s.name, o) for s, o in dancing]
    looked_at = len(said) - said.count(NOT_LOOKED_AT)
    kept_clear = sum(
        verdict(s.name, o) == "yes" and not o.violations_of_model for s, o in dancing
    )
    found = (
        f"Of {len(SUBJECTS)} robots in the catalogue {len(tried)} were tried. "
        f"{len(ran)} of these ran, {len(dancing)} the dance and {arms} an arm's "
        f"task, {clean} without any violation. The pictures of {looked_at} dancers "
        f"were looked at: {said.count('yes')} dance recognisably, {kept_clear} of them "
        "without a violation of capsules, limits or speeds."
    )
    known = {subject.name for subject, _ in tried}
    if untried := [s.name for s in SUBJECTS if s.name not in known]:
        found += f" Not tried: {'; '.join(untried)}."
    return found


def versions() -> str:
    """Which versions of the robots' packages these were."""
    found = []
    for package in sorted({subject.package for subject in SUBJECTS}):
        try:
            found.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            found.append(f"{package} (not installed)")
    return ", ".join(found)


def _short(row: Sequence[str]) -> list[str]:
    """Without what arms have not."""
    return [*row[:3], *row[4:]]


def _row(subject: Subject, outcome: Outcome) -> list[str]:
    o = outcome
    return [
        subject.name,
        subject.package,
        o.task.replace("upper-body", "seven points"),
        verdict(subject.name, o),
        f"{o.import_time:.0f} / {o.run_time:.0f} s",
        _mm(o.error),
        "–" if not o.size else f"{100 * o.error / o.size:.0f} %",
        _mm(o.capsules, 1),
        _mm(o.meshes, 1),
        _violations(o),
        "–" if o.at_top_speed is None else f"{100 * o.at_top_speed:.0f} %",
        str(len(o.warnings)) if o.warnings else "–",
    ]


def _violations(o: Outcome) -> str:
    counts = {
        "capsules": (o.penetrating, o.samples),
        "meshes": (o.meshes_penetrating, o.mesh_samples),
        "limits": (o.beyond_limit, o.samples),
        "speeds": (o.beyond_speed, o.samples),
    }
    found = [f"{what} {n} of {total}" for what, (n, total) in counts.items() if n]
    pairs = [" and ".join(pair) for pair in o.mesh_pairs]
    if len(pairs) > _PAIRS:
        pairs[_PAIRS:] = [f"{len(pairs) - _PAIRS} more"]
    if pairs:
        found.append("; ".join(pairs))
    return ", ".join(found) or "0"


def _mm(metres: float | None, digits: int = 0) -> str:
    if metres is None or not math.isfinite(metres):
        return "–"
    return f"{1e3 * metres:.{digits}f} mm"
