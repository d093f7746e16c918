"""The command `crar-drake bench`: how long a control step takes, and of what.

`docs/speed.md` says what is measured and what is to be reached. Everything is timed
in one process and one thread, by turns, so that figures of one run can be compared.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from benchmarks.step_robots import PERIOD, make_robot, make_samples
from benchmarks.step_subjects import (
    OVERHEAD,
    PARTS,
    Bound,
    ModelAlone,
    SceneGraphDistances,
    Step,
    StepInParts,
    samples_of_run,
)
from benchmarks.step_timing import (
    BY_TURNS,
    IN_A_ROW,
    Subject,
    median,
    time_side_by_side,
)
from crar_drake import __version__
from crar_drake.control.parameters import CrarParameters
from crar_drake.results import RECORDING
from crar_drake.results.playback import save_recording
from crar_drake.robot.task import EXPERIMENTS
from crar_drake.run import run_scenario
from crar_drake.simulation.diagram import MakeCrarDiagram, PrepareScenario, Setup
from crar_drake.simulation.scenario import Scenario
from crar_drake.simulation.visualization import start_recording
from crar_drake.studies.machine import describe_machine

MODES = ("paper", "lookahead")
MEASUREMENTS = ("step", "simulation", "scaling")

# What grows: joints, tasks, near pairs and far pairs of each robot.
SCALING = {
    "pairs": [(14, 2, pairs, 0) for pairs in (5, 10, 20, 50, 100, 200)],
    "far pairs": [(14, 2, 10, far) for far in (0, 10, 40, 90, 190)],
    "joints": [(joints, 2, 30, 0) for joints in (7, 14, 21, 30, 45, 60)],
    "tasks": [(30, tasks, 30, 0) for tasks in (1, 2, 5, 10, 20)],
}
_GROWING = {"joints": 0, "tasks": 1, "pairs": 2, "far pairs": 3}

# To be reached; ratios, so that they hold on any machine.
STEP_OVER_BOUND = {"paper": 1.6, "lookahead": 2.0}
P99_OVER_MEDIAN = 2.0
REAL_TIME_FACTOR = 2.0
PAIRS_EXPONENT = 1.0
FAR_PAIRS_GROWTH = 1.25  # the step with 190 far pairs over that without

# Is told in a few words what is being measured.
Progress = Callable[[str], None]


@dataclass(frozen=True)
class BenchSettings:
    """What is measured, and for how long.

    Attributes:
        motion: the control steps are those along this motion.
        duration: of it that is simulated [s]; at most the motion's.
        repeats: how often each simulation is timed.
        scaling_steps: control steps per robot that is made up.
        measurements: which of MEASUREMENTS.
        experiments: the task sets.
    """

    motion: str = "dance"
    duration: float = 3.0  # [s]
    repeats: int = 3
    scaling_steps: int = 200
    measurements: tuple[str, ...] = MEASUREMENTS
    experiments: tuple[str, ...] = tuple(EXPERIMENTS)
    scaling: dict[str, list[tuple[int, int, int, int]]] = field(
        default_factory=lambda: dict(SCALING)
    )


def run_bench(
    settings: BenchSettings | None = None, progress: Progress | None = None
) -> dict:
    """Measures, and returns what `bench.json` holds; durations are in seconds.

    NumPy's library must not use threads of its own: set OMP_NUM_THREADS=1 before
    NumPy is imported, as the command does.

    Returns:
        "version", "machine", "settings"; lists "step", "simulation" and "scaling"
        with an entry per case; "targets", see `find_targets`.

    Raises:
        CrarError: the motion cannot be found, read or scaled.
    """
    settings = settings or BenchSettings()
    tell = progress or (lambda text: None)
    result = {
        "version": __version__,
        "machine": describe_machine(),
        "settings": asdict(settings),
        "step": [],
        "simulation": [],
        "scaling": [],
    }
    measurements = settings.measurements
    if "step" in measurements:
        for experiment in settings.experiments:
            tell(f"one control step, {experiment}")
            result["step"] += measure_step(settings, experiment)
    if "simulation" in measurements:
        for experiment in settings.experiments:
            tell(f"whole simulation, {experiment}")
            result["simulation"] += measure_simulation(settings, experiment)
    if "scaling" in measurements:
        for quantity, robots in settings.scaling.items():
            tell(f"growth with the {quantity}")
            result["scaling"] += measure_scaling(
                quantity, robots, settings.scaling_steps
            )
    result["targets"] = find_targets(result)
    return result


def write_json(result: dict, path: str | os.PathLike[str]) -> None:
    """Writes the result of `run_bench`, whole or not at all."""
    from crar_drake.files import whole_file

    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(result, indent=2) + "\n")


# --- one control step -------------------------------------------------------------


def measure_step(settings: BenchSettings, experiment: str) -> list[dict]:
    """Control steps of both modes, their bounds and their parts, along the motion."""
    runs = {}
    for mode in MODES:
        scenario = _scenario(settings, experiment, mode)
        run = run_scenario(scenario, record=False)
        runs[mode] = (run.setup.model, scenario.controller, samples_of_run(run))
    num_steps = min(len(samples) for _, _, samples in runs.values())

    steps = {mode: Step(*run) for mode, run in runs.items()}
    bounds = {mode: Bound(*run) for mode, run in runs.items()}
    in_parts = {mode: StepInParts(*run) for mode, run in runs.items()}
    subjects: dict[tuple[str, str], Subject] = {}
    for mode, run in runs.items():
        subjects |= {
            ("step", mode): steps[mode],
            ("bound", mode): bounds[mode],
            ("model", mode): ModelAlone(*run),
            ("scene graph", mode): SceneGraphDistances(*run),
            ("parts", mode): in_parts[mode],
        }
    in_a_row = time_side_by_side(subjects, num_steps, IN_A_ROW)
    for step in steps.values():
        step.restart()
    by_turns = time_side_by_side(
        {key: s for key, s in subjects.items() if key[0] in ("step", "bound")},
        num_steps,
        BY_TURNS,
    )
    entries = []
    for mode, (model, _, _) in runs.items():
        step = in_a_row["step", mode].figures()
        kept = in_a_row["parts", mode].kept
        parts = {p: median(in_parts[mode].own[p][:num_steps][kept]) for p in PARTS}
        parts[OVERHEAD] = step["median"] - sum(parts.values())
        entries.append(
            {
                "experiment": experiment,
                "constraints": mode,
                "joints": model.n,
                "task_rows": model.m,
                "pairs": len(model.pairs),
                "links": bounds[mode].num_links,
                "steps": num_steps,
                "in_a_row": _with_ratio(step, in_a_row["bound", mode].figures()),
                "by_turns": _with_ratio(
                    by_turns["step", mode].figures(),
                    by_turns["bound", mode].figures(),
                ),
                "parts": parts,
                "model_alone": in_a_row["model", mode].figures(),
                "scene_graph_distances": in_a_row["scene graph", mode].figures(),
            }
        )
    return entries


def _with_ratio(step: dict[str, float], bound: dict[str, float]) -> dict:
    return {"step": step, "bound": bound, "ratio": step["median"] / bound["median"]}


# --- the whole simulation ---------------------------------------------------------


def measure_simulation(settings: BenchSettings, experiment: str) -> list[dict]:
    """Real-time factors of the scenario, with and without recording, by turns."""
    prepared = {}
    for mode in MODES:
        scenario = _scenario(settings, experiment, mode)
        setup = PrepareScenario(scenario)
        scenario.duration = min(settings.duration, setup.motion.duration)
        prepared[mode] = (scenario, setup)
    timings: dict[tuple[str, bool], list[SimulationTime]] = {}
    for _ in range(settings.repeats):
        for mode, (scenario, setup) in prepared.items():
            for recording in (False, True):
                timing = time_simulation(scenario, setup, recording)
                timings.setdefault((mode, recording), []).append(timing)
    entries = []
    for (mode, recording), repeats in timings.items():
        duration = prepared[mode][0].duration
        wall, cpu, page = (
            median(np.array(times)) for times in zip(*repeats, strict=True)
        )
        entries.append(
            {
                "experiment": experiment,
                "constraints": mode,
                "recording": recording,
                "duration": duration,
                "wall": [timing.wall for timing in repeats],
                "real_time_factor": duration / wall,
                "cpu_factor": duration / cpu,
                "writing_the_page": page,
            }
        )
    return entries


class SimulationTime(NamedTuple):
    """Wall time of a simulation, processor time of all threads, and the wall time of
    writing the page after it [s]."""

    wall: float
    cpu: float
    page: float


def time_simulation(
    scenario: Scenario, setup: Setup, recording: bool
) -> SimulationTime:
    """Times a simulation from its start to its end; building it does not count."""
    meshcat = Meshcat() if recording else None
    diagram = MakeCrarDiagram(scenario, meshcat, setup)
    simulator = Simulator(diagram)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    if meshcat is not None:
        start_recording(meshcat, scenario.visualization.publish_period)
    simulator.Initialize()
    start, cpu_start = time.perf_counter(), time.process_time()
    simulator.AdvanceTo(scenario.duration)
    end, cpu_end = time.perf_counter(), time.process_time()
    if meshcat is not None:
        with tempfile.TemporaryDirectory() as folder:
            save_recording(meshcat, Path(folder) / RECORDING)
    return SimulationTime(end - start, cpu_end - cpu_start, time.perf_counter() - end)


# --- growth -----------------------------------------------------------------------


def measure_scaling(
    quantity: str, robots: Sequence[tuple[int, int, int, int]], num_steps: int
) -> list[dict]:
    """Median control step of robots of growing size, see `bench_robots`.

    Args:
        quantity: which grows, a key of SCALING.
        robots: joints, tasks, near pairs and far pairs of each.
        num_steps: control steps of each robot and mode.
    """
    subjects: dict[tuple[str, int], Subject] = {}
    for i, robot in enumerate(robots):
        model = make_robot(*robot)
        for mode in MODES:
            parameters = CrarParameters(constraints=mode, period=PERIOD, blend_time=0.0)
            samples = make_samples(model, parameters, num_steps)
            subjects[mode, i] = Step(model, parameters, samples)
    timings = time_side_by_side(subjects, num_steps)
    sizes = [robot[_GROWING[quantity]] for robot in robots]
    entries = []
    for mode in MODES:
        figures = [timings[mode, i].figures() for i in range(len(robots))]
        medians = [f["median"] for f in figures]
        entries.append(
            {
                "quantity": quantity,
                "constraints": mode,
                "robots": [
                    dict(
                        zip(
                            ("joints", "tasks", "near_pairs", "far_pairs"),
                            robot,
                            strict=True,
                        )
                    )
                    for robot in robots
                ],
                "sizes": sizes,
                "median": medians,
                "p99": [f["p99"] for f in figures],
                "cpu_median": [f["cpu_median"] for f in figures],
                **fit_growth(sizes, medians),
            }
        )
    return entries


def fit_growth(sizes: Sequence[float], times: Sequence[float]) -> dict[str, float]:
    """How times grow with sizes.

    Returns:
        "exponent": k of the best time = c size^k; "last_exponent": k between the
        two largest sizes alone; "per_unit": slope of the best straight line [s];
        "last_over_first": ratio of the times at the largest and smallest size.
        Exponents are of the sizes that are not 0.
    """
    x, y = np.array(sizes, dtype=float), np.array(times, dtype=float)
    log_x, log_y = np.log(x[x > 0.0]), np.log(y[x > 0.0])
    return {
        "exponent": float(np.polyfit(log_x, log_y, 1)[0]),
        "last_exponent": float((log_y[-1] - log_y[-2]) / (log_x[-1] - log_x[-2])),
        "per_unit": float(np.polyfit(x, y, 1)[0]),
        "last_over_first": float(y[-1] / y[0]),
    }


# --- targets ----------------------------------------------------------------------


def find_targets(result: dict) -> list[dict]:
    """What is to be reached, of what was measured; the worst of all cases counts.

    Returns:
        Per target "target" (text), "value", "limit", "at_least" (else at most) and
        "reached".
    """
    found = []

    def add(text: str, values: list[float], limit: float, at_least=False) -> None:
        if values:
            value = min(values) if at_least else max(values)
            reached = value >= limit if at_least else value <= limit
            found.append(
                {
                    "target": text,
                    "value": value,
                    "limit": limit,
                    "at_least": at_least,
                    "reached": bool(reached),
                }
            )

    steps = result["step"]
    for mode, limit in STEP_OVER_BOUND.items():
        of_mode = [e for e in steps if e["constraints"] == mode]
        for order, words in (("in_a_row", "in a row"), ("by_turns", "by turns")):
            add(
                f"{mode}: step over bound, {words}",
                [e[order]["ratio"] for e in of_mode],
                limit,
            )
    for clock, words in (("", "wall clock"), ("cpu_", "processor time")):
        add(
            f"step: 99th percentile over median, {words}",
            [
                e["in_a_row"]["step"][f"{clock}p99"]
                / e["in_a_row"]["step"][f"{clock}median"]
                for e in steps
            ],
            P99_OVER_MEDIAN,
        )
    for factor, words in (
        ("real_time_factor", "wall clock"),
        ("cpu_factor", "processor time"),
    ):
        add(
            f"simulation: real-time factor with recording, {words}",
            [e[factor] for e in result["simulation"] if e["recording"]],
            REAL_TIME_FACTOR,
            at_least=True,
        )
    scaling = result["scaling"]
    add(
        "growth with the pairs: largest exponent",
        [
            max(e["exponent"], e["last_exponent"])
            for e in scaling
            if e["quantity"] == "pairs"
        ],
        PAIRS_EXPONENT,
    )
    add(
        "lookahead: growth by 190 pairs beyond the influence distance",
        [
            e["last_over_first"]
            for e in scaling
            if e["quantity"] == "far pairs" and e["constraints"] == "lookahead"
        ],
        FAR_PAIRS_GROWTH,
    )
    return found


# --- the circumstances ------------------------------------------------------------


def _scenario(settings: BenchSettings, experiment: str, mode: str) -> Scenario:
    return Scenario(
        motion=settings.motion,
        experiment=experiment,
        controller=CrarParameters(constraints=mode),
        duration=settings.duration,
    )
