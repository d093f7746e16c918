"""The experiments of the paper's Section IV, repeated.

    python -m benchmarks.section_iv [--motions cmu]

The same command continues one that was stopped.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.section_iv.plan import MOTION_SETS, make_plan
from benchmarks.section_iv.report import FIGURES, tables
from benchmarks.section_iv.reproduce import reproduce
from benchmarks.section_iv.simulate import finished
from benchmarks.sweep.cases import find_motions
from benchmarks.sweep.command import add_duration, list_of, sweep_bar
from crar_drake.commands import answer
from crar_drake.commands.options import Parser, add_jobs, add_what_runs
from crar_drake.commands.output import OUT, continuing, label
from crar_drake.files import check_folder


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; the exit code is as of `crar-drake`."""
    parser = Parser(
        prog="python -m benchmarks.section_iv",
        description="Repeat the experiments of the paper's Section IV. The same "
        "command continues one that was stopped.",
    )
    add_what_runs(parser, run)
    parser.add_argument(
        "--motions",
        type=list_of(str),
        action="extend",
        metavar="M[,M...]",
        help="builtin (the four built-in motions), cmu (the CMU recordings 05_02, "
        "13_29, 14_07 and 13_17), or names of motions, the first of them a dance "
        "(default: builtin)",
    )
    add_duration(parser)
    add_jobs(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for figures and results (default: out/reproduce/NAME, "
        "where NAME says which motions)",
    )
    return answer(parser, argv)


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""

    chosen = arguments.motions or ["builtin"]
    motions = [m for name in chosen for m in MOTION_SETS.get(name, (name,))]
    found = find_motions(motions)
    labels = [str(label(name)).replace(os.sep, "_") for name in chosen]
    out = arguments.out or OUT / "reproduce" / "-".join(labels)
    check_folder(out)
    plan = make_plan(found, duration=arguments.duration)

    kept = len(finished(plan, out))
    with continuing(out), sweep_bar(kept, len(plan.simulations)) as show:
        result = reproduce(
            plan,
            out,
            jobs=arguments.jobs,
            progress=lambda done, total, newest: show(done, total, newest.result),
        )
    for table in tables(result):
        print(table.markdown())
    print(out / FIGURES)


if __name__ == "__main__":
    sys.exit(main())
