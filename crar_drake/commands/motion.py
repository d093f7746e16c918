"""`crar-drake motion`: what is in a motion."""

import argparse
from pathlib import Path

from crar_drake.commands.options import (
    FILE_OPTIONS,
    MOTION_HELP,
    add_command,
    add_file_options,
    add_frame_rate,
    add_reference_options,
    add_skeleton,
)
from crar_drake.commands.output import OUT, label
from crar_drake.errors import printable


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "motion",
        run,
        "Print what is in a motion and what looks bad, and plot it. It may also be a "
        "motion of a whole robot (.csv, .npz, .npy, .pkl, .motion).",
    )
    parser.add_argument("motion", metavar="MOTION", help=MOTION_HELP)
    add_skeleton(parser)
    add_frame_rate(parser)
    add_file_options(parser)
    add_reference_options(parser)
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
    from crar_drake.motion.robots_own import holds_reference

    plot = arguments.plot or OUT / f"{label(arguments.motion)}.png"
    if arguments.plot is not None:
        check_picture(plot)
    if arguments.robot or arguments.layout or holds_reference(arguments.motion):
        _describe_reference(arguments, plot)
        return
    given = {name: getattr(arguments, name) for name in FILE_OPTIONS}
    performer = load_performer(
        arguments.motion,
        MotionOptions(**{name: value for name, value in given.items() if value}),
    )
    report = inspect(performer)
    for line in describe(report):
        print(printable(line))
    if report.obstacle and arguments.plot is None:
        return
    plot_motion(performer, plot)
    print(plot)


def _describe_reference(arguments: argparse.Namespace, plot: Path) -> None:
    """What is in a motion of a whole robot; a file may hold several."""
    from crar_drake.commands.convert import reference_robot
    from crar_drake.errors import MotionError
    from crar_drake.references.motion_files import read_motions
    from crar_drake.references.motion_report import describe_motion, plot_robot_motion

    for option in set(FILE_OPTIONS) - {"frame_rate"}:
        if getattr(arguments, option):
            raise MotionError(
                f"{arguments.motion}: --{option} is for motions of people, not of a "
                "robot"
            )
    robot = reference_robot(arguments)
    motions = read_motions(
        arguments.motion,
        layout=arguments.layout,
        rate=arguments.frame_rate,
        robot=robot,
    )
    for motion in motions:
        for line in describe_motion(motion, robot):
            print(printable(line))
    if len(motions) > 1:
        print(f"{len(motions)} motions, of which the first is drawn")
    plot_robot_motion(motions[0], plot)
    print(plot)
