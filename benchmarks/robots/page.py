"""The page of what became of each robot."""

from __future__ import annotations

import importlib.metadata
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

from benchmarks.robots.catalogue import SUBJECTS, Subject
from benchmarks.robots.trial import TOOL, WHOLE_BODY, Outcome
from benchmarks.robots.verdicts import NOT_LOOKED_AT, verdict
from crar_drake.studies.tables import markdown_table, write_report

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


def write_page(
    tried: Sequence[tuple[Subject, Outcome]], motion: str, path: Path | None
) -> None:
    """Prints the tables, and writes the page if there is a path for it.

    Args:
        tried: robots and what became of them.
        motion: what those with two arms did.
        path: Markdown file.
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
    packages = sorted({subject.package for subject in SUBJECTS})
    duration = max((o.duration for _, o in dancing), default=0.0)
    text = f"""# Robots that nobody corrected

    pip install '.[robots-table,compiled]'
    pip install --no-deps 'holosoma-retargeting>=0.1'  # without torch
    crar-drake fetch 05_02
    python -m benchmarks.robots --duration 4 --sheets out/sheets --page
    docs/measurements/robots.md

This page is written by that command. It imports robots of packages on PyPI with
`crar-drake import-robot FILE --lock hands,head,other`, corrects nothing, and sets each
the task that its import allows:

* *whole body*: two arms, two legs, a root that floats: seven points of the upper body
  and the poses of both feet follow {motion}, the first {duration:.1f} s, with the
  settings of the shipped scenario `g1_whole_body_dance`; where *knees* stands they are
  targets, too;
* *seven points*: two arms on a base that drives or is mounted: the same without feet,
  with default settings;
* *tool*: a single arm's tool visits places that its joints reach.

A row stays until `--again` runs it anew, so that rows are of several versions. The
control period is 5 ms, the constraints are the lookahead. *Capsules* and *meshes*
are the smallest distances between links, judged at every control step and every 50 ms.
A *violation* is a sample in which capsules or meshes penetrate, or a joint is beyond
its limit or its speed. Meshes can penetrate where capsules do not cover them or nobody
watches the pair ([what to do](your-robot.md#what-the-report-warns-of)); which they are
is said. *Size* is the height of the neck, or the tool's longest way; errors count from
when the targets are blended in. *Import* and *run* are CPU seconds, the run without
compiling; *at top speed* is the share of control steps in which a joint moves as fast
as its limit lets it; *warnings* are lines of the import's report.

*Dances* is what a look at pictures of eight moments said (`--sheets`), the robot's
meshes above the performer: "yes" where the one is recognised in the other, else what is
wrong. Nothing computes it; a verdict is of one run, and is dropped where the error of a
later one differs by 3 mm. The four seconds are a stand with crossed legs and one raised
arm.

Of {len(SUBJECTS)} robots in the catalogue {len(tried)} were tried. {len(ran)} of these
ran, {len(dancing)} the dance and {len(arms)} an arm's task, {clean} without any
violation. The pictures of {looked_at} dancers were looked at: {said.count("yes")} dance
recognisably, {kept_clear} of them without a violation of capsules, limits or speeds. No
hand work was done on any.
"""
    if dancing:
        text += f"""
## Dancing

{markdown_table(_HEADER, [_row(s, o) for s, o in dancing])}"""
    if arms:
        text += f"""
## Arms

{markdown_table(_short(_HEADER), [_short(_row(s, o)) for s, o in arms])}"""
    if stopped:
        rows = [[s.name, s.package, s.kind, o.why] for s, o in stopped]
        text += f"""
## Those that could not

{markdown_table(("robot", "package", "what it is", "why"), rows)}"""
    known = {subject.name for subject, _ in tried}
    if untried := [s.name for s in SUBJECTS if s.name not in known]:
        text += "\n" + _wrapped(f"Not tried: {'; '.join(untried)}.")
    text += "\n" + _wrapped(_versions(packages))
    write_report(text, path)


def _wrapped(text: str) -> str:
    return textwrap.fill(text, 88, break_on_hyphens=False) + "\n"


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
    told = [f"{what} {n} of {total}" for what, (n, total) in counts.items() if n]
    pairs = [" and ".join(pair) for pair in o.mesh_pairs]
    if len(pairs) > _PAIRS:
        pairs[_PAIRS:] = [f"{len(pairs) - _PAIRS} more"]
    if pairs:
        told.append("; ".join(pairs))
    return ", ".join(told) or "0"


def _mm(metres: float | None, digits: int = 0) -> str:
    if metres is None or not math.isfinite(metres):
        return "–"
    return f"{1e3 * metres:.{digits}f} mm"


def _versions(packages: Sequence[str]) -> str:
    """Which versions this was."""
    told = []
    for package in packages:
        try:
            told.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            told.append(f"{package} (not installed)")
    return f"Versions: {', '.join(told)}."
