"""Many motions through many settings: `python -m benchmarks.sweep`.

Each case is one whole simulation, judged afterwards by the referee. Cases run in
any `concurrent.futures` executor. Finished cases are kept in a CSV file, a line
each, so that a sweep that was killed goes on where it stopped.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, as_completed
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.errors import CrarError, WriteError, nearest
from crar_drake.files import sole_writer, write_whole
from crar_drake.fresh_processes import given_or_fresh
from crar_drake.law.parameters import (
    PaperParameters,
    Parameters,
    with_constraints,
)
from crar_drake.simulation.scenario import Scenario, parse_scenario

if TYPE_CHECKING:
    from crar_drake.judging.referee import Violations
    from crar_drake.results.summary import Summary
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
    """One line of the CSV file: a case and what came of it.

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

    duration: float = float("nan")
    samples: int = 0
    penetrating: int = 0
    beyond_limit: int = 0
    smallest_distance: float = float("nan")
    smallest_pair: str = ""
    largest_excess: float = float("nan")
    beyond_speed: int = 0
    largest_speed_excess: float = float("nan")
    rms_task_error: float = float("nan")
    mean_power: float = float("nan")
    peak_torque: float = float("nan")
    rms_acceleration: float = float("nan")
    corrected: float = float("nan")
    scaled: float = float("nan")
    unclear: int = 0
    path_clearance: float = float("nan")
    longest_held_back: float = float("nan")
    wall_time: float = float("nan")
    error: str = ""

    @property
    def case(self) -> Case:
        """The case that this is the result of."""
        return Case(**{f.name: getattr(self, f.name) for f in fields(Case)})

    @property
    def violated(self) -> bool:
        """Whether any sample penetrates or is beyond a joint limit."""
        return self.penetrating > 0 or self.beyond_limit > 0


def find_motions(paths: Iterable[str | os.PathLike[str]]) -> list[str]:
    """Names of all motions below the paths, sorted.

    Args:
        paths: folders (searched for .amc files), .amc files, or names of motions
            (`dance`, `cmu:05_02`).

    Raises:
        CrarError: a path does not exist or a folder has no motion in it.
    """
    from crar_drake.motion.catalogue import builtin_names

    motions: list[str] = []
    for entry in paths:
        path = Path(entry)
        if path.is_dir():
            found = sorted(str(p) for p in path.rglob("*.amc"))
            if not found:
                raise CrarError(f"{path}: there is no .amc file below this folder")
            motions += found
        elif path.is_file() or str(entry).startswith("cmu:"):
            motions.append(str(entry))
        elif str(entry) in builtin_names():
            motions.append(str(entry))
        else:
            raise CrarError(
                f"{entry}: neither a folder, a file nor the name of a motion"
                f"{nearest(str(entry), builtin_names())}"
            )
    return list(dict.fromkeys(motions))


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
    """Simulates and judges one case; this is what a worker process runs.

    Args:
        case: what to run.
        scenario: YAML text of the scenario that the case changes; by default the
            defaults of `Scenario`.

    Returns:
        The result; what went wrong (a bad file, a simulation that diverges) is its
        `error`, not an exception.
    """
    from crar_drake.run import run_scenario

    try:
        base = parse_scenario(scenario) if scenario else _default_scenario()
        run = run_scenario(_scenario_of(case, base), record=False)
        result, _ = judge(case, run)
    except Exception as error:
        return failed(case, error)
    return result


def judge(case: Case, run: RunResult) -> tuple[Result, Violations]:
    """The figures of a run, and what the referee says of its every sample."""
    from crar_drake.judging.referee import Referee

    log, summary, model = run.log, run.summary, run.setup.model
    referee = Referee(
        model.plant, model.scene_graph, model.description.pairs, log.velocity_limits
    )
    verdict = referee.violations(log.q, log.v)
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
        **_admission(summary),
        wall_time=_number(summary.wall_time),
    )
    return result, verdict


def _admission(summary: Summary) -> dict[str, float]:
    """The fields of a result that tell how its steps were admitted."""
    if not (steps := summary.admitted_steps):
        return {}
    return dict(
        corrected=summary.corrected_steps / steps,
        scaled=summary.scaled_steps / steps,
        unclear=summary.unclear_steps,
        path_clearance=_number(summary.path_clearance),
        longest_held_back=summary.longest_held_back,
    )


def failed(case: Case, error: Exception) -> Result:
    """The result of a case that could not be run."""
    if isinstance(error, CrarError):
        return _failed(case, str(error))
    # Drake's, where a robot is thrown to infinity.
    return _failed(case, f"{type(error).__name__}: {error}")


def run_sweep(
    cases: Sequence[Case],
    out: str | os.PathLike[str],
    *,
    scenario: Scenario | None = None,
    executor: Executor | None = None,
    jobs: int | None = None,
    progress: Callable[[int, int, Result], None] | None = None,
) -> list[Result]:
    """Runs the cases that `out` does not hold yet, and adds them to it.

    Args:
        cases: what to run; those that stand in `out` without an error are kept.
        out: CSV file, see `Result`. It is for one scenario: give another file where
            the scenario's other settings differ.
        scenario: what the cases have in common; their motion, experiment, mode,
            level and period are replaced.
        executor: any `concurrent.futures` executor; by default processes.
        jobs: number of those processes; by default one per core.
        progress: called with (finished, all, newest result).

    Returns:
        The results of all cases, in their order.

    With a scenario, its settings are kept beside the results, in a .yaml file.

    Raises:
        CrarError: `out` is there but is not a sweep's file, its results were made
            with other settings, or another sweep is writing to it.
        WriteError: `out` cannot be written. What is finished till then stays.
    """
    out = Path(out)
    text = "" if scenario is None else scenario.to_yaml()
    with sole_writer(out):
        finished = {r.case: r for r in read_results(out) if not r.error}
        wanted = list(dict.fromkeys(cases))
        waiting = [case for case in wanted if case not in finished]
        if scenario is not None:
            _keep_settings(scenario, out)
        _start_file(out, finished.values())
        done = len(wanted) - len(waiting)
        with (
            given_or_fresh(executor, jobs) as pool,
            open(out, "ab", buffering=0) as stream,
        ):
            futures: dict[Future, Case] = {
                pool.submit(run_case, case, text): case for case in waiting
            }
            try:
                for future in as_completed(futures):
                    try:
                        result = future.result()
                    except RuntimeError as error:  # its process died
                        result = _failed(futures[future], str(error))
                    _append(_line(result), stream.fileno(), out)
                    finished[result.case] = result
                    done += 1
                    if progress is not None:
                        progress(done, len(wanted), result)
            except BaseException:
                for future in futures:
                    future.cancel()
                raise
    return [finished[case] for case in wanted]


def read_results(path: str | os.PathLike[str]) -> list[Result]:
    """Reads a sweep's CSV file; a last line that was cut off is left out.

    Raises:
        CrarError: the file's columns are not those of `Result`.
    """
    path = Path(path)
    if not path.is_file() or not path.stat().st_size:
        return []
    text = path.read_text(errors="replace")
    whole, newline, _ = text.rpartition("\n")
    reader = csv.DictReader(io.StringIO(whole + newline))
    names = [f.name for f in fields(Result)]
    if reader.fieldnames != names:
        raise CrarError(
            f"{path}: this is not a sweep's file of this version (its columns should "
            f"be {', '.join(names)}); give another --out"
        )
    converters = {"float": float, "int": int}
    types = {f.name: converters.get(str(f.type), str) for f in fields(Result)}
    try:
        return [
            Result(**{name: types[name](row[name]) for name in names}) for row in reader
        ]
    except (TypeError, ValueError) as error:
        raise CrarError(f"{path}: line {reader.line_num}: {error}") from error


def _failed(case: Case, why: str) -> Result:
    return Result(**asdict(case), error=" ".join(why.split()))


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def _default_scenario() -> Scenario:
    return Scenario(motion="dance", experiment="wrists")


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


def parameters_of(case: Case, base: Parameters) -> Parameters:
    """The controller's parameters of a case; another law's but for what it says are
    the defaults."""
    found = replace(with_constraints(base, case.constraints), period=case.period)
    if isinstance(found, PaperParameters):
        return replace(found, level=case.level)
    return found


def _line(result: Result | None) -> str:
    """A line of the file; the header for None."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = [f.name for f in fields(Result)]
    writer.writerow(names if result is None else [getattr(result, n) for n in names])
    return stream.getvalue()


def _start_file(path: str | os.PathLike[str], results: Iterable[Result]) -> None:
    """Writes header and kept results, without failed cases and cut-off lines."""
    write_whole(path, _line(None) + "".join(map(_line, results)))


def _append(line: str, handle: int, path: Path) -> None:
    """Adds a line to an open file, and none if the disk is full.

    A process that is killed may leave a line cut off at the end, where reading drops
    it.
    """
    end = os.fstat(handle).st_size
    data = line.encode()
    try:
        while data:
            data = data[os.write(handle, data) :]
        os.fsync(handle)
    except OSError as error:
        os.ftruncate(handle, end)
        raise WriteError(path, error) from error


def _keep_settings(scenario: Scenario, out: Path) -> None:
    """Writes what all cases have in common beside the results, which do not say it.

    Raises:
        CrarError: the results there were made with something else in common.
    """
    path, text = settings_path(out), _common_settings(scenario).to_yaml()
    if out.is_file() and path.is_file() and path.read_text() != text:
        raise CrarError(
            f"{out}: its results were made with another --scenario, --duration or "
            f"--frame-rate (see {path}); give another --out"
        )
    write_whole(path, text)


def settings_path(out: Path) -> Path:
    """Where the settings of a sweep's results are."""
    return out.with_suffix(".yaml")


def _common_settings(scenario: Scenario) -> Scenario:
    """The scenario, with the same value in all that a case puts its own in."""
    period = scenario.plant_config.time_step or scenario.controller.period
    controller = replace(scenario.controller, period=period)
    if isinstance(controller, PaperParameters):
        controller = replace(controller, constraints="paper", level="acceleration")
    return replace(
        scenario,
        description="",
        motion="dance",
        experiment="wrists",
        tasks=[],
        keyframes={},
        controller=controller,
    )
