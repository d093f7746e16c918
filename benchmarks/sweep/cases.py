"""A case of a sweep: one whole simulation, judged by the referee at each sample."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

from crar_drake.errors import CrarError, nearest
from crar_drake.judging.referee import Referee, Violations
from crar_drake.law.parameters import PaperParameters, Parameters, with_constraints
from crar_drake.motion.catalogue import builtin_names
from crar_drake.simulation.scenario import Scenario, parse_scenario

if TYPE_CHECKING:
    from crar_drake.run import RunResult


@dataclass(frozen=True)
class Case:
    """One simulation of a sweep.

    Attributes:
        motion: a motion's name, as everywhere.
        experiment: a task set, "wrists" or "upper-body".
        constraints, level: of the controller.
        period: control period [s].
    """

    motion: str
    experiment: str
    constraints: str
    level: str
    period: float


@dataclass(frozen=True)
class Result(Case):
    """A case and what came of it.

    `error` is empty for a case that ran; the figures of one that did not are NaN.
    Distances and limits are the referee's, at every logged sample.

    Attributes:
        duration: simulated [s].
        samples: logged and judged.
        penetrating, beyond_limit: samples with a pair at d < 0, or with a joint
            more than 1e-6 rad outside.
        smallest_distance: over pairs and samples [m], of smallest_pair.
        largest_excess: of a joint beyond its limit [rad].
        beyond_speed: samples with a joint more than 1e-6 rad/s faster than its limit,
            which are not among the violations.
        largest_speed_excess: of a joint [rad/s].
        rms_task_error: of positions [m].
        mean_power: of the controlled joints [W].
        peak_torque: of a controlled joint [Nm].
        rms_acceleration: commanded, controlled joints [rad/s^2].
        corrected, scaled: shares of the control steps that the law corrected, or scaled
            towards braking; NaN unless constraints are "lookahead".
        unclear: control steps that began with a braking path not known to be clear.
        path_clearance: smallest bound for distances on braking paths [m]; NaN likewise.
        longest_held_back: in corrected or scaled steps in a row [s]; NaN likewise.
        wall_time: of the simulation [s].
        error: why the case could not be run.
    """

    duration: float = math.nan
    samples: int = 0
    penetrating: int = 0
    beyond_limit: int = 0
    smallest_distance: float = math.nan
    smallest_pair: str = ""
    largest_excess: float = math.nan
    beyond_speed: int = 0
    largest_speed_excess: float = math.nan
    rms_task_error: float = math.nan
    mean_power: float = math.nan
    peak_torque: float = math.nan
    rms_acceleration: float = math.nan
    corrected: float = math.nan
    scaled: float = math.nan
    unclear: int = 0
    path_clearance: float = math.nan
    longest_held_back: float = math.nan
    wall_time: float = math.nan
    error: str = ""

    @property
    def case(self) -> Case:
        """The case that this is the result of."""
        return Case(**{f.name: getattr(self, f.name) for f in fields(Case)})

    @property
    def violated(self) -> bool:
        """Whether any sample penetrates or is beyond a joint limit."""
        return self.penetrating > 0 or self.beyond_limit > 0


def clip_label(motion: str) -> str:
    """A motion's short name: `05_02` of any path to it, and of `cmu:05_02`."""
    return PurePath(motion).stem.removeprefix("cmu:")


def find_motions(paths: Iterable[str | os.PathLike[str]]) -> list[str]:
    """Names of all motions below the paths; those of a folder by number.

    Args:
        paths: folders (searched for .amc files), .amc files, or names of motions
            (`dance`, `cmu:05_02`).

    Raises:
        CrarError: a path does not exist or a folder has no motion in it.
    """
    motions: list[str] = []
    for entry in map(str, paths):
        if Path(entry).is_dir():
            found = sorted(map(str, Path(entry).rglob("*.amc")), key=_by_number)
            if not found:
                raise CrarError(f"{entry}: there is no .amc file below this folder")
            motions += found
        elif (
            Path(entry).is_file()
            or entry.startswith("cmu:")
            or entry in builtin_names()
        ):
            motions.append(entry)
        else:
            raise CrarError(
                f"{entry}: neither a folder, a file nor the name of a motion"
                f"{nearest(entry, builtin_names())}"
            )
    return list(dict.fromkeys(motions))


def _by_number(motion: str) -> tuple:
    """Trials by number: 05_02 before 13_29 before 127_23."""
    parts = re.split(r"(\d+)", clip_label(motion))
    return ([int(part) if part.isdigit() else part for part in parts], motion)


def make_cases(
    motions: Sequence[str],
    experiments: Sequence[str] = ("wrists", "upper-body"),
    constraints: Sequence[str] = ("lookahead",),
    levels: Sequence[str] = ("acceleration",),
    periods: Sequence[float] = (1e-3,),
) -> list[Case]:
    """Every combination that there is; lookahead has no velocity level."""
    return [
        Case(motion, experiment, mode, level, period)
        for experiment in experiments
        for mode in constraints
        for level in levels
        for period in periods
        for motion in motions
        if not (mode == "lookahead" and level == "velocity")
    ]


def run_case(case: Case, scenario: str = "") -> Result:
    """Simulates and judges one case; this is what a process runs.

    Args:
        case: what to run.
        scenario: YAML text of the scenario that the case changes; by default the
            defaults of `Scenario`.
    """
    from crar_drake.run import run_scenario

    base = parse_scenario(scenario) if scenario else default_scenario()
    run = run_scenario(_scenario_of(case, base), record=False)
    return judge(case, run)[0]


def judge(case: Case, run: RunResult) -> tuple[Result, Violations]:
    """The figures of a run, and what the referee says of its every sample."""
    log, summary, model = run.log, run.summary, run.setup.model
    referee = Referee(
        model.plant, model.scene_graph, model.description.pairs, log.velocity_limits
    )
    verdict = referee.violations(log.q, log.v)
    admission = {}
    if steps := summary.admitted_steps:
        admission = dict(
            corrected=summary.corrected_steps / steps,
            scaled=summary.scaled_steps / steps,
            unclear=summary.unclear_steps,
            path_clearance=_number(summary.path_clearance),
            longest_held_back=summary.longest_held_back,
        )
    result = Result(
        **asdict(case),
        duration=float(log.time[-1]),
        samples=len(log.time),
        penetrating=verdict.num_penetrating,
        beyond_limit=verdict.num_beyond_limit,
        smallest_distance=verdict.smallest_distance,
        smallest_pair=" - ".join(verdict.smallest_distance_pair or ()),
        largest_excess=verdict.largest_limit_excess,
        beyond_speed=verdict.num_beyond_speed,
        largest_speed_excess=verdict.largest_speed_excess,
        rms_task_error=_number(summary.rms_task_error),
        mean_power=summary.mean_power,
        peak_torque=summary.peak_torque,
        rms_acceleration=summary.rms_acceleration,
        **admission,
        wall_time=_number(summary.wall_time),
    )
    return result, verdict


def failed(case: Case, why: str) -> Result:
    """The result of a case that could not be run."""
    return Result(**asdict(case), error=why)


def default_scenario() -> Scenario:
    """What cases change, where no other is named."""
    return Scenario(motion="dance", experiment="wrists")


def parameters_of(case: Case, base: Parameters) -> Parameters:
    """The controller's parameters of a case; another law's but for what it says are
    the defaults."""
    found = replace(with_constraints(base, case.constraints), period=case.period)
    if isinstance(found, PaperParameters):
        return replace(found, level=case.level)
    return found


def _scenario_of(case: Case, base: Scenario) -> Scenario:
    return replace(
        base,
        motion=case.motion,
        experiment=case.experiment,
        tasks=[],
        keyframes={},
        controller=parameters_of(case, base.controller),
        # Every step of the plant is judged, not only those of the controller.
        log_period=base.log_period or base.plant_config.time_step,
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else value
