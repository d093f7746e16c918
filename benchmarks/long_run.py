"""What a run of many minutes takes: memory, time and the size of its files.

    python -m benchmarks.long_run [MOTION] [--minutes 1,10]
        [--page docs/measurements/memory.md]

The motion is played there and back until the time is over; each length runs in a
process of its own, with log, plot and recording.
"""

import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.amc_files import write_amc, write_asf
from benchmarks.page import Benchmark, Table, run
from crar_drake.fresh_processes import FreshProcesses
from crar_drake.motion.catalogue import load_clip
from crar_drake.motion.formats.asf_amc import Clip
from crar_drake.results import LOG, RECORDING
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import load_scenario

HEADER = [
    "motion",
    "log samples",
    "log.npz",
    "recording.html",
    "peak memory",
    "wall time",
    "samples in violation",
]


def there_and_back(clip: Clip, duration: float) -> Clip:
    """The clip forwards, backwards, forwards, ... until `duration` [s] is over."""
    frames = np.arange(clip.num_frames)
    once = np.concatenate([frames, frames[-2:0:-1]])
    wanted = int(duration * clip.frame_rate) + 1
    order = np.resize(once, wanted)
    return replace(
        clip,
        root_position=clip.root_position[order],
        root_rotation=clip.root_rotation[order],
        joints={name: values[order] for name, values in clip.joints.items()},
    )


def measure(motion: str, scenario: str, minutes: float) -> list[str]:
    """Runs it, and returns a line of the table; to be called in a fresh process."""
    clip = there_and_back(load_clip(motion), 60.0 * minutes)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        write_asf(path / "long.asf", clip.skeleton)
        write_amc(path / "long.amc", clip)
        frames = clip.num_frames
        del clip
        chosen = load_scenario(scenario)
        chosen.motion = str(path / "long.amc")
        start = time.perf_counter()
        run = run_scenario(chosen, path / "out")
        wall = time.perf_counter() - start
        sizes = [(path / "out" / name).stat().st_size for name in (LOG, RECORDING)]
    # Kilobytes on Linux, bytes on macOS.
    unit = 1 if sys.platform == "darwin" else 1024
    peak = unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return [
        f"{minutes:g} min, {frames} frames",
        f"{len(run.log.time)}",
        f"{sizes[0] / 2**20:.0f} MiB",
        f"{sizes[1] / 2**20:.0f} MiB",
        f"{peak / 2**20:.0f} MiB",
        f"{wall:.0f} s",
        f"{run.summary.violated_samples}",
    ]


def main(argv: Sequence[str] | None = None) -> None:
    """Measures every length, and prints the table."""
    benchmark = Benchmark("benchmarks.long_run", __doc__, "memory")
    parser = benchmark.parser
    parser.add_argument("motion", nargs="?", default="dance")
    parser.add_argument("--scenario", default="dance", help="everything else")
    parser.add_argument("--minutes", default="1,10", help="lengths [min]")
    arguments = benchmark.parse(argv, lambda _: "runs")
    lengths = [float(text) for text in arguments.minutes.split(",")]
    rows = []
    for minutes in lengths:
        with FreshProcesses(1) as pool:
            call = pool.submit(measure, arguments.motion, arguments.scenario, minutes)
            rows.append(call.result())
    benchmark.report([Table(HEADER, rows)])


if __name__ == "__main__":
    run(main)
