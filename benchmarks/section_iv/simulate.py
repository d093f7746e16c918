"""What came of a simulation of the plan, and of all of them."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.section_iv.plan import Plan, Simulation
from benchmarks.sweep.cases import Case, Result, failed as failed_case, judge
from crar_drake.results.controlled_joints import controlled_joints
from crar_drake.results.log import SimulationLog
from crar_drake.simulation.scenario import parse_scenario

LOGS = "logs"


@dataclass(frozen=True)
class Outcome:
    """What came of one simulation.

    Attributes:
        case: the simulation.
        result: its figures; `result.error` says why it could not be run.
        violated_share: of the samples, with any violation; NaN if it could not be run.
        rms_torque_step: of the torque's change from one sample to the next, over
            samples and controlled joints [Nm]; likewise.
    """

    case: Simulation
    result: Result
    violated_share: float = np.nan
    rms_torque_step: float = np.nan

    @property
    def error(self) -> str:
        """Why it could not be run; "" if it could."""
        return self.result.error


class Outcomes:
    """All outcomes of a plan.

    Attributes:
        plan: it.
        by_name: of the simulations.
    """

    def __init__(self, plan: Plan, by_name: Mapping[str, Outcome]) -> None:
        self.plan, self.by_name = plan, by_name
        self._by_key = {
            (o.case.motion, o.case.experiment, o.case.series): o
            for o in by_name.values()
        }

    def of(self, motion: str, experiment: str, series: str) -> Outcome:
        """Of a simulation that is not one of the sweep over damping."""
        return self._by_key[motion, experiment, series]

    def damped(self, level: str, constraints: str, factor: float) -> Result:
        """Of the sweep over damping."""
        return self.by_name[self.plan.damping[level, constraints, factor]].result


def simulate(simulation: Simulation, out: Path) -> Outcome:
    """Runs one simulation, and keeps its log; this is what a process runs.

    Args:
        simulation: what to run.
        out: folder of the reproduction.
    """
    from crar_drake.run import run_scenario

    # Drake announces the address of every page, where nothing is to be seen.
    logging.getLogger("drake").setLevel(logging.WARNING)
    run = run_scenario(parse_scenario(simulation.scenario), record=False)
    result, verdict = judge(_case_of(simulation), run)
    if simulation.keep_log:
        run.log.save(log_path(simulation, out))
    return Outcome(
        simulation,
        result,
        float((verdict.count > 0).mean()),
        rms_torque_step(run.log),
    )


def rms_torque_step(log: SimulationLog) -> float:
    """As of `Outcome` [Nm]."""
    steps = np.diff(controlled_joints(log).torque, axis=0)
    return float(np.sqrt(np.mean(steps**2)))


def failed(simulation: Simulation, why: str) -> Outcome:
    """Of a simulation that could not be run."""
    return Outcome(simulation, failed_case(_case_of(simulation), why))


def parse(fields: dict) -> Outcome:
    """Of the fields of one that was kept."""
    case, result = Simulation(**fields["case"]), Result(**fields["result"])
    return Outcome(**fields | {"case": case, "result": result})


def log_path(simulation: Simulation, out: Path) -> Path:
    """Of the samples that figures need."""
    return out / LOGS / f"{simulation.name}.npz"


def _case_of(simulation: Simulation) -> Case:
    controller = parse_scenario(simulation.scenario).controller
    how = controller.constraints, controller.level, controller.period
    return Case(simulation.motion, simulation.experiment, *how)
