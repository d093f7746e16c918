"""What a reproduction tells: tables of its findings and of its simulations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.page import Table
from benchmarks.section_iv.findings import Finding
from benchmarks.section_iv.plan import EXPERIMENT_1, EXPERIMENT_2, LABELS, Plan
from benchmarks.section_iv.simulate import Outcome
from benchmarks.sweep.figures import clip_label

FIGURES = "figures"
TITLES = {
    EXPERIMENT_1: "Experiment 1, two wrists, m = 6",
    EXPERIMENT_2: "Experiment 2, seven points, m = 21",
}
HEADER = (
    *("motion", "controller", "rms task error [mm]", "mean power [W]"),
    *("smallest distance [mm]", "samples in violation [%]", "peak torque [Nm]"),
    "rms acceleration [rad/s²]",
)


@dataclass(frozen=True)
class Reproduction:
    """Everything that is told.

    Attributes:
        plan, outcomes, findings: see there.
        figures: files, by name, in reading order.
        wall_time: that this call took for how many simulations [s].
        simulated: number of simulations that it ran; the others were there.
    """

    plan: Plan
    outcomes: Mapping[str, Outcome]
    findings: Sequence[Finding]
    figures: Mapping[str, Path]
    wall_time: float
    simulated: int


def tables(made: Reproduction) -> list[Table]:
    """The findings, and what was simulated."""
    findings = [
        [f.source, f.statement, f.verdict, f.figures, f.reason, f.criterion]
        for f in made.findings
    ]
    header = ("paper", "finding", "here", "figures", "why", "criterion")
    return [
        Table(header, findings, "The paper's findings"),
        *(_results(made, experiment) for experiment in TITLES),
    ]


def _results(made: Reproduction, experiment: str) -> Table:
    rows = []
    for outcome in made.outcomes.values():
        s, result = outcome.simulation, outcome.result
        if s.experiment != experiment or s.series not in LABELS:
            continue  # of the sweep over the damping, which is drawn
        violated = outcome.details.violated_share if outcome.details else np.nan
        rows.append(
            [
                clip_label(s.motion),
                LABELS[s.series],
                f"{1e3 * result.rms_task_error:.1f}",
                f"{result.mean_power:.1f}",
                f"{1e3 * result.smallest_distance:.1f}",
                f"{100 * violated:.1f}",
                f"{result.peak_torque:.0f}",
                f"{result.rms_acceleration:.1f}",
            ]
        )
    return Table(HEADER, rows, TITLES[experiment])
