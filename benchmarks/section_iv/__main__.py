"""The experiments of the paper's Section IV, repeated.

    python -m benchmarks.section_iv [--motions cmu]

The same command continues one that was stopped.
"""

import os
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path

import matplotlib

from benchmarks.kept_cases import run_cases, source_digest
from benchmarks.options import add_duration, list_of
from benchmarks.page import Benchmark, Table, run
from benchmarks.section_iv.figures import all_figures
from benchmarks.section_iv.findings import Finding, check_findings
from benchmarks.section_iv.plan import (
    EXPERIMENT_1,
    EXPERIMENT_2,
    LABELS,
    MOTION_SETS,
    Plan,
    make_plan,
)
from benchmarks.section_iv.simulate import (
    Outcome,
    Outcomes,
    failed,
    log_path,
    parse,
    simulate,
)
from benchmarks.sweep.cases import clip_label, find_motions
from benchmarks.sweep.tables import headline
from crar_drake.commands.options import add_jobs
from crar_drake.commands.output import label
from crar_drake.errors import CrarError
from crar_drake.figures import save_figure
from crar_drake.files import check_folder
from crar_drake.fresh_processes import given_or_fresh
from crar_drake.motion.catalogue import load_clip
from crar_drake.results.log import SimulationLog

RESULTS, FIGURES = "results.json", "figures"
# Pictures and thousands of lines are smaller as pixels.
_PIXELS = ("figure-3", "torque-spikes")
TITLES = {
    EXPERIMENT_1: "Experiment 1, two wrists, m = 6",
    EXPERIMENT_2: "Experiment 2, seven points, m = 21",
}
HEADER = (
    *("motion", "controller", "rms task error [mm]", "mean power [W]"),
    *("smallest distance [mm]", "samples in violation [%]", "peak torque [Nm]"),
    "rms acceleration [rad/s²]",
)


def main(argv: Sequence[str] | None = None) -> None:
    """Simulates, tests the findings, and draws."""
    benchmark = Benchmark("benchmarks.section_iv", __doc__, "reproduction")
    parser = benchmark.parser
    parser.add_argument(
        "--motions",
        type=list_of(str),
        action="extend",
        metavar="M[,M...]",
        help="builtin (the four built-in motions), cmu (the CMU recordings 05_02, "
        "13_29, 14_07 and 13_17), or names of motions, the first of them a dance "
        "(default: builtin)",
    )
    add_duration(parser)
    add_jobs(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for figures and results (default: out/reproduce/NAME, "
        "where NAME says which motions)",
    )
    arguments = benchmark.parse(argv, lambda given: "findings")
    chosen = arguments.motions or ["builtin"]
    motions = [m for name in chosen for m in MOTION_SETS.get(name, (name,))]
    labels = [str(label(name)).replace(os.sep, "_") for name in chosen]
    out = arguments.out or Path("out/reproduce") / "-".join(labels)
    check_folder(out)
    plan = make_plan(find_motions(motions), duration=arguments.duration)
    outcomes = run_plan(plan, out, arguments.jobs)
    findings = write_figures(outcomes, out)
    benchmark.report(tables(outcomes, findings))
    print(out / FIGURES)


def run_plan(plan: Plan, out: Path, jobs: int | None) -> Outcomes:
    """Runs what of the plan is not finished yet.

    Args:
        plan: all simulations.
        out: folder of the reproduction; gets the results, and logs of the dance.
        jobs: number of processes at a time; by default one per core.

    Raises:
        CrarError: a simulation could not be run.
    """
    found = run_cases(
        partial(simulate, out=out),
        # The long ones first, so that the processes end together.
        sorted(plan.simulations, key=lambda simulation: -simulation.duration),
        out / RESULTS,
        given_or_fresh(None, jobs),
        made_of=source_digest(Path(__file__).parent),
        parse=parse,
        failed=failed,
        is_whole=lambda o: not o.case.keep_log or log_path(o.case, out).is_file(),
        headline=lambda outcome: headline(outcome.result),
    )
    failures = [f"{o.case.name}: {o.error}" for o in found if o.error]
    if failures:
        raise CrarError("could not be simulated: " + "; ".join(failures))
    by_name = {o.case.name: o for o in found}
    return Outcomes(plan, {s.name: by_name[s.name] for s in plan.simulations})


def write_figures(outcomes: Outcomes, out: Path) -> list[Finding]:
    """Draws all figures into a folder of `out`; the findings."""
    plan = outcomes.plan

    @cache
    def log(experiment: str, series: str) -> SimulationLog:
        simulation = outcomes.of(plan.dance, experiment, series).case
        return SimulationLog.load(log_path(simulation, out))

    frame_rate = load_clip(plan.dance).frame_rate
    # The same data give the same files.
    with matplotlib.rc_context({"svg.hashsalt": "crar-drake"}):
        for name, draw in all_figures(outcomes, log, frame_rate).items():
            pixels = name.startswith(_PIXELS)
            path = out / FIGURES / f"{name}{'.png' if pixels else '.svg'}"
            metadata = {} if pixels else {"Date": None}
            save_figure(draw(), path, dpi=100, metadata=metadata)
    return check_findings(outcomes, log)


def tables(outcomes: Outcomes, findings: Sequence[Finding]) -> list[Table]:
    """The findings, and what was simulated."""
    rows = [
        [f.source, f.statement, f.verdict, f.figures, f.criterion] for f in findings
    ]
    header = ("paper", "finding", "here", "figures", "criterion")
    found = outcomes.by_name.values()
    return [
        Table(header, rows, "The paper's findings"),
        *(
            # Those of the sweep over the damping are drawn.
            Table(
                HEADER,
                [
                    _row(o)
                    for o in found
                    if o.case.experiment == experiment and o.case.series in LABELS
                ],
                title,
            )
            for experiment, title in TITLES.items()
        ),
    ]


def _row(outcome: Outcome) -> list[str]:
    simulation, result = outcome.case, outcome.result
    return [
        clip_label(simulation.motion),
        LABELS[simulation.series],
        f"{1e3 * result.rms_task_error:.1f}",
        f"{result.mean_power:.1f}",
        f"{1e3 * result.smallest_distance:.1f}",
        f"{100 * outcome.violated_share:.1f}",
        f"{result.peak_torque:.0f}",
        f"{result.rms_acceleration:.1f}",
    ]


if __name__ == "__main__":
    run(main)
