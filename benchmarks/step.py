"""How long a control step takes, and of what; compiled where Numba is installed.

    python -m benchmarks.step [--quick] [--page docs/measurements/speed.md]

`docs/measurements/speed.md` says what is measured and what is to be reached. Everything
is timed in one process and one thread, by turns, so that figures of one run can be
compared.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from benchmarks.options import add_preview_option, defaults_or_preview
from benchmarks.page import Benchmark, describe_machine
from benchmarks.page import run as run_command
from benchmarks.plain import as_it_is, plain
from benchmarks.step_compiling import measure_compiling
from benchmarks.step_report import draw_bench, tables
from benchmarks.step_robots import PERIOD, make_robot, make_samples
from benchmarks.step_subjects import (
    OVERHEAD,
    PARTS,
    Bound,
    Samples,
    Step,
    StepInParts,
    samples_of_run,
    samples_with_poses,
)
from benchmarks.step_timing import (
    BY_TURNS,
    IN_A_ROW,
    Subject,
    Timing,
    median,
    time_side_by_side,
)
from benchmarks.sweep.command import list_of, one_of
from crar_drake import __version__
from crar_drake.commands.options import positive
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations.compilation import IS_COMPILED, arithmetic
from crar_drake.figures import save_figure
from crar_drake.files import check_folder, write_whole
from crar_drake.results import RECORDING
from crar_drake.results.playback import record_log
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS, Task
from crar_drake.run import make_log, run_scenario
from crar_drake.simulation.diagram import Setup
from crar_drake.simulation.scenario import Scenario

MODES = ("paper", "lookahead")
MEASUREMENTS = ("step", "simulation", "scaling", "compiling")

# Whose control steps are measured; the first two are the paper's task sets.
HANDS = "hands' poses"  # of which states and ways are those of the wrists
LIMITED = "upper-body, effort limits"
CASES = (*EXPERIMENTS, HANDS, LIMITED)

# What grows: joints, tasks, near pairs and far pairs of each robot.
SCALING = {
    "pairs": [(14, 2, pairs, 0) for pairs in (5, 10, 20, 50, 100, 200)],
    "far pairs": [(14, 2, 10, far) for far in (0, 10, 40, 90, 190)],
    "joints": [(joints, 2, 30, 0) for joints in (7, 14, 21, 30, 45, 60)],
    "tasks": [(30, tasks, 30, 0) for tasks in (1, 2, 5, 10, 20)],
}
_GROWING = {"joints": 0, "tasks": 1, "pairs": 2, "far pairs": 3}

# To be reached; ratios, so that they hold on any machine.
STEP_OVER_BOUND = {"paper": 1.45, "lookahead": 1.45}
P99_OVER_MEDIAN = 2.0
REAL_TIME_FACTOR = 3.0
PAIRS_EXPONENT = 1.0
FAR_PAIRS_GROWTH = 1.25  # the step with 190 far pairs over that without
FIRST_COMPILE = 45.0  # [s] of one core: the one that depends on the machine


@dataclass(frozen=True)
class BenchSettings:
    """What is measured, and for how long.

    Attributes:
        motion: the control steps are those along this motion.
        duration: of it that is simulated [s]; at most the motion's.
        repeats: how often each simulation is timed.
        scaling_steps: control steps per robot that is made up.
        measurements: which of MEASUREMENTS.
        cases: of CASES; whole simulations are those of the task sets among them.
        preview: of the lookahead [s]; None for its own, 0 for none.
    """

    motion: str = "dance"
    duration: float = 3.0  # [s]
    repeats: int = 3
    scaling_steps: int = 200
    measurements: tuple[str, ...] = MEASUREMENTS
    cases: tuple[str, ...] = CASES
    scaling: dict[str, list[tuple[int, int, int, int]]] = field(
        default_factory=lambda: dict(SCALING)
    )
    preview: float | None = None


def run_bench(
    settings: BenchSettings, tell: Callable[[str], None] = lambda text: None
) -> dict:
    """Measures, and returns what `bench.json` holds; durations are in seconds.

    NumPy's library must not use threads of its own: set OMP_NUM_THREADS=1 before
    NumPy is imported, as the command does for itself.

    Returns:
        "version", "machine", "settings"; "arithmetic", as the control law is; lists
        "step", "simulation" and "scaling" with an entry per case; "compiling", see
        `measure_compiling`, or None; "targets", see `find_targets`.

    Raises:
        CrarError: the motion cannot be found, read or scaled.
    """
    result = {
        "version": __version__,
        "machine": describe_machine(),
        "settings": asdict(settings),
        "arithmetic": arithmetic(),
        "step": [],
        "simulation": [],
        "scaling": [],
        "compiling": None,
    }
    measurements = settings.measurements
    if "compiling" in measurements and IS_COMPILED:
        tell("compiling")
        result["compiling"] = measure_compiling()
    if "step" in measurements:
        for case in settings.cases:
            tell(f"one control step, {case}")
            result["step"] += measure_step(settings, case)
    if "simulation" in measurements:
        for experiment in filter(EXPERIMENTS.get, settings.cases):
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


# --- one control step -------------------------------------------------------------


def measure_step(settings: BenchSettings, case: str) -> list[dict]:
    """Control steps of both modes, their bounds and their parts, along the motion."""
    runs = {mode: _steps_of(settings, case, mode) for mode in MODES}
    num_steps = min(len(samples) for _, _, samples in runs.values())

    steps = {mode: Step(*run) for mode, run in runs.items()}
    bounds = {mode: Bound(*run) for mode, run in runs.items()}
    in_parts = {mode: StepInParts(*run) for mode, run in runs.items()}
    subjects: dict[tuple[str, str], Subject] = {}
    for mode, run in runs.items():
        subjects |= {
            ("step", mode): steps[mode],
            ("bound", mode): bounds[mode],
            ("parts", mode): in_parts[mode],
        }
        if IS_COMPILED:
            subjects["plain step", mode] = _plain_step(*run)
        _warm_up(subjects, mode)
    in_a_row = time_side_by_side(subjects, num_steps, IN_A_ROW)
    compared = {key: s for key, s in subjects.items() if key[0] in _COMPARED}
    for subject in compared.values():
        subject.restart()
    by_turns = time_side_by_side(compared, num_steps, BY_TURNS)
    entries = []
    for mode, (model, _, _) in runs.items():
        kept = in_a_row["parts", mode].kept
        parts = {p: median(in_parts[mode].own[p][:num_steps][kept]) for p in PARTS}
        whole = _figures(in_a_row, mode)
        parts[OVERHEAD] = whole["step"]["median"] - sum(parts.values())
        entries.append(
            {
                "case": case,
                "constraints": mode,
                "joints": model.n,
                "task_rows": model.m,
                "pairs": len(model.pairs),
                "links": bounds[mode].num_links,
                "steps": num_steps,
                "in_a_row": whole,
                "by_turns": _figures(by_turns, mode),
                "parts": parts,
            }
        )
    return entries


# What is timed by turns, too.
_COMPARED = ("step", "plain step", "bound")


def _figures(timings: dict[tuple[str, str], Timing], mode: str) -> dict:
    """Figures of each subject of _COMPARED, the plain step's None without Numba, and
    the ratios of the step's to the bound's."""
    found: dict = {
        name: timings[name, mode].figures() if (name, mode) in timings else None
        for name in _COMPARED
    }
    step, bound = found["step"], found["bound"]
    found["ratio"] = step["median"] / bound["median"]
    found["cpu_ratio"] = step["cpu_median"] / bound["cpu_median"]
    return found


def _steps_of(
    settings: BenchSettings, case: str, mode: str
) -> tuple[ControlModel, CrarParameters, Samples]:
    """Model, parameters and samples of a case of CASES."""
    experiment = {HANDS: "wrists", LIMITED: "upper-body"}.get(case, case)
    scenario = _scenario(settings, experiment, mode)
    scenario.controller.respect_effort_limits = case == LIMITED
    run = run_scenario(scenario, record=False)
    model, samples = run.setup.model, samples_of_run(run)
    if case == HANDS:
        wrists = model.description.task_frames
        tasks = [
            Task(frame=wrists[name], kind="pose", orientation_weight=0.2)
            for name in EXPERIMENTS["wrists"]
        ]
        time_step = scenario.plant_config.time_step
        model = ControlModel.FromDescription(
            model.description, tasks, time_step=time_step
        )
        samples = samples_with_poses(samples, model, scenario.controller)
    return model, scenario.controller, samples


def _plain_step(
    model: ControlModel, parameters: CrarParameters, samples: Samples
) -> Step:
    """The same step without Numba."""
    package = plain()
    other = package.ControlModel.FromDescription(
        package.load_robot_description(model.description.name),
        [package.Task(**vars(task)) for task in model.tasks],
        time_step=model.plant.time_step(),
    )
    values = {f.name: getattr(parameters, f.name) for f in fields(parameters)}
    return Step(other, package.CrarParameters(**values), samples, package)


def _warm_up(subjects: dict[tuple[str, str], Subject], mode: str) -> None:
    """Everything once, so that nothing compiles while it is timed."""
    for (_, its_mode), subject in subjects.items():
        if its_mode == mode:
            subject.begin()
            subject.prepare(0)
            subject()
            subject.end()
            subject.restart()


# --- the whole simulation ---------------------------------------------------------


def measure_simulation(settings: BenchSettings, experiment: str) -> list[dict]:
    """Real-time factors of the scenario, with and without recording and Numba, by
    turns."""
    packages = {"as it is": as_it_is()}
    if IS_COMPILED:
        packages["plain"] = plain()
    prepared = {}
    for mode in MODES:
        for name, package in packages.items():
            scenario = _scenario(settings, experiment, mode, package)
            setup = package.PrepareScenario(scenario)
            scenario.duration = min(settings.duration, setup.motion.duration)
            prepared[mode, name] = (scenario, setup, package)
    timings: dict[tuple[str, str, bool], list[SimulationTime]] = {}
    for _ in range(settings.repeats):
        for (mode, name), simulated in prepared.items():
            for recording in (False, True):
                timing = time_simulation(*simulated, recording)
                timings.setdefault((mode, name, recording), []).append(timing)
    entries = []
    for (mode, name, recording), repeats in timings.items():
        duration = prepared[mode, name][0].duration
        wall, cpu, page = (
            median(np.array(times)) for times in zip(*repeats, strict=True)
        )
        entries.append(
            {
                "case": experiment,
                "constraints": mode,
                "plain": name == "plain",
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
    scenario: Scenario, setup: Setup, package: SimpleNamespace, recording: bool
) -> SimulationTime:
    """Times a simulation from its start to its end; building it does not count.

    Args:
        scenario, setup: of the package.
        package: of `benchmarks.plain`.
        recording: whether its page is made afterwards.
    """
    diagram = package.MakeCrarDiagram(scenario, setup=setup)
    simulator = Simulator(diagram)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    simulator.Initialize()
    start, cpu_start = time.perf_counter(), time.process_time()
    simulator.AdvanceTo(scenario.duration)
    end, cpu_end = time.perf_counter(), time.process_time()
    if recording:
        log = make_log(scenario, setup, diagram, simulator.get_context())
        with tempfile.TemporaryDirectory() as folder:
            record_log(log, Path(folder) / RECORDING, scenario=scenario)
    return SimulationTime(end - start, cpu_end - cpu_start, time.perf_counter() - end)


# --- growth -----------------------------------------------------------------------


def measure_scaling(
    quantity: str, robots: Sequence[tuple[int, int, int, int]], num_steps: int
) -> list[dict]:
    """Median control step of robots of growing size, see `step_robots`.

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
            _warm_up({(mode, mode): subjects[mode, i]}, mode)
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
                "robots": list(robots),
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

    steps, scaling = result["step"], result["scaling"]
    for mode, limit in STEP_OVER_BOUND.items():
        for order, words in (("in_a_row", "in a row"), ("by_turns", "by turns")):
            ratios = [e[order]["cpu_ratio"] for e in steps if e["constraints"] == mode]
            add(f"{mode}: step over bound, {words}, processor time", ratios, limit)
    for clock, words in (("", "wall clock"), ("cpu_", "processor time")):
        each = [e["in_a_row"]["step"] for e in steps]
        ratios = [step[f"{clock}p99"] / step[f"{clock}median"] for step in each]
        add(f"step: 99th percentile over median, {words}", ratios, P99_OVER_MEDIAN)
    recorded = [e for e in result["simulation"] if e["recording"] and not e["plain"]]
    for factor, words in (
        ("real_time_factor", "wall clock"),
        ("cpu_factor", "processor time"),
    ):
        text = f"simulation: real-time factor with recording, {words}"
        add(text, [e[factor] for e in recorded], REAL_TIME_FACTOR, at_least=True)
    if result["compiling"]:
        first = result["compiling"]["first"]["cpu"]
        add("first compile, processor time [s]", [first], FIRST_COMPILE)
    exponents = [
        max(e["exponent"], e["last_exponent"])
        for e in scaling
        if e["quantity"] == "pairs"
    ]
    add("growth with the pairs: largest exponent", exponents, PAIRS_EXPONENT)
    growths = [
        e["last_over_first"]
        for e in scaling
        if e["quantity"] == "far pairs" and e["constraints"] == "lookahead"
    ]
    text = "lookahead: growth by 190 pairs beyond the influence distance"
    add(text, growths, FAR_PAIRS_GROWTH)
    return found


# --- the circumstances ------------------------------------------------------------


def _scenario(
    settings: BenchSettings,
    experiment: str,
    mode: str,
    package: SimpleNamespace | None = None,
) -> Scenario:
    package = package or as_it_is()
    controller = package.CrarParameters(constraints=mode)
    controller.lookahead.preview = settings.preview
    return package.Scenario(
        motion=settings.motion,
        experiment=experiment,
        controller=controller,
        duration=settings.duration,
    )


# --- the command ------------------------------------------------------------------


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.step", __doc__, "speed")
    parser = benchmark.parser
    parser.add_argument("--motion", default="dance", help="(default: %(default)s)")
    parser.add_argument(
        "--duration", type=positive, metavar="S", help="of it [s] (default: 3)"
    )
    parser.add_argument(
        "--only",
        type=list_of(one_of(MEASUREMENTS)),
        action="extend",
        metavar="M[,M...]",
        help=f"what to measure, of {', '.join(MEASUREMENTS)} (default: all)",
    )
    add_preview_option(parser)
    parser.add_argument("--quick", action="store_true", help="few samples")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/bench"),
        metavar="DIR",
        help="for bench.json and bench.png (default: %(default)s)",
    )
    arguments = benchmark.parse(argv, _part)
    check_folder(arguments.out)
    settings = BenchSettings(
        motion=arguments.motion,
        duration=arguments.duration or (1.0 if arguments.quick else 3.0),
        measurements=tuple(dict.fromkeys(arguments.only or MEASUREMENTS)),
        preview=arguments.preview,
    )
    if arguments.quick:
        settings = replace(settings, repeats=1, scaling_steps=20)
    result = run_bench(
        settings, lambda text: print(f"measuring: {text}", file=sys.stderr)
    )
    data, plot = arguments.out / "bench.json", arguments.out / "bench.png"
    write_whole(data, json.dumps(result, indent=2) + "\n")
    save_figure(draw_bench(result), plot, dpi=150)
    benchmark.report(
        tables(result),
        f"Motion {settings.motion}, {settings.duration:g} s. "
        f"The step is {result['arithmetic']}.",
    )
    print(data, plot, sep="\n")


def _part(arguments: argparse.Namespace) -> str:
    measured = defaults_or_preview(arguments)
    return "step" if measured == "defaults" else f"step {measured}"


def _take_one_thread() -> None:
    """Starts this command again unless NumPy's library has one thread only.

    The library reads its settings when it is loaded, which has happened.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    if any(os.environ.get(name) != "1" for name in names):
        os.environ.update(dict.fromkeys(names, "1"))
        command = [sys.executable, "-m", "benchmarks.step", *sys.argv[1:]]
        os.execv(sys.executable, command)


if __name__ == "__main__":
    _take_one_thread()
    run_command(main)
