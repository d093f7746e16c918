"""`crar-drake run`: a scenario, simulated and kept."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.folders import progress_bar
from crar_drake.commands.options import (
    FILE_OPTIONS,
    add_command,
    add_motion_options,
    add_scenario,
    changed_scenario,
    chosen_scenario,
    positive,
)
from crar_drake.commands.output import (
    FAST,
    OUT,
    counted,
    final_line,
    label,
    tell_run,
)
from crar_drake.errors import ScenarioError

if TYPE_CHECKING:
    from crar_drake.results.summary import Summary
    from crar_drake.run import RunResult
    from crar_drake.simulation.scenario import Scenario


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "run",
        run,
        "Simulate a scenario; write a recording, a log, a summary and a plot. The last "
        "line is OK, or VIOLATED and what, and the exit code then 1.",
    )
    add_scenario(parser)
    add_motion_options(parser)
    parser.add_argument(
        "--duration",
        type=positive,
        metavar="S",
        help="simulate S seconds (default: the whole motion)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for recording.html, log.npz, summary.json and plot.png "
        "(default: out/NAME, where NAME says what was run)",
    )
    parser.add_argument(
        "--no-page", action="store_true", help="do not make recording.html"
    )


def run(arguments: argparse.Namespace) -> int:
    """Does what the arguments say.

    Returns:
        The exit code: 1 if a sample penetrates or is beyond a limit, else 0.
    """
    scenario = _scenario(arguments)
    out = arguments.out or OUT / _out_name(arguments)

    from crar_drake.run import RunFailed, RunInterrupted, run_scenario

    def show_bad(result: RunResult) -> None:
        for line in result.summary.remarks:
            print(f"BAD: {line}")

    try:
        with progress_bar() as bar:
            task = bar.add_task("", total=None)

            def show(time: float, duration: float, factor: float) -> None:
                what = f"s, {factor:.2f} x real time"
                bar.update(task, completed=time, total=duration, description=what)

            result = run_scenario(
                scenario,
                out,
                record=not arguments.no_page,
                progress=show,
                tell=lambda line: print(line, file=sys.stderr),
            )
    except (RunFailed, RunInterrupted) as stopped:
        tell_run(stopped.result, arguments.verbose)
        show_bad(stopped.result)
        raise
    tell_run(result, arguments.verbose)
    summary = result.summary
    if summary.stance is not None:
        print(summary.stance.line())
    show_bad(result)
    return final_line(
        [
            *counted(summary.penetrating_samples, "sample", "penetrate{s}"),
            *counted(summary.beyond_limit_samples, "sample", "beyond a joint limit"),
            *counted(summary.beyond_speed_samples, "sample", "beyond a speed limit"),
            *counted(summary.fast_contacts, "contact", FAST),
            *_fallen(summary),
        ],
        len(summary.remarks),
    )


def _fallen(summary: Summary) -> list[str]:
    """The violation of a robot that stood by itself, and fell."""
    stood = summary.stance
    if stood is None or stood.fell is None:
        return []
    return [f"the robot fell at {stood.fell:.2f} s"]


def _scenario(arguments: argparse.Namespace) -> Scenario:
    """What is simulated, by the scenario and the options."""
    scenario = changed_scenario(chosen_scenario(arguments.scenario), arguments)
    for name in FILE_OPTIONS:
        value = getattr(arguments, name)
        if value is None:
            continue
        if scenario.keyframes and name != "frame_rate":  # of which `validate` tells
            raise ScenarioError(
                f"--{name}: {arguments.scenario} follows keyframes, not a motion"
            )
        setattr(scenario, name, value)
    if arguments.duration is not None:
        scenario.duration = arguments.duration
    scenario.validate()
    return scenario


def _out_name(arguments: argparse.Namespace) -> Path:
    """The folder says what was run, so that variants do not replace each other: by the
    scenario, and by what options put into it."""
    from crar_drake.results.summary import robot_name

    files = [label(each) for each in (arguments.scenario, arguments.motion) if each]
    settings = [setting.partition("=") for setting in arguments.set]
    parts = [
        *(each.name for each in files),
        robot_name(arguments.robot or ""),
        arguments.tasks,
        *(
            re.sub(r"[^\w.-]+", "_", f"{key.removeprefix('controller.')}-{value[:20]}")
            for key, _, value in settings
        ),
    ]
    name = "_".join(filter(None, parts))
    return Path(*(each.parent for each in files)) / name
