"""Runs a scenario: simulates, keeps the log, and writes what is to be seen of it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Context, Diagram

from crar_drake.diagram import MakeCrarDiagram, PrepareScenario, Setup
from crar_drake.disturbances import ScaleMasses
from crar_drake.errors import ScenarioError
from crar_drake.files import whole_file
from crar_drake.log import SimulationLog
from crar_drake.motion.report import inspect
from crar_drake.robot_description import lasting_name
from crar_drake.run_warnings import run_warnings
from crar_drake.scenario import Scenario
from crar_drake.summary import Summary, summarize

# What a run writes into its folder.
RECORDING, LOG, SUMMARY, PLOT = "recording.html", "log.npz", "summary.json", "plot.png"

# The controller's outputs that a log keeps.
_LOGGED = (
    "actuation",
    "desired_acceleration",
    "task_error",
    "signed_distances",
    "constraint_weights",
    "status",
    "resting_margins",
    "torque_limit",
)

# The progress is told this often [s of simulated time].
_SLICE = 0.0625

# Takes simulated time [s], duration [s] and the real-time factor so far.
Progress = Callable[[float, float, float], None]


@dataclass(frozen=True)
class RunResult:
    """What a run leaves.

    Attributes:
        log: the samples.
        summary: the figures.
        setup: what the run was made of.
        files: what was written, in the order of `run_scenario`; empty if nothing.
    """

    log: SimulationLog
    summary: Summary
    setup: Setup
    files: list[Path] = field(default_factory=list)


def run_scenario(
    scenario: Scenario,
    out: str | os.PathLike[str] | None = None,
    *,
    record: bool = True,
    progress: Progress | None = None,
) -> RunResult:
    """Simulates a scenario to its end.

    With `out`, the folder then holds `recording.html` (a page to look at),
    `log.npz` (see `SimulationLog`), `summary.json` (see `Summary`) and `plot.png`,
    all of this run: they replace older ones together, after everything succeeded,
    and an older recording goes if this run makes none. A run that fails leaves the
    folder as it was.

    Args:
        scenario: from `load_scenario`, or made in Python.
        out: folder to write into; None writes nothing.
        record: whether to make the recording, if there is a folder for it.
        progress: is told simulated time, duration and real-time factor.

    Raises:
        CrarError: something in the scenario, its robot or its motion is wrong, or
            `out` cannot be written to.
    """
    if out is not None:
        check_writable(Path(out))
    setup = PrepareScenario(scenario)
    meshcat = Meshcat() if record and out is not None else None
    diagram = MakeCrarDiagram(scenario, meshcat, setup)
    duration = scenario.duration or setup.motion.duration

    simulator = Simulator(diagram)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    if scenario.disturbances.mass_scale != 1.0:
        plant = diagram.GetSubsystemByName("plant")
        ScaleMasses(
            plant,
            plant.GetMyMutableContextFromRoot(simulator.get_mutable_context()),
            scenario.disturbances.mass_scale,
        )
    if meshcat is not None:
        from crar_drake.recording import start_recording

        start_recording(meshcat, scenario.visualization.publish_period)
    wall_time = _simulate(simulator, duration, progress)
    log = make_log(scenario, setup, diagram, simulator.get_context())
    clip = setup.motion.clip
    report = inspect(clip) if clip is not None else None
    warnings = run_warnings(scenario, setup, report, recorded=meshcat is not None)
    summary = summarize(log, wall_time, motion=report, warnings=warnings)
    if out is None:
        return RunResult(log, summary, setup)
    return RunResult(log, summary, setup, _write(Path(out), log, summary, meshcat))


def make_log(
    scenario: Scenario, setup: Setup, diagram: Diagram, context: Context
) -> SimulationLog:
    """Collects the log of a diagram that was simulated.

    Args:
        scenario: of the diagram.
        setup: of the scenario.
        diagram: made by `MakeCrarDiagram`.
        context: of the diagram, after the simulation.
    """

    def samples(port: str) -> np.ndarray:
        sink = diagram.GetSubsystemByName(f"log_{port}")
        return sink.FindLog(context).data().T.copy()

    diagnostics = samples("diagnostics")
    slices = diagram.GetSubsystemByName("crar_controller").diagnostics_slices
    model = setup.model
    plant = model.plant
    nq = plant.num_positions()
    state = samples("state")
    lower, upper = np.full(nq, -np.inf), np.full(nq, np.inf)
    lower[model.controlled], upper[model.controlled] = model.lower, model.upper
    actuators = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices()]
    actuators.sort(key=lambda actuator: actuator.input_start())
    sink = diagram.GetSubsystemByName("log_state")
    return SimulationLog(
        time=sink.FindLog(context).sample_times().copy(),
        q=state[:, :nq],
        v=state[:, nq:],
        desired_tasks=samples("desired_tasks"),
        **{name: diagnostics[:, slices[name]].copy() for name in _LOGGED},
        position_names=np.array(model.position_names),
        actuator_names=np.array(
            [model.position_names[a.joint().velocity_start()] for a in actuators]
        ),
        controlled_names=np.array(model.joint_names),
        task_names=np.array(model.layout.names),
        task_kinds=np.array(model.layout.kinds),
        pair_names=np.array([f"{a} - {b}" for a, b in model.pairs.names], dtype=str),
        lower=lower,
        upper=upper,
        # The run may be looked at from another working directory.
        scenario=replace(scenario, robot=lasting_name(scenario.robot)).to_yaml(),
    )


def _simulate(
    simulator: Simulator, duration: float, progress: Progress | None
) -> float:
    """Advances to the end and returns the wall time that it took [s]."""
    start = time.perf_counter()
    simulator.Initialize()
    steps = max(1, round(duration / _SLICE))
    for until in np.linspace(0.0, duration, steps + 1)[1:]:
        simulator.AdvanceTo(until)
        if progress is not None:
            progress(until, duration, until / (time.perf_counter() - start))
    return time.perf_counter() - start


def _write(
    out: Path, log: SimulationLog, summary: Summary, meshcat: Meshcat | None
) -> list[Path]:
    from crar_drake.plots import plot_run

    paths = [out / name for name in (RECORDING, LOG, SUMMARY, PLOT)]
    recording, log_path, summary_path, plot = paths
    # They all get their names when the stack is left, or none does.
    with ExitStack() as stack:
        if meshcat is not None:
            from crar_drake.recording import save_recording

            save_recording(meshcat, stack.enter_context(whole_file(recording)))
        log.save(stack.enter_context(whole_file(log_path)))
        stack.enter_context(whole_file(summary_path)).write_text(summary.to_json())
        plot_run(log, stack.enter_context(whole_file(plot)))
    if meshcat is None:
        recording.unlink(missing_ok=True)
        paths.remove(recording)
    return paths


def check_writable(out: Path) -> None:
    """Better to know before a long simulation than after it.

    Raises:
        ScenarioError: `out` is below a file, or may not be written to.
    """
    place = out.absolute()
    while not place.exists():
        place = place.parent
    if not place.is_dir():
        raise ScenarioError(f"{out}: {place} is a file; name another folder")
    if not os.access(place, os.W_OK):
        raise ScenarioError(f"{out}: {place} may not be written to; name another one")
