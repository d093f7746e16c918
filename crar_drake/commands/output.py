"""Where commands write by default, what they say, and how they end."""

from __future__ import annotations

import errno
import hashlib
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from crar_drake.errors import CrarError, plural, printable
from crar_drake.interrupts import all_as_ctrl_c

if TYPE_CHECKING:
    from crar_drake.run import RunResult

OUT = Path("out")


def label(path: str | Path) -> Path:
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


def final_line(
    violated: list[str],
    bad: int = 0,
    guessed: Iterable[str] = (),
    left: Sequence[str] = (),
    unread: str = "",
) -> int:
    """Prints the last line of a command that judges: OK, VIOLATED and what, or, if
    nothing is but something could not be looked at, NOT JUDGED.

    Args:
        violated: what is, each in a few words.
        bad: how many lines BAD are printed above it, of what violates nothing.
        left: of each motion what is wrong with it that was left as it was, or "".
        guessed: what was guessed of the files that are judged, a sentence each.
        unread: what could not be judged, in words; "" if all was.

    Returns:
        The exit code: 1 if something is violated, else 2 if something is not judged,
        else 0.
    """
    if unread and not violated:
        print(f"NOT JUDGED: {unread}", flush=True)
        return 2
    ok = f"OK: nothing is violated, but see {bad} BAD above" if bad else "OK"
    was = [words for words in left if words]
    if was:
        of_many = f"something of {plural(len(was), 'motion')}"
        which = was[0] if len(left) == 1 else of_many
        ok = f"{ok}, left as it was: {which}"
    line = f"VIOLATED: {'; '.join(filter(None, [*violated, unread]))}"
    line = line if violated else ok
    heads = [
        printable(guess.partition(": ")[0].partition(", ")[0])
        + (" (NOT sure)" if "NOT sure" in guess else "")
        for guess in dict.fromkeys(guessed)
    ]
    print(f"{line}; guessed: {', '.join(heads)}" if heads else line, flush=True)
    return int(bool(violated))


def exit_code(do: Callable[[], int | None]) -> int:
    """Does what a command does; failures become messages on stderr.

    Returns:
        The exit code: what is returned, None is 0; 2 if something the user gave is
        wrong, or the system refuses; 130 if it is asked to end.
    """
    with lasting_output():
        try:
            with all_as_ctrl_c():
                code = do() or 0
            sys.stdout.flush()
        except (CrarError, KeyboardInterrupt, OSError) as error:
            code = tell_failure(error)
            if isinstance(error, OSError):  # a full disk, a file that may not be read
                drop_output(sys.stdout)
    return code


def tell_failure(error: BaseException) -> int:
    """Says on stderr why a command failed; returns its exit code.

    Args:
        error: that ended it; of a kind that no user makes, its traceback is printed.
    """
    if isinstance(error, KeyboardInterrupt):
        about = f" {error}" if str(error) else ""
        print(f"crar-drake: interrupted{about}", file=sys.stderr)
        return 130
    if isinstance(error, CrarError):
        what = printable(str(error))
    elif isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        what = f"{where}{error.strerror or error}"
    else:
        traceback.print_exception(error)
        return 1
    print(f"crar-drake: error: {what}", file=sys.stderr)
    return 2


def tell_run(result: RunResult, verbose: bool = False) -> None:
    """Prints the figures, the warnings and the files of a run."""
    from rich.console import Console

    from crar_drake.results.summary_table import summary_table

    Console().print(summary_table(result.summary, verbose))
    for line in result.summary.warnings:
        print(f"warning: {line}")
    for path in result.files:
        print(path)


# What is counted of contacts with obstacles that move.
FAST = "with an obstacle while the link was fast"


def counted(number: int, what: str, does: str) -> list[str]:
    """ "3 samples penetrate", as the only entry; of none, no entry.

    Args:
        what: they are, in the singular.
        does: what they do, in the plural; "{s}" in it is s for one.
    """
    if not number:
        return []
    return [f"{plural(number, what)} {does.format(s='s' if number == 1 else '')}"]


def tell_drawn(models: Iterable[str]) -> None:
    """Warns of models of which a page shows other than their looks."""
    for model in models:
        print(
            f"warning: model {model} has no visual geometry: its collision shapes are "
            "drawn"
        )


@contextmanager
def continuing(out: Path) -> Iterator[None]:
    """Says on stderr, if it is interrupted, that what is finished is in `out`."""
    try:
        yield
    except KeyboardInterrupt:
        print(
            f"crar-drake: what is finished is in {out}; the same command continues",
            file=sys.stderr,
        )
        raise


class LastingStream:
    """A stream whose reader may go away, as `| head` does, or a terminal: what is
    written then is dropped. A full disk is an error as ever."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """As of the stream."""
        return self._unless_gone(self._stream.write, text) or len(text)

    def flush(self) -> None:
        """As of the stream."""
        self._unless_gone(self._stream.flush)

    def _unless_gone(self, do: Callable, *arguments: str) -> Any:
        try:
            return do(*arguments)
        except OSError as error:
            if error.errno not in (errno.EPIPE, errno.EIO):
                raise
            drop_output(self._stream)


def drop_output(stream: TextIO) -> None:
    """Lets what a stream still holds, and all that is written to it, go nowhere, if it
    cannot be written: Python flushes it when it exits, where no failure is caught."""
    try:
        stream.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextmanager
def lasting_output() -> Iterator[None]:
    """Lets the block, whose work is worth more than its words, come to its end where
    nobody reads stdout or stderr any more, or they were closed from the first."""
    # Else the first files that are opened get their numbers, and what is said.
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    before = [each or open(os.devnull, "w") for each in (sys.stdout, sys.stderr)]
    sys.stdout, sys.stderr = map(LastingStream, before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
