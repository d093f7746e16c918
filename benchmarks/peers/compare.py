"""Compares the lookahead with PlaCo, Pink, mink, Drake, OSCBF and embodik.

    python -m benchmarks.peers.compare               # run and print
    python -m benchmarks.peers.compare --tune        # choose settings.json anew
    python -m benchmarks.peers.compare --page docs/measurements/peers.md

Makes an environment for each peer under --out (the versions are in `peers.py`), writes
the problem, runs every controller on every case in several rounds, one after the
other in one process each and with one thread, and judges what they recorded.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.progress import track

from benchmarks.page import ROOT, Benchmark, run
from benchmarks.peers.judge import Figures, Judge
from benchmarks.peers.peers import (
    ENVIRONMENTS,
    OURS,
    PAPER,
    PEERS,
    PYTHONS,
    Peer,
)
from benchmarks.peers.problem import CASES, write_problem
from benchmarks.peers.report import Row, tables
from benchmarks.peers.tuning import choose, holds, load_settings, save_settings
from crar_drake import CrarError
from crar_drake.commands.options import count
from crar_drake.files import write_whole

PERIOD = 0.005  # [s] of all controllers
WARM_UP = 20  # first steps of a run, not timed


class PeerError(CrarError):
    """A peer could not be installed or did not run."""


@dataclass(frozen=True)
class Entry:
    """A controller with the settings for each case."""

    name: str
    peer: Peer
    settings: dict[str, dict]


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.peers.compare", __doc__, "peers")
    parser = benchmark.parser
    parser.add_argument("--out", type=Path, default=Path("out/peers"))
    parser.add_argument("--tune", action="store_true", help="try all grids first")
    add_only(benchmark)
    parser.add_argument("--rounds", type=count, default=3, help="runs, for times")
    arguments = benchmark.parse(
        argv, lambda given: "compare, some" if given.only else "compare"
    )
    chosen = only((*PEERS, OURS), arguments, benchmark)
    out = arguments.out.resolve()
    folder = out / "problem"
    write_problem(folder)
    data = json.loads((folder / "problem.json").read_text())
    judge = Judge(data["robot"], data["joints"], data["tasks"])
    pythons = {
        name: environment(out / "environments", name, ENVIRONMENTS[name])
        for name in {peer.environment for peer in chosen}
    }
    if arguments.tune:
        tune(chosen, pythons, folder, out / "tuning", judge)
    rows = run_all(
        entries(chosen), pythons, folder, out / "runs", judge, arguments.rounds
    )
    benchmark.report(tables(rows, load_settings()))


def add_only(benchmark: Benchmark) -> None:
    """The option that `only` reads."""
    benchmark.parser.add_argument(
        "--only", nargs="+", default=[], help="controllers whose names contain one"
    )


def only(named: Sequence, arguments: argparse.Namespace, benchmark: Benchmark) -> list:
    """Those peers, or entries, that are asked for; all if none is."""
    parts = arguments.only
    chosen = [one for one in named if not parts or any(p in one.name for p in parts)]
    if not chosen:
        names = ", ".join(one.name for one in named)
        benchmark.parser.error(
            f"--only {' '.join(parts)!r}: no such controller; there are {names}"
        )
    return chosen


def environment(folder: Path, name: str, requirements: tuple[str, ...]) -> str:
    """The Python of an environment with these packages, made if it is not there.

    Raises:
        PeerError: it could not be made.
    """
    if not name:
        return sys.executable
    python = folder / name / "bin" / "python"
    stamp = folder / name / "installed.txt"
    wanted = "\n".join(requirements)
    if stamp.is_file() and stamp.read_text() == wanted:
        return str(python)
    base = shutil.which(PYTHONS[name]) if name in PYTHONS else sys.executable
    if base is None:
        raise PeerError(f"{name}: needs {PYTHONS[name]} on the path")
    for command in (
        [base, "-m", "venv", "--clear", str(folder / name)],
        [str(python), "-m", "pip", "install", "--quiet", *requirements],
    ):
        finished = subprocess.run(command, capture_output=True, text=True)
        if finished.returncode:
            raise PeerError(
                f"{name}: {' '.join(command)} failed; the environment is made from "
                f"PyPI:\n{finished.stderr[-2000:]}"
            )
    stamp.write_text(wanted)
    return str(python)


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


def own_entries(cases: Sequence[str], **more: dict) -> list[Entry]:
    """Ours with the same settings for all cases; `more` by the name."""
    each = {"lookahead, default": {}, "the paper's law, made safe": PAPER} | more
    return [Entry(name, OURS, dict.fromkeys(cases, one)) for name, one in each.items()]


def tune(
    chosen: list[Peer], pythons: dict[str, str], folder: Path, out: Path, judge: Judge
) -> None:
    """Tries every peer's grid, and saves the best settings for each case."""
    settings = load_settings()
    for peer in (peer for peer in chosen if peer is not OURS):
        settings[peer.name] = {}
        for case in CASES:
            jobs = [
                job(case, grid, out / f"{i}.npz") for i, grid in enumerate(peer.grid)
            ]
            drive(peer, pythons, folder, jobs)
            judged = [
                judge.figures(dict(np.load(one["out"])))
                for one in track(jobs, f"{peer.name}, {case}")
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
    rows: list[Entry],
    pythons: dict[str, str],
    folder: Path,
    out: Path,
    judge: Judge,
    rounds: int,
) -> list[Row]:
    """Runs all entries, round by round, so that a busy moment hits no one alone."""
    jobs = {
        (entry.name, turn): [
            job(case, entry.settings[case], out / f"{i} {case} {turn}.npz")
            for case in CASES
        ]
        for i, entry in enumerate(rows)
        for turn in range(rounds)
    }
    for turn in range(rounds):
        for entry in track(rows, f"round {turn + 1} of {rounds}"):
            drive(entry.peer, pythons, folder, jobs[entry.name, turn])
    made = []
    for entry in rows:
        for column, case in enumerate(CASES):
            turns = [
                dict(np.load(jobs[entry.name, turn][column]["out"]))
                for turn in range(rounds)
            ]
            times = [turn["step_time"][WARM_UP:] for turn in turns]
            made.append(
                Row(
                    name=entry.name,
                    case=case,
                    settings=entry.settings[case],
                    versions=json.loads(str(turns[0]["versions"])),
                    figures=Figures(**asdict(judge.figures(turns[0]))),
                    median_time=float(np.median([np.median(t) for t in times])),
                    p99_time=float(np.median([np.percentile(t, 99) for t in times])),
                )
            )
    return made


def add_peer_options(parser: argparse.ArgumentParser, out: str) -> None:
    """Of a benchmark that drives peers, in environments that may be there already.

    Args:
        parser: the benchmark's.
        out: its folder.
    """
    parser.add_argument("--out", type=Path, default=Path(out))
    parser.add_argument(
        "--environments",
        type=Path,
        default=Path("out/peers/environments"),
        help="of the peers; made where they are not there",
    )


def recorded(
    rows: Sequence[Entry],
    cases: Mapping[str, float],
    arguments: argparse.Namespace,
    folder: Path,
    keep: bool = False,
) -> Iterator[tuple[Entry, dict[str, dict[str, np.ndarray]]]]:
    """Drives controllers through cases; yields what each recorded, by its cases.

    Args:
        rows: the controllers.
        cases: to their periods of control [s].
        arguments: with those of `add_peer_options`.
        folder: of the problem.
        keep: whether what was recorded of the same is not recorded again.

    Raises:
        PeerError: an environment could not be made, or a driver ended with an error.
    """
    runs = arguments.out.resolve() / "runs"
    for entry in track(rows, "controllers"):
        python = environment(
            arguments.environments.resolve(),
            entry.peer.environment,
            ENVIRONMENTS[entry.peer.environment],
        )
        jobs = {
            case: job(
                case, entry.settings[case], runs / f"{entry.name} {case}.npz", period
            )
            | {"keep": keep}
            for case, period in cases.items()
        }
        drive(entry.peer, {entry.peer.environment: python}, folder, list(jobs.values()))
        yield entry, {case: dict(np.load(one["out"])) for case, one in jobs.items()}


def job(case: str, settings: dict, out: Path, period: float = PERIOD) -> dict:
    """One run for `driver.main`."""
    return {
        "case": case,
        "period": period,
        "settings": settings,
        "out": str(out.absolute()),
    }


def drive(peer: Peer, pythons: dict[str, str], folder: Path, jobs: list[dict]) -> None:
    """Runs jobs in the peer's own environment, with one thread.

    Raises:
        PeerError: the driver ended with an error.
    """
    Path(jobs[0]["out"]).parent.mkdir(parents=True, exist_ok=True)
    changes = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    finished = subprocess.run(
        [
            pythons[peer.environment],
            "-m",
            f"benchmarks.peers.{peer.driver}",
            str(folder.absolute()),
            json.dumps(jobs),
        ],
        capture_output=True,
        text=True,
        # Its folder comes first on the path of modules.
        cwd=ROOT,
        env=os.environ | changes,
    )
    if finished.returncode:
        raise PeerError(f"{peer.driver} failed:\n{finished.stderr[-2000:]}")


if __name__ == "__main__":
    run(main)
