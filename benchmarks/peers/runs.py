"""Runs controllers in environments of their own, and reads what they recorded."""

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from benchmarks.page import ROOT, Benchmark
from benchmarks.peers.peers import ENVIRONMENTS, OURS, PAPER, PYTHONS, Peer
from crar_drake import CrarError

PERIOD = 0.005  # [s] of all controllers
# Of the peers, beside this project's: made once for all benchmarks.
PLACE = Path("out/peers/environments")

Recorded = dict[str, np.ndarray]  # what `driver.Controller.record` returns


class PeerError(CrarError):
    """A peer could not be installed or did not run."""


@dataclass(frozen=True)
class Entry:
    """A controller with the settings for each case."""

    name: str
    peer: Peer
    settings: dict[str, dict]


def own_entries(cases: Sequence[str], **more: dict) -> list[Entry]:
    """Ours with the same settings for all cases; `more` by the name."""
    each = {"lookahead, default": {}, "the paper's law, made safe": PAPER} | more
    return [Entry(name, OURS, dict.fromkeys(cases, one)) for name, one in each.items()]


def add_peer_options(benchmark: Benchmark, out: str) -> None:
    """Of a benchmark that drives peers; --only is for `only`.

    Args:
        benchmark: it.
        out: its folder.
    """
    parser = benchmark.parser
    parser.add_argument("--out", type=Path, default=Path(out))
    parser.add_argument(
        "--environments",
        type=Path,
        default=PLACE,
        help="of the peers; made where they are not there",
    )
    parser.add_argument(
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


def environment(place: Path, name: str) -> str:
    """The Python of an environment, made if it is not there.

    Args:
        place: the folder of environments.
        name: of ENVIRONMENTS.

    Raises:
        PeerError: it could not be made.
    """
    if not name:
        return sys.executable
    folder, requirements = place.resolve() / name, ENVIRONMENTS[name]
    python, stamp = folder / "bin" / "python", folder / "installed.txt"
    wanted = "\n".join(requirements)
    if stamp.is_file() and stamp.read_text() == wanted:
        return str(python)
    base = shutil.which(PYTHONS[name]) if name in PYTHONS else sys.executable
    if base is None:
        raise PeerError(f"{name}: needs {PYTHONS[name]} on the path")
    for command in (
        [base, "-m", "venv", "--clear", str(folder)],
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


def job(case: str, settings: dict, out: Path, period: float = PERIOD) -> dict:
    """One run for `driver.main`."""
    return {
        "case": case,
        "period": period,
        "settings": settings,
        "out": str(out.absolute()),
    }


def drive(
    peer: Peer, place: Path, folder: Path, jobs: Mapping[Any, dict]
) -> dict[Any, Recorded]:
    """Runs jobs in one process of the peer's environment, with one thread.

    Args:
        peer: whose driver is run.
        place: the folder of environments.
        folder: of the problem.
        jobs: by anything.

    Returns:
        What each recorded.

    Raises:
        PeerError: the environment could not be made, or the driver ended with an error.
    """
    for one in jobs.values():
        Path(one["out"]).parent.mkdir(parents=True, exist_ok=True)
    run_driver(
        environment(place, peer.environment),
        peer.driver,
        *(str(folder.absolute()), json.dumps(list(jobs.values()))),
    )
    return {key: dict(np.load(one["out"])) for key, one in jobs.items()}


def run_driver(python: str, driver: str, *words: str) -> None:
    """Runs a module of this folder with some Python.

    Raises:
        PeerError: it ended with an error.
    """
    finished = subprocess.run(
        [python, "-m", f"benchmarks.peers.{driver}", *words],
        capture_output=True,
        text=True,
        cwd=ROOT,  # its folder comes first on the path of modules
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    if finished.returncode:
        raise PeerError(f"{driver} failed:\n{finished.stderr[-2000:]}")


def recorded(
    rows: Sequence[Entry],
    cases: Sequence[str],
    arguments: argparse.Namespace,
    folder: Path,
    period: float = PERIOD,
) -> Iterator[tuple[Entry, dict[str, Recorded]]]:
    """Drives controllers through cases; yields what each recorded, by its cases.

    Args:
        rows: the controllers.
        cases: by name.
        arguments: with those of `add_peer_options`.
        folder: of the problem.
        period: of control [s].

    Raises:
        PeerError: as of `drive`.
    """
    runs = arguments.out / "runs"
    for entry in track(rows, "controllers"):
        jobs = {
            case: job(
                case, entry.settings[case], runs / f"{entry.name} {case}.npz", period
            )
            for case in cases
        }
        yield entry, drive(entry.peer, arguments.environments, folder, jobs)
