"""Compares the lookahead with PlaCo, Pink, mink, Drake, OSCBF and embodik.

    python -m benchmarks.peers.compare               # run and print
    python -m benchmarks.peers.compare --tune        # choose settings.json anew
    python -m benchmarks.peers.compare --page docs/measurements/peers.md

Makes an environment for each peer under --out (the versions are in `peers.py`), writes
the problem, runs every controller on every case in several rounds, one after the
other in one process each and with one thread, and judges what they recorded.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from rich.progress import track

from benchmarks.page import Benchmark, run
from benchmarks.peers.judge import Judge
from benchmarks.peers.peers import OURS, PEERS, Peer
from benchmarks.peers.problem import CASES, write_problem
from benchmarks.peers.report import Row, tables
from benchmarks.peers.runs import (
    Entry,
    PeerError,
    add_peer_options,
    drive,
    job,
    only,
    own_entries,
)
from benchmarks.peers.tuning import choose, holds, load_settings, save_settings
from crar_drake.commands.options import count
from crar_drake.files import write_whole

WARM_UP = 20  # first steps of a run, not timed


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.peers.compare", __doc__, "peers")
    parser = benchmark.parser
    add_peer_options(benchmark, "out/peers")
    parser.add_argument("--tune", action="store_true", help="try all grids first")
    parser.add_argument("--rounds", type=count, default=3, help="runs, for times")
    arguments = benchmark.parse(
        argv, lambda given: "compare, some" if given.only else "compare"
    )
    chosen = only((*PEERS, OURS), arguments, benchmark)
    out, place = arguments.out, arguments.environments
    folder = out / "problem"
    write_problem(folder)
    judge = Judge.of(folder)
    if arguments.tune:
        tune(chosen, place, folder, out / "tuning", judge)
    rows = run_all(
        entries(chosen), place, folder, out / "runs", judge, arguments.rounds
    )
    benchmark.report(tables(rows, load_settings()))


def entries(chosen: list[Peer]) -> list[Entry]:
    """Peers as tuned for each case; ours as it comes, and of the paper's law.

    Raises:
        PeerError: there are no settings for a peer.
    """
    settings = load_settings()
    made = []
    for peer in chosen:
        if peer is OURS:
            made += own_entries(list(CASES))
            continue
        tuned = settings.get(peer.name)
        if tuned is None:
            raise PeerError(f"settings.json has no {peer.name!r}: run with --tune")
        chosen_settings = {case: one["settings"] for case, one in tuned.items()}
        made.append(Entry(peer.name, peer, chosen_settings))
    return made


def tune(
    chosen: list[Peer], place: Path, folder: Path, out: Path, judge: Judge
) -> None:
    """Tries every peer's grid, and saves the best settings for each case."""
    settings = load_settings()
    for peer in (peer for peer in chosen if peer is not OURS):
        settings[peer.name] = {}
        for case in CASES:
            jobs = {
                i: job(case, one, out / f"{i}.npz") for i, one in enumerate(peer.grid)
            }
            found = drive(peer, place, folder, jobs)
            judged = [
                judge.figures(one)
                for one in track(found.values(), f"{peer.name}, {case}", len(found))
            ]
            settings[peer.name][case] = choose(peer.grid, judged, case)
            write_whole(
                out / f"{peer.name}, {case}.json",
                json.dumps(
                    [
                        {"settings": s, "holds": holds(f, case)} | asdict(f)
                        for s, f in zip(peer.grid, judged, strict=True)
                    ],
                    indent=1,
                ),
            )
        save_settings(settings)


def run_all(
    rows: list[Entry], place: Path, folder: Path, out: Path, judge: Judge, rounds: int
) -> list[Row]:
    """Runs all entries, round by round, so that a busy moment hits no one alone."""
    found: dict[tuple[str, str], list[dict]] = {}
    for turn in range(rounds):
        for i, entry in enumerate(track(rows, f"round {turn + 1} of {rounds}")):
            jobs = {
                case: job(case, entry.settings[case], out / f"{i} {case} {turn}.npz")
                for case in CASES
            }
            for case, one in drive(entry.peer, place, folder, jobs).items():
                found.setdefault((entry.name, case), []).append(one)
    made = []
    for entry in rows:
        for case in CASES:
            turns = found[entry.name, case]
            times = [turn["step_time"][WARM_UP:] for turn in turns]
            made.append(
                Row(
                    name=entry.name,
                    case=case,
                    settings=entry.settings[case],
                    versions=json.loads(str(turns[0]["versions"])),
                    figures=judge.figures(turns[0]),
                    median_time=float(np.median([np.median(t) for t in times])),
                    p99_time=float(np.median([np.percentile(t, 99) for t in times])),
                )
            )
    return made


if __name__ == "__main__":
    run(main)
