"""`crar-drake play`: a scenario live in a browser."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.options import (
    CONSTRAINTS,
    add_command,
    add_scenario,
    chosen_scenario,
    override_motion,
    positive,
)
from crar_drake.commands.output import OUT, label, tell_failure
from crar_drake.errors import CrarError

if TYPE_CHECKING:
    from crar_drake.play.session import PlaySession
    from crar_drake.run import Interrupts
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
        "it moves. Ctrl-C ends it and keeps a recording.",
    )
    add_scenario(parser)
    parser.add_argument(
        "--constraints",
        choices=CONSTRAINTS,
        default="lookahead",
        help="instead of the scenario's (default: %(default)s); with the others "
        "nothing is guaranteed",
    )
    parser.add_argument(
        "--period",
        type=positive,
        default=_PERIOD,
        metavar="S",
        help="control period instead of the scenario's: a longer one asks less of the "
        "computer (default: %(default)g)",
    )
    parser.add_argument(
        "--speed",
        type=positive,
        default=1.0,
        metavar="X",
        help="simulated seconds in a real one, as wished (default: %(default)g)",
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address of the page; by default this computer alone has it. Whoever "
        "reaches another address moves the robot: nobody is asked who they are",
    )
    parser.add_argument(
        "--port",
        type=int,
        default=_PORT,
        help="of the page; 0 takes a free one (default: %(default)s)",
    )
    parser.add_argument(
        "--no-browser", action="store_true", help="print the URL, open no browser"
    )
    parser.add_argument(
        "--save",
        type=Path,
        metavar="FOLDER",
        help="keep recording.html, log.npz, summary.json and plot.png there, unasked "
        "(default: out/NAME_play, asked for on a terminal)",
    )
    parser.add_argument(
        "--duration", type=positive, metavar="S", help="end after S simulated seconds"
    )


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    scenario = chosen_scenario(arguments.scenario)
    _override(scenario, arguments)
    name = label(arguments.scenario)
    out = arguments.save or OUT / name.with_name(f"{name.name}_play")

    from crar_drake.files import check_file
    from crar_drake.play.session import PlaySession
    from crar_drake.results import LOG
    from crar_drake.run import ctrl_c

    if arguments.save:
        check_file(out / LOG)
    session = PlaySession(
        scenario,
        host=arguments.host,
        port=arguments.port,
        speed=arguments.speed,
        tell=lambda text: print(text, file=sys.stderr),
    )
    with ctrl_c() as interrupts:
        try:
            print(f"{session.url}  (Ctrl-C ends it)", flush=True)
            if not arguments.no_browser:
                _open(session.url)
            try:
                session.run(interrupts, arguments.duration)
            except KeyboardInterrupt:  # a second one, which does not wait for a step
                pass
            interrupts.ignore()
            _finish(session, out, arguments, interrupts)
        except BaseException as error:
            session.end("the simulation has ended")
            _close(session, error)
            raise
    _close(session)


def _close(session: PlaySession, error: BaseException | None = None) -> None:
    """Ends Meshcat; and the process here, where it could not end as usual."""
    if session.close():
        return
    code = 0 if error is None else tell_failure(error)
    sys.stdout.flush()
    os._exit(code)


def _override(scenario: Scenario, arguments: argparse.Namespace) -> None:
    from crar_drake.law.parameters import with_constraints

    override_motion(scenario, arguments)
    scenario.controller = with_constraints(scenario.controller, arguments.constraints)
    scenario.controller.period = arguments.period
    scenario.validate()


def _open(url: str) -> None:
    import webbrowser

    if not webbrowser.open(url):
        print("no browser could be opened: open the address by hand", file=sys.stderr)


def _finish(
    session: PlaySession,
    out: Path,
    arguments: argparse.Namespace,
    interrupts: Interrupts,
) -> None:
    """Keeps what was recorded, and says so on the page and on the terminal."""
    from rich.console import Console

    from crar_drake.play.saving import save_session
    from crar_drake.results.summary_table import summary_table

    live, wanted, record = session.live, True, True
    interrupts.hold = False
    try:
        asks = arguments.save is None and sys.stdin.isatty()
        _tell_end(session, out, asks)
        wanted = _ask(out) if asks else True
    except KeyboardInterrupt:  # in a hurry, but nothing is lost
        print()
        record = False
    interrupts.ignore()  # until files are written
    session.end()  # if that was what it disturbed
    if not wanted:
        print("nothing is kept")
        return
    result, missing = save_session(
        live, out, interrupts, record=record, failure=session.failure
    )
    Console().print(summary_table(result.summary))
    for path in result.files:
        print(path)
    if not record or any(isinstance(why, KeyboardInterrupt) for why in missing):
        raise KeyboardInterrupt(_kept(result.files, out))
    if missing:
        raise missing[0]
    if session.failure is not None:
        raise CrarError(
            f"the simulation stopped at {live.time:.3f} s: {session.failure}; {out} "
            "holds what was simulated till then"
        )


def _tell_end(session: PlaySession, out: Path, asks: bool) -> None:
    live, pacer = session.live, session.pacer
    where = "the terminal asks whether to keep it" if asks else f"it is kept in {out}"
    session.end(f"ended after {live.time:.1f} s; {where}")
    print(
        f"{live.time:.1f} s simulated, {pacer.behind:.1f} s behind the clock; "
        f"{live.reported()}"
    )
    if session.failure is not None:
        print(f"stopped: {session.failure}", file=sys.stderr)


def _ask(out: Path) -> bool:
    """Whether to keep anything."""
    try:
        answer = input(f"keep the recording in {out}? [Y/n] ")
    except EOFError:
        return True
    return answer.strip().lower() not in ("n", "no")


def _kept(files: list[Path], out: Path) -> str:
    names = [path.name for path in files]
    if "log.npz" not in names:
        return f"nothing was written to {out}"
    reported = f"{out} holds {', '.join(names)}"
    if "recording.html" not in names:
        reported += f"; crar-drake playback {out / 'log.npz'} makes a page"
    return reported
