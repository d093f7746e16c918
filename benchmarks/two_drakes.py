"""What a control step takes with two versions of Drake, measured by turns.

    python -m benchmarks.two_drakes .venv/bin/python .venv-3.13/bin/python
        [--motion dance] [--duration 1] [--rounds 5]
        [--page docs/measurements/speed.md]

Each interpreter has its own Drake, NumPy and Python, so that the ratio is that of all
three. Both run this checkout; a round is `benchmarks.step --only step` in the one and
then in the other.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.page import Benchmark, Table, run
from crar_drake.errors import CrarError

ROOT = Path(__file__).resolve().parents[1]  # of the checkout

# What is compared: its name in the table, and where bench.json has its median [s].
_COMPARED = {
    "step": ("in_a_row", "step", "cpu_median"),
    "Drake's calls and the distances (the bound)": ("in_a_row", "bound", "cpu_median"),
    "step, by turns": ("by_turns", "step", "cpu_median"),
}


def measure_once(python: str, motion: str, duration: float) -> dict:
    """What `benchmarks.step` finds with an interpreter, as `bench.json` has it.

    Args:
        python: the interpreter.
        motion: as of `benchmarks.step`.
        duration: of the motion [s].

    Raises:
        CrarError: the interpreter does not run, or the measurement fails in it.
    """
    path = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, path))}
    with tempfile.TemporaryDirectory() as folder:
        command = [python, "-m", "benchmarks.step", "--only", "step"]
        command += ["--motion", motion, "--duration", str(duration), "--out", folder]
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True
            )
        except OSError as error:
            raise CrarError(f"{python} does not run: {error.strerror}") from error
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["nothing was said"])[-1]
            raise CrarError(f"{python} cannot measure: {last}")
        return json.loads((Path(folder) / "bench.json").read_text())


def measure(
    pythons: Sequence[str], motion: str, duration: float, rounds: int
) -> list[list[dict]]:
    """The results of each interpreter, round by round, measured by turns.

    Raises:
        CrarError: as `measure_once`.
    """
    found: list[list[dict]] = [[] for _ in pythons]
    for k in range(rounds):
        for python, results in zip(pythons, found, strict=True):
            print(f"measuring: round {k + 1} of {rounds}, {python}", file=sys.stderr)
            results.append(measure_once(python, motion, duration))
    return found


def make_table(
    found: Sequence[Sequence[dict]], motion: str, duration: float
) -> tuple[Table, str]:
    """Medians of the rounds and of their ratios, and what they were measured on.

    Args:
        found: from `measure`, of two interpreters.
        motion, duration: that were measured.
    """
    first, second = found
    machines = [results[0]["machine"] for results in found]
    names = [f"Drake {m['drake']}" for m in machines]
    loads = [
        result["machine"]["load"] or 0.0 for results in found for result in results
    ]
    whole = [
        f"{name} (Python {m['python']}, NumPy {m['numpy']})"
        for name, m in zip(names, machines, strict=True)
    ]
    text = (
        f"Load average {min(loads):.1f} to {max(loads):.1f}; {machines[0]['threads']} "
        f"thread; motion {motion}, {duration:g} s; {len(first)} rounds by turns. "
        f"{whole[0]} and {whole[1]}. Medians of processor time [µs], and of the "
        "rounds' ratios with the least and the largest."
    )
    rows = []
    for case in range(len(first[0]["step"])):
        entry = first[0]["step"][case]
        for what, (order, subject, figure) in _COMPARED.items():
            a, b = (
                np.array([r["step"][case][order][subject][figure] for r in results])
                for results in found
            )
            ratio = b / a
            rows.append(
                [
                    f"{entry['case']}, {entry['constraints']}",
                    what,
                    f"{1e6 * np.median(a):.0f}",
                    f"{1e6 * np.median(b):.0f}",
                    f"{np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f})",
                ]
            )
    header = ["tasks, constraints", "what", *names, "second over first"]
    return Table(header, rows), text


def main(argv: Sequence[str] | None = None) -> None:
    """Measures, and reports the table."""
    benchmark = Benchmark("benchmarks.two_drakes", __doc__, "speed")
    parser = benchmark.parser
    parser.add_argument("pythons", nargs=2, metavar="PYTHON", help="an interpreter")
    parser.add_argument("--motion", default="dance", help="as of benchmarks.step")
    parser.add_argument("--duration", type=float, default=1.0, help="of it [s]")
    parser.add_argument("--rounds", type=int, default=5, help="(default: %(default)s)")
    arguments = benchmark.parse(argv, lambda _: "two drakes")
    motion, duration = arguments.motion, arguments.duration
    if arguments.rounds < 1:
        raise CrarError(f"--rounds: {arguments.rounds} must be at least 1")
    found = measure(arguments.pythons, motion, duration, arguments.rounds)
    table, about = make_table(found, motion, duration)
    benchmark.report([table], about)


if __name__ == "__main__":
    run(main)
