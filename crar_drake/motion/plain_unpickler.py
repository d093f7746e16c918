"""Python's own reader of pickles, kept to what builds plain data.

Of its opcodes those remain that build containers, numbers and texts. What a file names
is looked up in a short list (`pickled_arrays.KNOWN`); nothing is imported. What could
take long is asked first: keys are hashed only if that is quick, and arrays are as large
as their bytes.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import struct
from collections.abc import Callable, Iterable

import numpy as np

from crar_drake.motion.pickled_arrays import (
    CALLED,
    KNOWN,
    MOST_NUMBER_KEYS,
    NDARRAY,
    ArrayInMaking,
    JoblibArray,
    RefusedPickle,
    TypeInMaking,
    check_keys,
    check_shape,
    shaped,
)

# What calls may copy: twice the file for arrays' bytes that are written as text, and as
# much again. A small file can hand the same bytes to a call as often as it likes.
_MOST_COPIES, _FEW_COPIES = 4, 2**20

# Containers in each other, and entries if each is counted wherever it is referred to: a
# small file can refer to a list so often that to go through it would take for ever.
_DEEPEST = 30
_MOST_ENTRIES = 50_000_000

# Containers in one file: a motion's numbers are in arrays, or in a list a frame. What
# is nothing but containers in containers is refused before they are all made.
_MOST_CONTAINERS = 1_000_000

_SIMPLE = (bool, int, float, complex, str, bytes, bytearray, np.generic)
_CONTAINERS = (dict, list, tuple, set, frozenset)

# Python's own class in Python: that in C cannot be kept from hashing what it reads.
_PYTHONS = pickle._Unpickler


class PlainUnpickler(_PYTHONS):
    """Reads one pickle.

    Attributes:
        known: what stands for a name that the file has, by module and name.
        called: which of those are functions.
    """

    known, called = KNOWN, CALLED

    def __init__(self, data: bytes) -> None:
        """
        Args:
            data: the whole file, unpacked; no opcode can ask for more.
        """
        self._data = io.BytesIO(data)
        self._size = len(data)
        self._copied = self._number_keys = self._containers = 0
        # Texts of Python 2 stay bytes: an array's numbers are among them.
        super().__init__(self._data, encoding="bytes")

    def load(self) -> object:
        """What is in the file.

        Raises:
            RefusedPickle: it is more than data, or damaged.
        """
        try:
            return _Finish()(super().load())[0]
        except RecursionError:
            raise RefusedPickle("its containers are too many deep") from None
        except MemoryError:
            raise RefusedPickle("it is larger than the memory") from None
        except (EOFError, struct.error):
            raise RefusedPickle("the file is cut off") from None
        except (TypeError, AttributeError, LookupError) as error:
            if "unhashable" in str(error):
                raise RefusedPickle(
                    "a dict has keys that are no plain values"
                ) from None
            raise RefusedPickle("it is a damaged pickle") from None
        except (pickle.UnpicklingError, ValueError, OverflowError) as error:
            raise RefusedPickle(
                f"it is no pickle, or one that is damaged or cut off ({error})"
            ) from None

    def find_class(self, module: str, name: str) -> object:
        """The stand-in of what the file names.

        Raises:
            RefusedPickle: the name is none of those that NumPy and joblib write.
        """
        if (module, name) in self.known:
            return self.known[module, name]
        hint = ""
        if module.split(".")[0] == "torch":
            hint = "; save tensors as arrays (`.numpy()`) first"
        raise RefusedPickle(
            f"it names {module[:60]}.{name[:60]}, which is no plain data and could run "
            f"code when it is loaded; only arrays and plain containers are read{hint}"
        )

    # containers with keys ----------------------------------------------------------

    def _check_keys(self, keys: Iterable[object]) -> None:
        """`check_keys`, and the numbers of the whole file are not too many."""
        self._number_keys += check_keys(keys)
        if self._number_keys > MOST_NUMBER_KEYS:
            raise RefusedPickle("its dicts have too many numbers as keys")

    def _target(self, kind: type):
        target = self.stack[-1]
        if not isinstance(target, kind):
            raise TypeError
        return target

    def _dict(self) -> None:
        items = self.pop_mark()
        self._check_keys(items[::2])
        self.append(dict(zip(items[::2], items[1::2], strict=True)))

    def _set_item(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self._check_keys([key])
        self._target(dict)[key] = value

    def _set_items(self) -> None:
        items = self.pop_mark()
        self._check_keys(items[::2])
        self._target(dict).update(zip(items[::2], items[1::2], strict=True))

    def _frozenset(self) -> None:
        items = self.pop_mark()
        self._check_keys(items)
        self.append(frozenset(items))

    def _add_items(self) -> None:
        items = self.pop_mark()
        self._check_keys(items)
        self._target(set).update(items)

    # calls -------------------------------------------------------------------------

    def _bytearray8(self) -> None:
        # Python's own makes one of the announced size before it reads.
        size = int.from_bytes(self.read(8), "little")
        if size > self._size:
            raise EOFError
        self.append(bytearray(self.read(size)))

    def _call(self) -> None:
        arguments, function = self.stack.pop(), self.stack.pop()
        # Only functions of `pickled_arrays` are ever on the stack; all else is data.
        if not callable(function) or function not in self.called:
            raise RefusedPickle("it calls what is no function of NumPy's arrays")
        if not isinstance(arguments, tuple):
            raise TypeError
        self._count_copied(*arguments)
        made = function(*arguments)
        if isinstance(made, dict | set | frozenset):
            self._check_keys(made)
        self.append(made)

    def _count_copied(self, *arguments: object) -> None:
        """Adds what a call copies; few bytes can ask for it again and again."""
        self._copied += sum(
            len(argument)
            for argument in arguments
            if isinstance(argument, str | bytes | bytearray | list)
        )
        if self._copied > _MOST_COPIES * self._size + _FEW_COPIES:
            raise RefusedPickle("it copies the same data too often")

    def _build(self) -> None:
        state = self.stack.pop()
        target = self.stack[-1]
        if isinstance(target, JoblibArray):
            if not isinstance(state, dict):
                raise TypeError
            target.value = self._joblib_array(state)
        elif isinstance(target, ArrayInMaking):
            version, shape, dtype, fortran, data = state
            if shape == () and isinstance(data, list) and len(data) == 1:
                if not isinstance(data[0], dict):
                    raise RefusedPickle("it has an object that is no dict")
                target.dict = data[0]
                return
            if not isinstance(dtype, TypeInMaking) or not isinstance(
                data, bytes | bytearray
            ):
                raise RefusedPickle("it has an array of objects, which are no numbers")
            self._count_copied(data)
            target.value = shaped(data, dtype.value, shape, bool(fortran))
        elif isinstance(target, TypeInMaking):
            target.set_state(state)
        else:
            raise RefusedPickle("it sets the attributes of what is no array")

    def _joblib_array(self, state: dict) -> np.ndarray:
        """What follows in the file: perhaps padding, then the numbers."""
        if state.get("subclass") is not NDARRAY or not isinstance(
            state.get("dtype"), TypeInMaking
        ):
            raise RefusedPickle(
                "it has a subclass of NumPy's arrays, or an array of objects"
            )
        dtype, shape = state["dtype"].value, state.get("shape")
        if state.get("numpy_array_alignment_bytes") is not None:
            padding = self._data.read(1)
            self._data.read(padding[0])
        check_shape(shape)
        size = math.prod(shape) * dtype.itemsize
        # Asked before memory is: a few bytes can claim any size.
        if not 0 <= size <= self._size - self._data.tell():
            raise RefusedPickle(
                "an array is larger than the file, which may be cut off"
            )
        data = self._data.read(size)
        return shaped(data, dtype, shape, state.get("order") == "F")


def _refusing(name: str) -> Callable[[PlainUnpickler], None]:
    def refuse(reader: PlainUnpickler) -> None:
        raise RefusedPickle(
            f"it does more than hold data (opcode {name}); only arrays and plain "
            "containers are read"
        )

    return refuse


def _unknown(reader: PlainUnpickler) -> None:
    raise pickle.UnpicklingError("a byte that is no opcode")


def _counted(code: int) -> Callable[[PlainUnpickler], None]:
    pythons = _PYTHONS.dispatch[code]

    def count(reader: PlainUnpickler) -> None:
        reader._containers += 1
        if reader._containers > _MOST_CONTAINERS:
            raise RefusedPickle(
                f"it has more than {_MOST_CONTAINERS} containers; save its numbers as "
                "arrays"
            )
        pythons(reader)

    return count


# Opcodes whose way is Python's own: they push, copy references, or end.
_AS_PYTHON = {
    *("PROTO", "FRAME", "STOP", "POP", "POP_MARK", "DUP"),
    *("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE", "GET", "BINGET", "LONG_BINGET"),
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4"),
    *("FLOAT", "BINFLOAT", "NONE", "NEWTRUE", "NEWFALSE"),
    *("STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE"),
    *("SHORT_BINUNICODE", "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8"),
    *("APPEND", "APPENDS"),
    *("GLOBAL", "STACK_GLOBAL"),  # by find_class
}
# The same, which make a container.
_COUNTED = {
    *("MARK", "EMPTY_LIST", "EMPTY_DICT", "EMPTY_SET", "EMPTY_TUPLE"),
    *("LIST", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"),
}
_OURS = {
    "DICT": PlainUnpickler._dict,
    "SETITEM": PlainUnpickler._set_item,
    "SETITEMS": PlainUnpickler._set_items,
    "FROZENSET": PlainUnpickler._frozenset,
    "ADDITEMS": PlainUnpickler._add_items,
    "BYTEARRAY8": PlainUnpickler._bytearray8,
    "REDUCE": PlainUnpickler._call,
    "NEWOBJ": PlainUnpickler._call,
    "BUILD": PlainUnpickler._build,
}
PlainUnpickler.dispatch = dict.fromkeys(range(256), _unknown)
for _opcode in pickletools.opcodes:
    _code, _name = ord(_opcode.code), _opcode.name
    if _name in _AS_PYTHON:
        PlainUnpickler.dispatch[_code] = _PYTHONS.dispatch[_code]
    elif _name in _COUNTED:
        PlainUnpickler.dispatch[_code] = _counted(_code)
    else:
        PlainUnpickler.dispatch[_code] = _OURS.get(_name, _refusing(_name))


class _Finish:
    """Puts arrays where they are being built, in a tree without end or excess."""

    def __init__(self) -> None:
        self._done: dict[int, tuple[object, int]] = {}
        self._open: set[int] = set()

    def __call__(self, value: object) -> tuple[object, int]:
        """The value, and its number of entries."""
        if value is None or isinstance(value, _SIMPLE):
            return value, 1
        if isinstance(value, ArrayInMaking):
            if value.dict is not None:
                return self(value.dict)
            if value.value is None:
                raise RefusedPickle("it has an array without numbers")
            return value.value, 1
        if not isinstance(value, _CONTAINERS):
            raise RefusedPickle("it has something that is no plain data")
        if id(value) in self._done:
            return self._done[id(value)]
        if id(value) in self._open or len(self._open) > _DEEPEST:
            raise RefusedPickle("its containers hold each other, or are too many deep")
        self._open.add(id(value))
        self._done[id(value)] = self._container(value)
        self._open.discard(id(value))
        return self._done[id(value)]

    def _container(self, value) -> tuple[object, int]:
        if isinstance(value, dict):
            keys = [self(key) for key in value]
            items = [self(item) for item in value.values()]
            if any(isinstance(key, np.ndarray) for key, _ in keys):
                raise RefusedPickle("a dict has keys that are no plain values")
            size = 1 + sum(n for _, n in keys) + sum(n for _, n in items)
            finished = {k: x for (k, _), (x, _) in zip(keys, items, strict=True)}
        else:
            items = [self(item) for item in value]
            size = 1 + sum(n for _, n in items)
            finished = type(value)(x for x, _ in items)
        if size > _MOST_ENTRIES:
            raise RefusedPickle("it has too many entries")
        return finished, size
