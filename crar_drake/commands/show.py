"""`crar-drake show`: what is at hand, what is in a file, and pages to look at."""

import argparse
from pathlib import Path

from crar_drake.commands.options import (
    FILE_OPTIONS,
    MOTION_HELP,
    UsageError,
    add_command,
    add_motion_options,
    add_reference_options,
    given_motion_options,
)
from crar_drake.commands.output import OUT, label, tell_drawn
from crar_drake.errors import printable

# What is shown to the options that say something of it.
_OPTIONS = {
    "what is at hand": (),
    "a person's motion": (*FILE_OPTIONS, "out"),
    "a robot's motion": ("robot", "layout", "frame_rate", "out"),
    "a log": ("robot", "out"),
    "several logs": ("robot", "out", "label", "overlay"),
    "several motions of a robot": (
        *("robot", "out", "label", "overlay", "layout", "frame_rate"),
        *("clip", "no_meshes"),
    ),
    "a person beside a robot": (
        *("robot", "out", "label", "overlay", "layout", "clip", "no_meshes"),
        *FILE_OPTIONS,
    ),
}


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "show",
        run,
        "Without a file: list the robots, motions and scenarios that are at hand. Of a "
        "motion of a person or a robot: print what is in it and what looks bad, and "
        "plot it. Of a log: make a page to look at, without simulating again. Of "
        "several logs, or several motions of a robot, such as before and after "
        "cleaning, or the person's before them: make one page with one time line.",
    )
    parser.add_argument(
        "files",
        nargs="*",
        metavar="FILE",
        help=f"a motion: {MOTION_HELP}; or the log.npz of a run, or its folder",
    )
    add_reference_options(parser, "; or of a log's, if it is not where it was")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="picture of a motion to write (default: out/MOTION.png), or page of runs "
        "or of several motions (default: playback.html beside the log, or "
        f"{OUT / 'compare.html'})",
    )
    add_motion_options(parser.add_argument_group("of a motion"))
    group = parser.add_argument_group("of a page")
    group.add_argument(
        "--overlay",
        action="store_true",
        help="lay several robots over each other (default: side by side); the page "
        "has a button for it, too",
    )
    group.add_argument(
        "--label",
        action="append",
        metavar="TEXT",
        help="what to call one of several, once for each in their order (default: "
        "its file or folder)",
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
    files = arguments.files
    if not files:
        from crar_drake.commands.listing import print_what_is_at_hand

        _refuse_others(arguments, "what is at hand")
        print_what_is_at_hand()
        return
    logs = [_log_of(each) for each in files]
    if logs == [None]:
        _show_motion(arguments, files[0])
    else:
        named = zip(logs, files, strict=True)
        _make_page(arguments, [log or Path(file) for log, file in named])


def _refuse_others(arguments: argparse.Namespace, what: str) -> None:
    """Raises UsageError if an option is given that says nothing of what is shown."""
    for name in sorted({name for names in _OPTIONS.values() for name in names}):
        if name not in _OPTIONS[what] and getattr(arguments, name):
            of = " or ".join(each for each in _OPTIONS if name in _OPTIONS[each])
            before = f"{arguments.files[0]}: " if arguments.files else ""
            option = name.replace("_", "-")
            raise UsageError(f"{before}--{option} is of {of}, not of {what}")


def _log_of(text: str) -> Path | None:
    """The log that a file or a folder is or holds, or None: it is a motion."""
    from crar_drake.motion.catalogue import builtin_names
    from crar_drake.results import LOG
    from crar_drake.results.log import is_log

    path = Path(text)
    if path.is_dir() and text not in builtin_names():
        return path / LOG
    return path if is_log(path) else None


# --- a motion ---------------------------------------------------------------------


def _show_motion(arguments: argparse.Namespace, motion: str) -> None:
    from crar_drake.figures import check_picture
    from crar_drake.motion.robots_own import holds_reference

    plot = arguments.out or OUT / f"{label(motion)}.png"
    if arguments.out is not None:
        check_picture(plot)
    if arguments.robot or arguments.layout or holds_reference(motion):
        _refuse_others(arguments, "a robot's motion")
        drawn = _describe_reference(arguments, motion, plot)
    else:
        _refuse_others(arguments, "a person's motion")
        drawn = _describe_person(arguments, motion, plot)
    if drawn:
        print(plot)


def _describe_person(arguments: argparse.Namespace, motion: str, plot: Path) -> bool:
    """What is in a person's motion; whether there is a picture of it."""
    from crar_drake.motion.catalogue import load_performer
    from crar_drake.motion.picture import plot_motion
    from crar_drake.motion.report import describe, inspect

    performer = load_performer(motion, given_motion_options(arguments))
    report = inspect(performer)
    for line in describe(report):
        print(printable(line))
    if report.obstacle and arguments.out is None:
        return False
    plot_motion(performer, plot)
    return True


def _describe_reference(arguments: argparse.Namespace, motion: str, plot: Path) -> bool:
    """What is in a motion of a whole robot, and a picture; a file may hold several."""
    from crar_drake.commands.convert import reference_robot
    from crar_drake.references.motion_files import read_motions
    from crar_drake.references.motion_report import describe_motion, plot_robot_motion

    robot = reference_robot(arguments)
    motions = read_motions(
        motion, layout=arguments.layout, rate=arguments.frame_rate, robot=robot
    )
    for each in motions:
        for line in describe_motion(each, robot):
            print(printable(line))
    if len(motions) > 1:
        print(f"{len(motions)} motions, of which the first is drawn")
    plot_robot_motion(motions[0], plot)
    return True


# --- pages ------------------------------------------------------------------------


def _make_page(arguments: argparse.Namespace, paths: list[Path]) -> None:
    """The page of one run or of several, or of several motions of a robot."""
    from crar_drake.files import check_file
    from crar_drake.motion.robots_own import holds_reference
    from crar_drake.results.log import SimulationLog
    from crar_drake.results.playback import record_logs

    single = len(paths) == 1
    references = [] if single else [path for path in paths if holds_reference(path)]
    people = [path for path in paths if path not in references] if references else []
    several = "several logs"
    if references:
        several = "a person beside a robot" if people else "several motions of a robot"
    _refuse_others(arguments, "a log" if single else several)
    labels = arguments.label
    if labels is not None and len(labels) != len(paths):
        raise UsageError(
            f"--label: given {len(labels)} times for {len(paths)} files; give it once "
            "for each, or not at all"
        )
    default = paths[0].with_name("playback.html") if single else OUT / "compare.html"
    out = arguments.out or default
    check_file(out)
    labels = labels or _file_labels(paths)
    if references:
        of_all = list(zip(paths, labels, strict=True))
        of_all.sort(key=lambda each: each[0] in people)
        labels = [each for _, each in of_all]
        _show_references(arguments, references, people, labels, out)
    else:
        logs = [SimulationLog.load(path) for path in paths]
        robot, overlay = arguments.robot or "", arguments.overlay
        tell_drawn(record_logs(logs, out, labels=labels, overlay=overlay, robot=robot))
    print(out)


def _show_references(
    arguments: argparse.Namespace,
    references: list[Path],
    people: list[Path],
    labels: list[str],
    out: Path,
) -> None:
    """Motions of a robot, and the person who moved so, whose label is the last."""
    from crar_drake.motion.catalogue import load_performer
    from crar_drake.results import LOG
    from crar_drake.results.log import is_log
    from crar_drake.results.motion_page import compare_files

    no_person = [path for path in people if path.name == LOG or is_log(path)]
    if no_person or len(people) > 1:
        raise UsageError(
            f"{(no_person or people[1:])[0]} is no reference motion, and "
            f"{references[0]} is one: compare runs, or reference motions beside one "
            "person"
        )
    if not arguments.robot:
        raise UsageError("say which robot the motions are of: --robot ROBOT")
    from crar_drake.robot.description import whole_body_name

    person = None
    if people:
        person = load_performer(str(people[0]), given_motion_options(arguments))
    compare_files(
        references,
        out,
        whole_body_name(arguments.robot),
        labels=labels,
        layout=arguments.layout,
        rate=None if people else arguments.frame_rate,
        clip=arguments.clip,
        meshes=not arguments.no_meshes,
        overlay=arguments.overlay,
        person=person,
    )


def _file_labels(paths: list[Path]) -> list[str]:
    """What files are called: by their names, else by their folders, else by number."""
    for labels in (
        [path.name for path in paths],
        [path.absolute().parent.name for path in paths],
    ):
        if len(set(labels)) == len(labels):
            return labels
    return [f"{path.name} {i + 1}" for i, path in enumerate(paths)]
