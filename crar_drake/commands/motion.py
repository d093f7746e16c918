"""`crar-drake motion`: what is in a motion."""

from __future__ import annotations

import argparse
from pathlib import Path

from crar_drake.commands.options import (
    FILE_OPTIONS,
    MOTION_HELP,
    add_command,
    add_file_options,
    add_frame_rate,
    add_skeleton,
)
from crar_drake.commands.output import OUT, motion_label


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "motion",
        run,
        "Print what is in a motion and what looks bad, and plot it.",
    )
    parser.add_argument("motion", metavar="MOTION", help=MOTION_HELP)
    add_skeleton(parser)
    add_frame_rate(parser)
    add_file_options(parser)
    parser.add_argument(
        "--plot",
        type=Path,
        metavar="FILE",
        help="picture to write (default: out/MOTION.png)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.figures import check_picture
    from crar_drake.motion.catalogue import load_performer
    from crar_drake.motion.options import MotionOptions
    from crar_drake.motion.picture import plot_motion
    from crar_drake.motion.report import describe, inspect

    plot = arguments.plot or OUT / f"{motion_label(arguments.motion)}.png"
    if arguments.plot is not None:
        check_picture(plot)
    given = {name: getattr(arguments, name) for name in FILE_OPTIONS}
    performer = load_performer(
        arguments.motion,
        MotionOptions(**{name: value for name, value in given.items() if value}),
    )
    report = inspect(performer)
    for line in describe(report):
        print(line)
    if report.obstacle and arguments.plot is None:
        return
    plot_motion(performer, plot)
    print(plot)
