"""`crar-drake judge` of reference motions: files that policies are trained on."""

from __future__ import annotations

import argparse
import math
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.folders import frames_bar
from crar_drake.commands.options import Parser, add_frame_rate, add_jobs, positive
from crar_drake.commands.output import counted, final_line
from crar_drake.errors import CrarError

if TYPE_CHECKING:
    from crar_drake.references.folders import FileResult

_MILLIMETRE = 1e-3  # [m]


def add_reference_judge_options(parser: Parser) -> None:
    """Adds what is of reference motions alone."""
    group = parser.add_argument_group("of reference motions")
    add_frame_rate(group)
    add_jobs(group)
    group.add_argument(
        "--certificate",
        action="store_true",
        help="check the certificates that crar-drake clean has written beside them",
    )
    group.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for judge.json and a plot over time of each motion",
    )
    group.add_argument(
        "--most-below",
        type=positive,
        default=10.0,
        metavar="MM",
        help="how far below the ground is no violation yet (default: %(default)s mm)",
    )
    group.add_argument(
        "--most-slip",
        type=positive,
        default=math.inf,
        metavar="MM",
        help="how far a foot may slip in one contact (default: slip is reported, "
        "but is no violation)",
    )


def is_reference_or_folder(path: Path) -> bool:
    """Whether a path is no log: a folder, or a motion by suffix and keys."""
    from crar_drake.motion.robots_own import holds_reference, is_reference

    if path.is_dir() or (is_reference(path) and path.suffix.lower() != ".npz"):
        return True
    return holds_reference(path)  # of a damaged NPZ the log's reader tells


def run_references(arguments: argparse.Namespace) -> int:
    """Judges reference motions.

    Returns:
        The exit code, as of `final_line`.
    """
    from crar_drake.files import check_folder
    from crar_drake.references.faults import Tolerances
    from crar_drake.references.folders import FileResult, each_file, references_in
    from crar_drake.references.reference_judge import FileJudge
    from crar_drake.references.verdict_report import verdict_lines
    from crar_drake.robot.description import load_robot_description, whole_body_name

    if not arguments.robot:
        folders = [path for path in arguments.what if path.is_dir()]
        if folders:
            raise CrarError(
                f"{folders[0]}: this is a folder; name log.npz, or if reference "
                "motions are in it, say which robot they are of with --robot"
            )
        raise CrarError(
            "say which robot the motions are of: --robot ROBOT (imported once by "
            "crar-drake import-robot FILE --whole-body --out ROBOT)"
        )
    arguments.robot = whole_body_name(arguments.robot)
    if arguments.out is not None:
        check_folder(arguments.out)
    files = references_in(arguments.what)
    begin = partial(
        FileJudge,
        arguments.robot,
        layout=arguments.layout,
        rate=arguments.frame_rate,
        meshes=not arguments.no_meshes,
        every=arguments.every,
        tolerances=Tolerances(
            below_ground=_MILLIMETRE * arguments.most_below,
            slip=_MILLIMETRE * arguments.most_slip,
        ),
    )
    if len(files) == 1:
        judged = [FileResult(files[0], tuple(begin()(files[0])))]
    else:
        load_robot_description(arguments.robot)  # what is wrong with it is said once
        results = each_file([(file,) for file in files], begin, jobs=arguments.jobs)
        done: dict[Path, FileResult] = {}
        with frames_bar() as progress, closing(results):
            for result in results:
                done[result.source] = result
                progress(len(done), len(files))
        judged = [done[file] for file in files]
    for entry in judged:
        for verdict in entry.clips:
            for line in verdict_lines(verdict):
                print(line)
    _print_table(judged)
    if arguments.out is not None:
        _write(judged, arguments.robot, arguments.out)
    verdicts = [verdict for entry in judged for verdict in entry.clips]
    violated = list(verdicts[0].violations) if len(verdicts) == 1 else []
    if len(verdicts) > 1:
        number = sum(bool(verdict.violations) for verdict in verdicts)
        violated = counted(number, "motion", f"of {len(verdicts)}")
    unusable = sum(bool(entry.error) for entry in judged)
    unread = f"{unusable} of {len(judged)} files cannot be used" if unusable else ""
    guessed = [guess for verdict in verdicts for guess in verdict.motion.guesses]
    left = ["; ".join(verdict.left_as_it_was) for verdict in verdicts]
    return final_line(violated, guessed=guessed, left=left, unread=unread)


def _print_table(judged: list[FileResult]) -> None:
    """A row a motion, if there are several; then the files that cannot be used."""
    from crar_drake.references.verdict_report import HEADER, verdict_row

    verdicts = [verdict for entry in judged for verdict in entry.clips]
    if len(verdicts) + sum(bool(entry.error) for entry in judged) < 2:
        return
    rows = [HEADER, *(verdict_row(verdict) for verdict in verdicts)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADER))]
    print()
    for row in rows:
        cells = zip(row, widths, strict=True)
        print("  ".join(cell.ljust(width) for cell, width in cells).rstrip())
    violated = sum(bool(verdict.violations) for verdict in verdicts)
    unusable = [entry for entry in judged if entry.error]
    print(
        f"\n{len(verdicts)} motions: {violated} with a violation, "
        f"{len(verdicts) - violated} clean; {len(unusable)} files cannot be used"
    )
    for entry in unusable:
        print(f"  {entry.error}")


def _write(judged: list[FileResult], robot: str, out: Path) -> None:
    """judge.json, and a plot a motion."""
    import json
    import re

    from crar_drake.files import write_whole
    from crar_drake.references.verdict_report import (
        name_of,
        plot_verdict,
        verdict_data,
    )
    from crar_drake.version import __version__

    data = {
        "version": __version__,
        "robot": robot,
        "motions": [verdict_data(v) for entry in judged for v in entry.clips],
        "unusable": [
            {"file": str(entry.source), "error": entry.error}
            for entry in judged
            if entry.error
        ],
    }
    names: set[str] = set()
    for verdict in (v for entry in judged for v in entry.clips):
        name = re.sub(r"[^\w.\-]+", "_", name_of(verdict))
        while name in names:  # files of one name in several folders
            name += "_"
        names.add(name)
        plot_verdict(verdict, out / f"{name}.png")
    write_whole(out / "judge.json", json.dumps(data, indent=1, allow_nan=False) + "\n")
    print(out / "judge.json")
