"""The command `crar-drake`.

What takes long to import is imported by the command that needs it, so that help and
mistyped options answer at once.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from crar_drake import __version__
from crar_drake.drake_warnings import collected_warnings
from crar_drake.errors import CrarError, ScenarioError

if TYPE_CHECKING:
    from crar_drake.run import Progress
    from crar_drake.simulation.scenario import Scenario
    from crar_drake.studies.sweep import Case, Result

DEFAULT_SCENARIO = "dance"
OUT = Path("out")

# The same as in crar_drake.robot.task and crar_drake.control.parameters, which take
# long to import; a test compares them.
EXPERIMENTS = ("wrists", "upper-body")
LEVELS = ("velocity", "acceleration")
CONSTRAINTS = ("none", "paper", "lookahead")


# What several commands say of the same options.
_MOTION = (
    "a built-in one (dance), a CMU recording (cmu:05_02), or a path (some/path.amc)"
)
_SKELETON = "the motion's skeleton (.asf), if it is not beside the motion"
_EXPERIMENT = "which points follow the motion: two wrists, or seven of the upper body"
_LEVEL = (
    "how accelerations are computed: velocity (as the change of wanted velocities) or "
    "acceleration (directly)"
)
_CONSTRAINTS = (
    "what keeps the robot from collisions and joint limits: none (nothing), paper (as "
    "in the paper), lookahead (acts where the robot would come to rest)"
)


class UsageError(CrarError):
    """The command line itself is wrong."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: the arguments; by default those of the process.

    Returns:
        0; 2 if something the user gave is wrong, which is then on stderr; 130 if
        interrupted.
    """
    # Nothing here opens a window. A backend that is not there would fail importing.
    os.environ["MPLBACKEND"] = "agg"
    try:
        arguments = _parse(argv)
        with collected_warnings(verbose=arguments.verbose):
            arguments.command(arguments)
        sys.stdout.flush()
    except CrarError as error:
        print(f"crar-drake: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stopped:
        about = f" {stopped}" if str(stopped) else ""
        print(f"crar-drake: interrupted{about}", file=sys.stderr)
        return 130
    except BrokenPipeError:  # of `crar-drake list | head`
        _drop_output()
    except OSError as error:  # a full disk, a file that may not be read
        where = f"{error.filename}: " if error.filename else ""
        print(f"crar-drake: error: {where}{error.strerror or error}", file=sys.stderr)
        _drop_output()
        return 2
    return 0


def _drop_output() -> None:
    """Python flushes stdout once more when it exits, where a failure is not caught."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


# --- the commands -----------------------------------------------------------------


def _run(arguments: argparse.Namespace) -> None:
    from crar_drake.simulation.scenario import load_scenario

    scenario = load_scenario(arguments.scenario)
    _override(scenario, arguments)
    out = arguments.out or OUT / _out_name(scenario, arguments)

    from rich.console import Console

    from crar_drake.results.summary import summary_table
    from crar_drake.run import RunFailed, RunInterrupted, RunResult, run_scenario

    def show(result: RunResult) -> None:
        Console().print(summary_table(result.summary))
        for line in result.summary.warnings:
            print(f"warning: {line}")
        for path in result.files:
            print(path)

    try:
        with _progress_bar() as progress:
            result = run_scenario(
                scenario,
                out,
                record=not arguments.no_recording,
                progress=progress,
                tell=print,
            )
    except (RunFailed, RunInterrupted) as stopped:
        show(stopped.result)
        raise
    show(result)


def _motion(arguments: argparse.Namespace) -> None:
    from crar_drake.figures import check_picture
    from crar_drake.motion.catalogue import load_clip
    from crar_drake.motion.report import describe, inspect, plot_motion

    plot = arguments.plot or OUT / f"{_motion_label(arguments.motion)}.png"
    if arguments.plot is not None:
        check_picture(plot)
    clip = load_clip(
        arguments.motion, arguments.skeleton, frame_rate=arguments.frame_rate
    )
    report = inspect(clip)
    for line in describe(report):
        print(line)
    if report.obstacle and arguments.plot is None:
        return
    plot_motion(clip, plot)
    print(plot)


def _list(arguments: argparse.Namespace) -> None:
    from crar_drake.motion.catalogue import available_trials, builtin_names, load_clip
    from crar_drake.resources import data_folder
    from crar_drake.robot.description import import_file, imported_names, robot_names
    from crar_drake.simulation.scenario import load_scenario, scenario_names

    def duration(motion: str) -> str:
        clip = load_clip(motion)
        return f"{clip.duration:.1f} s at {clip.frame_rate:g} Hz"

    def about(robot: str) -> str:
        """What follows the name in the first line of the robot's README."""
        readme = data_folder("models") / robot / "README.md"
        if not readme.is_file():
            return ""
        with readme.open(encoding="utf-8") as lines:
            return lines.readline().partition(":")[2].strip()

    imported = imported_names()
    robots = {name: "imported" for name in imported}
    robots |= {name: about(name) for name in robot_names()}
    for name in robot_names():
        if import_file(name) is not None and name not in imported:
            robots[name] += f"; first: crar-drake import-robot {name}"
    motions = {name: duration(name) for name in builtin_names()}
    motions |= {files.name: str(files.amc) for files in available_trials()}
    scenarios = {name: load_scenario(name).description for name in scenario_names()}
    for title, entries in (
        ("Robots, which a scenario names (crar-drake import-robot adds more)", robots),
        ("Motions, for run --motion (crar-drake fetch adds more)", motions),
        ("Scenarios, for crar-drake run", scenarios),
    ):
        print(title)
        for name, text in entries.items():
            print(f"  {name:<22}{text}".rstrip())


def _fetch(arguments: argparse.Namespace) -> None:
    from crar_drake.motion.catalogue import trial_id
    from crar_drake.motion.fetch import LICENCE_NOTICE, fetch, rich_progress

    trials = [trial_id(text) for text in arguments.trials]
    print(LICENCE_NOTICE)
    for trial in trials:
        with rich_progress() as progress:
            files = fetch(trial, progress=progress, force=arguments.force)
        print(files.asf)
        print(files.amc)


def _import_robot(arguments: argparse.Namespace) -> None:
    from crar_drake.files import whole_file
    from crar_drake.resources import imported_robots_folder
    from crar_drake.robot.description import IMPORT_FILE, import_file
    from crar_drake.robot_import import check_installed, import_robot, load_choices
    from crar_drake.robot_import.source_urdf import find_urdf

    # What is missing is told before a file is written.
    check_installed()
    given = arguments.robot
    robot, out = given, arguments.out
    shipped = import_file(given)
    if shipped is not None:
        robot = ""
        find_urdf(load_choices(shipped).source)
        out = out or imported_robots_folder() / given
        kept = arguments.out is not None and (out / IMPORT_FILE).is_file()
        if not kept:
            with whole_file(out / IMPORT_FILE) as temporary:
                temporary.write_bytes(shipped.read_bytes())
    elif (Path(given) / IMPORT_FILE).is_file():
        robot, out = "", out or Path(given)
    elif out is None:
        out = imported_robots_folder() / Path(given).stem
    with _import_bar() as progress:
        report = import_robot(
            robot,
            out,
            package_paths=tuple(arguments.package_path or ()),
            progress=progress,
        )
    for line in report.lines():
        print(line)
    print()
    for name in (IMPORT_FILE, "robot.yaml", "robot.urdf", "picture.png", "report.txt"):
        print(out / name)


@contextmanager
def _import_bar() -> Iterator[Callable[[str, float], None]]:
    """Yields a callback that draws how far an import is, on stderr."""
    from rich import progress
    from rich.console import Console

    columns = (
        progress.BarColumn(bar_width=20),
        progress.TextColumn("{task.description}"),
    )
    bar = progress.Progress(*columns, console=Console(stderr=True), transient=True)

    def show(what: str, share: float) -> None:
        if not bar.tasks:
            bar.add_task(what, total=1.0)
        if share > 0.0:  # a robot that is refused shows no bar
            bar.start()
        bar.update(bar.task_ids[0], completed=share, description=what)

    try:
        yield show
    finally:
        if bar.live.is_started:
            bar.stop()


def _judge(arguments: argparse.Namespace) -> None:
    from crar_drake.results.hull_judge import HullJudge, has_hulls
    from crar_drake.results.log import SimulationLog
    from crar_drake.results.logged_robot import check_logged_robot, load_logged_robot
    from crar_drake.results.referee import Referee
    from crar_drake.robot.model import ControlModel
    from crar_drake.simulation.scenario import parse_scenario

    log = SimulationLog.load(arguments.log)
    scenario = parse_scenario(log.scenario, "the log's scenario")
    description = load_logged_robot(log, arguments.robot or "")
    model = ControlModel.FromDescription(description, scenario.task_list())
    check_logged_robot(log, model.plant, description)
    try:
        capsules = Referee(
            model.plant, model.scene_graph, description.pairs
        ).violations(log.q)
    except ValueError as error:
        raise CrarError(f"{arguments.log}: {error}") from error
    print(
        f"referee, collision shapes, {capsules.num_samples} samples: "
        f"{capsules.num_penetrating} in penetration, {capsules.num_beyond_limit} "
        f"beyond a joint limit, smallest distance "
        f"{1e3 * capsules.smallest_distance:.1f} mm"
        + _of_pair(capsules.smallest_distance_pair)
    )
    if not has_hulls(description):
        return
    steps = max(1, len(log.time) - 1)
    period = (log.time[-1] - log.time[0]) / steps or arguments.every
    every = max(1, round(arguments.every / period))
    hulls = HullJudge(description).judge(log.q[::every])
    print(
        f"convex hulls of the real meshes, {hulls.num_samples} samples: "
        f"{hulls.num_penetrating} in penetration, smallest distance "
        f"{1e3 * hulls.smallest_distance:.1f} mm"
        + _of_pair(hulls.smallest_distance_pair)
    )
    for a, b in hulls.left_out:
        print(f"left out, since their hulls overlap in the rest posture: {a} - {b}")


def _of_pair(pair: tuple[str, str] | None) -> str:
    return f" ({pair[0]} - {pair[1]})" if pair else ""


def _playback(arguments: argparse.Namespace) -> None:
    from crar_drake.files import check_file
    from crar_drake.results.log import SimulationLog
    from crar_drake.simulation.visualization import record_log

    log = SimulationLog.load(arguments.log)
    out = arguments.out or arguments.log.with_name("playback.html")
    check_file(out)
    for model in record_log(log, out, robot=arguments.robot or ""):
        print(
            f"warning: model {model} has no visual geometry: its collision shapes are "
            "drawn"
        )
    print(out)


def _sweep(arguments: argparse.Namespace) -> None:
    out: Path = arguments.out
    if out.suffix != ".csv" or out.is_dir():
        raise UsageError(f"--out: {out} must be a file that ends in .csv")

    from crar_drake.files import check_file
    from crar_drake.simulation.scenario import Scenario, load_scenario
    from crar_drake.studies.sweep import (
        find_motions,
        make_cases,
        read_results,
        run_sweep,
        settings_path,
    )

    if arguments.scenario is None:
        scenario = Scenario(motion="dance", experiment="wrists")
    else:
        scenario = load_scenario(arguments.scenario)
    if arguments.duration is not None:
        scenario.duration = arguments.duration
    scenario.frame_rate = arguments.frame_rate  # else it is of the scenario's motion
    controller = scenario.controller
    cases = make_cases(
        find_motions(arguments.paths),
        EXPERIMENTS if arguments.experiment == "both" else [arguments.experiment],
        arguments.constraints or [controller.constraints],
        arguments.level or [controller.level],
        arguments.period or [controller.period],
    )
    if not cases:
        raise UsageError(
            "constraints lookahead work on accelerations; use --level acceleration, "
            "or other --constraints"
        )
    _check_settings(scenario, cases)
    finished = {result.case for result in read_results(out) if not result.error}
    scenario.skeleton = ""  # it belongs to the scenario's motion
    for path in (out, settings_path(out), out.with_suffix(".png")):
        check_file(path)

    from rich.console import Console

    from crar_drake.studies.sweep_report import failures, plot_sweep, sweep_tables

    kept = len(finished.intersection(cases))
    try:
        with _sweep_bar(kept, len(cases)) as progress:
            results = run_sweep(
                cases, out, scenario=scenario, jobs=arguments.jobs, progress=progress
            )
    except KeyboardInterrupt:
        print(
            f"crar-drake: what is finished is in {out}; the same command continues",
            file=sys.stderr,
        )
        raise
    console = Console()
    for table in sweep_tables(results):
        console.print(table)
    for line in failures(results):
        print(f"failed: {line}", file=sys.stderr)
    plot = out.with_suffix(".png")
    plot_sweep(results, plot)
    print(out)
    print(plot)


def _reproduce(arguments: argparse.Namespace) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from crar_drake.files import check_folder
    from crar_drake.studies.section_iv.plan import MOTION_SETS, make_plan
    from crar_drake.studies.section_iv.report import report_path
    from crar_drake.studies.section_iv.reproduce import reproduce
    from crar_drake.studies.section_iv.simulate import finished
    from crar_drake.studies.sweep import find_motions

    chosen = arguments.motions or ["builtin"]
    motions = [m for name in chosen for m in MOTION_SETS.get(name, (name,))]
    found = find_motions(motions)
    labels = [_motion_label(name).replace(os.sep, "_") for name in chosen]
    out = arguments.out or OUT / "reproduce" / "-".join(labels)
    check_folder(out)
    plan = make_plan(found, duration=arguments.duration)

    try:
        with _sweep_bar(len(finished(plan, out)), len(plan.simulations)) as show:
            result = reproduce(
                plan,
                out,
                jobs=arguments.jobs,
                progress=lambda done, total, newest: show(done, total, newest.result),
            )
    except KeyboardInterrupt:
        print(
            f"crar-drake: what is finished is in {out}; the same command continues",
            file=sys.stderr,
        )
        raise
    table = Table(title="The paper's findings", title_justify="left")
    for column in ("paper", "finding", "here"):
        table.add_column(column)
    for finding in result.findings:
        style = "green" if finding.holds else "red"
        table.add_row(
            finding.source, finding.statement, Text(finding.verdict, style=style)
        )
    Console().print(table)
    print(report_path(out))


# --- what a run does --------------------------------------------------------------


def _override(scenario: Scenario, arguments: argparse.Namespace) -> None:
    """Puts the options in the place of what the scenario says."""
    if arguments.motion is not None:
        if scenario.keyframes:
            raise ScenarioError(
                f"--motion: {arguments.scenario} follows keyframes of its own; take a "
                "scenario with a motion, or change the file"
            )
        # The scenario's skeleton and rate belong to the scenario's motion.
        scenario.motion, scenario.skeleton = arguments.motion, ""
        scenario.frame_rate = None
    if arguments.skeleton is not None:
        if scenario.keyframes:
            raise ScenarioError(
                f"--skeleton: {arguments.scenario} follows keyframes, not a motion"
            )
        scenario.skeleton = arguments.skeleton
    if arguments.frame_rate is not None:
        scenario.frame_rate = arguments.frame_rate
    if arguments.experiment is not None:
        if scenario.tasks:
            raise ScenarioError(
                f"--experiment: {arguments.scenario} lists tasks of its own; take a "
                "scenario with an experiment, or change the file"
            )
        scenario.experiment = arguments.experiment
    if arguments.level is not None:
        scenario.controller.level = arguments.level
    if arguments.constraints is not None:
        scenario.controller.constraints = arguments.constraints
    if arguments.duration is not None:
        scenario.duration = arguments.duration
    scenario.validate()


def _out_name(scenario: Scenario, arguments: argparse.Namespace) -> Path:
    """The folder says what was run, so that variants do not replace each other.

    It is known before: shipped scenarios and motions, trials, and files in the
    working directory have their names; other files also that of their folder, see
    `_label`. A file of one's own, and a robot that is not the default, are named
    with the motion and the experiment that are put into them.
    """
    from crar_drake.simulation.scenario import scenario_names

    path = Path(arguments.scenario)
    shipped = path.parent.name in ("", "diagrams") and path.stem in scenario_names()
    name = Path(path.stem) if shipped else _label(path)
    parts = [name.name, arguments.level, arguments.constraints]
    if arguments.motion or (scenario.experiment and arguments.experiment):
        motion = _label(scenario.motion)
        parts[:1] = [motion.name, scenario.experiment]
        if not shipped or not scenario.experiment:
            parts[:0] = [name.name]
        elif scenario.robot != type(scenario)().robot:
            robot = Path(scenario.robot)  # a name, or a robot.yaml in its folder
            parts[:0] = [robot.parent.name if robot.suffix else robot.name]
        name = motion if shipped else name.parent / motion
    return name.with_name("_".join(filter(None, parts)))


def _label(path: str | Path) -> Path:
    """A relative path without suffix that tells files of one name apart.

    Names that are no paths, and files in the working directory, are themselves;
    files below it keep their folders. Of others the folder's name is kept, with
    some digits that stand for the whole of its path.
    """
    path = Path(str(path).removeprefix("cmu:"))
    folder = path.absolute().parent.resolve()
    try:
        folder = folder.relative_to(Path.cwd().resolve())
    except ValueError:
        digits = hashlib.sha256(os.fsencode(folder)).hexdigest()[:6]
        folder = Path(f"{folder.name or 'root'}-{digits}")
    return folder / path.stem


def _motion_label(motion: str) -> str:
    return str(_label(motion))


@contextmanager
def _progress_bar() -> Iterator[Progress]:
    """Yields a callback that draws how far the simulation is, on stderr."""
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("simulating"),
        progress.BarColumn(),
        progress.TextColumn("{task.completed:.1f} s of {task.fields[of]:.1f} s"),
        progress.TextColumn("{task.fields[factor]:.2f} x real time"),
        progress.TimeRemainingColumn(),
    )
    bar = progress.Progress(*columns, console=Console(stderr=True))

    def show(time: float, duration: float, factor: float) -> None:
        if not bar.tasks:  # a run that cannot begin shows no bar
            bar.start()
            bar.add_task("", of=duration, factor=factor)
        task = bar.task_ids[0]
        bar.update(task, completed=time, total=duration, factor=factor)

    try:
        yield show
    finally:
        if bar.tasks:
            bar.stop()


# --- what a sweep does ------------------------------------------------------------


def _check_settings(scenario: Scenario, cases: Iterable[Case]) -> None:
    """A wrong setting is told before hours of simulation, not by every case."""
    for constraints, level, period in {
        (case.constraints, case.level, case.period) for case in cases
    }:
        controller = replace(
            scenario.controller, constraints=constraints, level=level, period=period
        )
        replace(scenario, controller=controller).validate()


@contextmanager
def _sweep_bar(
    finished: int, total: int
) -> Iterator[Callable[[int, int, Result], None]]:
    """Yields a callback that draws how far the sweep is, on stderr."""
    from rich import progress
    from rich.console import Console
    from rich.table import Column

    from crar_drake.studies.sweep_report import headline

    columns = (
        progress.BarColumn(bar_width=20),
        progress.MofNCompleteColumn(),
        progress.TextColumn("ETA"),
        progress.TimeRemainingColumn(table_column=Column(min_width=7)),
        progress.TextColumn(
            "{task.fields[newest]}",
            markup=False,
            table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis"),
        ),
    )
    # A case takes up to minutes, so that a short average would know no speed.
    with progress.Progress(
        *columns,
        console=Console(stderr=True),
        speed_estimate_period=3600.0,
        expand=True,
    ) as bar:
        task = bar.add_task("", total=total, completed=finished, newest="")

        def show(done: int, total: int, newest: Result) -> None:
            bar.update(task, completed=done, newest=headline(newest))

        yield show


# --- the arguments ----------------------------------------------------------------


class _Parser(argparse.ArgumentParser):
    """Raises instead of exiting, and knows what a mistyped word may have meant."""

    def __init__(self, **options) -> None:
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message} (see {self.prog} --help)")

    def _check_value(self, action: argparse.Action, value: object) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(
                action, f"{value!r} is unknown{_nearest(str(value), action.choices)}"
            )


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = _make_parser()
    arguments, unknown = parser.parse_known_args(argv)
    if unknown:
        chosen: _Parser = arguments.parser
        first = unknown[0]
        if first.startswith("-"):
            option = first.partition("=")[0]
            chosen.error(
                f"unknown option {option}"
                f"{_nearest(option, chosen._option_string_actions)}"
            )
        chosen.error(f"unexpected argument {first!r}")
    return arguments


def _make_parser() -> _Parser:
    parser = _Parser(
        prog="crar-drake",
        description="Make simulated robots follow motion-capture data without running "
        "into themselves or beyond their joint limits, by Constrained Resolved "
        "Acceleration Control.",
        epilog="Start with `crar-drake run`, which simulates a built-in dance, and "
        "`crar-drake list`. `crar-drake COMMAND --help` tells a command's options.",
    )
    parser.add_argument(
        "--version", action="version", version=f"crar-drake {__version__}"
    )
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True, parser_class=_Parser
    )

    def add(name: str, command: Callable, text: str) -> _Parser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(command=command, parser=sub)
        sub.add_argument(
            "--verbose",
            action="store_true",
            help="print all that Drake says, not one line for warnings of a kind",
        )
        return sub

    run = add(
        "run",
        _run,
        "Simulate a scenario; write a recording, a log, a summary and a plot.",
    )
    run.add_argument(
        "scenario",
        nargs="?",
        default=DEFAULT_SCENARIO,
        help="a YAML file that says what to simulate, or the name of a shipped one, "
        "see `crar-drake list` (default: %(default)s)",
    )
    run.add_argument(
        "--motion",
        metavar="MOTION",
        help=f"follow this motion instead of the scenario's: {_MOTION}",
    )
    run.add_argument("--skeleton", metavar="FILE", help=_SKELETON)
    frame_rate = {
        "type": _positive,
        "metavar": "HZ",
        "help": "frames per second of the motion (default: what its file states, else "
        "that of the CMU database)",
    }
    run.add_argument("--frame-rate", **frame_rate)
    run.add_argument("--experiment", choices=EXPERIMENTS, help=_EXPERIMENT)
    run.add_argument("--level", choices=LEVELS, help=_LEVEL)
    run.add_argument("--constraints", choices=CONSTRAINTS, help=_CONSTRAINTS)
    run.add_argument(
        "--duration",
        type=_positive,
        metavar="S",
        help="simulate S seconds (default: the whole motion)",
    )
    run.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for recording.html, log.npz, summary.json and plot.png "
        "(default: out/NAME, where NAME says what was run)",
    )
    run.add_argument(
        "--no-recording", action="store_true", help="do not make recording.html"
    )

    sweep = add(
        "sweep",
        _sweep,
        "Simulate many motions and count their violations. The same command "
        "continues a sweep that was stopped.",
    )
    sweep.add_argument(
        "paths",
        nargs="+",
        metavar="PATH",
        help=f"a folder with .amc files in it or below, or a motion: {_MOTION}",
    )
    sweep.add_argument(
        "--experiment",
        choices=(*EXPERIMENTS, "both"),
        default="both",
        help=f"{_EXPERIMENT} (default: %(default)s)",
    )
    for name, known, text in (
        ("constraints", CONSTRAINTS, _CONSTRAINTS),
        ("level", LEVELS, _LEVEL),
    ):
        sweep.add_argument(
            f"--{name}",
            type=_list_of(_one_of(known)),
            action="extend",
            metavar=f"{name[0].upper()}[,{name[0].upper()}...]",
            help=f"{text}; one or several (default: the scenario's)",
        )
    sweep.add_argument(
        "--period",
        type=_list_of(_positive),
        action="extend",
        metavar="S[,S...]",
        help="time between two computations of the torque [s], one or several "
        "(default: the scenario's)",
    )
    sweep.add_argument(
        "--duration",
        type=_positive,
        metavar="S",
        help="simulate S seconds of each motion (default: all of it)",
    )
    sweep.add_argument("--frame-rate", **frame_rate)
    sweep.add_argument(
        "--scenario",
        metavar="SCENARIO",
        help="a YAML file, or the name of a shipped scenario: everything else",
    )
    sweep.add_argument(
        "--jobs", type=_count, metavar="N", help="processes (default: one per core)"
    )
    sweep.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        default=OUT / "sweep" / "results.csv",
        help="table of the results; a .png (plot) and a .yaml (what they have in "
        "common) go beside it (default: %(default)s)",
    )

    reproduce = add(
        "reproduce",
        _reproduce,
        "Repeat the experiments of the paper's Section IV and write a report. The "
        "same command continues one that was stopped.",
    )
    reproduce.add_argument(
        "--motions",
        type=_list_of(str),
        action="extend",
        metavar="M[,M...]",
        help="builtin (the four built-in motions), cmu (the CMU recordings 05_02, "
        "13_29, 14_07 and 13_17), or names of motions, the first of them a dance "
        "(default: builtin)",
    )
    reproduce.add_argument(
        "--duration",
        type=_positive,
        metavar="S",
        help="simulate S seconds of each motion (default: all of it)",
    )
    reproduce.add_argument(
        "--jobs", type=_count, metavar="N", help="processes (default: one per core)"
    )
    reproduce.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for report.html and its files (default: out/reproduce/NAME, "
        "where NAME says which motions)",
    )

    motion = add(
        "motion",
        _motion,
        "Print what is in a motion and what looks bad, and plot it.",
    )
    motion.add_argument("motion", metavar="MOTION", help=_MOTION)
    motion.add_argument("--skeleton", metavar="FILE", help=_SKELETON)
    motion.add_argument("--frame-rate", **frame_rate)
    motion.add_argument(
        "--plot",
        type=Path,
        metavar="FILE",
        help="picture to write (default: out/MOTION.png)",
    )

    add("list", _list, "List the robots, motions and scenarios that are at hand.")

    fetch = add(
        "fetch",
        _fetch,
        "Download recordings of the CMU motion-capture database into the user's cache.",
    )
    fetch.add_argument(
        "trials",
        nargs="+",
        metavar="TRIAL",
        help="a recording's number in the database, such as 05_02",
    )
    fetch.add_argument(
        "--force", action="store_true", help="download it even if it is there already"
    )

    imported = add(
        "import-robot",
        _import_robot,
        "Make a robot that scenarios can name, from its URDF (docs/your-robot.md). "
        "Needs crar-drake[robots].",
    )
    imported.add_argument(
        "robot",
        metavar="ROBOT",
        help="a URDF file, g1, talos, the name of another robot of the package "
        "example-robot-data, or a folder that was imported before",
    )
    imported.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder to write (default: one in the user's cache, so that scenarios "
        "find the robot by its name)",
    )
    imported.add_argument(
        "--package-path",
        action="append",
        metavar="DIR",
        help="folder in which the packages of package:// addresses lie",
    )

    def add_robot(parser: _Parser) -> None:
        parser.add_argument(
            "--robot",
            metavar="ROBOT",
            help="name or folder of the log's robot, if it is not where it was when "
            "the log was made",
        )

    judge = add(
        "judge",
        _judge,
        "Count the collisions and passed joint limits of a saved log, independently "
        "of the controller; of imported robots also by the hulls of their meshes.",
    )
    judge.add_argument("log", type=Path, metavar="LOG", help="the log.npz of a run")
    add_robot(judge)
    judge.add_argument(
        "--every",
        type=_positive,
        default=0.02,
        metavar="S",
        help="look at the meshes' hulls every S seconds (default: %(default)s)",
    )

    playback = add(
        "playback",
        _playback,
        "Make a page to look at from a saved log, without simulating again.",
    )
    playback.add_argument("log", type=Path, metavar="LOG", help="the log.npz of a run")
    playback.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="page to write (default: playback.html beside the log)",
    )
    add_robot(playback)
    return parser


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive whole number")
    return int(text)


def _list_of(convert: Callable[[str], object]) -> Callable[[str], list]:
    """Converts what stands between commas."""
    return lambda text: [convert(part.strip()) for part in text.split(",")]


def _one_of(known: Sequence[str]) -> Callable[[str], str]:
    def convert(text: str) -> str:
        if text not in known:
            raise argparse.ArgumentTypeError(
                f"{text!r} is unknown{_nearest(text, known)}"
            )
        return text

    return convert


def _nearest(word: str, known: Iterable[str]) -> str:
    """The end of a message: the nearest word, or else all there are."""
    known = list(known)
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]}?" if close else f"; known: {', '.join(known)}"
