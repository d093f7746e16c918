"""Pickles that hold data alone, read without running anything that is in them.

A pickle is a program: Python's own reader calls what it names. Here that reader
(`plain_unpickler`) has the opcodes alone that build plain containers, numbers, texts
and NumPy arrays; whatever else a file names or does is refused. Nothing is imported
and nothing is called by a name from the file: the few names that NumPy and joblib
write stand for functions of `pickled_arrays`.

joblib's `dump` puts the bytes of an array behind the opcodes that describe it, perhaps
compresses all of it; that is read, too.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import pickle
import pickletools
import zlib
from pathlib import Path

from crar_drake.errors import MotionError
from crar_drake.files import whole_file
from crar_drake.motion.array_files import LARGEST
from crar_drake.motion.pickled_arrays import RefusedPickle
from crar_drake.motion.plain_unpickler import PlainUnpickler

# How often its own size a file may unpack to, beyond what is small [bytes]: numbers of
# a motion do not compress that well.
_LARGEST_RATIO, _SMALL = 100, 64 * 2**20

# First bytes of what joblib compresses with, and what unpacks it.
_COMPRESSED = {
    b"\x1f\x8b": gzip.open,
    b"BZ": bz2.open,
    b"\xfd7zXZ": lzma.open,
    b"]\x00": lzma.open,
}


def read_plain_pickle(path: str | os.PathLike[str]) -> object:
    """What a pickle holds: dicts, lists, tuples, sets, numbers, texts, None, arrays.

    Args:
        path: of a file by `pickle.dump` (protocols 0 to 5) or `joblib.dump`.

    Raises:
        MotionError: there is no such file, it is cut off or no pickle, or it holds
            anything else; the message says what.
    """
    path = Path(path)
    if not path.is_file():
        raise MotionError(f"{path}: there is no such file")
    try:
        return PlainUnpickler(_unpacked(path)).load()
    except RefusedPickle as error:
        raise MotionError(f"{path}: {error}") from None


def write_plain_pickle(path: str | os.PathLike[str], value: object) -> None:
    """Writes plain containers and arrays, for every NumPy from 1 on to read.

    Args:
        path: of the file; it appears whole or not at all.
        value: as `read_plain_pickle` returns it.
    """
    with whole_file(path) as temporary:
        temporary.write_bytes(for_any_numpy(pickle.dumps(value, protocol=3)))


def for_any_numpy(data: bytes) -> bytes:
    """A pickle of protocol 3 with the names of NumPy 1, which NumPy 2 knows, too."""
    parts, before = [], 0
    for opcode, argument, position in pickletools.genops(data):
        if opcode.name == "GLOBAL":  # c, module, newline, name, newline
            after = position + len(argument.encode()) + 2
            named = data[position:after].replace(b"cnumpy._core.", b"cnumpy.core.")
            parts += [data[before:position], named]
            before = after
    return b"".join([*parts, data[before:]])


def _unpacked(path: Path) -> bytes:
    with path.open("rb") as file:
        start = file.read(6)
    if not start:
        raise RefusedPickle("the file is empty")
    most = min(LARGEST, _SMALL + _LARGEST_RATIO * path.stat().st_size)
    try:
        for magic, opener in _COMPRESSED.items():
            if start.startswith(magic) and not _starts_pickle(start):
                with opener(path, "rb") as file:
                    return _bounded(file.read(most + 1), most)
        # zlib: the first two bytes are a multiple of 31, the method is 8.
        if start[0] == 0x78 and int.from_bytes(start[:2], "big") % 31 == 0:
            unpacker = zlib.decompressobj()
            data = unpacker.decompress(path.read_bytes(), most + 1)
            if not unpacker.eof and len(data) <= most:
                raise RefusedPickle("the file is cut off")
            return _bounded(data, most)
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise RefusedPickle(
            f"the compressed file is damaged or cut off ({error})"
        ) from None
    return path.read_bytes()


def _starts_pickle(start: bytes) -> bool:
    """`]` is the empty list as well as lzma's first byte; a 0 is no opcode."""
    return start[:1] == b"]" and start[1:2] != b"\x00"


def _bounded(data: bytes, most: int) -> bytes:
    if len(data) > most:
        raise RefusedPickle(f"it unpacks to more than {most / 2**20:.0f} MiB")
    return data
