"""What the options of several commands have in common: parser, types, texts."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from crar_drake.errors import CrarError, ScenarioError, nearest

if TYPE_CHECKING:
    from crar_drake.motion.options import MotionOptions
    from crar_drake.simulation.scenario import Scenario

DEFAULT_SCENARIO = "dance"

# As in crar_drake.robot.task, which takes long to import; a test compares them.
EXPERIMENTS = ("wrists", "upper-body")

# What several commands say of a motion.
MOTION_HELP = (
    "a built-in one (dance), a CMU recording (cmu:05_02), or a file: .amc, .bvh, .c3d, "
    ".trc, .mvnx, .npz, .npy, .csv, .pkl"
)


class UsageError(CrarError):
    """The command line itself is wrong."""


class Parser(argparse.ArgumentParser):
    """Raises instead of exiting, and knows what a mistyped word may have meant."""

    def __init__(self, **options) -> None:
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message} (see {self.prog} --help)")

    def _get_value(self, action: argparse.Action, arg_string: str) -> object:
        # Of a variable of the shell that is not set; as a path the working directory.
        named = not action.option_strings and action.nargs != argparse.PARSER
        if not arg_string and (named or action.type is Path):
            raise argparse.ArgumentError(action, "it is empty")
        return super()._get_value(action, arg_string)

    def _check_value(self, action: argparse.Action, value: object) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(
                action, f"{value!r} is unknown{nearest(str(value), action.choices)}"
            )


# --- options that several commands have ------------------------------------------


def add_command(
    subparsers: argparse._SubParsersAction,
    name: str,
    run: Callable[[argparse.Namespace], None],
    text: str,
) -> Parser:
    """Adds a command that says what it does, and returns the parser of its options."""
    parser = subparsers.add_parser(name, help=text, description=text)
    add_what_runs(parser, run)
    return parser


def add_what_runs(parser: Parser, run: Callable[[argparse.Namespace], None]) -> None:
    """Adds what a parser's options are handed to, and --verbose."""
    parser.set_defaults(command=run, parser=parser)
    parser.add_argument(
        "--verbose",
        action="store_true",
        help="print all figures, and all that Drake says instead of one line for "
        "warnings of a kind",
    )


def add_robot_and_tasks(parser: Parser) -> None:
    """Adds --robot and --tasks, in the place of a scenario's."""
    parser.add_argument(
        "--robot",
        metavar="ROBOT",
        help="name or folder of a robot instead of the scenario's",
    )
    parser.add_argument(
        "--tasks",
        choices=EXPERIMENTS,
        help="which points follow the motion: two wrists, or seven of the upper body",
    )


def add_scenario(parser: Parser) -> None:
    """Adds what is simulated: a scenario, and options in the place of what it says, see
    `changed_scenario`."""
    parser.add_argument(
        "scenario",
        nargs="?",
        default=DEFAULT_SCENARIO,
        help="a YAML file that says what to simulate, or the name of a shipped one, "
        "see `crar-drake show` (default: %(default)s)",
    )
    add_robot_and_tasks(parser)
    parser.add_argument(
        "--motion",
        metavar="MOTION",
        help=f"follow this motion instead of the scenario's: {MOTION_HELP}",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change anything else of the scenario, once for each: "
        "controller.constraints=paper (or none: what keeps the robot from collisions "
        "and joint limits), controller.period=0.002; diagrams/README.md has the keys",
    )


def add_frame_rate(parser: Parser) -> None:
    """Adds --frame-rate, of a motion."""
    parser.add_argument(
        "--frame-rate",
        type=positive,
        metavar="HZ",
        help="frames per second of the motion (default: what its file states, else "
        "that of the CMU database)",
    )


def add_motion_options(parser: Parser) -> None:
    """Adds what is inferred of a person's motion, and may be wrong: `FILE_OPTIONS`."""
    parser.add_argument(
        "--skeleton",
        metavar="FILE",
        help="the motion's skeleton (.asf), if it is not beside the motion; of a "
        "motion of SMPL-H or SMPL-X the model's own NPZ",
    )
    add_frame_rate(parser)
    parser.add_argument(
        "--unit",
        metavar="UNIT",
        help="of the motion's lengths: m, cm, mm, in, cmu (the CMU database's), or a "
        "number of metres (default: so that its performer has a person's height)",
    )
    for option, what in (("up", "points up"), ("facing", "becomes forward")):
        parser.add_argument(
            f"--{option}",
            metavar="AXIS",
            help=f"the motion file's axis that {what}: x, y, z, or as in --{option}=-x "
            "(default: by its skeleton)",
        )
    parser.add_argument(
        "--joints",
        metavar="FILE",
        help="a YAML file that says which of the motion's joints are meant, where the "
        "match is wrong",
    )


FILE_OPTIONS = ("skeleton", "frame_rate", "unit", "up", "facing", "joints")


def given_motion_options(arguments: argparse.Namespace) -> MotionOptions:
    """What the options of `add_motion_options` say of a motion."""
    from crar_drake.motion.options import MotionOptions

    given = {name: getattr(arguments, name) for name in FILE_OPTIONS}
    return MotionOptions(**{name: value for name, value in given.items() if value})


def add_reference_options(parser: Parser, also: str = "") -> None:
    """Adds --robot and --layout, of a motion of a whole robot.

    Args:
        also: what else the robot is of, for the help's end.
    """
    parser.add_argument(
        "--robot",
        metavar="ROBOT",
        help=f"name or folder of the robot that a reference motion is of{also}",
    )
    parser.add_argument(
        "--layout",
        metavar="LAYOUT",
        help="layout of a reference motion (default: what the file looks like)",
    )


def add_whole_body(parser: Parser, out: str) -> None:
    """Adds --robot, --out and --jobs, of what makes motions of a whole robot.

    Args:
        out: what --out is, for the help.
    """
    parser.add_argument(
        "--robot",
        required=True,
        metavar="ROBOT",
        help="name or folder of the robot, imported as a whole body",
    )
    parser.add_argument("--out", type=Path, metavar="PATH", help=out)
    add_jobs(parser)


def add_served(parser: Parser, port: int, what: str, reached: str, unit: str) -> None:
    """Adds --host, --port and --duration, of what goes on until somebody ends it.

    Args:
        port: that is the default.
        what: has the port.
        reached: what is done by whoever reaches the host by default.
        unit: of the duration.
    """
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help=f"address of {what}; by default this computer alone {reached}. Whoever "
        "reaches another address moves the robot: nobody is asked who they are",
    )
    parser.add_argument(
        "--port",
        type=int,
        default=port,
        help=f"of {what}; 0 takes a free one (default: %(default)s)",
    )
    parser.add_argument(
        "--duration", type=positive, metavar="S", help=f"end after S {unit}"
    )


def add_jobs(parser: Parser) -> None:
    """Adds --jobs, of what simulates much."""
    parser.add_argument(
        "--jobs", type=count, metavar="N", help="processes (default: one per core)"
    )


# --- types of options -------------------------------------------------------------


def positive(text: str) -> float:
    """Converts a positive, finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def share(text: str) -> float:
    """Converts a positive number, at most 1."""
    value = positive(text)
    if value > 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no share: it is at most 1")
    return value


def count(text: str) -> int:
    """Converts a positive whole number."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive whole number")
    return int(text)


def chosen_scenario(name: str) -> Scenario:
    """The scenario of that name or file.

    Raises:
        ScenarioError: there is none, or it is a motion.
    """
    from crar_drake.motion.catalogue import MOTION_SUFFIXES, refuse_robot_motion
    from crar_drake.simulation.scenario import load_scenario

    path = Path(name)
    if path.is_file():
        refuse_robot_motion(path)
        if path.suffix.lower() in MOTION_SUFFIXES:
            raise ScenarioError(
                f"{name} is a motion, not a scenario: give it as --motion {name}"
            )
    return load_scenario(name)


def changed_scenario(scenario: Scenario, arguments: argparse.Namespace) -> Scenario:
    """The scenario with what the options of `add_scenario` say in the place of its own.

    Args:
        scenario: is changed, too.

    Raises:
        ScenarioError: it has no motion or no experiment to be replaced, or a setting
            is none of a scenario.
    """
    for option, key, own in (
        ("motion", "motion", "keyframes"),
        ("tasks", "experiment", "tasks"),
    ):
        value = getattr(arguments, option)
        if value is None:
            continue
        if getattr(scenario, own):
            raise ScenarioError(
                f"--{option}: {arguments.scenario} has {own} of its own; take a "
                f"scenario with {key}, or change the file"
            )
        setattr(scenario, key, value)
    if arguments.motion is not None:
        # What the scenario says of its motion's file belongs to that one.
        for name in FILE_OPTIONS:
            setattr(scenario, name, None if name == "frame_rate" else "")
    if arguments.robot is not None:
        scenario.robot = arguments.robot
    return _with_settings(scenario, arguments.set) if arguments.set else scenario


def _with_settings(scenario: Scenario, settings: list[str]) -> Scenario:
    """The scenario with some of its keys set, as in controller.margin=0.01; together,
    since one may need another. Of one key the last counts."""
    import yaml
    from pydrake.common.yaml import yaml_dump, yaml_load_data

    from crar_drake.law.parameters import CONSTRAINTS, with_constraints
    from crar_drake.simulation.scenario import parse_scenario

    values = {}
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not (key and equals):
            raise UsageError(f"--set {setting}: write KEY=VALUE, as in duration=2")
        values[key] = text
    constraints = values.get("controller.constraints")
    if constraints in CONSTRAINTS:  # which choose the keys of the others
        del values["controller.constraints"]
        scenario.controller = with_constraints(scenario.controller, constraints)
    whole = yaml_load_data(scenario.to_yaml())
    for key, text in values.items():
        *way, last = key.split(".")
        try:
            holder = whole
            for name in way:
                holder[name] = holder.get(name) or {}
                holder = holder[name]
            holder[last] = yaml.safe_load(text)
        except (yaml.YAMLError, AttributeError, TypeError) as error:  # no keys in text
            raise ScenarioError(
                f"--set {key}={text}: no such key, or no value"
            ) from error
    try:
        return parse_scenario(yaml_dump(whole), f"--set {' --set '.join(settings)}")
    except ScenarioError as error:  # whose lines are of no file
        raise ScenarioError(re.sub(r" \(line \d+\)", "", str(error))) from error
