"""The command `crar-drake`: a file for each of its commands.

Each file has `add`, which adds the command and its options, and `run`, which does it.
What takes long to import is imported by the command that needs it, so that help and
mistyped options answer at once.
"""

import argparse
import os
import sys
from collections.abc import Sequence

from crar_drake.commands import (
    clean,
    convert,
    import_robot,
    judge,
    play,
    retarget,
    run,
    serve,
    show,
)
from crar_drake.commands.options import Parser
from crar_drake.commands.output import exit_code
from crar_drake.drake_warnings import collected_warnings
from crar_drake.errors import nearest
from crar_drake.version import __version__

# In the order of the help.
COMMANDS = (
    run,
    play,
    show,
    import_robot,
    retarget,
    judge,
    clean,
    convert,
    serve,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: the arguments; by default those of the process. Without any it prints the
            help.

    Returns:
        0; 1 if something is violated or untrue of what `judge`, `run` or `clean` looked
        at; 2 if something the user gave is wrong, which is then on stderr; 130 if
        interrupted.
    """
    given = sys.argv[1:] if argv is None else argv
    parser = make_parser()
    if not given:
        parser.print_help()
        return 0
    return answer(parser, given)


def answer(parser: Parser, argv: Sequence[str] | None = None) -> int:
    """Does what arguments ask for, as `main`; failures become messages and exit codes.

    Args:
        parser: of the arguments; it sets `command`, which is called with what they
            say.
        argv: the arguments; by default those of the process.
    """
    # Nothing here opens a window. A backend that is not there would fail importing.
    os.environ["MPLBACKEND"] = "agg"

    def do() -> int | None:
        arguments = parse(parser, argv)
        with collected_warnings(verbose=arguments.verbose):
            return arguments.command(arguments)

    return exit_code(do)


def parse(parser: Parser, argv: Sequence[str] | None) -> argparse.Namespace:
    """What the arguments say.

    Returns:
        the options; `command`, to be called with them; `parser`, the command's.

    Raises:
        UsageError: there is no such command or option, or a value is wrong.
    """
    arguments, unknown = parser.parse_known_args(argv)
    if unknown:
        chosen: Parser = arguments.parser
        first = unknown[0]
        if first.startswith("-"):
            option = first.partition("=")[0]
            known = [each for each in chosen._option_string_actions if each != "-h"]
            chosen.error(f"unknown option {option}{nearest(option, known)}")
        chosen.error(f"unexpected argument {first!r}")
    return arguments


def make_parser() -> Parser:
    """The parser of all commands."""
    parser = Parser(
        prog="crar-drake",
        description="Make simulated robots follow motion-capture data without running "
        "into themselves or beyond their joint limits, by Constrained Resolved "
        "Acceleration Control.",
        epilog="Start with `crar-drake run`, which simulates a built-in dance, and "
        "`crar-drake show`. `crar-drake COMMAND --help` tells a command's options.",
    )
    parser.add_argument(
        "--version", action="version", version=f"crar-drake {__version__}"
    )
    subparsers = parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True, parser_class=Parser
    )
    for command in COMMANDS:
        command.add(subparsers)
    return parser
