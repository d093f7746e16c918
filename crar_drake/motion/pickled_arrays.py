"""What the names in a pickle of NumPy or joblib stand for: arrays, numbers, containers.

Each is a function or class of this file that takes what the pickle gives it, checks it,
and makes plain data of it. Other names are not known.
"""

from __future__ import annotations

import math
import re
from collections import OrderedDict
from collections.abc import Iterable

import numpy as np

# Kinds of numbers that an array may have: truth values, integers, floats, texts.
_KINDS = "biufUS"
_TYPE_NAME = re.compile(rf"[<>|=]?[{_KINDS}][0-9]{{0,4}}")

# Texts are hashed with a secret, numbers are not: those of a file can be chosen such
# that a dict compares each with all others. Small ones cannot.
MOST_NUMBER_KEYS = 4096
_SMALL_KEY, _LARGEST_KEY = 2**16, 2**64


class RefusedPickle(Exception):
    """What is wrong with the file, without its name."""


class ArrayInMaking:
    """An array that is being built; or the dict that one without axes is put around, as
    `np.save` puts it."""

    def __init__(self) -> None:
        self.value: np.ndarray | None = None
        self.dict: dict | None = None


class TypeInMaking:
    """A NumPy type that is being built."""

    def __init__(self, name: object) -> None:
        if not isinstance(name, str):
            raise RefusedPickle("an array's type is damaged")
        if name == "O8":
            self.value = np.dtype(object)
            return
        refusal = f"it has an array of type {name[:40]!r}, which are no numbers"
        # NumPy's own reader of names knows far more, and evaluates some.
        if not _TYPE_NAME.fullmatch(name):
            raise RefusedPickle(refusal)
        try:
            self.value = np.dtype(name)
        except (TypeError, ValueError):
            raise RefusedPickle(refusal) from None

    def set_state(self, state: object) -> None:
        """(version, byte order, subtype, names, fields, size, alignment, flags)"""
        plain = (
            isinstance(state, tuple)
            and len(state) >= 5
            and state[2:5] == (None, None, None)
            and state[1] in ("<", ">", "|", "=")
        )
        if not plain:
            raise RefusedPickle("it has an array of a type that is made of others")
        if state[1] in "<>":
            self.value = self.value.newbyteorder(state[1])


class JoblibArray(ArrayInMaking):
    """The same, of what joblib writes before an array's bytes."""


# Stand-ins for what is only named, and compared with.
NDARRAY, _DICT, _LATIN = object(), object(), "latin1"


def _reconstruct(cls: object, shape: object, code: object) -> ArrayInMaking:
    if cls is not NDARRAY:
        raise RefusedPickle("it has a subclass of NumPy's arrays")
    return ArrayInMaking()


def _frombuffer(buffer: object, dtype: object, shape: object, order: object):
    if not isinstance(buffer, bytes | bytearray) or not isinstance(dtype, TypeInMaking):
        raise RefusedPickle("an array is damaged")
    array = ArrayInMaking()
    array.value = shaped(buffer, dtype.value, shape, order == "F")
    return array


def _scalar(dtype: object, data: object = b""):
    if not isinstance(dtype, TypeInMaking) or not isinstance(data, bytes):
        raise RefusedPickle("a number is damaged")
    return shaped(data, dtype.value, (), False)[()]


def _encode(text: object, encoding: object = None) -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise RefusedPickle("bytes are damaged")
    return text.encode(_LATIN)


def _dtype(name: object, *rest: object) -> TypeInMaking:
    return TypeInMaking(name)


def _ordered(*items: object) -> dict:
    if len(items) > 1 or (items and not isinstance(items[0], list)):
        raise RefusedPickle("a dict is damaged")
    pairs = items[0] if items else []
    if not all(isinstance(pair, list | tuple) and len(pair) == 2 for pair in pairs):
        raise RefusedPickle("a dict is damaged")
    check_keys(key for key, _ in pairs)
    return OrderedDict((key, value) for key, value in pairs)


def _default_dict(*arguments: object) -> dict:
    """What it has for keys that are not there is no data."""
    if arguments not in ((), (None,), (_DICT,)):
        raise RefusedPickle("a dict is damaged")
    return {}


def _container(kind: type):
    def make(*items: object):
        if len(items) > 1 or (items and not isinstance(items[0], list | bytes)):
            raise RefusedPickle("a container is damaged")
        if items and kind in (set, frozenset):
            check_keys(items[0])
        try:
            return kind(*items)
        except (TypeError, ValueError):
            raise RefusedPickle("a container is damaged") from None

    return make


KNOWN = {
    **{
        (f"{core}.{module}", name): function
        for core in ("numpy.core", "numpy._core")
        for module, name, function in (
            ("multiarray", "_reconstruct", _reconstruct),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _frombuffer),
        )
    },
    ("numpy", "ndarray"): NDARRAY,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): _ordered,
    ("collections", "defaultdict"): _default_dict,
    ("builtins", "dict"): _DICT,
    ("__builtin__", "dict"): _DICT,
    **{
        (module, kind.__name__): _container(kind)
        for module in ("builtins", "__builtin__")
        for kind in (set, frozenset, bytearray, bytes)
    },
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): JoblibArray,
}
CALLED = frozenset(KNOWN.values()) - {NDARRAY, _DICT}


def check_keys(keys: Iterable[object]) -> int:
    """Refuses what would take long to hash or compare, before that is done.

    Args:
        keys: of a dict, or what is in a set.

    Returns:
        How many are numbers that could have been chosen to make it slow.

    Raises:
        RefusedPickle: one is no text, bytes, number or None, or the numbers are too
            many or too large.
    """
    numbers = 0
    for key in keys:
        if isinstance(key, str | bytes):
            continue
        if key is not None and not isinstance(key, int | float | np.number | np.bool_):
            raise RefusedPickle("a dict has keys that are no plain values")
        if key is None or (isinstance(key, int) and abs(key) < _SMALL_KEY):
            continue
        numbers += 1
        large = isinstance(key, int) and abs(key) > _LARGEST_KEY
        if large or numbers > MOST_NUMBER_KEYS:
            raise RefusedPickle("a dict has too many or too large numbers as keys")
    return numbers


def check_shape(shape: object) -> None:
    """Refuses what is no shape of an array, before it is multiplied.

    Raises:
        RefusedPickle: it is not of up to eight lengths.
    """
    plain = (
        isinstance(shape, tuple)
        and len(shape) <= 8
        and all(isinstance(length, int) and 0 <= length < 2**48 for length in shape)
    )
    if not plain:
        raise RefusedPickle("an array is damaged")


def shaped(
    data: bytes | bytearray, dtype: np.dtype, shape: object, fortran: bool
) -> np.ndarray:
    """An array of its own from its bytes; as large as they are, whatever it says."""
    check_shape(shape)
    if dtype.hasobject:
        raise RefusedPickle("it has an array of objects, which are no numbers")
    if dtype.itemsize == 0:
        raise RefusedPickle("an array is damaged")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise RefusedPickle("an array has another size than its shape says")
    flat = np.frombuffer(bytes(data), dtype)
    array = flat.reshape(shape, order="F" if fortran else "C").copy()
    return array.astype(dtype.newbyteorder("="), copy=False)
