"""What commands that simulate many motions have in common: options, and a bar."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich import progress
from rich.console import Console
from rich.table import Column

from benchmarks.sweep.cases import Result
from benchmarks.sweep.report import headline
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
