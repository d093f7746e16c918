"""Pickles that hold data alone, read without running anything that is in them.

A pickle is a program: it names what is called. Names are looked up in a short list of
those that NumPy and joblib write for arrays and plain containers; nothing is imported,
and a file that names anything else is refused. joblib's `dump` puts the bytes of an
array behind the opcodes that describe it, perhaps compresses all of it; that is read,
too.
"""

import bz2
import io
import lzma
import math
import os
import pickle
import pickletools
import re
import zlib
from collections import OrderedDict
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.files import whole_file
from crar_drake.motion.array_files import LARGEST

# How often its own size a file may unpack to, beyond what is small [bytes]: numbers of
# a motion do not compress that well.
_LARGEST_RATIO, _SMALL = 100, 64 * 2**20

# First bytes of what joblib compresses with, and what unpacks it.
_UNPACKERS = {
    b"x": zlib.decompressobj,
    b"\x1f\x8b": lambda: zlib.decompressobj(16 + zlib.MAX_WBITS),  # gzip
    b"BZ": bz2.BZ2Decompressor,
    b"\xfd7zXZ": lzma.LZMADecompressor,
    b"]\x00": lzma.LZMADecompressor,
}

# Truth values, integers, floats, texts, objects. NumPy's own reader knows far more.
_TYPE_NAME = re.compile(r"[<>|=]?[biufUSO][0-9]{0,4}")


class RefusedPickle(Exception):
    """What is wrong with the file, without its name."""


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


# --- what the names stand for -----------------------------------------------------


class _JoblibArray:
    """Stands before the bytes of an array in a file of joblib's."""


_NDARRAY = "ndarray"  # is named as a class of arrays; nothing calls it


def _array(kind: object, *rest: object) -> np.ndarray:
    """An empty array, whose shape and numbers follow."""
    if kind is not _NDARRAY:
        raise RefusedPickle("it has a subclass of NumPy's arrays")
    return np.empty(0)


def _buffered(data: object, dtype: np.dtype, shape: tuple, order: str) -> np.ndarray:
    return np.frombuffer(data, dtype).reshape(shape, order=order).copy()


def _scalar(dtype: np.dtype, data: bytes) -> np.generic:
    return np.frombuffer(data, dtype, 1)[0]


def _dtype(name: object, *rest: object) -> np.dtype:
    if not isinstance(name, str) or not _TYPE_NAME.fullmatch(name):
        raise RefusedPickle("it has an array of a type that is no numbers")
    return np.dtype(name, copy=True)  # its byte order may follow


def _latin(text: str, encoding: str) -> bytes:
    return text.encode("latin1")


def _default_dict(*factory: object) -> dict:
    """What it has for keys that are not there is no data."""
    return {}


_KNOWN = {
    **{
        (f"{core}.{module}", name): function
        for core in ("numpy.core", "numpy._core")
        for module, name, function in (
            ("multiarray", "_reconstruct", _array),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _buffered),
        )
    },
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _latin,
    ("collections", "OrderedDict"): OrderedDict,
    ("collections", "defaultdict"): _default_dict,
    **{
        (module, kind.__name__): kind
        for module in ("builtins", "__builtin__")
        for kind in (dict, set, frozenset)
    },
    ("__builtin__", "bytes"): lambda: b"",
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
}


class PlainUnpickler(pickle._Unpickler):
    """Reads one pickle.

    It is Python's own reader, the one in Python: that in C reads ahead, over the bytes
    of joblib's arrays.
    """

    dispatch = dict(pickle._Unpickler.dispatch)

    def __init__(self, data: bytes) -> None:
        """
        Args:
            data: the whole file, unpacked; arrays are no larger.
        """
        self._data, self._size = io.BytesIO(data), len(data)
        # Texts of Python 2 stay bytes: an array's numbers are among them.
        super().__init__(self._data, encoding="bytes")

    def load(self) -> object:
        """What is in the file.

        Raises:
            RefusedPickle: it is more than data, or damaged.
        """
        try:
            return super().load()
        except RefusedPickle:
            raise
        except EOFError:
            raise RefusedPickle("the file is cut off") from None
        except MemoryError:
            raise RefusedPickle("it is larger than the memory") from None
        except Exception as error:
            # Damaged opcodes end in errors of any kind.
            raise RefusedPickle(
                f"it is no pickle of plain data, or one that is damaged ({error})"
            ) from None

    def find_class(self, module: str, name: str) -> object:
        """What stands for a name.

        Raises:
            RefusedPickle: the name is none of those that NumPy and joblib write.
        """
        if (module, name) in _KNOWN:
            return _KNOWN[module, name]
        hint = ""
        if str(module).split(".")[0] == "torch":
            hint = "; save tensors as arrays (`.numpy()`) first"
        raise RefusedPickle(
            f"it names {module[:60]}.{name[:60]}, which is no plain data and could run "
            f"code when it is loaded; only arrays and plain containers are read{hint}"
        )

    def _build(self) -> None:
        """Fills in an array or a type; nothing else has a state."""
        state, target = self.stack.pop(), self.stack[-1]
        if isinstance(target, np.ndarray):
            _, shape, dtype, fortran, data = state
            # `np.save` puts an array without axes around a dict.
            if dtype.hasobject and (shape != () or not isinstance(data, list)):
                raise RefusedPickle("it has an array of objects, which are no numbers")
            target.__setstate__((1, _lengths(shape), dtype, bool(fortran), data))
        elif isinstance(target, np.dtype):
            if state[2:5] != (None, None, None) or state[1] not in ("<", ">", "|", "="):
                raise RefusedPickle("it has an array of a type that is made of others")
            own = target.itemsize, target.alignment, target.flags
            target.__setstate__((3, state[1], None, None, None, *own))
        elif isinstance(target, _JoblibArray):
            self.stack[-1] = self._joblib_array(**state)
        else:
            raise RefusedPickle("it sets the attributes of what is no array")

    dispatch[pickle.BUILD[0]] = _build

    def _joblib_array(
        self,
        subclass: object,
        shape: tuple,
        order: str,
        dtype: np.dtype,
        allow_mmap: object = None,
        numpy_array_alignment_bytes: int | None = None,
    ) -> np.ndarray:
        """What follows in the file: perhaps padding, then the numbers."""
        if subclass is not _NDARRAY or dtype.hasobject:
            raise RefusedPickle(
                "it has a subclass of NumPy's arrays, or an array of objects"
            )
        if numpy_array_alignment_bytes is not None:
            self._data.read(self._data.read(1)[0])
        size = math.prod(_lengths(shape)) * dtype.itemsize
        if size > self._size - self._data.tell():
            raise RefusedPickle(
                "an array is larger than the file, which may be cut off"
            )
        return _buffered(self._data.read(size), dtype, shape, order)


def _lengths(shape: object) -> tuple[int, ...]:
    """A shape as it stands in a file."""
    if not isinstance(shape, tuple) or not all(
        isinstance(length, int) and 0 <= length < 2**48 for length in shape
    ):
        raise RefusedPickle("an array is damaged")
    return shape


def _unpacked(path: Path) -> bytes:
    data = path.read_bytes()
    most = min(LARGEST, _SMALL + _LARGEST_RATIO * len(data))
    for magic, unpacker_of in _UNPACKERS.items():
        if data.startswith(magic):
            unpacker = unpacker_of()
            break
    else:
        return data
    try:
        unpacked = unpacker.decompress(data, most + 1)
        # Some compress a file in several streams.
        while unpacker.eof and unpacker.unused_data and len(unpacked) <= most:
            data, unpacker = unpacker.unused_data, unpacker_of()
            unpacked += unpacker.decompress(data, most + 1 - len(unpacked))
    except (EOFError, OSError, zlib.error, lzma.LZMAError) as error:
        raise RefusedPickle(
            f"the compressed file is damaged or cut off ({error})"
        ) from None
    if len(unpacked) > most:
        raise RefusedPickle(f"it unpacks to more than {most / 2**20:.0f} MiB")
    if not unpacker.eof:
        raise RefusedPickle("the file is cut off")
    return unpacked
