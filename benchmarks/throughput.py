"""How many clips a second does a core clean, or retarget, and in what memory?

    python -m benchmarks.throughput FOLDER --robot g1_whole_body [--what retarget]
        [--jobs N] [--page docs/measurements/throughput.md]

All of it counts: processes that start, reading, solving, certificates, writing. What
is compiled is compiled before. A second of a core is one of processor time, of which
others on the machine take none.
"""

import os
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.page import Benchmark, Table, run
from crar_drake.errors import CrarError
from crar_drake.fresh_processes import FreshProcesses
from crar_drake.references.clean_file import clean_file
from crar_drake.references.clean_folder import clean_folder
from crar_drake.references.folders import find_references
from crar_drake.references.retarget_file import retarget_file
from crar_drake.references.retarget_folder import find_people, retarget_folder
from crar_drake.robot.description import whole_body_name

_SELF, _CHILDREN = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN

# What is done: how a folder's files are found, and with what one file, and all of them.
WORKS = {
    "clean": (find_references, clean_file, clean_folder),
    "retarget": (find_people, retarget_file, retarget_folder),
}


def measure(
    what: str, folder: Path, robot: str, jobs: int
) -> tuple[dict[str, str], int]:
    """Does the work on a folder, into one that is then removed.

    Args:
        what: of WORKS.
        folder: with motions.
        robot: name or folder.
        jobs: processes at a time.

    Returns:
        The row of the table by its columns, and how many files could not be done.
        Processor time is of all processes; solving is without reading, writing and
        certificates.

    Raises:
        CrarError: the folder or the robot cannot be used, or no file could be done.
    """
    find, of_file, of_folder = WORKS[what]
    shortest = min(find(folder), key=lambda path: path.stat().st_size)
    with tempfile.TemporaryDirectory() as name:
        compiled, out = Path(name) / "compiled", Path(name) / "out"
        with FreshProcesses(1) as pool:
            suffix = ".csv" if what == "retarget" else shortest.suffix
            first = compiled / f"first{suffix}"
            pool.submit(of_file, shortest, first, robot).exception()
        began, before = time.perf_counter(), _processor_time()
        files = of_folder(folder, out, robot, jobs=jobs)
        wall, used = time.perf_counter() - began, _processor_time() - before
    clips = [clip for file in files for clip in file.clips]
    if not clips:
        raise CrarError(f"{folder}: no file could be done; the first: {files[0].error}")
    # Kilobytes on Linux, bytes on macOS.
    unit = 1 if sys.platform == "darwin" else 1024
    memory, own = (
        unit * resource.getrusage(who).ru_maxrss for who in (_CHILDREN, _SELF)
    )
    frames = sum(clip.frames for clip in clips)
    duration = sum((clip.frames - 1) / clip.rate for clip in clips)
    row = {
        "clips": f"{len(clips)}",
        "frames": f"{frames}",
        "of motion": f"{duration:.1f} s",
        "processes": f"{jobs}",
        "wall time": f"{wall:.1f} s",
        "processor time": f"{used:.1f} s",
        "clips / s and core": f"{len(clips) / used:.3f}",
        "frames / s and core": f"{frames / used:.1f}",
        "x real time and core": f"{duration / used:.2f}",
        "solving, of all": f"{sum(clip.seconds for clip in clips) / used:.0%}",
        "peak memory of a process": f"{memory / 2**20:.0f} MiB",
        "and of the first one": f"{own / 2**20:.0f} MiB",
    }
    return row, sum(bool(file.error) for file in files)


def _processor_time() -> float:
    """Of this process and of its children that have ended [s]."""
    used = [resource.getrusage(who) for who in (_SELF, _CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def main(argv: Sequence[str] | None = None) -> None:
    """Measures, and prints the table."""
    benchmark = Benchmark("benchmarks.throughput", __doc__, "throughput")
    benchmark.parser.add_argument("folder", type=Path, help="with motions")
    benchmark.parser.add_argument("--robot", required=True, help="name or folder")
    benchmark.parser.add_argument("--what", choices=WORKS, default="clean")
    benchmark.parser.add_argument("--jobs", type=int, help="(default: one per core)")
    arguments = benchmark.parse(argv, lambda given: given.what)
    row, failed = measure(
        arguments.what,
        arguments.folder,
        whole_body_name(arguments.robot),
        arguments.jobs or os.cpu_count() or 1,
    )
    said = f"{failed} files could not be done." if failed else ""
    benchmark.report([Table([*row], [[*row.values()]])], said)


if __name__ == "__main__":
    run(main)
