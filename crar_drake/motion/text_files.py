"""Text of motion files, whatever program wrote it."""

import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

from crar_drake.errors import MotionError

_MARKS = {b"\xff\xfe\x00\x00": "utf-32", b"\x00\x00\xfe\xff": "utf-32"} | {
    b"\xff\xfe": "utf-16",
    b"\xfe\xff": "utf-16",
}

_LARGEST = 1e9  # of a number in any unit or in degrees: more was never measured
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+")

_POINTER = b"version https://git-lfs.github.com/spec/"

# Escapes, and marks that turn the direction of a text.
_OBEYED = re.compile("[\x01-\x08\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def read_motion_text(path: str | os.PathLike[str]) -> str:
    """The text of a file in UTF-8, UTF-16, UTF-32 or, if it is none, Latin-1.

    Numbers and keywords are ASCII in all of them; names may need the right one.
    Line ends become \\n; form feeds and the like are mere blanks, and stay. What a
    terminal would obey, in a name, is escaped.

    Raises:
        MotionError: it cannot be read, or is a pointer of Git LFS.
    """
    refuse_pointer(path)
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise MotionError(
            f"{path}: cannot read this file: {error.strerror or error}"
        ) from error
    text = _decoded(data).replace("\r\n", "\n").replace("\r", "\n")
    return _OBEYED.sub(lambda found: ascii(found[0])[1:-1], text)


class NumberedLines:
    """The lines of a text file as words, and errors that name file and line.

    Attributes:
        number: of the line that was read last, from 1; 0 before the first.
    """

    def __init__(self, path: str | os.PathLike[str], comment: str = "\n") -> None:
        """
        Args:
            comment: what begins one, up to the end of its line; by default none.

        Raises:
            MotionError: as of `read_motion_text`.
        """
        self.path, self.number, self._comment = Path(path), 0, comment
        # Unlike `splitlines`, as editors count them.
        self._lines = iter(read_motion_text(path).removesuffix("\n").split("\n"))

    def __iter__(self) -> Iterator[list[str]]:
        """The words of each further line that has any."""
        for line in self._lines:
            self.number += 1
            if words := line.partition(self._comment)[0].split():
                yield words

    def fail(self, message: str, number: int | None = None) -> NoReturn:
        """Raises MotionError, of the line that was read last or of another."""
        number = self.number if number is None else number
        raise MotionError(f"{self.path}{f':{number}' * bool(number)}: {message}")

    def numbers(self, words: list[str], number: int | None = None) -> list[float]:
        """The words as finite numbers; fails, of the line as of `fail`, if one is none
        or beyond all that is measured."""
        try:
            values = list(map(float, words))
            # Quick; written so that a NaN fails, too.
            if sum(map(abs, values)) <= _LARGEST:
                return values
        except ValueError:
            pass
        for word in words:
            try:
                value = float(word)
            except ValueError:
                comma = _DECIMAL_COMMA.fullmatch(word)
                hint = "; write a point for the decimal comma" if comma else ""
                self.fail(f"expected a number, found {shown(word)}{hint}", number)
            if not math.isfinite(value):
                self.fail(f"{word} is not a finite number; repair the file", number)
            if abs(value) > _LARGEST:
                self.fail(f"{shown(word)} is no measurement; repair the file", number)
        return values


def refuse_pointer(path: str | os.PathLike[str]) -> None:
    """Raises MotionError if a file is what Git LFS leaves in a clone in its place.

    A file that cannot be read is none.
    """
    try:
        with open(path, "rb") as stream:
            start = stream.read(len(_POINTER))
    except OSError:
        return
    if start == _POINTER:
        raise MotionError(
            f"{path}: this is a pointer of Git LFS, not the file itself, which "
            "`git lfs pull` fetches"
        )


def _decoded(data: bytes) -> str:
    for mark, encoding in _MARKS.items():
        if data.startswith(mark):
            return data.decode(encoding, errors="replace")
    # Without a mark, ASCII in UTF-16 has a zero beside each letter.
    start = data[:64]
    for zeros, encoding in ((start[1::2], "utf-16-le"), (start[::2], "utf-16-be")):
        if len(zeros) > 1 and not any(zeros):
            return data.decode(encoding, errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def shown(text: str) -> str:
    """Foreign text as something short that is safe to print."""
    return ascii(text if len(text) <= 24 else text[:21] + "...")
