"""`crar-drake retarget`: a person's motion as a robot's reference motion."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.clean import changes
from crar_drake.commands.folders import (
    frames_bar,
    tell_files,
    violations,
    work_on,
    written_lines,
)
from crar_drake.commands.options import (
    MOTION_HELP,
    UsageError,
    add_command,
    add_motion_options,
    add_whole_body,
    given_motion_options,
    positive,
    share,
)
from crar_drake.commands.output import OUT, final_line, label

if TYPE_CHECKING:
    from crar_drake.references.retarget_file import RetargetedClip


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "retarget",
        run,
        "Make a reference motion of a whole robot of a person's motion: root and all "
        "joints, without a simulation, clear of collisions, within limits, feet on the "
        "floor; with a certificate beside it. The last line is OK, or VIOLATED and "
        "what, and the exit code 1, as it is if a file failed. The same command "
        "continues a folder that was stopped.",
    )
    parser.add_argument(
        "motion",
        metavar="MOTION",
        help=f"{MOTION_HELP}; or a folder with such in it or below",
    )
    add_whole_body(
        parser,
        "a .csv, .npz or .pkl to write (default: out/retarget/MOTION.csv), or folder "
        "for those of a folder",
    )
    parser.add_argument(
        "--layout",
        metavar="LAYOUT",
        help="layout to write (default: xyzw-csv, mjlab-npz or gmr-pkl by the suffix; "
        "of a folder xyzw-csv)",
    )
    parser.add_argument(
        "--rate",
        type=positive,
        default=30.0,
        metavar="HZ",
        help="frames per second to write (default: 30)",
    )
    parser.add_argument(
        "--limits",
        type=share,
        default=1.0,
        metavar="SHARE",
        help="share of each joint's range, about its middle, that may be used "
        "(default: 1)",
    )
    parser.add_argument(
        "--at-most",
        type=partial(changes, parts=("limbs",)),
        default={},
        metavar="LIMITS",
        help="how far limbs may be off from the person's for longer than 0.2 s, such "
        "as limbs=30deg (default: 45deg); a motion with limbs that are farther off is "
        "written, too, but violates this",
    )
    add_motion_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Does what the arguments say.

    Returns:
        The exit code: 1 if something is violated.
    """
    from crar_drake.robot.description import whole_body_name

    options = {
        "robot": whole_body_name(arguments.robot),
        "person": given_motion_options(arguments),
        "rate": arguments.rate,
        "limits": arguments.limits,
    }
    if arguments.layout:
        options["layout"] = arguments.layout
    if arguments.at_most:
        options["most_off"] = arguments.at_most["limbs"]
    if Path(arguments.motion).is_dir():
        from crar_drake.references.retarget_file import RetargetOptions

        folder, work = Path(arguments.motion), RetargetOptions(**options)
        out = arguments.out or OUT / "retarget" / label(folder / "all").parent.name
        return work_on(work, folder, out, arguments.jobs, _summary)
    if arguments.jobs is not None:
        raise UsageError("--jobs is for folders")
    from crar_drake.references.retarget_file import retarget_file

    name = f"{label(arguments.motion)}.csv"
    out = arguments.out or OUT / "retarget" / name
    if out.is_dir():
        out = out / Path(name).name
    with frames_bar() as progress:
        clip = retarget_file(arguments.motion, out, progress=progress, **options)
    for line in (*_lines(clip), *(written_lines(clip) if arguments.verbose else ())):
        print(line)
    tell_files(out)
    return final_line(violations([clip]))


def _summary(clips: Sequence[RetargetedClip]) -> list[str]:
    """What became of the motions of a folder, in words."""
    lines = [
        f"{len(clips)} motions, {sum(clip.frames for clip in clips)} frames: "
        f"{sum(clip.violated for clip in clips)} violate something"
    ]
    if clips:
        median, most = (
            math.degrees(max(getattr(clip, name) for clip in clips))
            for name in ("limbs_median", "limbs_most")
        )
        lines.append(
            f"at most, of all: limbs are off in direction by {median:.1f} deg in the "
            f"median and {most:.1f} deg in 95 % of the frames; planted feet slip by "
            f"{1e3 * max(clip.slip for clip in clips):.1f} mm"
        )
    return lines


def _lines(clip: RetargetedClip) -> list[str]:
    """How like the person the robot moves, in words."""
    knees = ", ".join(
        f"{side} {math.degrees(more):+.1f} deg"
        for side, more in (("left", clip.left_knee), ("right", clip.right_knee))
    )
    return [
        f"read: {clip.guessed}",
        f"{clip.frames} frames at {clip.rate:g} Hz, {clip.seconds:.1f} s of a "
        f"processor, {clip.times_real_time:.1f} x real time",
        "limbs are off in direction by at most "
        f"{math.degrees(clip.limbs_median):.1f} deg in the median and "
        f"{math.degrees(clip.limbs_most):.1f} deg in 95 % of the frames "
        f"(of all, {clip.farthest.replace('_', ' ')} is the farthest off: "
        f"{math.degrees(clip.farthest_most):.1f} deg)",
        f"knees bend more than the person's in the median by: {knees}",
        f"planted feet slip by at most {1e3 * clip.slip:.1f} mm, the lowest point is "
        f"{1e3 * clip.lowest:+z.1f} mm over the floor",
        f"the root accelerates by {clip.root:.1f} m/s^2 rms, at most "
        f"{clip.root_peak:.1f}; the person's, scaled, by {clip.persons_root:.1f} and "
        f"{clip.persons_root_peak:.1f}",
        f"nearest links {1e3 * clip.nearest:.1f} mm apart, on ways between frames "
        f"at least {1e3 * clip.between:.1f} mm",
    ]
