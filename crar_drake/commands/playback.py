"""`crar-drake playback`: a saved log as a page to look at."""

import argparse
from pathlib import Path

from crar_drake.commands.options import add_command, add_robot
from crar_drake.commands.output import tell_drawn


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "playback",
        run,
        "Make a page to look at from a saved log, without simulating again.",
    )
    parser.add_argument("log", type=Path, metavar="LOG", help="the log.npz of a run")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="page to write (default: playback.html beside the log)",
    )
    add_robot(parser)


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.files import check_file
    from crar_drake.results.log import SimulationLog
    from crar_drake.results.playback import record_log

    log = SimulationLog.load(arguments.log)
    out = arguments.out or arguments.log.with_name("playback.html")
    check_file(out)
    tell_drawn(record_log(log, out, robot=arguments.robot or ""))
    print(out)
