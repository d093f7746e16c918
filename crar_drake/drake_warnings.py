"""Drake's warnings, collected while a command runs and reported once, in a line each.

Drake warns whenever it parses a model, which one run does several times over, and an
inertia that cannot be takes eight lines each time. Its messages come as records of
Python's logger "drake".
"""

import logging
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_WIDTH = 100  # of a line
_LINES = 8  # that are printed, at most

# A parser's message begins with the file and the line that it is about.
_PLACE = re.compile(r"(?P<place>.*?:\d+): (?:warning|error): ", re.DOTALL)
# What is said of every ground, and matters to soft bodies alone.
_SOFT_BODIES = "not currently supported for deformable contact"
# What Drake 1.58 logs of an exception that it raises as well.
_RAISED_TOO = "Could not initialize pydrake: "
# A function's name tells the user nothing, and rows of a matrix little.
_NOISE = re.compile(r"\b\w+\(\): |^\s*\[.*\]\s*$", re.MULTILINE)
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


class _Listener(logging.Handler):
    """Keeps each different warning, and what is worse, in a list."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Takes a message of Drake's."""
        text = record.getMessage()
        matters = _SOFT_BODIES not in text and not text.startswith(_RAISED_TOO)
        if matters and text not in self.texts:
            self.texts.append(text)


@contextmanager
def recorded_warnings() -> Iterator[list[str]]:
    """Keeps Drake quiet within the block; yields the list of its different warnings,
    which grows as they come.

    What Drake merely announces (Meshcat's address) is not among them.
    """
    logger, heard = logging.getLogger("drake"), _Listener()
    handlers, propagate = logger.handlers[:], logger.propagate
    logger.handlers[:], logger.propagate = [heard], False
    try:
        yield heard.texts
    finally:
        logger.handlers[:], logger.propagate = handlers, propagate


@contextmanager
def collected_warnings(*, verbose: bool = False) -> Iterator[None]:
    """Keeps Drake quiet within the block, and prints its warnings to stderr at the end,
    short.

    Args:
        verbose: change nothing: all is printed by Drake itself, at once and whole.
    """
    if verbose:
        yield
        return
    with recorded_warnings() as texts:
        try:
            yield
        finally:
            if lines := _lines(texts):
                print(
                    "Drake warns; --verbose prints all of it:",
                    *(f"  {line}" for line in lines),
                    sep="\n",
                    file=sys.stderr,
                )


def tell_again(texts: list[str]) -> None:
    """Tells this process's logger what `recorded_warnings` kept in another process."""
    for text in texts:
        logging.getLogger("drake").warning("%s", text)


def _lines(texts: list[str]) -> list[str]:
    """One line for warnings that differ in places and numbers only, with how many there
    are and the first one's place."""
    kinds: dict[str, list[str]] = {}
    for text in texts:
        kinds.setdefault(_NUMBER.sub("#", _what(text)), []).append(text)
    lines = [_short(of_kind) for of_kind in kinds.values()]
    if len(lines) > _LINES:
        lines[_LINES - 1 :] = [f"and {len(lines) - _LINES + 1} kinds more"]
    return lines


def _what(text: str) -> str:
    """A message in one line, without the place."""
    return " ".join(_NOISE.sub("", _PLACE.sub("", text, count=1)).split())


def _short(texts: list[str]) -> str:
    """One line for messages of one kind."""
    count = f"{len(texts)} x " if len(texts) > 1 else ""
    match = _PLACE.match(texts[0])
    # Folders are long, and the user knows them.
    place = f" ({match['place'].rpartition('/')[2]})" if match else ""
    what, room = _what(texts[0]), _WIDTH - 2 - len(count) - len(place)
    if len(what) > room:
        what = what[: max(room, 40) - 4].rstrip() + " ..."
    return f"{count}{what}{place}"
