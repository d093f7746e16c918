"""`crar-drake play`: a scenario live in a browser."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.options import (
    add_command,
    add_scenario,
    add_served,
    changed_scenario,
    chosen_scenario,
    positive,
)
from crar_drake.commands.output import OUT, label, tell_failure, tell_run

if TYPE_CHECKING:
    from crar_drake.play.session import PlaySession
    from crar_drake.simulation.scenario import Scenario

_PORT = 7680
_PERIOD = 5e-3  # [s]


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "play",
        run,
        "Simulate a scenario live in a browser: drag targets and push the robot while "
        "it moves. Ctrl-C ends it and keeps a recording. Constraints are lookahead and "
        f"the control period is {1e3 * _PERIOD:g} ms, whatever the scenario says, "
        "unless --set says otherwise.",
    )
    add_scenario(parser)
    parser.add_argument(
        "--speed",
        type=positive,
        default=1.0,
        metavar="X",
        help="simulated seconds in a real one, as wished (default: %(default)g)",
    )
    parser.add_argument(
        "--no-browser", action="store_true", help="print the URL, open no browser"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for recording.html, log.npz, summary.json and plot.png "
        "(default: out/NAME_play)",
    )
    add_served(parser, _PORT, "the page", "has it", "simulated seconds")


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    scenario = _scenario(arguments)
    name = label(arguments.scenario)
    out = arguments.out or OUT / name.with_name(f"{name.name}_play")

    from crar_drake.files import check_file
    from crar_drake.interrupts import held_interrupts
    from crar_drake.play.session import PlaySession
    from crar_drake.results import LOG
    from crar_drake.run import RunFailed, RunInterrupted

    check_file(out / LOG)
    session = PlaySession(
        scenario,
        host=arguments.host,
        port=arguments.port,
        speed=arguments.speed,
        tell=lambda text: print(text, file=sys.stderr),
    )
    try:
        with held_interrupts() as interrupts:
            print(f"{session.url}  (Ctrl-C ends it)", flush=True)
            if not arguments.no_browser:
                _open(session.url)
            session.run(interrupts, arguments.duration)
            result = session.save(out, interrupts)
        tell_run(result)
    except BaseException as error:
        if isinstance(error, RunFailed | RunInterrupted):
            tell_run(error.result)
        _close(session, error)
        raise
    _close(session)


def _close(session: PlaySession, error: BaseException | None = None) -> None:
    """Ends Meshcat; and the process here, where it could not end as usual."""
    live, pacer = session.live, session.pacer
    print(f"{live.time:.1f} s simulated, {pacer.behind:.1f} s behind the clock")
    if session.close():
        return
    code = 0 if error is None else tell_failure(error)
    sys.stdout.flush()
    os._exit(code)


def _scenario(arguments: argparse.Namespace) -> Scenario:
    """What is simulated, by the scenario and the options."""
    from crar_drake.law.parameters import with_constraints

    scenario = chosen_scenario(arguments.scenario)
    scenario.controller = with_constraints(scenario.controller, "lookahead")
    scenario.controller.period = _PERIOD
    scenario = changed_scenario(scenario, arguments)
    scenario.validate()
    return scenario


def _open(url: str) -> None:
    import webbrowser

    if not webbrowser.open(url):
        print("no browser could be opened: open the address by hand", file=sys.stderr)
