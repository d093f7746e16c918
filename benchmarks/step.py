"""How long a control step takes.

    python -m benchmarks.step [--quick] [--page docs/measurements/speed.md]

Everything is timed in one process and one thread, by turns, so that figures of one run
can be compared.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numba
import numpy as np

from benchmarks.options import (
    add_preview_option,
    defaults_or_preview,
    list_of,
    lookahead_defaults,
    one_of,
)
from benchmarks.page import Benchmark, Table, run as run_command
from benchmarks.step_compiling import measure_compiling
from benchmarks.step_robots import PERIOD, make_robot, make_samples
from benchmarks.step_timing import Step, fit_growth, samples_of_run, time_side_by_side
from crar_drake.law.parameters import CONSTRAINTS, PaperParameters
from crar_drake.results import RECORDING
from crar_drake.results.playback import record_logs
from crar_drake.run import make_log, run_scenario
from crar_drake.simulation.diagram import (
    MakeCrarDiagram,
    MakeSimulator,
    PrepareScenario,
)
from crar_drake.simulation.scenario import Scenario

MODES = ("paper", "lookahead")
MEASUREMENTS = ("step", "simulation", "growth", "compiling")
MOTION = "dance"
REPEATS = 3  # of a simulation
LIMITED = "upper-body, effort limits"
CASES = ("wrists", "upper-body", LIMITED)

# What grows: joints, tasks, near pairs and far pairs of each robot.
GROWING = {
    "pairs": [(14, 2, pairs, 0) for pairs in (5, 10, 20, 50, 100, 200)],
    "far pairs": [(14, 2, 10, far) for far in (0, 10, 40, 90, 190)],
    "joints": [(joints, 2, 30, 0) for joints in (7, 14, 21, 30, 45, 60)],
    "tasks": [(30, tasks, 30, 0) for tasks in (1, 2, 5, 10, 20)],
}
_COLUMN = {"joints": 0, "tasks": 1, "pairs": 2, "far pairs": 3}


def measure_steps(
    duration: float, preview: float | None = None, cases: Sequence[str] = CASES
) -> Table:
    """Control steps of both modes, side by side, along the motion.

    Args:
        duration: of the motion [s].
        preview: of the lookahead [s]; None for its own, 0 for none.
        cases: of CASES.
    """
    steps = {}
    for case in cases:
        for mode in MODES:
            scenario = scenario_of(case, mode, duration, preview)
            run = run_scenario(scenario, record=False)
            name = f"{case}, {mode}"
            model, parameters = run.setup.model, scenario.controller
            steps[name] = Step(model, parameters, samples_of_run(run))
    rows = [
        [name, _us(np.median(times)), _us(np.percentile(times, 99))]
        for name, times in time_side_by_side(steps).items()
    ]
    columns = ("tasks, constraints", "step", "p99")
    return Table(columns, rows, "One control step, in a row [µs]")


def scenario_of(
    case: str, mode: str, duration: float, preview: float | None = None
) -> Scenario:
    """The scenario of a case of CASES; see `measure_steps`."""
    limited = case == LIMITED
    controller = PaperParameters(effort_limits=limited)
    if mode == "lookahead":
        controller = lookahead_defaults(preview, effort_limits=limited)
    return Scenario(
        motion=MOTION,
        experiment="upper-body" if limited else case,
        controller=controller,
        duration=duration,
    )


def measure_simulations(
    duration: float, preview: float | None = None, repeats: int = REPEATS
) -> Table:
    """Real-time factors of whole simulations, with and without recording, by turns;
    see `measure_steps`."""
    timings: dict[tuple[str, bool], list[tuple[float, ...]]] = {}
    for _ in range(repeats):
        for mode in MODES:
            scenario = scenario_of("wrists", mode, duration, preview)
            for recording in (False, True):
                timing = time_simulation(scenario, recording)
                timings.setdefault((mode, recording), []).append(timing)
    rows = []
    for (mode, recording), repeated in timings.items():
        wall, cpu, page = np.median(repeated, axis=0)
        rows.append(
            [
                f"wrists, {mode}",
                "yes" if recording else "no",
                f"{duration / wall:.2f}",
                f"{duration / cpu:.2f}",
                f"{page:.2f} s" if recording else "–",
            ]
        )
    columns = ("tasks, constraints", "recording", "real-time factor")
    more = ("by processor time", "writing the page afterwards")
    return Table((*columns, *more), rows, "Whole simulation, 1 kHz")


def time_simulation(scenario: Scenario, recording: bool) -> tuple[float, float, float]:
    """Times a simulation from its start to its end; building it does not count.

    Returns:
        Its wall time, processor time of all threads, and the wall time of writing the
        page after it [s].
    """
    setup = PrepareScenario(scenario)
    diagram = MakeCrarDiagram(scenario, setup=setup)
    simulator = MakeSimulator(scenario, diagram)
    simulator.Initialize()
    start, cpu_start = time.perf_counter(), time.process_time()
    simulator.AdvanceTo(scenario.duration)
    end, cpu_end = time.perf_counter(), time.process_time()
    if recording:
        log = make_log(scenario, setup, diagram, simulator.get_context())
        with tempfile.TemporaryDirectory() as folder:
            record_logs([log], Path(folder) / RECORDING)
    return end - start, cpu_end - cpu_start, time.perf_counter() - end


def measure_growth(
    num_steps: int, growing: dict[str, list[tuple[int, int, int, int]]] = GROWING
) -> Table:
    """Median control step of robots of growing size, see `step_robots`.

    Args:
        num_steps: of each robot and mode.
        growing: what grows, to joints, tasks, near and far pairs of each robot.
    """
    rows = []
    for quantity, robots in growing.items():
        sizes = [robot[_COLUMN[quantity]] for robot in robots]
        steps = {}
        for size, robot in zip(sizes, robots, strict=True):
            model = make_robot(*robot)
            for mode in MODES:
                parameters = CONSTRAINTS[mode](period=PERIOD, blend_time=0.0)
                samples = make_samples(model, parameters, num_steps)
                steps[mode, size] = Step(model, parameters, samples)
        times = time_side_by_side(steps)
        for mode in MODES:
            medians = [float(np.median(times[mode, size])) for size in sizes]
            growth = fit_growth(sizes, medians)
            rows.append(
                [
                    quantity,
                    mode,
                    ", ".join(map(str, sizes)),
                    ", ".join(map(_us, medians)),
                    f"{growth['exponent']:.2f}, {growth['last_exponent']:.2f}",
                    f"{1e6 * growth['per_unit']:.2f}",
                    f"{growth['last_over_first']:.2f}",
                ]
            )
    columns = ("growing", "constraints", "sizes", "step, median [µs]")
    more = ("exponent, of the last two", "per unit [µs]", "last over first")
    return Table((*columns, *more), rows, "Growth of the control step")


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:.0f}"


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.step", __doc__, "speed")
    parser = benchmark.parser
    parser.add_argument(
        "--only",
        type=list_of(one_of(MEASUREMENTS)),
        action="extend",
        metavar="M[,M...]",
        help=f"what to measure, of {', '.join(MEASUREMENTS)} (default: all)",
    )
    add_preview_option(parser)
    parser.add_argument("--quick", action="store_true", help="few samples")
    arguments = benchmark.parse(argv, _part)
    measured = arguments.only or MEASUREMENTS
    preview, quick = arguments.preview, arguments.quick
    duration = 1.0 if quick else 3.0
    tables = []
    for name, wanted, measure in (
        ("steps", "step", lambda: measure_steps(duration, preview)),
        ("compiling", "compiling", measure_compiling),
        (
            "whole simulations",
            "simulation",
            lambda: measure_simulations(duration, preview, 1 if quick else REPEATS),
        ),
        ("growth", "growth", lambda: measure_growth(20 if quick else 200)),
    ):
        if wanted in measured:
            print(f"measuring: {name}", file=sys.stderr)
            tables.append(measure())
    version = numba.__version__
    about = f"Motion {MOTION}, {duration:g} s. The step is compiled by Numba {version}."
    benchmark.report(tables, about)


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
