"""`crar-drake convert`: a robot's motion from one layout to another."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.options import (
    UsageError,
    add_command,
    add_frame_rate,
    add_reference_options,
    positive,
)
from crar_drake.errors import MotionError

if TYPE_CHECKING:
    from crar_drake.references.robot_motion import RobotMotion
    from crar_drake.references.whole_body import WholeBody


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "convert",
        run,
        "Write a robot's motion (a reference motion, as policies are trained on) in "
        "another layout, or at another rate. docs/guides/reference-motions.md has the "
        "layouts.",
    )
    parser.add_argument(
        "motion",
        type=Path,
        metavar="IN",
        help="the motion's file, or the log.npz of a run, of which what is blended in "
        "at first is left out",
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="the file to write")
    parser.add_argument(
        "--to",
        metavar="LAYOUT",
        help="layout of OUT (docs/guides/reference-motions.md; default: "
        "that of IN, if OUT has its suffix)",
    )
    parser.add_argument(
        "--rate",
        type=positive,
        metavar="HZ",
        help="frames per second of OUT, along splines (default: those of IN)",
    )
    add_frame_rate(parser)
    add_reference_options(parser, "; or of a log's, if it is not where it was")
    parser.add_argument("--clip", metavar="NAME", help="of a file with several motions")


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.files import check_file
    from crar_drake.references.contacts import LABELS, contacts_path, labels_beside
    from crar_drake.references.layout_writer import kept_extras
    from crar_drake.references.layouts import layout_named, layouts_of
    from crar_drake.references.motion_files import (
        read_motion,
        read_motions,
        write_motions,
    )
    from crar_drake.references.resampling import resampled
    from crar_drake.results.log import is_log

    check_file(arguments.out)
    if is_log(arguments.motion):
        motions, robot = _of_log(arguments)
    else:
        robot = reference_robot(arguments)
        options = dict(layout=arguments.layout, rate=arguments.frame_rate, robot=robot)
        if arguments.clip is not None:
            motions = (read_motion(arguments.motion, clip=arguments.clip, **options),)
        else:
            motions = read_motions(arguments.motion, **options)
    possible = layouts_of(arguments.out)
    to = arguments.to
    if to is None:
        if motions[0].layout in possible:
            to = motions[0].layout
        elif len(possible) == 1:
            (to,) = possible
        else:
            raise MotionError(
                f"{arguments.out}: say its layout with --to"
                + (f": {', '.join(possible)}" if possible else "")
            )
    layout = layout_named(to)
    if to not in possible:
        raise MotionError(
            f"{arguments.out}: {to} is a {layout.suffix} file; name it so"
        )
    beside = LABELS if labels_beside(motions, layout) else ()
    written, reported = [], []
    for motion in motions:
        reported += [f"guessed: {guess}" for guess in motion.guesses]
        lost: tuple[str, ...] = ()
        if arguments.rate is not None:
            motion, lost = resampled(motion, arguments.rate)
        kept = {*kept_extras(motion, layout), *beside}
        lost = (*lost, *(key for key in motion.extras if key not in kept))
        if lost:
            names = ", ".join(dict.fromkeys(lost))
            reported.append(f"left out, since {to} or the new rate has none: {names}")
        written.append(motion)
    write_motions(arguments.out, written, to, robot)
    for line in dict.fromkeys(reported):
        print(line)
    for motion in written:
        clip = f"{motion.clip}: " if motion.clip else ""
        print(
            f"{clip}{motion.num_frames} frames at {motion.rate:g} Hz, "
            f"{motion.num_joints} joints, from {motion.layout} to {to}"
        )
    print(arguments.out)
    if labels_beside(written, layout):
        print(contacts_path(arguments.out))


def _of_log(arguments: argparse.Namespace) -> tuple[tuple[RobotMotion], WholeBody]:
    """The motion of a run from its log, and the robot.

    Raises:
        UsageError: an option is given that says nothing of a log.
    """
    from crar_drake.references.whole_body import WholeBody
    from crar_drake.results.log import SimulationLog
    from crar_drake.results.logged_motion import motion_of_log
    from crar_drake.results.logged_robot import load_logged_robot, load_logged_scenario

    for name in ("layout", "clip", "frame_rate"):
        if getattr(arguments, name) is not None:
            raise UsageError(
                f"{arguments.motion}: --{name.replace('_', '-')} is of a file of "
                "motions, not of a log"
            )
    log = SimulationLog.load(arguments.motion)
    robot = WholeBody(load_logged_robot(log, arguments.robot or ""))
    start = load_logged_scenario(log).controller.blend_time
    return (motion_of_log(log, robot, start),), robot


def reference_robot(arguments: argparse.Namespace):
    """The robot that --robot names, or None."""
    if not arguments.robot:
        return None
    from crar_drake.references.whole_body import WholeBody
    from crar_drake.robot.description import load_robot_description, whole_body_name

    return WholeBody(load_robot_description(whole_body_name(arguments.robot)))
