"""The whole reproduction: simulates, tests the findings, draws."""

import time
from concurrent.futures import Executor
from functools import cache
from pathlib import Path

import matplotlib

from benchmarks.section_iv.figures import all_figures
from benchmarks.section_iv.findings import check_findings
from benchmarks.section_iv.plan import Plan
from benchmarks.section_iv.report import FIGURES, Reproduction
from benchmarks.section_iv.simulate import (
    Progress,
    finished,
    log_path,
    run_plan,
)
from crar_drake.errors import CrarError
from crar_drake.figures import save_figure
from crar_drake.files import check_folder
from crar_drake.motion.catalogue import load_clip
from crar_drake.results.log import SimulationLog

# Pictures and thousands of lines are smaller as pixels.
_PIXELS = ("figure-3", "torque-spikes")


def reproduce(
    plan: Plan,
    out: str | Path,
    *,
    executor: Executor | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> Reproduction:
    """Runs a plan, and writes what it found into a folder.

    The folder then holds `figures`, `logs` (of the dance) and `results` (one file per
    simulation, which a later call with the same plan does not run again).

    Args:
        plan: from `make_plan`.
        out: the folder.
        executor: any; by default a process for each simulation.
        jobs: number of processes at a time; by default one per core.
        progress: called with (finished, all, newest outcome).

    Raises:
        CrarError: a simulation could not be run, or the folder not be written to.
    """
    out, start = Path(out), time.perf_counter()
    check_folder(out)
    kept = len(finished(plan, out))
    outcomes = run_plan(plan, out, executor=executor, jobs=jobs, progress=progress)
    failures = [f"{n}: {o.result.error}" for n, o in outcomes.items() if o.result.error]
    if failures:
        raise CrarError("could not be simulated: " + "; ".join(failures))

    simulations = {
        (s.experiment, s.series): s for s in plan.simulations if s.motion == plan.dance
    }

    @cache
    def log(experiment: str, series: str) -> SimulationLog:
        return SimulationLog.load(log_path(simulations[experiment, series], out))

    frame_rate = load_clip(plan.dance).frame_rate
    findings = check_findings(plan, outcomes, log)
    figures = {}
    # The same data give the same files.
    with matplotlib.rc_context({"svg.hashsalt": "crar-drake"}):
        for name, draw in all_figures(plan, outcomes, log, frame_rate).items():
            pixels = name.startswith(_PIXELS)
            path = out / FIGURES / f"{name}{'.png' if pixels else '.svg'}"
            metadata = {} if pixels else {"Date": None}
            save_figure(draw(), path, dpi=100, metadata=metadata)
            figures[name] = path
    return Reproduction(
        plan=plan,
        outcomes=outcomes,
        findings=findings,
        figures=figures,
        wall_time=time.perf_counter() - start,
        simulated=len(outcomes) - kept,
    )
