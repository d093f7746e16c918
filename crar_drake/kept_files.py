"""What is kept in the user's cache and can be made again: by which sources it was made,
and when it goes."""

import hashlib
import os
import shutil
import time
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path

# What nobody used for so long goes [s].
LONGEST = 60 * 86400.0


def digest_of(sources: Iterable[Path]) -> str:
    """Of the contents of files, in their order: 64 hexadecimal digits."""
    digest = hashlib.sha256()
    for path in sources:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def mark_used(place: Path) -> None:
    """Notes that a file or folder was used now; nothing where that cannot be noted."""
    with suppress(OSError):
        os.utime(place)


@cache
def remove_unused(folder: Path) -> None:
    """Removes what nobody used for `LONGEST` from a folder, once in a process.

    Other processes may do the same at once. Who misses a file makes it again.
    """
    oldest = time.time() - LONGEST
    with suppress(OSError):
        for place in folder.iterdir():
            with suppress(OSError):
                if place.stat().st_mtime >= oldest:
                    continue
                if place.is_dir():
                    shutil.rmtree(place, ignore_errors=True)
                else:
                    place.unlink()
