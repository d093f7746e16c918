"""What the names in a pickle of NumPy or joblib stand for: arrays, numbers, containers.

Each is a function or class of this file that takes what the pickle gives it, checks it,
and makes plain data of it. Other names are not known.
"""

from __future__ import annotations

import math
from collections import OrderedDict

import numpy as np

# Kinds of numbers that an array may have: truth values, integers, floats, texts.
_KINDS = "biufUS"


class RefusedPickle(Exception):
    """What is wrong with the file, without its name."""


class ArrayInMaking:
    """An array that is being built."""

    def __init__(self) -> None:
        self.value: np.ndarray | None = None


class TypeInMaking:
    """A NumPy type that is being built."""

    def __init__(self, name: object) -> None:
        if not isinstance(name, str):
            raise RefusedPickle("an array's type is damaged")
        try:
            dtype = np.dtype(name)
        except (TypeError, ValueError):
            raise RefusedPickle(f"it has an array of type {name!r}") from None
        if dtype.kind not in _KINDS or dtype.fields or dtype.shape:
            raise RefusedPickle(
                f"it has an array of type {dtype}, which are no numbers"
            )
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
            raise RefusedPickle("it has an array of a type that is made of others")
        if state[1] in "<>":
            self.value = self.value.newbyteorder(state[1])


class JoblibArray(ArrayInMaking):
    """The same, of what joblib writes before an array's bytes."""


# Stand-ins for what is only named, and compared with.
NDARRAY, _LATIN = object(), "latin1"


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
    try:
        return OrderedDict(tuple(item) for item in (items[0] if items else ()))
    except (TypeError, ValueError):
        raise RefusedPickle("a dict is damaged") from None


def _container(kind: type):
    def make(*items: object):
        if len(items) > 1 or (items and not isinstance(items[0], list | bytes)):
            raise RefusedPickle("a container is damaged")
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
    **{
        (module, kind.__name__): _container(kind)
        for module in ("builtins", "__builtin__")
        for kind in (set, frozenset, bytearray, bytes)
    },
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): JoblibArray,
}
CALLED = frozenset(function for function in KNOWN.values() if function is not NDARRAY)


def shaped(
    data: bytes | bytearray, dtype: np.dtype, shape: object, fortran: bool
) -> np.ndarray:
    """An array of its own from its bytes; as large as they are, whatever it says."""
    numbers = isinstance(shape, tuple) and all(
        isinstance(length, int) and 0 <= length < 2**48 for length in shape
    )
    if not numbers or len(shape) > 8 or dtype.itemsize == 0:
        raise RefusedPickle("an array is damaged")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise RefusedPickle("an array has another size than its shape says")
    flat = np.frombuffer(bytes(data), dtype)
    array = flat.reshape(shape, order="F" if fortran else "C").copy()
    return array.astype(dtype.newbyteorder("="), copy=False)
