"""Where compiled functions are kept: a cache that is broken never stops anybody.

What cannot be read, damaged or cut off, counts as not there, and is compiled again.
What cannot be written, on a full disk or one that is read only, is said once. A folder
that is full of what others compiled may well be read only.

Numba's own cache looks at the file of a function only, but a compiled function contains
those that it calls, and the constants that it uses. It also depends on where the source
lies, and trusts what it reads.
"""

import hashlib
import logging
import pickle
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import numba
from numba.core import serialize
from numba.core.compiler import CompileResult

from crar_drake.errors import WriteError
from crar_drake.files import whole_file
from crar_drake.kept_files import digest_of, mark_used, remove_unused
from crar_drake.resources import cached

_PACKAGE = Path(__file__).parents[1]
_IMPORT = re.compile(r"^\s*from crar_drake\.(\S+) import (\([^)]*|.*)", re.MULTILINE)
_DIGEST = hashlib.sha256().digest_size

_SAID: set[Path] = set()  # folders of which it was said that nothing is kept there


@cache
def _imported(source: Path) -> frozenset[Path]:
    """The files of the package that a file takes names from."""
    found = set()
    for module, names in _IMPORT.findall(source.read_text(encoding="utf-8")):
        place = _PACKAGE.joinpath(*module.split("."))
        found.add(place.with_suffix(".py"))
        if place.is_dir():
            inside = ("__init__", *re.findall(r"\w+", names))
            found |= {place / f"{name}.py" for name in inside}
    return frozenset(place for place in found if place.is_file())


def sources_of(source: Path) -> list[Path]:
    """All files that what is compiled of a file can be made of: itself, those of the
    package that it takes names from, and those that these do.
    """
    found, left = {source}, [source]
    while left:
        more = _imported(left.pop()) - found
        found |= more
        left += more
    return sorted(found)


@cache
def cache_folder(source: Path) -> Path:
    """Where the compiled functions of a file are kept: another folder for other
    `sources_of` it, and for another Numba or Python.

    In the user's cache, or in NUMBA_CACHE_DIR where that is set. A new folder in the
    user's cache takes the places of those that nobody used for long. All copies of the
    sources find what one has compiled.
    """
    theirs = numba.config.CACHE_DIR
    by = f"{numba.__version__}-{sys.implementation.cache_tag}"
    name = f"{source.stem}-{by}-{digest_of(sources_of(source))[:16]}"
    folder = (Path(theirs) if theirs else cached("compiled")) / name
    if folder.is_dir():
        mark_used(folder)
    elif not theirs:
        remove_unused(folder.parent)
    return folder


class Kept:
    """What was compiled of one function: what Numba asks of a cache.

    A file for each signature, with a digest of what is in it: machine code of which a
    bit is wrong could do anything.

    Attributes:
        cache_path: the folder of these files.
    """

    def __init__(self, function: Callable) -> None:
        if function.__closure__:
            raise TypeError(f"{function} is not made of its sources alone")
        folder = cache_folder(Path(function.__code__.co_filename))
        self.cache_path = folder / function.__qualname__
        self._line = function.__code__.co_firstlineno

    def load_overload(self, signature, target) -> CompileResult | None:
        """What was kept for a signature; None if nothing that can be used."""
        target.refresh()
        try:
            kept = self._file(signature, target).read_bytes()
        except OSError:
            return None
        digest, content = kept[:_DIGEST], kept[_DIGEST:]
        if hashlib.sha256(content).digest() != digest:
            return None
        # Of a type that stands in another file by now nothing can be made any more.
        with suppress(ImportError, AttributeError):
            return CompileResult._rebuild(target, *pickle.loads(content))
        return None

    def save_overload(self, signature, result: CompileResult) -> None:
        """Keeps what was compiled, if that can be done."""
        if result.library.has_dynamic_globals:
            return  # places in this process's memory
        content = serialize.dumps(result._reduce())
        place = self._file(signature, result.target_context)
        try:
            with whole_file(place) as path:
                path.write_bytes(hashlib.sha256(content).digest() + content)
        except WriteError as error:
            folder = self.cache_path.parents[1]
            if folder not in _SAID:
                _SAID.add(folder)
                logging.getLogger("crar_drake").warning(
                    f"what is compiled cannot be kept ({error}): every process "
                    "compiles it again; NUMBA_CACHE_DIR names another folder"
                )

    def _file(self, signature, target) -> Path:
        known = f"{self._line} {signature} {target.codegen().magic_tuple()}"
        return self.cache_path / hashlib.sha256(known.encode()).hexdigest()[:32]
