"""`crar-drake clean`: reference motions made clear of collisions and within limits."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.folders import (
    frames_bar,
    progress_bar,
    tell_files,
    violations,
    work_on,
    written_lines,
)
from crar_drake.commands.options import (
    UsageError,
    add_command,
    add_frame_rate,
    add_whole_body,
    positive,
    share,
)
from crar_drake.commands.output import OUT, final_line, label

if TYPE_CHECKING:
    from crar_drake.references.clean_file import CleanedClip


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "clean",
        run,
        "Change a reference motion of a whole robot the least so that it keeps all "
        "constraints, and write it in its own layout with a certificate beside it, "
        "and a page that shows both. "
        "The last line is OK, or VIOLATED and what, and the exit code 1, as it is if a "
        "file failed. The same command continues a folder that was stopped.",
    )
    parser.add_argument(
        "reference",
        type=Path,
        metavar="PATH",
        help="a robot motion (.csv, .npz, .pkl), or a folder with such in it or below",
    )
    add_whole_body(
        parser, "file to write, or folder for those of a folder (default: in out/clean)"
    )
    add_frame_rate(parser)
    parser.add_argument(
        "--hands",
        action="store_true",
        help="keep the hands' poses throughout, as of hands that hold an object (those "
        "that carry the robot on the ground are kept without this)",
    )
    parser.add_argument(
        "--layout",
        metavar="LAYOUT",
        help="layout of the files (default: what each looks like)",
    )
    parser.add_argument(
        "--velocity-scale",
        type=share,
        default=1.0,
        metavar="SHARE",
        help="share of the robot's speed limits that may be used (default: 1)",
    )
    parser.add_argument(
        "--at-most",
        type=changes,
        default={},
        metavar="LIMITS",
        help="how far a motion may change, such as joints=15deg,feet=20mm (and hands); "
        "one that changed by more is written, too, but violates this",
    )
    parser.add_argument(
        "--frames",
        type=frame_range,
        default=(1, None),
        metavar="A:B",
        help="write these frames alone, counted from 1, A and B among them; A: is to "
        "the end, :B from the beginning",
    )
    parser.add_argument(
        "--ground",
        action="store_true",
        help="raise or lower each motion so that its feet's floor is at z = 0",
    )
    parser.add_argument(
        "--retime",
        action="store_true",
        help="slow a motion down where a joint is faster than its limit (default: it "
        "stays in time, and the joint lags)",
    )
    parser.add_argument(
        "--no-page",
        action="store_true",
        help="no page of before and after, which takes longer than cleaning does (of "
        "a folder's files there is none; crar-drake show makes it)",
    )


# Unit of --at-most: metres or radians in it.
_UNITS = {
    **{part: {"deg": math.radians(1.0), "rad": 1.0} for part in ("joints", "limbs")},
    **{part: {"mm": 1e-3, "cm": 1e-2, "m": 1.0} for part in ("feet", "hands")},
}


def changes(
    text: str, parts: Sequence[str] = ("joints", "feet", "hands")
) -> dict[str, float]:
    """Converts joints=15deg,feet=20mm, of some parts: [rad], [m]."""
    found: dict[str, float] = {}
    for entry in text.split(","):
        part, _, amount = entry.strip().partition("=")
        given = re.fullmatch(r"([\d.eE+-]+) *([a-z]*)", amount)
        if part not in parts or part in found:
            names = " and ".join([", ".join(parts[:-1]), parts[-1]][len(parts) == 1 :])
            such = ",".join(f"{x}=15{next(iter(_UNITS[x]))}" for x in parts)
            raise argparse.ArgumentTypeError(
                f"{entry.strip()!r}: say once each how far {names} may be off, such as "
                f"{such}"
            )
        if given is None or given[2] not in _UNITS[part]:
            units = list(_UNITS[part])
            raise argparse.ArgumentTypeError(
                f"{entry.strip()!r}: {part} need a number in {' or '.join(units)}, "
                f"such as {part}=15{units[0]}"
            )
        found[part] = _UNITS[part][given[2]] * positive(given[1])
    return found


def frame_range(text: str) -> tuple[int, int | None]:
    """Converts A:B, A: or :B, counted from 1."""
    given = re.fullmatch(r"(\d*):(\d*)", text.strip())
    first, last = (int(x) if x else None for x in given.groups()) if given else (0, 0)
    first = 1 if first is None else first
    if first < 1 or (last is not None and last < first):
        raise argparse.ArgumentTypeError(
            f"{text!r} are no frames; write the first and the last one, counted from "
            "1, such as 101:400, or 101: to the end"
        )
    return first, last


def run(arguments: argparse.Namespace) -> int:
    """Does what the arguments say.

    Returns:
        The exit code: 1 if something is still violated or a file of a folder failed.
    """
    from crar_drake.references.change import AtMost
    from crar_drake.references.cleaning import CleaningParameters
    from crar_drake.robot.description import whole_body_name

    reference: Path = arguments.reference
    arguments.robot = whole_body_name(arguments.robot)
    options = {
        "robot": arguments.robot,
        "parameters": CleaningParameters(
            hands=arguments.hands, velocity_scale=arguments.velocity_scale
        ),
        "layout": arguments.layout,
        "rate": arguments.frame_rate,
        "frames": arguments.frames,
        "ground": arguments.ground,
        "retime": arguments.retime,
        "at_most": AtMost(**arguments.at_most),
    }
    if reference.is_dir():
        from crar_drake.references.clean_file import CleanOptions

        out = arguments.out or OUT / "clean" / label(reference / "all").parent.name
        work = CleanOptions(**options)
        return work_on(work, reference, out, arguments.jobs, _summary)
    if arguments.jobs is not None:
        raise UsageError("--jobs is for folders")
    from crar_drake.files import check_file
    from crar_drake.references.clean_file import clean_file

    out = arguments.out or OUT / "clean" / label(reference).with_suffix(
        reference.suffix
    )
    if out.is_dir():
        out = out / reference.name
    if reference.is_file() and out.suffix.lower() != reference.suffix.lower():
        raise UsageError(
            f"--out: {out} must end in {reference.suffix}, as the reference does"
        )
    page = out.with_suffix(".html")
    if not arguments.no_page:
        check_file(page)
    with frames_bar() as progress:
        clips = clean_file(reference, out, progress=progress, **options)
    for clip in clips:
        for line in (*_clip_lines(clip), *written_lines(clip)):
            print(line)
    tell_files(out)
    if not arguments.no_page:
        _write_page(arguments, out, page, clips)
        print(page)
    guessed = [guess for clip in clips for guess in clip.guessed.split("; ") if guess]
    return final_line(violations(clips), left=[c.left for c in clips], guessed=guessed)


def _summary(clips: Sequence[CleanedClip]) -> list[str]:
    """What became of the motions of a folder, in words."""
    return [
        f"{len(clips)} motions: capsules penetrated in "
        f"{sum(clip.penetrating_before > 0 for clip in clips)} and do in "
        f"{sum(clip.penetrating > 0 for clip in clips)}; "
        f"{sum(clip.violated for clip in clips)} violate something"
    ]


def _write_page(
    arguments: argparse.Namespace, out: Path, page: Path, clips: list[CleanedClip]
) -> None:
    """Before and after; of a file with several motions, of that which changed most."""
    from crar_drake.errors import ModelError
    from crar_drake.results.motion_page import compare_files
    from crar_drake.robot_import.link_meshes import check_installed

    shown = max(clips, key=lambda clip: clip.joints_worst).clip or None
    if shown:
        print(
            f"the page is of {shown}, which changed the most; of another: crar-drake "
            "show BEFORE AFTER --clip NAME"
        )
    meshes = True
    try:
        check_installed()
    except ModelError as error:
        meshes = False
        print(f"the page colours links by their capsules: {error}")
    with progress_bar() as bar:
        bar.add_task("judging both for the page", total=None)
        compare_files(
            [arguments.reference, out],
            page,
            arguments.robot,
            labels=["before", "after"],
            layout=arguments.layout,
            rate=arguments.frame_rate,
            clip=shown,
            frames=arguments.frames,
            meshes=meshes,
        )


def _clip_lines(clip: CleanedClip) -> list[str]:
    """What cleaning changed of a motion, in words."""
    lines = [
        *([f"guessed: {clip.guessed}"] if clip.guessed else []),
        f"{clip.clip + ': ' if clip.clip else ''}{clip.frames} frames at "
        f"{clip.rate:g} Hz; before and after: {clip.penetrating_before} and "
        f"{clip.penetrating} frames with capsules in penetration, "
        f"{clip.beyond_limit_before} and {clip.beyond_limit} beyond a joint limit, "
        f"{clip.too_fast_before} and {clip.too_fast} beyond a speed limit, smallest "
        f"distance {1e3 * clip.nearest_before:.1f} and {1e3 * clip.nearest:.1f} mm "
        f"(between frames at least {1e3 * clip.between:.1f} mm)",
        f"changed: {clip.changed} frames; joints {math.degrees(clip.joints_rms):.2f} "
        f"deg rms, {math.degrees(clip.joints_worst):.2f} deg at most; feet "
        f"{_millimetres(clip.feet_rms, clip.feet_worst)}; hands "
        f"{_millimetres(clip.hands_rms, clip.hands_worst)}; jerk of the joints "
        f"{clip.jerk_before:.0f} and {clip.jerk:.0f} rad/s^3 rms",
        f"{clip.seconds:.1f} s of a processor, {clip.times_real_time:.1f} x real time",
    ]
    if clip.raised:
        lines.append(
            f"{'raised' if clip.raised > 0.0 else 'lowered'} by "
            f"{1e3 * abs(clip.raised):.1f} mm, so that the feet's floor is at z = 0"
        )
    if clip.slowed:
        lines.append(
            f"slowed down: it takes {clip.slowed:.2f} s longer, so that no joint is "
            "too fast"
        )
    if clip.exceeded:
        lines.append(f"changed by more than is allowed: {clip.exceeded}")
    if clip.left:
        lines.append(f"left as it was: {clip.left}")
    if clip.frozen:
        lines.append(
            f"in {clip.frozen} frames the robot stands still while its reference moves"
        )
    return lines


def _millimetres(rms: float, worst: float) -> str:
    if rms != rms:
        return "none"
    return f"{1e3 * rms:.1f} mm rms, {1e3 * worst:.1f} mm at most"
