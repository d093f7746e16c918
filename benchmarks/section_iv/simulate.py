"""Runs a plan's simulations in processes, and keeps what came of each in a file.

A finished simulation is `results/<name>.json`; an interrupted reproduction goes on
with what is missing. Logs are written before that file.
"""

import json
import logging
import math
from collections.abc import Callable
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.section_iv.plan import Plan, Simulation
from benchmarks.sweep.cases import Case, Result, failed, judge
from crar_drake.errors import CrarError
from crar_drake.files import write_whole
from crar_drake.fresh_processes import given_or_fresh
from crar_drake.results.controlled_joints import controlled_joints
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import LIMIT_TOLERANCE
from crar_drake.simulation.scenario import parse_scenario
from crar_drake.version import __version__

RESULTS, LOGS = "results", "logs"

# W is said to jump where one of its elements changes by more than this in a sample.
_JUMP = 0.1
# Spikes are this share of the samples, those with the largest torque.
_SPIKES = 1e-3

Progress = Callable[[int, int, "Outcome"], None]


@dataclass(frozen=True)
class Details:
    """Figures that explain those of a `Result`; NaN where there is no such sample.

    Attributes:
        violated_share: of the samples, with any violation.
        error_in_violation, error_otherwise: rms task error over the samples that
            violate a constraint, and over the others [m].
        squared_error_in_violation: share of the squared error, over samples, that
            belongs to those in violation.
        power_in_violation, power_otherwise: mean power, likewise [W].
        limited_joint: the joint that is beyond its limit in most samples; "" if none.
        limited_joint_share: of the samples.
        rms_torque_step: of the torque's change from one sample to the next, over
            samples and controlled joints [Nm].
        power_of_peaks: share of the energy in the 1 % of samples with most power.
        spikes_at_jumps: of the 0.1 % of samples with the largest torque, the share
            at which an element of W has just changed by more than 10 %.
        jumps: the same share of all samples.
    """

    violated_share: float
    error_in_violation: float  # [m]
    error_otherwise: float  # [m]
    squared_error_in_violation: float
    power_in_violation: float  # [W]
    power_otherwise: float  # [W]
    limited_joint: str
    limited_joint_share: float
    rms_torque_step: float  # [Nm]
    power_of_peaks: float
    spikes_at_jumps: float
    jumps: float


@dataclass(frozen=True)
class Outcome:
    """What came of one simulation.

    Attributes:
        simulation: what was run.
        result: its figures; `result.error` says why it could not be run.
        details: further ones; None if it could not be run.
    """

    simulation: Simulation
    result: Result
    details: Details | None


def analyse(log: SimulationLog, violations: np.ndarray) -> Details:
    """Computes the further figures of a run.

    Args:
        log: of the run, T samples.
        violations: (T,) violated limits plus penetrating pairs, of the referee.
    """
    layout, joints = log.layout, controlled_joints(log)
    squared = np.sum(log.task_error[:, layout.linear_rows] ** 2, axis=-1).mean(axis=1)
    violated = violations > 0
    power = joints.power
    beyond = (joints.excess > LIMIT_TOLERANCE).mean(axis=0)
    limited = int(np.argmax(beyond))
    peaks = np.sort(power)[-max(1, len(power) // 100) :]
    W = log.constraint_weights
    jump = np.zeros(len(W), dtype=bool)
    jump[1:] = np.any(np.abs(W[1:] / W[:-1] - 1.0) > _JUMP, axis=1)
    torque = np.abs(joints.torque).max(axis=1)
    spikes = np.argsort(torque)[-max(1, round(_SPIKES * len(torque))) :]
    return Details(
        violated_share=float(violated.mean()),
        error_in_violation=_rms(squared[violated]),
        error_otherwise=_rms(squared[~violated]),
        squared_error_in_violation=float(squared[violated].sum() / squared.sum()),
        power_in_violation=_mean(power[violated]),
        power_otherwise=_mean(power[~violated]),
        limited_joint=joints.names[limited] if beyond[limited] else "",
        limited_joint_share=float(beyond[limited]),
        rms_torque_step=_rms(np.diff(joints.torque, axis=0) ** 2),
        power_of_peaks=float(peaks.sum() / power.sum()),
        spikes_at_jumps=float(jump[spikes].mean()),
        jumps=float(jump.mean()),
    )


def simulate(simulation: Simulation, out: str) -> Outcome:
    """Runs one simulation and writes its files; this is what a process runs.

    Args:
        simulation: what to run.
        out: folder of the reproduction.
    """
    from crar_drake.run import run_scenario

    # Drake announces the address of every page, where nothing is to be seen.
    logging.getLogger("drake").setLevel(logging.WARNING)
    scenario = parse_scenario(simulation.scenario)
    controller = scenario.controller
    case = Case(
        simulation.motion,
        simulation.experiment,
        controller.constraints,
        controller.level,
        controller.period,
    )
    try:
        run = run_scenario(scenario, record=False)
        result, verdict = judge(case, run)
    except Exception as error:
        outcome = Outcome(simulation, failed(case, error), None)
    else:
        outcome = Outcome(simulation, result, analyse(run.log, verdict.count))
        if simulation.keep_log:
            run.log.save(log_path(simulation, out))
    path = _result_path(simulation, out)
    write_whole(path, _to_json(outcome))
    return outcome


def run_plan(
    plan: Plan,
    out: Path,
    *,
    executor: Executor | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Outcome]:
    """Runs what of the plan is not finished yet.

    Args:
        plan: all simulations.
        out: folder of the reproduction.
        executor: any; by default a process for each simulation.
        jobs: number of processes at a time; by default one per core.
        progress: called with (finished, all, newest outcome).

    Returns:
        The outcomes by the names of the simulations, in the order of the plan.
    """
    done = finished(plan, out)
    # The long ones first, so that the processes end together.
    waiting = sorted(
        (s for s in plan.simulations if s.name not in done),
        key=lambda simulation: -simulation.duration,
    )
    with given_or_fresh(executor, jobs) as pool:
        futures = {pool.submit(simulate, s, str(out)): s for s in waiting}
        for future in as_completed(futures):
            simulation = futures[future]
            try:
                done[simulation.name] = future.result()
            except RuntimeError as error:  # its process died
                raise CrarError(f"{simulation.name}: {error}") from error
            if progress is not None:
                progress(len(done), len(plan.simulations), done[simulation.name])
    return {s.name: done[s.name] for s in plan.simulations}


def finished(plan: Plan, out: Path) -> dict[str, Outcome]:
    """What the folder holds of the plan already, made by this version."""
    outcomes = {}
    for simulation in plan.simulations:
        try:
            text = _result_path(simulation, out).read_text()
            outcome = _from_json(text, simulation)
        except (OSError, ValueError, KeyError, TypeError):
            continue  # not there, or of another version: it is run again
        there = not simulation.keep_log or log_path(simulation, out).is_file()
        if outcome and not outcome.result.error and there:
            outcomes[simulation.name] = outcome
    return outcomes


def log_path(simulation: Simulation, out: str | Path) -> Path:
    """Of the samples that figures need."""
    return Path(out) / LOGS / f"{simulation.name}.npz"


def _result_path(simulation: Simulation, out: str | Path) -> Path:
    return Path(out) / RESULTS / f"{simulation.name}.json"


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else math.nan


def _rms(squares: np.ndarray) -> float:
    return math.sqrt(_mean(squares)) if squares.size else math.nan


def _to_json(outcome: Outcome) -> str:
    record = {
        "version": __version__,
        "scenario": outcome.simulation.scenario,
        "result": asdict(outcome.result),
        "details": asdict(outcome.details) if outcome.details else None,
    }
    return json.dumps(record, indent=2) + "\n"


def _from_json(text: str, simulation: Simulation) -> Outcome | None:
    """None if it is of another scenario or version."""
    record = json.loads(text)
    known = record["version"], record["scenario"]
    if known != (__version__, simulation.scenario):
        return None
    details = record["details"]
    return Outcome(
        simulation,
        Result(**record["result"]),
        Details(**details) if details else None,
    )
