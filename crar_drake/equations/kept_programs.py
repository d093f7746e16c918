"""Where compiled functions are kept: a cache that is broken never stops anybody.

What cannot be read, damaged or cut off, counts as not there, and is compiled again.
What cannot be written, on a full disk or one that is read only, is said once. A folder
that is full of what others compiled may well be read only.
"""

import hashlib
import logging
import os
import pickle
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import caching, config

_DIGEST = hashlib.sha256().digest_size

# Older Numbas have it by another name.
_Locator = getattr(caching, "UserProvidedCacheLocator", None) or (
    caching._UserProvidedCacheLocator
)


class Place(_Locator):
    """Where a function is kept: one of this package in a folder of its own.

    Numba's own place depends on where the source lies. Here the cache's folder stands
    for the sources already, so that all copies of them find what one has compiled.
    """

    def __init__(self, function, file) -> None:
        super().__init__(function, file)
        place = Path(file)
        if place.parent == Path(__file__).parent:
            name = f"{place.stem}.{function.__qualname__}"
            self._cache_path = str(Path(config.CACHE_DIR) / name)

    def ensure_cache_path(self) -> None:
        """Makes the folder if it can; else what is there is read, if anything is."""
        try:
            super().ensure_cache_path()
        except OSError as error:
            if not os.path.isdir(self.get_cache_path()):
                say_once(self.get_cache_path(), error)


class KeptResults(caching.CompileResultCacheImpl):
    """What is kept, at its `Place`."""

    _locator_classes = [Place]


class SealedFiles(caching.IndexDataCacheFile):
    """The files of a function, each with a digest of what is in it.

    Machine code of which a bit is wrong could do anything.
    """

    def _dump(self, obj: Any) -> bytes:
        content = super()._dump(obj)
        return hashlib.sha256(content).digest() + content

    def _load_index(self) -> dict:
        try:
            with open(self._index_path, "rb") as file:
                if pickle.load(file) != self._version:
                    return {}
                stamp, overloads = pickle.loads(_unsealed(file.read()))
        except Exception:  # of a damaged file pickle raises whatever it likes
            return {}
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        content = Path(self._data_path(name)).read_bytes()
        return pickle.loads(_unsealed(content))


def _unsealed(content: bytes) -> bytes:
    """What `_dump` sealed; OSError, as if there were no file, if it is damaged."""
    content, digest = content[_DIGEST:], content[:_DIGEST]
    if hashlib.sha256(content).digest() != digest:
        raise OSError("damaged")
    return content


class Cache(caching.FunctionCache):
    """What was compiled of one function."""

    _impl_class = KeptResults

    def __init__(self, function) -> None:
        super().__init__(function)
        self._cache_file = SealedFiles(
            self._cache_path,
            self._impl.filename_base,
            self._impl.locator.get_source_stamp(),
        )

    def save_overload(self, sig, data) -> None:
        """Keeps what was compiled, if that can be done."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            say_once(self.cache_path, error)


@cache
def _say(text: str) -> None:
    logging.getLogger("crar_drake").warning(text)


def say_once(place: str, error: OSError) -> None:
    """Says on stderr, once in a process, that what is compiled cannot be kept."""
    _say(
        f"what is compiled cannot be kept in {Path(place).parent} "
        f"({error.strerror or error}): every process compiles it again; "
        "NUMBA_CACHE_DIR names another folder"
    )
