"""`crar-drake compare`: several runs or motions in one page, with one time line."""

import argparse
from pathlib import Path

from crar_drake.commands.options import (
    UsageError,
    add_command,
    add_frame_rate,
    add_robot,
)
from crar_drake.commands.output import OUT, tell_drawn


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "compare",
        run,
        "Make one page of several runs from their saved logs, without simulating; or "
        "of reference motions of one robot, such as before and after cleaning.",
    )
    parser.add_argument(
        "logs",
        type=Path,
        nargs="+",
        metavar="RUN",
        help="the log.npz of a run, or its folder; or a reference motion (.csv, .npz, "
        ".pkl); two or more",
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
    add_robot(parser, "; or that of reference motions")
    group = parser.add_argument_group("of reference motions")
    add_frame_rate(group)
    group.add_argument(
        "--layout",
        metavar="LAYOUT",
        help="of the files (default: what each looks like)",
    )
    group.add_argument(
        "--clip", metavar="NAME", help="which motion of files that hold several"
    )
    group.add_argument(
        "--no-meshes",
        action="store_true",
        help="colour links by their capsules alone, which takes less time",
    )


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.files import check_file
    from crar_drake.motion.robots_own import holds_reference
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
    references = [path for path in paths if holds_reference(path)]
    if references:
        _compare_references(arguments, paths, references, out)
        return
    logs = [SimulationLog.load(path) for path in paths]
    labels = labels or distinct_labels(logs, [p.absolute().parent.name for p in paths])
    robot, overlay = arguments.robot or "", arguments.overlay
    tell_drawn(compare_logs(logs, out, labels=labels, overlay=overlay, robot=robot))
    print(out)


def _compare_references(
    arguments: argparse.Namespace, paths: list[Path], references: list[Path], out: Path
) -> None:
    from crar_drake.results.motion_page import compare_files

    others = [path for path in paths if path not in references]
    if others:
        raise UsageError(
            f"{others[0]} is no reference motion, and {references[0]} is one: compare "
            "runs, or reference motions"
        )
    if not arguments.robot:
        raise UsageError("say which robot the motions are of: --robot ROBOT")
    from crar_drake.robot.description import whole_body_name

    compare_files(
        paths,
        out,
        whole_body_name(arguments.robot),
        labels=arguments.label or _file_labels(paths),
        layout=arguments.layout,
        rate=arguments.frame_rate,
        clip=arguments.clip,
        meshes=not arguments.no_meshes,
        overlay=arguments.overlay,
    )
    print(out)


def _file_labels(paths: list[Path]) -> list[str]:
    """What files are called: by their names, else by their folders, else by number."""
    for labels in (
        [path.name for path in paths],
        [path.absolute().parent.name for path in paths],
    ):
        if len(set(labels)) == len(labels):
            return labels
    return [f"{path.name} {i + 1}" for i, path in enumerate(paths)]
