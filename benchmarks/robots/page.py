"""The page of what became of each robot."""

import importlib.metadata
import math
from collections.abc import Sequence

from benchmarks import page
from benchmarks.robots.catalogue import SUBJECTS, Subject
from benchmarks.robots.trial import TOOL, WHOLE_BODY, Outcome
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
    "feet: slip, median / worst",
    "lowest point",
    "at top speed",
    "warnings",
)

_PAIRS = 2  # whose meshes penetrate, that are named


def page_part(tried: Sequence[tuple[Subject, Outcome]], command: str = "") -> page.Part:
    """What became of the robots, as the page keeps it.

    Args:
        tried: robots and what became of them.
        command: that tried them.
    """
    ran = [(s, o) for s, o in tried if not o.why]
    stopped = [(s, o) for s, o in tried if o.why]
    dancing = [(s, o) for s, o in ran if o.task != TOOL]
    arms = [(s, o) for s, o in ran if o.task == TOOL]
    clean = sum(not o.violations for _, o in ran)
    said = [verdict(s.name, o) for s, o in dancing]
    looked_at = len(said) - said.count(NOT_LOOKED_AT)
    kept_clear = sum(
        verdict(s.name, o) == "yes" and not o.violations_of_model for s, o in dancing
    )
    found = (
        f"Of {len(SUBJECTS)} robots in the catalogue {len(tried)} were tried. "
        f"{len(ran)} of these ran, {len(dancing)} the dance and {len(arms)} an arm's "
        f"task, {clean} without any violation. The pictures of {looked_at} dancers "
        f"were looked at: {said.count('yes')} dance recognisably, {kept_clear} of them "
        "without a violation of capsules, limits or speeds."
    )
    known = {subject.name for subject, _ in tried}
    if untried := [s.name for s in SUBJECTS if s.name not in known]:
        found += f" Not tried: {'; '.join(untried)}."
    tables = [
        page.Table(_HEADER, [_row(s, o) for s, o in dancing], "Dancing"),
        page.Table(_short(_HEADER), [_short(_row(s, o)) for s, o in arms], "Arms"),
        page.Table(
            ("robot", "package", "what it is", "why"),
            [[s.name, s.package, s.kind, o.why] for s, o in stopped],
            "Those that could not",
        ),
    ]
    packages = sorted({subject.package for subject in SUBJECTS})
    law = f"{_versions(packages)}; {page.version_line()}"
    shown = [table for table in tables if table.rows]
    return page.Part(command, page.machine_line(), law, shown, found)


def _short(row: Sequence[str]) -> list[str]:
    """Without what arms have not."""
    return [*row[:3], *row[4:10], *row[12:]]


def _row(subject: Subject, outcome: Outcome) -> list[str]:
    o = outcome
    error = _mm(o.error)
    if o.task == WHOLE_BODY:
        error += f"; feet {_mm(o.feet_error)}"
    slip = "–"
    if o.contacts:
        slip = f"{_mm(o.median_slip, 1)} / {_mm(o.worst_slip, 1)}"
    return [
        subject.name,
        subject.package,
        o.task.replace("-", " ").replace("upper body", "seven points")
        + (", knees" if o.knees else ""),
        verdict(subject.name, o),
        f"{o.import_time:.0f} / {o.run_time:.0f} s",
        error,
        "–" if not o.size else f"{100 * o.error / o.size:.0f} %",
        _mm(o.capsules, 1),
        _mm(o.meshes, 1),
        _violations(o),
        slip,
        _mm(o.lowest, 1),
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


def _versions(packages: Sequence[str]) -> str:
    """Which versions this was."""
    found = []
    for package in packages:
        try:
            found.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            found.append(f"{package} (not installed)")
    return f"Versions: {', '.join(found)}"
