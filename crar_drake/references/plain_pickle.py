"""Pickles that hold data alone, read without running anything that is in them.

A pickle is a program: Python's own reader calls what it names. This one is another
interpreter of the same opcodes (as `pickletools` of the standard library lists them).
It knows those that build plain containers, numbers, texts and NumPy arrays; whatever
else a file names or does is refused. Nothing is imported and nothing is called by a
name from the file: the few names that NumPy and joblib write stand for functions of
this file.

joblib's `dump` puts the bytes of an array behind the opcodes that describe it, perhaps
compresses all of it; that is read, too.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import math
import os
import pickle
import pickletools
import zlib
from collections import OrderedDict
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.files import whole_file

# What a file may unpack to, and the containers' entries that it may have [bytes].
LARGEST = 4 * 2**30
_MOST_OPCODES = 20_000_000

# Kinds of numbers that an array may have: truth values, integers, floats, texts.
_KINDS = "biufUS"

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
        return _Reader(_unpacked(path), str(path)).read()
    except _Refused as error:
        raise MotionError(f"{path}: {error}") from None


def write_plain_pickle(path: str | os.PathLike[str], value: object) -> None:
    """Writes plain containers and arrays, for every NumPy from 1 on to read.

    Args:
        path: of the file; it appears whole or not at all.
        value: as `read_plain_pickle` returns it.
    """
    with whole_file(path) as temporary:
        temporary.write_bytes(_for_any_numpy(pickle.dumps(value, protocol=3)))


def _for_any_numpy(data: bytes) -> bytes:
    """The same pickle with the names that NumPy 1 has, which NumPy 2 knows as well."""
    parts, before = [], 0
    for opcode, argument, position in pickletools.genops(data):
        if opcode.name == "GLOBAL":  # c, module, newline, name, newline
            after = position + len(argument.encode()) + 2
            named = data[position:after].replace(b"cnumpy._core.", b"cnumpy.core.")
            parts += [data[before:position], named]
            before = after
    return b"".join([*parts, data[before:]])


class _Refused(Exception):
    """What is wrong with the file, without its name."""


def _unpacked(path: Path) -> io.BufferedReader | io.BytesIO:
    with path.open("rb") as file:
        start = file.read(6)
    if not start:
        raise _Refused("the file is empty")
    try:
        for magic, opener in _COMPRESSED.items():
            if start.startswith(magic) and not _starts_pickle(start):
                with opener(path, "rb") as file:
                    return _bounded(file.read(LARGEST + 1))
        # zlib: the first two bytes are a multiple of 31, the method is 8.
        if start[0] == 0x78 and int.from_bytes(start[:2], "big") % 31 == 0:
            unpacker = zlib.decompressobj()
            data = unpacker.decompress(path.read_bytes(), LARGEST + 1)
            if not unpacker.eof and len(data) <= LARGEST:
                raise _Refused("the file is cut off")
            return _bounded(data)
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise _Refused(f"the compressed file is damaged or cut off ({error})") from None
    return path.open("rb")


def _starts_pickle(start: bytes) -> bool:
    """`]` is the empty list as well as lzma's first byte; a 0 is no opcode."""
    return start[:1] == b"]" and start[1:2] != b"\x00"


def _bounded(data: bytes) -> io.BytesIO:
    if len(data) > LARGEST:
        raise _Refused(f"it unpacks to more than {LARGEST / 2**30:g} GiB")
    return io.BytesIO(data)


# --- what names in a pickle stand for ---------------------------------------------


class _Array:
    """An array that is being built."""

    def __init__(self) -> None:
        self.value: np.ndarray | None = None


class _Type:
    """A NumPy type that is being built."""

    def __init__(self, name: object) -> None:
        if not isinstance(name, str):
            raise _Refused("an array's type is damaged")
        try:
            dtype = np.dtype(name)
        except (TypeError, ValueError):
            raise _Refused(f"it has an array of type {name!r}") from None
        if dtype.kind not in _KINDS or dtype.fields or dtype.shape:
            raise _Refused(f"it has an array of type {dtype}, which are no numbers")
        self.value = dtype

    def set_state(self, state: object) -> None:
        """(version, byte order, subtype, names, fields, size, alignment, flags)"""
        plain = (
            isinstance(state, tuple)
            and len(state) >= 5
            and state[2:5] == (None, None, None)
            and state[1] in ("<", ">", "|", "=")
        )
        if not plain:
            raise _Refused("it has an array of a type that is made of others")
        if state[1] in "<>":
            self.value = self.value.newbyteorder(state[1])


class _JoblibArray(_Array):
    """The same, of what joblib writes before an array's bytes."""


# Stand-ins for what is only named, and compared with.
_NDARRAY, _LATIN = object(), "latin1"


def _reconstruct(cls: object, shape: object, code: object) -> _Array:
    if cls is not _NDARRAY:
        raise _Refused("it has a subclass of NumPy's arrays")
    return _Array()


def _frombuffer(buffer: object, dtype: object, shape: object, order: object):
    if not isinstance(buffer, bytes | bytearray) or not isinstance(dtype, _Type):
        raise _Refused("an array is damaged")
    array = _Array()
    array.value = _shaped(buffer, dtype.value, shape, order == "F")
    return array


def _scalar(dtype: object, data: object = b""):
    if not isinstance(dtype, _Type) or not isinstance(data, bytes):
        raise _Refused("a number is damaged")
    return _shaped(data, dtype.value, (), False)[()]


def _encode(text: object, encoding: object = None) -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise _Refused("bytes are damaged")
    return text.encode(_LATIN)


def _dtype(name: object, *rest: object) -> _Type:
    return _Type(name)


def _ordered(*items: object) -> dict:
    if len(items) > 1 or (items and not isinstance(items[0], list)):
        raise _Refused("a dict is damaged")
    try:
        return OrderedDict(tuple(item) for item in (items[0] if items else ()))
    except (TypeError, ValueError):
        raise _Refused("a dict is damaged") from None


def _container(kind: type):
    def make(*items: object):
        if len(items) > 1 or (items and not isinstance(items[0], list | bytes)):
            raise _Refused("a container is damaged")
        try:
            return kind(*items)
        except (TypeError, ValueError):
            raise _Refused("a container is damaged") from None

    return make


_KNOWN = {
    **{
        (f"{core}.{module}", name): function
        for core in ("numpy.core", "numpy._core")
        for module, name, function in (
            ("multiarray", "_reconstruct", _reconstruct),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _frombuffer),
        )
    },
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): _ordered,
    **{
        (module, kind.__name__): _container(kind)
        for module in ("builtins", "__builtin__")
        for kind in (set, frozenset, bytearray, bytes)
    },
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
}
_CALLED = frozenset(
    function for function in _KNOWN.values() if function is not _NDARRAY
)


def _shaped(
    data: bytes | bytearray, dtype: np.dtype, shape: object, fortran: bool
) -> np.ndarray:
    """An array of its own from its bytes; as large as they are, whatever it says."""
    numbers = isinstance(shape, tuple) and all(
        isinstance(length, int) and 0 <= length < 2**48 for length in shape
    )
    if not numbers or len(shape) > 8 or dtype.itemsize == 0:
        raise _Refused("an array is damaged")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise _Refused("an array has another size than its shape says")
    flat = np.frombuffer(bytes(data), dtype)
    array = flat.reshape(shape, order="F" if fortran else "C").copy()
    return array.astype(dtype.newbyteorder("="), copy=False)


# --- the opcodes --------------------------------------------------------------------

_MARK = object()

_PUSHES = {
    *("INT", "LONG", "FLOAT", "BININT", "BININT1", "BININT2", "BINFLOAT"),
    *("LONG1", "LONG4", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
}
# Python 2's texts, which `pickletools` decodes by one character a byte.
_OLD_TEXTS = {"STRING", "BINSTRING", "SHORT_BINSTRING"}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_EMPTY = {"EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_SET": set}
_TUPLES = {"EMPTY_TUPLE": 0, "TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


# Containers in each other, and entries if each is counted wherever it is referred to: a
# small file can refer to a list so often that to go through it would take for ever.
_DEEPEST = 30
_MOST_ENTRIES = 50_000_000


class _Finish:
    """Puts arrays where they are being built, in a tree without end or excess."""

    def __init__(self) -> None:
        self._done: dict[int, tuple[object, int]] = {}
        self._open: set[int] = set()

    def __call__(self, value: object) -> tuple[object, int]:
        """The value, and its number of entries."""
        if isinstance(value, _Array):
            if value.value is None:
                raise _Refused("it has an array without numbers")
            return value.value, 1
        if value is None or isinstance(value, _SIMPLE):
            return value, 1
        if not isinstance(value, _CONTAINERS):
            raise _Refused("it has something that is no plain data")
        if id(value) in self._done:
            return self._done[id(value)]
        if id(value) in self._open or len(self._open) > _DEEPEST:
            raise _Refused("its containers hold each other, or are too many deep")
        self._open.add(id(value))
        self._done[id(value)] = self._container(value)
        self._open.discard(id(value))
        return self._done[id(value)]

    def _container(self, value) -> tuple[object, int]:
        if isinstance(value, dict):
            keys = [self(key) for key in value]
            items = [self(item) for item in value.values()]
            if any(isinstance(key, np.ndarray) for key, _ in keys):
                raise _Refused("a dict has keys that are no plain values")
            size = 1 + sum(n for _, n in keys) + sum(n for _, n in items)
            finished = {k: x for (k, _), (x, _) in zip(keys, items, strict=True)}
        else:
            items = [self(item) for item in value]
            size = 1 + sum(n for _, n in items)
            finished = type(value)(x for x, _ in items)
        if size > _MOST_ENTRIES:
            raise _Refused("it has too many entries")
        return finished, size


_SIMPLE = (bool, int, float, complex, str, bytes, bytearray, np.generic)
_CONTAINERS = (dict, list, tuple, set, frozenset)


class _Reader:
    def __init__(self, file: io.BufferedReader | io.BytesIO, name: str) -> None:
        self._file, self._name = file, name
        self._stack: list = []
        self._memo: dict[int, object] = {}

    def read(self) -> object:
        with self._file:
            try:
                return self._run()
            except (IndexError, KeyError, TypeError, AttributeError) as error:
                if isinstance(error, TypeError) and "unhashable" in str(error):
                    raise _Refused("a dict has keys that are no plain values") from None
                raise _Refused("it is a damaged pickle") from None
            except (ValueError, EOFError, UnicodeDecodeError, OverflowError) as error:
                # pickletools: an unknown opcode, or fewer bytes than were announced.
                raise _Refused(
                    f"it is no pickle, or one that is damaged or cut off ({error})"
                ) from None
            except MemoryError:
                raise _Refused("it is larger than the memory") from None

    def _run(self) -> object:
        for number, (opcode, argument, _) in enumerate(pickletools.genops(self._file)):
            if number > _MOST_OPCODES:
                raise _Refused("it has too many parts")
            if opcode.name == "STOP":
                return _Finish()(self._stack.pop())[0]
            self._do(opcode.name, argument)
        raise _Refused("the file is cut off")

    def _do(self, name: str, argument: object) -> None:
        push = self._stack.append
        if name in _PUSHES:
            push(argument)
        elif name in _OLD_TEXTS:
            # An array's bytes among them; texts of Python 2 are not told apart.
            push(argument.encode(_LATIN) if isinstance(argument, str) else argument)
        elif name in _CONSTANTS:
            push(_CONSTANTS[name])
        elif name in _EMPTY:
            push(_EMPTY[name]())
        elif name in _TUPLES:
            push(self._last(_TUPLES[name]))
        elif name == "MARK":
            push(_MARK)
        elif name in ("PROTO", "FRAME"):
            pass
        elif name in _MEMO:
            _MEMO[name](self, argument)
        elif name in _BUILDS:
            _BUILDS[name](self, argument)
        else:
            raise _Refused(
                f"it does more than hold data (opcode {name}); only arrays and plain "
                "containers are read"
            )

    def _last(self, count: int) -> tuple:
        if count > len(self._stack):
            raise IndexError
        last = self._stack[len(self._stack) - count :]
        del self._stack[len(self._stack) - count :]
        return tuple(last)

    def _since_mark(self) -> list:
        for index in range(len(self._stack) - 1, -1, -1):
            if self._stack[index] is _MARK:
                items = self._stack[index + 1 :]
                del self._stack[index:]
                return items
        raise IndexError

    # memo

    def _put(self, argument: object) -> None:
        self._memo[int(argument)] = self._stack[-1]

    def _memoize(self, argument: object) -> None:
        self._memo[len(self._memo)] = self._stack[-1]

    def _get(self, argument: object) -> None:
        self._stack.append(self._memo[int(argument)])

    # containers

    def _pop(self, argument: object) -> None:
        self._stack.pop()

    def _pop_mark(self, argument: object) -> None:
        self._since_mark()

    def _dup(self, argument: object) -> None:
        self._stack.append(self._stack[-1])

    def _tuple(self, argument: object) -> None:
        self._stack.append(tuple(self._since_mark()))

    def _list(self, argument: object) -> None:
        self._stack.append(self._since_mark())

    def _dict(self, argument: object) -> None:
        items = self._since_mark()
        self._stack.append(dict(zip(items[::2], items[1::2], strict=True)))

    def _frozenset(self, argument: object) -> None:
        self._stack.append(frozenset(self._since_mark()))

    def _append(self, argument: object) -> None:
        value = self._stack.pop()
        self._target(list).append(value)

    def _appends(self, argument: object) -> None:
        items = self._since_mark()
        self._target(list).extend(items)

    def _add_items(self, argument: object) -> None:
        items = self._since_mark()
        self._target(set).update(items)

    def _set_item(self, argument: object) -> None:
        key, value = self._last(2)
        self._target(dict)[key] = value

    def _set_items(self, argument: object) -> None:
        items = self._since_mark()
        self._target(dict).update(zip(items[::2], items[1::2], strict=True))

    def _target(self, kind: type):
        target = self._stack[-1]
        if not isinstance(target, kind):
            raise TypeError
        return target

    # names

    def _global(self, argument: str) -> None:
        module, _, name = argument.partition(" ")
        self._named(module, name)

    def _stack_global(self, argument: object) -> None:
        module, name = self._last(2)
        self._named(module, name)

    def _named(self, module: object, name: object) -> None:
        found = _KNOWN.get((module, name)) if isinstance(name, str) else None
        if found is None:
            hint = ""
            if str(module).split(".")[0] == "torch":
                hint = "; save tensors as arrays (`.numpy()`) first"
            raise _Refused(
                f"it names {str(module)[:60]}.{str(name)[:60]}, which is no plain data "
                "and could run code when it is loaded; only arrays and plain "
                f"containers are read{hint}"
            )
        self._stack.append(found)

    def _reduce(self, argument: object) -> None:
        function, arguments = self._last(2)
        self._call(function, arguments)

    def _new(self, argument: object) -> None:
        self._reduce(argument)

    def _call(self, function: object, arguments: object) -> None:
        # Only functions of this file are ever on the stack; all else is data.
        if not callable(function) or function not in _CALLED:
            raise _Refused("it calls what is no function of NumPy's arrays")
        if not isinstance(arguments, tuple):
            raise TypeError
        self._stack.append(function(*arguments))

    def _build(self, argument: object) -> None:
        state = self._stack.pop()
        target = self._stack[-1]
        if isinstance(target, _JoblibArray):
            target.value = self._joblib_array(dict(state))
        elif isinstance(target, _Array):
            version, shape, dtype, fortran, data = state
            if not isinstance(dtype, _Type) or not isinstance(data, bytes | bytearray):
                raise _Refused("it has an array of objects, which are no numbers")
            target.value = _shaped(data, dtype.value, shape, bool(fortran))
        elif isinstance(target, _Type):
            target.set_state(state)
        else:
            raise _Refused("it sets the attributes of what is no array")

    def _joblib_array(self, state: dict) -> np.ndarray:
        """What follows in the file: perhaps padding, then the numbers."""
        if state.get("subclass") is not _NDARRAY or not isinstance(
            state.get("dtype"), _Type
        ):
            raise _Refused(
                "it has a subclass of NumPy's arrays, or an array of objects"
            )
        dtype, shape = state["dtype"].value, state.get("shape")
        if state.get("numpy_array_alignment_bytes") is not None:
            padding = self._file.read(1)
            self._file.read(padding[0])
        if not isinstance(shape, tuple):
            raise TypeError
        size = math.prod(shape) * dtype.itemsize
        if not 0 <= size <= LARGEST:
            raise _Refused("an array has an impossible size")
        data = self._file.read(size)
        if len(data) < size:
            raise _Refused("the file is cut off")
        return _shaped(data, dtype, shape, state.get("order") == "F")


_MEMO = {
    "PUT": _Reader._put,
    "BINPUT": _Reader._put,
    "LONG_BINPUT": _Reader._put,
    "MEMOIZE": _Reader._memoize,
    "GET": _Reader._get,
    "BINGET": _Reader._get,
    "LONG_BINGET": _Reader._get,
}
_BUILDS = {
    "POP": _Reader._pop,
    "POP_MARK": _Reader._pop_mark,
    "DUP": _Reader._dup,
    "TUPLE": _Reader._tuple,
    "LIST": _Reader._list,
    "DICT": _Reader._dict,
    "FROZENSET": _Reader._frozenset,
    "APPEND": _Reader._append,
    "APPENDS": _Reader._appends,
    "ADDITEMS": _Reader._add_items,
    "SETITEM": _Reader._set_item,
    "SETITEMS": _Reader._set_items,
    "GLOBAL": _Reader._global,
    "STACK_GLOBAL": _Reader._stack_global,
    "REDUCE": _Reader._reduce,
    "NEWOBJ": _Reader._new,
    "BUILD": _Reader._build,
}
