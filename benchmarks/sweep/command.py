"""What commands that simulate many motions have in common: options, and a bar."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from benchmarks.sweep.cases import Result
from benchmarks.sweep.report import headline
from crar_drake.commands.folders import progress_bar
from crar_drake.commands.options import Parser, positive
from crar_drake.errors import nearest


def add_duration(parser: Parser) -> None:
    """Adds --duration, of each of many motions."""
    parser.add_argument(
        "--duration",
        type=positive,
        metavar="S",
        help="simulate S seconds of each motion (default: all of it)",
    )


def list_of(convert: Callable[[str], object]) -> Callable[[str], list]:
    """Converts what stands between commas."""
    return lambda text: [convert(part.strip()) for part in text.split(",")]


def one_of(known: Sequence[str]) -> Callable[[str], str]:
    """Takes a known word only."""

    def convert(text: str) -> str:
        if text not in known:
            raise argparse.ArgumentTypeError(
                f"{text!r} is unknown{nearest(text, known)}"
            )
        return text

    return convert


@contextmanager
def sweep_bar(
    finished: int, total: int
) -> Iterator[Callable[[int, int, Result], None]]:
    """Yields a callback that draws how far the sweep is, on stderr."""
    with progress_bar() as bar:
        task = bar.add_task("", total=total, completed=finished)
        yield lambda done, total, newest: bar.update(
            task, completed=done, description=headline(newest)
        )
