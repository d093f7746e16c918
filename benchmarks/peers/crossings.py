"""Many random crossings: every controller with one set of settings for all of them.

    python -m benchmarks.peers.crossings --seeds 36
        [--page docs/measurements/crossings.md]

The motions are `motions.random_crossing` of the shipped upper body, or of another
robot of `problem.ROBOTS`. The peers keep the settings that `compare --tune` chose for
hands of the upper body swung through each other; of ours there is the default, as it
comes, and with a margin of which 5 mm are left for certain, and the paper's law, made
safe. Most of the plan's numbers were chosen at once on such motions of three robots
(seeds 0 to 35 of the arm, 0 to 11 and 36 to 59 of the upper body, 0 to 23 of the G1),
and on recordings of people.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.options import seed_number
from benchmarks.page import Benchmark, Table, run
from benchmarks.peers.judge import Figures, Judge
from benchmarks.peers.peers import PEERS
from benchmarks.peers.problem import ROBOT, ROBOTS, write_crossings, write_problem
from benchmarks.peers.runs import (
    Entry,
    add_peer_options,
    only,
    own_entries,
    recorded,
)
from benchmarks.peers.tuning import load_settings
from crar_drake.commands.options import count

TUNED_FOR = "crossing"
# The default, of whose margin the slack of a step leaves 5 mm.
FARTHER = {"margin": 0.006}
# Targets begin to move at 0.5 s and go on until 6 s: errors are told for each [s].
PARTS = ((0.5, 2.0), (2.0, 4.0), (4.0, 6.0))
HEADER = (
    "controller",
    "held",
    "smallest distance",
    "median rms error",
    "of the best that holds",
    "median rms acceleration",
)


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.peers.crossings", __doc__, "crossings")
    parser = benchmark.parser
    add_peer_options(benchmark, "out/crossings")
    parser.add_argument(
        "--robot", choices=tuple(ROBOTS), default=ROBOT, help="whose motions"
    )
    parser.add_argument("--seeds", type=count, default=12, help="how many motions")
    parser.add_argument(
        "--first", type=seed_number, default=0, help="the first one's seed"
    )
    arguments = benchmark.parse(
        argv,
        lambda given: (
            given.robot
            + (f", from {given.first}" if given.first else "")
            + (", some" if given.only else "")
        ),
    )
    folder = arguments.out / "problem"
    first = arguments.first
    write_problem(folder, arguments.robot)
    cases = write_crossings(folder, range(first, first + arguments.seeds))
    judge = Judge.of(folder)
    figures, in_parts = {}, {}
    farther = {"lookahead, default, 5 mm": FARTHER}
    compared = only(entries(cases, **farther), arguments, benchmark)
    for entry, found in recorded(compared, cases, arguments, folder):
        figures[entry.name] = [judge.figures(found[case]) for case in cases]
        in_parts[entry.name] = [
            [
                replace(whole, error=error_within(judge, found[case], *part))
                for case, whole in zip(cases, figures[entry.name], strict=True)
            ]
            for part in PARTS
        ]
    best = best_errors(figures)
    rows = [row(name, each, best) for name, each in figures.items()]
    benchmark.report([Table(HEADER, rows), by_time(in_parts)])


def error_within(
    judge: Judge, result: dict[str, np.ndarray], start: float, end: float
) -> float:
    """The rms error of what a driver recorded, from one time to another [m]."""
    within = (result["time"] >= start) & (result["time"] < end)
    return float(np.sqrt(np.mean(judge.errors(result)[within] ** 2)))


def by_time(errors: dict[str, list[list[Figures]]]) -> Table:
    """Of each of `PARTS` the errors of all controllers over `best_errors` there."""
    best = [
        best_errors({name: parts[i] for name, parts in errors.items()})
        for i in range(len(PARTS))
    ]
    return Table(
        ("controller", *(f"{start:g} to {end:g} s" for start, end in PARTS)),
        [[name, *map(of_the_best, parts, best)] for name, parts in errors.items()],
        "Of the best that holds, by time",
    )


def of_the_best(each: Sequence[Figures], best: Sequence[float]) -> str:
    """The median over the motions of the errors' ratios to `best_errors`."""
    ratios = [f.error / least for f, least in zip(each, best, strict=True)]
    return f"{np.nanmedian(ratios):.2f}"


def entries(cases: Sequence[str], **more: dict) -> list[Entry]:
    """Every controller, with the same settings for all cases; `more` of ours."""
    settings = load_settings()
    chosen = [(peer, settings[peer.name][TUNED_FOR]["settings"]) for peer in PEERS]
    peers = [Entry(peer.name, peer, dict.fromkeys(cases, one)) for peer, one in chosen]
    return peers + own_entries(cases, **more)


def best_errors(figures: dict[str, list[Figures]]) -> list[float]:
    """Of each motion the least error of all *peers* that hold there [m], or NaN."""
    peers = [figures[peer.name] for peer in PEERS if peer.name in figures]
    count = len(next(iter(figures.values())))
    return [
        min((each[i].error for each in peers if each[i].holds), default=np.nan)
        for i in range(count)
    ]


def row(name: str, each: Sequence[Figures], best: Sequence[float]) -> list[str]:
    """Medians over the motions, and of the errors' ratios to `best_errors`."""
    return [
        name,
        f"{sum(f.holds for f in each)} of {len(each)}",
        f"{1e3 * min(f.smallest_distance for f in each):.1f} mm",
        f"{1e3 * np.median([f.error for f in each]):.1f} mm",
        of_the_best(each, best),
        f"{np.median([f.rms_acceleration for f in each]):.1f} rad/s²",
    ]


if __name__ == "__main__":
    run(main)
