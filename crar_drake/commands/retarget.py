"""`crar-drake retarget`: a person's motion as a robot's reference motion."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.clean import clip_lines, frames_bar, violations
from crar_drake.commands.options import (
    FILE_OPTIONS,
    MOTION_HELP,
    add_command,
    add_file_options,
    add_frame_rate,
    add_skeleton,
    positive,
)
from crar_drake.commands.output import OUT, final_line, motion_label

if TYPE_CHECKING:
    from crar_drake.references.retarget_file import RetargetedClip

_DEGREE = 57.29577951308232
# Deeper than this below the floor is a violation, as `crar-drake judge` has it [m].
_MOST_BELOW = 0.01


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "retarget",
        run,
        "Make a reference motion of a whole robot of a person's motion: root and all "
        "joints, without a simulation, clear of collisions, within limits, feet on the "
        "floor; with a certificate beside it. The last line is OK, or VIOLATED and "
        "what, and the exit code 1.",
    )
    parser.add_argument("motion", metavar="MOTION", help=MOTION_HELP)
    parser.add_argument(
        "--robot",
        required=True,
        metavar="ROBOT",
        help="name or folder of the robot, imported as a whole body",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="a .csv, .npz or .pkl to write (default: out/retarget/MOTION.csv)",
    )
    parser.add_argument(
        "--layout",
        metavar="LAYOUT",
        help="layout to write (default: xyzw-csv, mjlab-npz or gmr-pkl by the suffix)",
    )
    parser.add_argument(
        "--rate",
        type=positive,
        default=30.0,
        metavar="HZ",
        help="frames per second to write (default: 30)",
    )
    add_skeleton(parser)
    add_frame_rate(parser)
    add_file_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Does what the arguments say.

    Returns:
        The exit code: 1 if something is violated.
    """
    from crar_drake.motion.options import MotionOptions
    from crar_drake.references.motion_certificate import certificate_path
    from crar_drake.references.retarget_file import retarget_file
    from crar_drake.robot.description import whole_body_name

    name = f"{motion_label(arguments.motion)}.csv"
    out = arguments.out or OUT / "retarget" / name
    if out.is_dir():
        out = out / name
    given = {option: getattr(arguments, option) for option in FILE_OPTIONS}
    with frames_bar() as progress:
        clip = retarget_file(
            arguments.motion,
            out,
            whole_body_name(arguments.robot),
            options=MotionOptions(**{k: v for k, v in given.items() if v}),
            layout=arguments.layout,
            rate=arguments.rate,
            progress=progress,
        )
    for line in _lines(clip):
        print(line)
    if arguments.verbose:
        for line in clip_lines(clip.cleaned):
            print(line)
    print(out)
    print(certificate_path(out))
    below = []
    if clip.lowest < -_MOST_BELOW:
        below = [f"{-1e3 * clip.lowest:.0f} mm below the floor"]
    return final_line([*violations([clip.cleaned]), *below])


def _lines(clip: RetargetedClip) -> list[str]:
    """How like the person the robot moves, in words."""
    cleaned = clip.cleaned
    limbs = [angles for limb, angles in clip.limbs.items() if "-" in limb]
    worst = max(clip.limbs, key=lambda limb: clip.limbs[limb][1])
    knees = ", ".join(
        f"{side} {_DEGREE * more:+.1f} deg ({_DEGREE * most:.1f} deg)"
        for side, (more, most) in clip.knees.items()
    )
    return [
        f"{cleaned.frames} frames at {cleaned.rate:g} Hz, {clip.seconds:.1f} s of a "
        f"processor, {clip.times_real_time:.1f} x real time",
        "limbs are off in direction by at most "
        f"{_DEGREE * max(median for median, _ in limbs):.1f} deg in the median and "
        f"{_DEGREE * max(most for _, most in limbs):.1f} deg in 95 % of the frames "
        f"(of all, {worst.replace('_', ' ')} is the farthest off: "
        f"{_DEGREE * clip.limbs[worst][1]:.1f} deg)",
        f"knees bend more than the person's by (median, and 95 %): {knees}",
        f"planted feet slip by at most {1e3 * clip.slip:.1f} mm, the lowest point is "
        f"{1e3 * clip.lowest:+.1f} mm over the floor",
        f"nearest links {1e3 * cleaned.nearest:.1f} mm apart, on ways between frames "
        f"at least {1e3 * cleaned.between:.1f} mm",
    ]
