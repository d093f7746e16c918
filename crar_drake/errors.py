"""The errors that a user can mend: each message names the thing and the remedy.

The command line prints them without a traceback and exits with code 2.
"""

import difflib
import math
import os
from collections.abc import Iterable, Sequence


class CrarError(ValueError):
    """Something the user gave is wrong; the message says what and what to do."""


class MotionError(CrarError):
    """A motion-capture file, its name, or its contents."""


class ModelError(CrarError):
    """A robot model, its description, or a plant handed to the controller."""


class ScenarioError(CrarError):
    """A scenario file or an option that overrides it."""


class WriteError(CrarError):
    """A file or folder cannot be written.

    Attributes:
        path: which.
    """

    def __init__(self, path: str | os.PathLike[str], why: str | OSError) -> None:
        if isinstance(why, OSError):
            why = f"could not be written: {why.strerror or why}"
        super().__init__(f"{path}: {why}")
        self.path = path
        self._why = why

    def __reduce__(self) -> tuple:
        # Processes of a pool send their errors.
        return WriteError, (self.path, self._why)


def check_vector(
    where: str, value: Sequence[float], error: type[CrarError] = ScenarioError
) -> None:
    """Raises the error, which begins with `where`, unless there are three numbers."""
    try:
        is_one = len(value) == 3 and all(map(math.isfinite, value))
    except TypeError:  # a number, or words
        is_one = False
    if not is_one:
        raise error(f"{where}: {value} must be three finite numbers")


def printable(text: str) -> str:
    """The text without what a terminal obeys: names come from files of others."""
    return "".join(
        c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text
    )


def few(names: Sequence[str], most: int) -> str:
    """The first ones with commas between, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


# More names than these are more than anybody reads.
_MOST_NAMES = 40


def nearest(name: str, known: Iterable[str]) -> str:
    """The end of an error message: "; did you mean x?" or the names there are."""
    known = sorted(set(known))
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; known are {few(known, _MOST_NAMES)}" if known else ""
