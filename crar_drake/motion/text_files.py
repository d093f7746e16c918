"""Text of motion files, whatever program wrote it."""

import os
import re
from pathlib import Path

from crar_drake.errors import MotionError

_MARKS = {b"\xff\xfe\x00\x00": "utf-32", b"\x00\x00\xfe\xff": "utf-32"} | {
    b"\xff\xfe": "utf-16",
    b"\xfe\xff": "utf-16",
}

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
