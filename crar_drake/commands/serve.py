"""`crar-drake serve`: a filter for teleoperation."""

import argparse
import math
import os
import select
import sys
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

from crar_drake.addresses import in_words
from crar_drake.commands.options import (
    add_command,
    add_robot_and_tasks,
    add_served,
    positive,
)
from crar_drake.errors import CrarError
from crar_drake.teleoperation.gate import Gate

_SCENARIO = "dance_wrists"
_PORT = 7670
_MEASURED = "measured"
_STDERR = 2  # the descriptor


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "serve",
        run,
        "Take targets of hands and other points over UDP, and answer with "
        "joint positions and torques that keep the robot from running into itself. "
        "docs/guides/teleoperation.md has the messages.",
    )
    parser.add_argument(
        "scenario",
        nargs="?",
        default=_SCENARIO,
        help="a scenario whose robot, tasks and gains count; its motion is not used, "
        "and the constraints are always lookahead (default: %(default)s)",
    )
    add_robot_and_tasks(parser)
    parser.add_argument(
        "--joints",
        action="store_true",
        help="targets are positions of joints, of a policy or a planner, instead of "
        "places of hands; the scenario's robot alone counts then",
    )
    parser.add_argument(
        "--rate",
        type=positive,
        default=200.0,
        metavar="HZ",
        help="commands per second (default: %(default)g)",
    )
    for bound in fields(Gate):
        parser.add_argument(
            f"--{bound.name.replace('_', '-')}",
            type=positive,
            default=bound.default,
            metavar=bound.metadata["unit"],
            help=f"{bound.metadata['help']} (default: %(default)g)",
        )
    parser.add_argument(
        "--start",
        type=Path,
        metavar="FILE",
        help="where the robot begins, as JSON of joint to position [rad or m]; "
        f"{_MEASURED}: where it says it is (default: in its rest posture)",
    )
    parser.add_argument(
        "--latency",
        type=positive,
        default=0.0,
        metavar="S",
        help="how old measured positions are when they come (default: %(default)g)",
    )
    parser.add_argument(
        "--tracking-error",
        type=positive,
        default=math.inf,
        metavar="RAD",
        help="brake where a joint of the robot is farther than this from what it was "
        "told, or the robot is not heard for --timeout (default: never)",
    )
    add_served(parser, _PORT, "UDP", "can send", "seconds")


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.interrupts import held_interrupts
    from crar_drake.law.compilation import when_compiling
    from crar_drake.teleoperation.serving import make_server

    measured = arguments.start == Path(_MEASURED)
    start = None if measured else _read_start(arguments.start)
    with when_compiling(tell_at_once):
        server = make_server(
            arguments.scenario,
            start=start,
            start_measured=measured,
            latency=arguments.latency,
            tracking_error=arguments.tracking_error,
            robot=arguments.robot or "",
            experiment=arguments.tasks or "",
            joints=arguments.joints,
            rate=arguments.rate,
            gate=Gate(
                **{each.name: getattr(arguments, each.name) for each in fields(Gate)}
            ),
            host=arguments.host,
            port=arguments.port,
        )
    model = server.motion.model
    tasks = ", ".join(server.motion.layout.names)
    print(f"{model.description.name}: UDP at {in_words(*server.address)}", flush=True)
    before = "the robot to say where it is, then for " if measured else ""
    print(f"waits for {before}targets of {tasks}; Ctrl-C ends it", flush=True)
    with held_interrupts() as interrupts:
        try:
            server.run(
                arguments.duration, tell=tell_at_once, asked=lambda: interrupts.asked
            )
        except KeyboardInterrupt:  # a second one: at once
            print("crar-drake: ended in motion", file=sys.stderr)
            raise
        finally:
            server.close()
    print("\n".join(server.statistics.lines()))


def _read_start(path: Path | None) -> dict[str, float] | None:
    """Joint to position, of --start."""
    if path is None:
        return None
    from crar_drake.strict_json import MessageError, read_object
    from crar_drake.teleoperation.messages import joint_positions

    try:
        return joint_positions(read_object(path.read_bytes()))
    except (OSError, MessageError) as error:
        raise CrarError(f"--start: {path}: {error}") from error


def tell_at_once(line: str) -> None:
    """Writes a line to stderr, or drops it where that would wait for a reader."""
    with suppress(OSError):
        if select.select([], [_STDERR], [], 0.0)[1]:
            # Not through sys.stderr, whose lock may be held.
            os.write(_STDERR, f"{line}\n".encode())
