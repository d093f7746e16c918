"""The errors that a user can mend: each message names the thing and the remedy.

The command line prints them without a traceback and exits with code 2.
"""

import difflib
import math
import os
import re
import sys
import warnings
from collections.abc import Iterable, Sequence


class CrarError(ValueError):
    """Something the user gave is wrong; the message says what and what to do."""


class MotionError(CrarError):
    """A motion-capture file, its name, or its contents."""


class NoMotionError(MotionError):
    """A file that holds something else; in a folder of motions it is skipped."""


class ModelError(CrarError):
    """A robot model, its description, or a plant handed to the controller."""


class ScenarioError(CrarError):
    """A scenario file or an option that overrides it."""


class InputError(CrarError):
    """A value that reached the controller at run time cannot be used."""


class CrarWarning(UserWarning):
    """What a user has to know of a set-up that is taken: it lessens what is promised,
    or something given has no effect."""


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


def tell(line: str, strict: bool) -> None:
    """Warns of what a user has to know, at the user's line.

    Raises:
        ModelError: strict.
    """
    if strict:
        raise ModelError(line)
    frame, level = sys._getframe(1), 2
    while frame.f_back and frame.f_globals["__name__"].startswith("crar_drake."):
        frame, level = frame.f_back, level + 1
    warnings.warn(CrarWarning(line), stacklevel=level)


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


def plural(number: int, what: str) -> str:
    """ "1 frame", or "3 frames"; what they are, in the singular."""
    return f"{number} {what}{'' if number == 1 else 's'}"


# More names than these are more than anybody reads.
_MOST_NAMES = 40


def nearest(name: str, known: Iterable[str]) -> str:
    """The end of an error message: "; did you mean x?" or the names there are.

    It may lack a letter. Else names are meant that have its words, or begin with them,
    or whose words it has: --rate is --frame-rate, and --out-dir is --out. Else what is
    spelled alike.
    """
    known = sorted(set(known))
    # What most names have in common, as the dashes of options, is no likeness.
    typed, words = {each.lstrip("-"): each for each in known}, _words(name)
    like = [each for each in typed if words and _is_part(words, _words(each))]
    close: list[str] = []
    for among, most, least in ((typed, 1, 0.85), (like, 3, 0.0), (typed, 1, 0.6)):
        close = close or difflib.get_close_matches(name.lstrip("-"), among, most, least)
    if close:
        *others, last = [repr(typed[each]) for each in close]
        meant = f"{', '.join(others)} or {last}" if others else last
        return f"; did you mean {meant}?"
    return f"; known are {few(known, _MOST_NAMES)}" if known else ""


def _words(name: str) -> list[str]:
    return re.findall(r"[^\W_]+", name.lower())


def _is_part(words: list[str], of: list[str]) -> bool:
    """Whether each word begins one of the other name, or these all are among them."""
    begun = all(any(each.startswith(word) for each in of) for word in words)
    return begun or (bool(of) and set(of) <= set(words))
