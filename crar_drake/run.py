"""Runs a scenario: simulates, keeps the log, and writes what is to be seen of it."""

import math
import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram
from pydrake.systems.primitives import VectorLogSink

from crar_drake.errors import CrarError, ScenarioError, WriteError
from crar_drake.files import check_file, turn_to_write, whole_file, write_whole
from crar_drake.interrupts import Interrupts, held_interrupts
from crar_drake.law.compilation import when_compiling
from crar_drake.motion.report import inspect
from crar_drake.resources import install_command
from crar_drake.results import LOG, PLOT, RECORDING, SUMMARY
from crar_drake.results.limb_directions import limb_directions
from crar_drake.results.log import SimulationLog
from crar_drake.results.obstacles import judge_obstacles
from crar_drake.results.remarks import lasting_error_warnings
from crar_drake.results.standing_run import as_measured, judged_speed_limits, stance
from crar_drake.results.summary import Summary, summarize
from crar_drake.robot.description import lasting_name
from crar_drake.robot.joints import joint_units
from crar_drake.robot.model import ControlModel
from crar_drake.simulation.diagram import (
    MakeCrarDiagram,
    MakeSimulator,
    PrepareScenario,
    Setup,
)
from crar_drake.simulation.scenario import Scenario
from crar_drake.simulation.warnings import moves_root, run_warnings

# The controller's outputs that a log keeps.
_LOGGED = (
    "actuation",
    "desired_acceleration",
    "task_error",
    "signed_distances",
    "constraint_weights",
    "status",
    "admission",
    "balance",
    "torque_limit",
)

# The progress is reported this often [s of simulated time].
_SLICE = 0.0625

# A run whose log and recording would take more memory than this is refused [B].
_MEMORY_LIMIT = 4 * 2**30

# What a frame of the recording is allowed to take of memory while the page is made, for
# each body and target [B].
_FRAME_BYTES = 2000

# A logged value is kept as 8 bytes, grown by doubling, and copied twice.
_VALUE_BYTES = 4 * 8

# What a simulation can fail of, midway, that is no defect of this program: wrong input,
# a robot that is thrown to infinity. NumPy's LinAlgError is among the ValueErrors.
FAILURES = (ValueError, FloatingPointError, OverflowError, RuntimeError)

# Takes simulated time [s], duration [s] and the real-time factor so far.
Progress = Callable[[float, float, float], None]


@dataclass(frozen=True)
class RunResult:
    """What a run leaves."""

    log: SimulationLog  # the samples
    summary: Summary  # the figures
    setup: Setup  # what the run was made of
    # what was written, in the order of `run_scenario`; empty if nothing
    files: list[Path] = field(default_factory=list)


class RunFailed(CrarError):
    """A run that did not come to its end, or whose files cannot all be written.

    Attributes:
        result: of what was simulated; its `files` are those that were written.
    """

    def __init__(self, message: str, result: RunResult | None = None) -> None:
        super().__init__(message)
        self.result = result


class RunInterrupted(KeyboardInterrupt):
    """A run that Ctrl-C ended; the message says what is kept of it.

    Attributes:
        result: as in `RunFailed`.
    """

    def __init__(self, message: str, result: RunResult | None = None) -> None:
        super().__init__(message)
        self.result = result


def run_scenario(
    scenario: Scenario,
    out: str | os.PathLike[str] | None = None,
    *,
    record: bool = True,
    progress: Progress | None = None,
    tell: Callable[[str], None] | None = None,
) -> RunResult:
    """Simulates a scenario to its end.

    With `out`, the folder then holds `recording.html` (a page to look at),
    `log.npz` (see `SimulationLog`), `summary.json` (see `Summary`) and `plot.png`,
    all of this run: the log is written first, the others of an earlier run go when
    it takes its place, and each follows whole or not at all. So what is missing
    could not be written (or, the recording, was not wanted), and what is there
    belongs to the log. If not even the log can be written, the folder stays as it
    was.

    A run that is stopped midway, by Ctrl-C or by an error, leaves the files of what
    was simulated till then, if that is at least one sample, and its summary says
    why it stopped. Another Ctrl-C leaves it at those that are there, but the log is
    written in any case.

    Args:
        scenario: from `load_scenario`, or made in Python.
        out: folder to write into; None writes nothing.
        record: whether to make the recording, if there is a folder for it.
        progress: is called with simulated time, duration and real-time factor.
        tell: is called with sentences when the control law has to be compiled first,
            and how far that is; this does not count as the run's wall time. Without
            it a line on stderr says so.

    Raises:
        CrarError: something in the scenario, its robot or its motion is wrong,
            `out` cannot be written to, or the run would not fit into memory.
        RunFailed: with `out`: the simulation failed midway, or a file could not be
            written.
        RunInterrupted: with `out`: Ctrl-C came (which is looked at between steps
            only if this is the main thread and nobody else handles it).
        Exception: without `out`, what stopped the simulation, as it was.
    """
    if out is not None:
        out = Path(out)
        for name in (RECORDING, LOG, SUMMARY, PLOT):
            check_file(out / name)
        # Whatever is wrong with what they need shows before the simulation.
        import crar_drake.results.plots

        if record:
            import crar_drake.results.playback  # noqa: F401
    with when_compiling(tell) if tell else nullcontext():
        setup = PrepareScenario(scenario)
        duration = scenario.duration or setup.motion.duration
        record = record and out is not None
        check_size(scenario, setup, duration, record)
        diagram = MakeCrarDiagram(scenario, setup=setup)
        diagram.GetSubsystemByName("crar_controller").law.compile(
            bool(scenario.obstacles)
        )

    simulator = MakeSimulator(scenario, diagram)
    report = inspect(p) if (p := setup.motion.performer) is not None else None
    warnings = run_warnings(scenario, setup, report, recorded=record)
    with held_interrupts() as interrupts:
        start, stopped = time.perf_counter(), None
        try:
            _simulate(simulator, duration, progress, interrupts)
        except BaseException as error:
            if out is None:
                raise
            stopped = error
        wall_time = time.perf_counter() - start
        interrupts.hold()  # until the log is written
        # Its robot named as in the log, for the figures to say the same.
        logged = with_lasting_name(scenario)
        log = make_log(logged, setup, diagram, simulator.get_context())
        if stopped is not None and not len(log.time):
            raise stopped
        blended = scenario.controller.blend_time
        warnings += lasting_error_warnings(log, blended)
        performer, lowest = setup.motion.performer, None
        if scenario.standing is not None:
            performer = None  # whose limbs turn with the hips; the robot's stay
        if stopped is None:
            try:
                lowest = _lowest(scenario, setup, log)
            except ModuleNotFoundError as error:
                warnings.append(_without_meshes(error))
        result = finish(
            *(log, logged, setup, out, interrupts, stopped),
            record=record,
            duration=f" of {duration:g} s",
            wall_time=wall_time,
            motion=report,
            warnings=warnings,
            limbs=limb_directions(log, setup.model, performer, blended),
            lowest=lowest,
        )
    return result


def finish(
    log: SimulationLog,
    scenario: Scenario,
    setup: Setup,
    out: Path | None,
    interrupts: Interrupts,
    stopped: BaseException | None,
    *,
    record: bool = True,
    note: str = "",
    duration: str = "",
    **known,
) -> RunResult:
    """The figures of a run; its files, and what is to be said where it is not whole.

    Args:
        log: its samples.
        scenario: as the log names it.
        setup: what the run was made of.
        out: folder to write into; None writes nothing.
        interrupts: held; another Ctrl-C leaves it at what is there, the log at least.
        stopped: what ended it before its time, if anything did.
        record: whether to make the recording.
        note: of the recording's caption.
        duration: that it was to have, in words.
        known: further arguments of `summarize`.

    Raises:
        RunFailed: something stopped the simulation, or a file cannot be written.
        RunInterrupted: not all was waited for.
    """
    model, stood = setup.model, None
    if scenario.standing is not None:
        stood = stance(log, setup.simulated, scenario.standing.friction)
    obstacles = judge_obstacles(
        log, scenario, model.plant, model.scene_graph, model.description.pairs
    )
    summary = summarize(log, obstacles=obstacles, stance=stood, **known)
    result = RunResult(log, replace(summary, stopped=_reason_of(stopped)), setup)
    if out is None:
        interrupts.release()
        return result
    missing = _write_run(out, result, record, interrupts, note)
    _tell_end(result, out, stopped, missing, duration)
    return result


def check_size(scenario: Scenario, setup: Setup, duration: float, record: bool) -> None:
    """Better to know before a simulation of days than from the system that ends it.

    Args:
        duration: of the run [s].
        record: whether it is recorded.

    Raises:
        ScenarioError: its log and recording would take more than 4 GiB of memory;
            the message says what to change.
    """
    model = setup.simulated
    period = scenario.log_period_for(duration)
    # State, tasks and the controller's diagnostics, roughly.
    columns = 5 * model.plant.num_positions() + 5 * model.layout.size
    columns += len(model.pairs.names)
    sample = columns * _VALUE_BYTES
    log = duration / period * sample
    frame = _FRAME_BYTES * (model.plant.num_bodies() + len(model.layout.names))
    frame_period = scenario.visualization.publish_period
    recording = duration / frame_period * frame if record else 0.0
    if log + recording <= _MEMORY_LIMIT:
        return
    changes = []
    if log > 0.5 * _MEMORY_LIMIT:
        least = period * math.ceil(2.0 * log / _MEMORY_LIMIT)
        changes.append(f"a log_period of at least {least:g} s (it is {period:g} s)")
    if recording > 0.5 * _MEMORY_LIMIT:
        least = frame_period * math.ceil(2.0 * recording / _MEMORY_LIMIT)
        changes.append(
            f"a visualization.publish_period of at least {least:g} s (it is "
            f"{frame_period:g} s) or no recording (--no-page)"
        )
    raise ScenarioError(
        f"duration: a run of {duration:g} s would take about "
        f"{(log + recording) / 2**30:.1f} GiB of memory, the log {log / 2**30:.1f} and "
        f"the recording {recording / 2**30:.1f}, where {_MEMORY_LIMIT / 2**30:.0f} are "
        f"allowed; choose a shorter one, or {' and '.join(changes)}"
    )


def make_log(
    scenario: Scenario, setup: Setup, diagram: Diagram, context: Context
) -> SimulationLog:
    """Collects the log of a diagram that was simulated.

    Args:
        diagram: made by `MakeCrarDiagram`.
        context: of the diagram, after the simulation. If that failed while it
            logged a sample, that sample is left out.
    """
    stands = scenario.standing is not None
    sinks = {name: sink.FindLog(context) for name, sink in log_sinks(diagram).items()}
    num_samples = min(sink.num_samples() for sink in sinks.values())

    def samples(port: str) -> np.ndarray:
        return sinks[port].data()[:, :num_samples].T.copy()

    diagnostics = samples("diagnostics")
    controller = diagram.GetSubsystemByName("crar_controller")
    slices = controller.diagnostics_slices
    model = setup.simulated
    plant = model.plant
    nq = plant.num_positions()
    state = samples("state")
    q, v = _unit_quaternions(state[:, :nq], model), state[:, nq:]
    desired_tasks = samples("desired_tasks")
    lower, upper = np.full(nq, -np.inf), np.full(nq, np.inf)
    controlled, joints = model.controlled_positions, model.joint_names
    lower[controlled], upper[controlled] = model.lower, model.upper
    reported = {name: diagnostics[:, slices[name]].copy() for name in _LOGGED}
    speed_limits = controller.law.speed_limits
    if stands:
        reported |= as_measured(reported, q, v, desired_tasks, setup.model, model)
        reported["actuation"] = samples("actuation")
        reported["desired_acceleration"] = samples("acceleration")
        speed_limits = judged_speed_limits(scenario, model)
    actuators = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices()]
    actuators.sort(key=lambda actuator: actuator.input_start())
    return SimulationLog(
        time=sinks["state"].sample_times()[:num_samples].copy(),
        q=q,
        v=v,
        desired_tasks=desired_tasks,
        obstacles=samples("obstacles")
        if "obstacles" in sinks
        else np.empty((num_samples, 0)),
        **reported,
        position_names=np.array(model.position_names),
        actuator_names=np.array(
            [model.velocity_names[a.joint().velocity_start()] for a in actuators]
        ),
        velocity_names=np.array(model.velocity_names),
        controlled_names=np.array(joints),
        controlled_units=np.array(joint_units(plant, joints)),
        task_names=np.array(model.layout.names),
        task_kinds=np.array(model.layout.kinds),
        pair_names=np.array([f"{a} - {b}" for a, b in model.pairs.names], dtype=str),
        lower=lower,
        upper=upper,
        velocity_limits=speed_limits,
        effort_limits=np.array([actuator.effort_limit() for actuator in actuators]),
        scenario=with_lasting_name(scenario).to_yaml(),
    )


def log_sinks(diagram: Diagram) -> dict[str, VectorLogSink]:
    """What logs of a diagram of `MakeCrarDiagram` are made of, by name."""
    names = ("state", "desired_tasks", "diagnostics", "obstacles")
    of_standing = ("actuation", "acceleration")
    return {
        name: diagram.GetSubsystemByName(f"log_{name}")
        for name in (*names, *of_standing)
        if diagram.HasSubsystemNamed(f"log_{name}")
    }


def _unit_quaternions(q: np.ndarray, model: ControlModel) -> np.ndarray:
    """(T, nq) positions; Drake's discrete plants let a quaternion grow."""
    if model.floats:
        root = model.root_positions[:4]
        q[:, root] /= np.linalg.norm(q[:, root], axis=1, keepdims=True)
    return q


def _lowest(
    scenario: Scenario, setup: Setup, log: SimulationLog
) -> tuple[float, str, float] | None:
    """What of a robot that a motion moves over the floor was lowest, see
    `lowest_point`; None of others."""
    model, blended = setup.model, scenario.controller.blend_time
    if not moves_root(scenario, model.description):
        return None
    if len(log.time) < 2 or log.time[-1] <= blended:
        return None
    from crar_drake.references.whole_body import WholeBody
    from crar_drake.results.logged_motion import lowest_point

    return lowest_point(log, WholeBody(model.description), blended)


def _without_meshes(error: ModuleNotFoundError) -> str:
    """What is not known without the library that reads meshes."""
    return (
        f"how the robot stood is not known without {error.name}: "
        f"{install_command('robots')}"
    )


def with_lasting_name(scenario: Scenario) -> Scenario:
    """As a log keeps it: it may be looked at from another working directory."""
    return replace(scenario, robot=lasting_name(scenario.robot))


def _simulate(
    simulator: Simulator,
    duration: float,
    progress: Progress | None,
    interrupts: Interrupts,
) -> None:
    """Advances to the end."""
    start = time.perf_counter()
    simulator.Initialize()
    steps = max(1, round(duration / _SLICE))
    for step in range(1, steps + 1):
        until = duration if step == steps else duration * step / steps
        simulator.AdvanceTo(until)
        if progress is not None:
            progress(until, duration, until / (time.perf_counter() - start))
        if interrupts.asked:
            raise KeyboardInterrupt


def _write_run(
    out: Path,
    result: RunResult,
    record: bool,
    interrupts: Interrupts,
    note: str,
) -> list[BaseException]:
    """Writes a run's files, and adds to `result.files` what is there.

    Returns:
        Why others are not: errors of writing, or a KeyboardInterrupt as the last.
    """
    from crar_drake.results.plots import plot_run

    log, summary = result.log, result.summary

    def write_summary(path: Path) -> None:
        write_whole(path, summary.to_json())

    def write_recording(path: Path) -> None:
        from crar_drake.results.playback import record_logs

        record_logs([log], path, note=note)

    # The page takes longest, and comes last.
    others: dict[str, Callable[[Path], None]] = {
        SUMMARY: write_summary,
        PLOT: lambda path: plot_run(log, path),
    }
    if record:
        others[RECORDING] = write_recording
    missing: list[BaseException] = []
    try:
        with turn_to_write(out):
            with whole_file(out / LOG) as temporary:
                with temporary.open("wb") as stream:
                    log.write(stream)
                # They are of an earlier run, and would seem to be of this one.
                for name in (RECORDING, SUMMARY, PLOT):
                    (out / name).unlink(missing_ok=True)
            result.files.append(out / LOG)
            interrupts.release()
            for name, write in others.items():
                try:
                    write(out / name)
                    result.files.append(out / name)
                except WriteError as error:
                    missing.append(error)
    except (WriteError, KeyboardInterrupt) as error:
        missing.append(error)
    order = (RECORDING, LOG, SUMMARY, PLOT)
    result.files.sort(key=lambda path: order.index(path.name))
    return missing


def _reason_of(stopped: BaseException | None) -> str:
    """Why a run stopped, for its summary."""
    if stopped is None:
        return ""
    if isinstance(stopped, KeyboardInterrupt):
        return "interrupted"
    name = "" if isinstance(stopped, CrarError) else f"{type(stopped).__name__}: "
    return f"{name}{stopped}"


def _tell_end(
    result: RunResult,
    out: Path,
    stopped: BaseException | None,
    missing: list[BaseException],
    duration: str,
) -> None:
    """Raises what is to be said of a run that is not whole; else nothing."""
    if stopped is None and not missing:
        return
    parts = []
    interrupted = isinstance(stopped, KeyboardInterrupt)
    if stopped is not None:
        reached = f"at {result.log.time[-1]:.3f} s{duration}"
        parts.append(reached if interrupted else f"{_reason_of(stopped)} ({reached})")
    for error in missing:
        if isinstance(error, WriteError):
            parts.append(str(error))
        else:
            parts.append("interrupted again while files were written")
            if not interrupted:
                parts[-1] = "while the files were written"
            interrupted = True
    names = ", ".join(path.name for path in result.files)
    if not names:
        parts.append(f"nothing was written, {out} is as it was")
    elif missing:
        parts.append(f"{out} holds {names} of this run")
        if out / LOG in result.files and out / RECORDING not in result.files:
            parts.append(f"crar-drake show {out / LOG} makes a page")
    else:
        parts.append(f"{out} holds what was simulated till then")
    message = "; ".join(parts)
    if interrupted:
        raise RunInterrupted(message, result) from stopped
    if stopped is not None and not isinstance(stopped, FAILURES):
        stopped.add_note(message)
        raise stopped
    cause = stopped if stopped is not None else missing[0]
    raise RunFailed(message, result) from cause
