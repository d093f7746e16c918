"""`crar-drake compare`: saved logs of several runs in one page, with one time line."""

from __future__ import annotations

import argparse
from pathlib import Path

from crar_drake.commands.options import UsageError, add_command, add_robot
from crar_drake.commands.output import OUT


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "compare",
        run,
        "Make one page of several runs from their saved logs, without simulating.",
    )
    parser.add_argument(
        "logs",
        type=Path,
        nargs="+",
        metavar="RUN",
        help="the log.npz of a run, or its folder; two or more",
    )
    parser.add_argument(
        "--overlay",
        action="store_true",
        help="lay the robots over each other (default: side by side); the page has a "
        "button for it, too",
    )
    parser.add_argument(
        "--label",
        action="append",
        metavar="TEXT",
        help="what to call a run, once for each in their order (default: what they "
        "differ in)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help=f"page to write (default: {OUT / 'compare.html'})",
    )
    add_robot(parser)


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.files import check_file
    from crar_drake.results import LOG
    from crar_drake.results.log import SimulationLog
    from crar_drake.results.marks import RUNS
    from crar_drake.results.playback import compare_logs, distinct_labels

    paths = [path / LOG if path.is_dir() else path for path in arguments.logs]
    if not 2 <= len(paths) <= len(RUNS):
        raise UsageError(
            f"name 2 to {len(RUNS)} runs to compare, not {len(paths)}; one log by "
            "itself becomes a page with crar-drake playback"
        )
    labels = arguments.label
    if labels is not None and len(labels) != len(paths):
        raise UsageError(
            f"--label: given {len(labels)} times for {len(paths)} runs; give it once "
            "for each, or not at all"
        )
    out = arguments.out or OUT / "compare.html"
    check_file(out)
    logs = [SimulationLog.load(path) for path in paths]
    for model in compare_logs(
        logs,
        out,
        labels=labels
        or distinct_labels(logs, [p.absolute().parent.name for p in paths]),
        overlay=arguments.overlay,
        robot=arguments.robot or "",
    ):
        print(
            f"warning: model {model} has no visual geometry: its collision shapes are "
            "drawn"
        )
    print(out)
