"""`crar-drake serve`: a filter for teleoperation."""

import argparse
import json
import math
import os
import queue
import sys
import threading
from pathlib import Path

from crar_drake.commands.options import (
    EXPERIMENT_HELP,
    EXPERIMENTS,
    add_command,
    positive,
)
from crar_drake.errors import CrarError

_SCENARIO = "dance_wrists"
_PORT = 7670
_MEASURED = "measured"
_STDERR = 2  # the descriptor

# As crar_drake.teleoperation.target_stream.Gate has them, which takes long to import; a
# test compares them.
GATE = {
    "speed": ("M/S", 1.5, "targets that are faster are approached at it"),
    "angular_speed": ("RAD/S", 6.0, "the same of orientations"),
    "joint_speed": (
        "RAD/S",
        3.0,
        "tasks that are joints count as clamped if they are faster, and pass as they "
        "are: the robot's own speed limits slow them down",
    ),
    "distance": ("M", 1.0, "targets farther from the robot's point are rejected"),
    "timeout": ("S", 0.25, "without targets for so long the robot brakes"),
}


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
    parser.add_argument(
        "--robot", metavar="ROBOT", help="another robot than the scenario's"
    )
    parser.add_argument("--experiment", choices=EXPERIMENTS, help=EXPERIMENT_HELP)
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
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to listen at; by default this computer alone can send. Whoever "
        "reaches another address moves the robot: nobody is asked who they are",
    )
    parser.add_argument(
        "--port",
        type=int,
        default=_PORT,
        help="of UDP; 0 takes a free one (default: %(default)s)",
    )
    for name, (unit, default, text) in GATE.items():
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            type=positive,
            default=default,
            metavar=unit,
            help=f"{text} (default: %(default)g)",
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
    parser.add_argument(
        "--duration", type=positive, metavar="S", help="end after S seconds"
    )


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.law.compilation import when_compiling
    from crar_drake.run import ctrl_c
    from crar_drake.teleoperation.serving import make_server
    from crar_drake.teleoperation.target_stream import Gate

    measured = arguments.start == Path(_MEASURED)
    start = None if measured else _read_start(arguments.start)
    reported = NeverWaiting()
    with when_compiling(reported.write):
        server = make_server(
            arguments.scenario,
            start=start,
            start_measured=measured,
            latency=arguments.latency,
            tracking_error=arguments.tracking_error,
            robot=arguments.robot or "",
            experiment=arguments.experiment or "",
            joints=arguments.joints,
            rate=arguments.rate,
            gate=Gate(**{name: getattr(arguments, name) for name in GATE}),
            host=arguments.host,
            port=arguments.port,
        )
    host, port = server.address
    host = f"[{host}]" if ":" in host else host
    model = server.motion.model
    tasks = ", ".join(server.motion.layout.names)
    print(f"{model.description.name}: UDP at {host}:{port}", flush=True)
    before = "the robot to say where it is, then for " if measured else ""
    print(f"waits for {before}targets of {tasks}; Ctrl-C ends it", flush=True)
    with ctrl_c() as interrupts:
        try:
            server.run(
                arguments.duration,
                tell=lambda done: reported.write(done.lines()[3]),
                asked=lambda: interrupts.asked,
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
    try:
        start = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise CrarError(f"--start: {path}: {error}") from error
    numbers = isinstance(start, dict) and all(
        isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)
        for x in start.values()
    )
    if not numbers:
        raise CrarError(f'--start: {path}: give {{"joint": position, ...}}')
    return start


class NeverWaiting:
    """Writes lines to stderr, where perhaps nobody reads any more.

    A thread does it, which may wait as long as it likes: meanwhile lines are dropped.
    """

    def __init__(self) -> None:
        self._lines: queue.Queue[str] = queue.Queue(maxsize=1)
        threading.Thread(target=self._run, daemon=True).start()

    def write(self, line: str) -> None:
        """Hands a line over, or drops it."""
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            pass

    def _run(self) -> None:
        try:
            while True:
                # Not through sys.stderr, whose lock would be held while this waits.
                os.write(_STDERR, f"{self._lines.get()}\n".encode())
        except OSError:  # nobody is there: what comes fills the queue, and is dropped
            pass
