"""Figures of many runs: per mode, and modes side by side."""

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from benchmarks.sweep.cases import Case, Result
from crar_drake.law.parameters import CONSTRAINTS, LEVELS


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


def _reduce(function: Callable, values: Sequence[float]) -> float:
    return float(function(values)) if len(values) else math.nan


def clip_order(motion: str) -> tuple:
    """Trials by number: 05_02 before 13_29 before 127_23."""
    parts = re.split(r"(\d+)", clip_label(motion))
    return ([int(part) if part.isdigit() else part for part in parts], motion)


def experiment_order(experiment: str) -> tuple:
    return (experiment != "wrists", experiment)


def _reading_order(r: Result) -> tuple:
    return (
        experiment_order(r.experiment),
        list(CONSTRAINTS).index(r.constraints),
        -LEVELS.index(r.level),
        r.period,
        clip_order(r.motion),
    )


def milliseconds(period: float) -> str:
    """For people."""
    return f"{1e3 * period:g} ms"
