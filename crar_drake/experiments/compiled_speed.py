"""What a control step and a simulation take with compiled arithmetic.

    OMP_NUM_THREADS=1 python -m crar_drake.experiments.compiled_speed
        [--motion dance] [--duration 3] [--markdown docs/speed.md]

Needs Numba (`pip install 'crar-drake[compiled]'`). Steps and bounds are those of
`crar-drake bench`, along the same motion and in the same orders.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from crar_drake.compiled.compiler import HAS_NUMBA
from crar_drake.compiled.distances import distances
from crar_drake.compiled.law import CompiledLaw, find_shapes
from crar_drake.control.law import ControlLaw, Memory, Targets
from crar_drake.control.parameters import CrarParameters
from crar_drake.errors import CrarError
from crar_drake.experiments.bench import (
    MODES,
    STEP_OVER_BOUND,
    describe_machine,
    time_simulation,
)
from crar_drake.experiments.bench_step import Bound, Samples, Step, samples_of_run
from crar_drake.experiments.bench_timing import (
    BY_TURNS,
    IN_A_ROW,
    Subject,
    time_side_by_side,
)
from crar_drake.experiments.tables import markdown_table
from crar_drake.files import whole_file
from crar_drake.robot import ControlModel
from crar_drake.run import run_scenario
from crar_drake.scenario import Scenario
from crar_drake.task import EXPERIMENTS

# Of the page the tables are between this line and the next heading as high as "##".
HEADING = "### Compiled, in one run"
ORDERS = {"in a row": IN_A_ROW, "by turns": BY_TURNS}
LARGEST_DIFFERENCE = 1e-9
AT_REST = 1e-3  # of a step without accelerations; the motions' are about 10 rad/s^2


class CompiledBound(Bound):
    """The bound, with compiled distances and gradients."""

    def __init__(
        self, model: ControlModel, parameters: CrarParameters, samples: Samples
    ) -> None:
        super().__init__(model, parameters, samples)
        shapes = find_shapes(model)
        self._distance_calls = [
            # The axes are what `proximity` is given, S what the gradients are.
            [(distances, (proximity[1][0], gradients[1][2], shapes), {})]
            for proximity, gradients in self._distance_calls
        ]


class Solve(Subject):
    """The law alone, without the system around it."""

    def __init__(self, law: ControlLaw, samples: Samples) -> None:
        self._law, self._samples = law, samples
        self._workspace = law.model.MakeWorkspace()

    def prepare(self, k: int) -> None:
        samples = self._samples
        if k == 0:
            self._memory = Memory()
        else:
            self._memory = self._step.memory
        self._k = k
        self._time = k * self._law.parameters.period
        self._q, self._v = samples.q[k], samples.v[k]
        self._targets = Targets(samples.tasks[k], samples.prescribed[k])

    def __call__(self) -> None:
        self._step = self._law.solve(
            self._workspace,
            self._memory,
            self._k,
            self._time,
            self._q,
            self._v,
            self._targets,
        )

    def results(self) -> tuple[np.ndarray, np.ndarray]:
        """Acceleration and torque of the last step."""
        return self._step.solution.acceleration, self._step.solution.actuation


def largest_difference(
    model: ControlModel, parameters: CrarParameters, samples: Samples
) -> tuple[float, float]:
    """Of acceleration [rad/s^2] and torque [Nm] between both laws the largest of all
    steps, relative to the step's largest entry, or to AT_REST if that is less."""
    plain = Solve(ControlLaw(model, parameters), samples)
    compiled = Solve(CompiledLaw(model, parameters), samples)
    largest = [0.0, 0.0]
    for k in range(len(samples)):
        for subject in (plain, compiled):
            subject.prepare(k)
            subject()
        pairs = zip(plain.results(), compiled.results(), strict=True)
        for i, (right, found) in enumerate(pairs):
            scale = max(np.abs(right).max(), AT_REST)
            largest[i] = max(largest[i], float(np.abs(found - right).max() / scale))
    return largest[0], largest[1]


def measure(motion: str, duration: float, experiment: str, mode: str) -> dict:
    """Compile time, differences and times [s] of one task set and constraint mode.

    Raises:
        CrarError: the motion cannot be used, or the answers differ.
    """
    parameters = CrarParameters(constraints=mode)
    compiled = replace(parameters, arithmetic="compiled")
    scenario = Scenario(
        motion=motion, experiment=experiment, controller=parameters, duration=duration
    )
    run = run_scenario(scenario, record=False)
    model, samples = run.setup.model, samples_of_run(run)

    first = Solve(CompiledLaw(model, parameters), samples)
    first.prepare(0)
    start = time.perf_counter(), time.thread_time()
    first()
    compiling = time.perf_counter() - start[0], time.thread_time() - start[1]
    acceleration, torque = largest_difference(model, parameters, samples)
    if not max(acceleration, torque) <= LARGEST_DIFFERENCE:
        raise CrarError(
            f"{experiment}, {mode}: the compiled answers differ by {acceleration:.1e} "
            f"(acceleration) and {torque:.1e} (torque), relative"
        )
    entry = {
        "experiment": experiment,
        "constraints": mode,
        "steps": len(samples),
        "compiling": compiling,
        "acceleration": acceleration,
        "torque": torque,
    }
    for order, block in ORDERS.items():
        subjects = {
            "step": Step(model, parameters, samples),
            "compiled step": Step(model, compiled, samples),
            "bound": Bound(model, parameters, samples),
            "compiled bound": CompiledBound(model, parameters, samples),
        }
        if block == IN_A_ROW:  # by turns they would find the steps' code in the caches
            subjects["law"] = Solve(ControlLaw(model, parameters), samples)
            subjects["compiled law"] = Solve(CompiledLaw(model, parameters), samples)
        timings = time_side_by_side(subjects, len(samples), block)
        entry[order] = {name: timing.figures() for name, timing in timings.items()}
    entry["simulation"] = {
        name: time_simulation(replace(scenario, controller=chosen), run.setup, True)
        for name, chosen in (("numpy", parameters), ("compiled", compiled))
    }
    entry["duration"] = run.log.time[-1]
    return entry


# --- the report -------------------------------------------------------------------


def report(entries: Sequence[dict], motion: str, duration: float) -> str:
    """The tables, as Markdown."""
    m = describe_machine()
    compiling = [e["compiling"] for e in entries]
    text = (
        f"{m['cpu']}, {m['cores']} cores, load average {m['load']:.1f} at the end; "
        f"Python {m['python']}, NumPy {m['numpy']}, Numba {version('numba')}, Drake "
        f"{m['drake']}; {m['threads']} thread; motion {motion}, {duration:g} s.\n\n"
        f"The first call of the process took {compiling[0][1]:.1f} s of processor time "
        f"({compiling[0][0]:.1f} s on the wall), with what the cache had. "
        f"Largest relative "
        f"difference to `ControlLaw` in {sum(e['steps'] for e in entries)} steps: "
        f"{max(e['acceleration'] for e in entries):.1e} of the acceleration, "
        f"{max(e['torque'] for e in entries):.1e} of the torque.\n"
    )
    text += (
        "\nMedians of processor time [µs] and their ratios; ratios of the wall clock's "
        "medians beside them.\n"
    )
    for order in ORDERS:
        text += f"\n{order.capitalize()}:\n\n"
        text += markdown_table(_HEADER, [_row(e, order) for e in entries])
    text += "\nThe law alone, without the system around it, in a row:\n\n"
    rows = []
    for e in entries:
        plain, fast = (e["in a row"][n]["cpu_median"] for n in ("law", "compiled law"))
        rows.append([_case(e), _us(plain), _us(fast), f"{plain / fast:.1f}"])
    header = ["tasks, constraints", "`ControlLaw`", "compiled", "ratio"]
    text += markdown_table(header, rows)
    text += (
        "\nThe whole simulation at 1 kHz with recording, real-time factors by the wall "
        "clock (by processor time):\n\n"
    )
    rows = [
        [_case(e), *map(partial(_factor, e), ("numpy", "compiled"))] for e in entries
    ]
    return text + markdown_table(["tasks, constraints", "numpy", "compiled"], rows)


_HEADER = [
    "tasks, constraints",
    "bound",
    "step",
    "over bound",
    "compiled step",
    "over bound",
    "wall clock",
    "wanted",
    "reached",
    "bound with compiled distances",
    "compiled step over it",
]


def _row(entry: dict, order: str) -> list[str]:
    figures = entry[order]
    cpu = {name: found["cpu_median"] for name, found in figures.items()}
    wall = figures["compiled step"]["median"] / figures["bound"]["median"]
    limit = STEP_OVER_BOUND[entry["constraints"]]
    ratio = cpu["compiled step"] / cpu["bound"]
    return [
        _case(entry),
        _us(cpu["bound"]),
        _us(cpu["step"]),
        f"{cpu['step'] / cpu['bound']:.2f}",
        _us(cpu["compiled step"]),
        f"{ratio:.2f}",
        f"{wall:.2f}",
        f"≤ {limit:g}",
        "yes" if max(ratio, wall) <= limit else "no",
        _us(cpu["compiled bound"]),
        f"{cpu['compiled step'] / cpu['compiled bound']:.2f}",
    ]


def _factor(entry: dict, arithmetic: str) -> str:
    timing = entry["simulation"][arithmetic]
    wall, cpu = (entry["duration"] / spent for spent in (timing.wall, timing.cpu))
    return f"{wall:.2f} ({cpu:.2f})"


def _case(entry: dict) -> str:
    return f"{entry['experiment']}, {entry['constraints']}"


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:.0f}"


def renewed(page: str, text: str) -> str:
    """A page with the text in the place of what was below its HEADING.

    Raises:
        CrarError: the page has no such heading.
    """
    before, found, after = page.partition(f"{HEADING}\n")
    if not found:
        raise CrarError(f"it has no line {HEADING!r}, below which to write")
    _, more, rest = after.partition("\n## ")
    return f"{before}{found}\n{text}{more}{rest}"


def _read_page(path: Path | None) -> str:
    if path is None or not path.exists():
        return f"{HEADING}\n"
    try:
        page = path.read_text(encoding="utf-8")
        renewed(page, "")
    except (OSError, UnicodeDecodeError, CrarError) as error:
        raise CrarError(f"{path}: {error}") from error
    return page


def require_numba() -> None:
    """Raises CrarError unless Numba is there."""
    if not HAS_NUMBA:
        raise CrarError(
            "this measurement needs Numba: pip install 'crar-drake[compiled]'"
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Measures, prints the tables; 0, or 2 with a message if something is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--motion", default="dance", help="as of crar-drake bench")
    parser.add_argument("--duration", type=float, default=3.0, help="of it [s]")
    parser.add_argument(
        "--markdown", type=Path, help="a page such as docs/speed.md, to renew"
    )
    arguments = parser.parse_args(argv)
    motion, duration = arguments.motion, arguments.duration
    try:
        if not 0.0 < duration < np.inf:
            raise CrarError(f"--duration: {duration:g} must be positive and finite")
        require_numba()
        page = _read_page(arguments.markdown)
        entries = []
        for experiment in EXPERIMENTS:
            for mode in MODES:
                print(f"measuring: {experiment}, {mode}", file=sys.stderr)
                entries.append(measure(motion, duration, experiment, mode))
        text = report(entries, motion, duration)
        print(text)
        if arguments.markdown is not None:
            with whole_file(arguments.markdown) as temporary:
                temporary.write_text(renewed(page, text), encoding="utf-8")
    except CrarError as error:
        print(f"compiled_speed: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    # Nothing is gained by threads; NumPy's library is loaded by now, so say so.
    if os.environ.get("OMP_NUM_THREADS") != "1":
        print("set OMP_NUM_THREADS=1 to measure one thread", file=sys.stderr)
    sys.exit(main())
