"""An interpreter of those of a pickle's opcodes that build plain data."""

from __future__ import annotations

import io
import math
import pickletools

import numpy as np

from crar_drake.references.pickled_arrays import (
    CALLED,
    KNOWN,
    NDARRAY,
    ArrayInMaking,
    JoblibArray,
    RefusedPickle,
    TypeInMaking,
    shaped,
)

# More is no motion.
_MOST_OPCODES = 20_000_000

_LATIN = "latin1"

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
        if isinstance(value, ArrayInMaking):
            if value.value is None:
                raise RefusedPickle("it has an array without numbers")
            return value.value, 1
        if value is None or isinstance(value, _SIMPLE):
            return value, 1
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


_SIMPLE = (bool, int, float, complex, str, bytes, bytearray, np.generic)
_CONTAINERS = (dict, list, tuple, set, frozenset)


class PickleReader:
    def __init__(self, file: io.BufferedReader | io.BytesIO) -> None:
        """
        Args:
            file: at its beginning; it is closed by `read`.
        """
        self._file = file
        self._size = file.seek(0, io.SEEK_END)
        file.seek(0)
        self._stack: list = []
        self._memo: dict[int, object] = {}

    def read(self) -> object:
        """What is in the file.

        Raises:
            RefusedPickle: it is more than data, or damaged.
        """
        with self._file:
            try:
                return self._run()
            except (IndexError, KeyError, TypeError, AttributeError) as error:
                if isinstance(error, TypeError) and "unhashable" in str(error):
                    raise RefusedPickle(
                        "a dict has keys that are no plain values"
                    ) from None
                raise RefusedPickle("it is a damaged pickle") from None
            except (ValueError, EOFError, UnicodeDecodeError, OverflowError) as error:
                # pickletools: an unknown opcode, or fewer bytes than were announced.
                raise RefusedPickle(
                    f"it is no pickle, or one that is damaged or cut off ({error})"
                ) from None
            except MemoryError:
                raise RefusedPickle("it is larger than the memory") from None

    def _run(self) -> object:
        for number, (opcode, argument, _) in enumerate(pickletools.genops(self._file)):
            if number > _MOST_OPCODES:
                raise RefusedPickle("it has too many parts")
            if opcode.name == "STOP":
                return _Finish()(self._stack.pop())[0]
            self._do(opcode.name, argument)
        raise RefusedPickle("the file is cut off")

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
            raise RefusedPickle(
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
        found = KNOWN.get((module, name)) if isinstance(name, str) else None
        if found is None:
            hint = ""
            if str(module).split(".")[0] == "torch":
                hint = "; save tensors as arrays (`.numpy()`) first"
            raise RefusedPickle(
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
        if not callable(function) or function not in CALLED:
            raise RefusedPickle("it calls what is no function of NumPy's arrays")
        if not isinstance(arguments, tuple):
            raise TypeError
        self._stack.append(function(*arguments))

    def _build(self, argument: object) -> None:
        state = self._stack.pop()
        target = self._stack[-1]
        if isinstance(target, JoblibArray):
            target.value = self._joblib_array(dict(state))
        elif isinstance(target, ArrayInMaking):
            version, shape, dtype, fortran, data = state
            if not isinstance(dtype, TypeInMaking) or not isinstance(
                data, bytes | bytearray
            ):
                raise RefusedPickle("it has an array of objects, which are no numbers")
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
            padding = self._file.read(1)
            self._file.read(padding[0])
        if not isinstance(shape, tuple):
            raise TypeError
        size = math.prod(shape) * dtype.itemsize
        # Asked before memory is: a few bytes can claim any size.
        if not 0 <= size <= self._size - self._file.tell():
            raise RefusedPickle(
                "an array is larger than the file, which may be cut off"
            )
        data = self._file.read(size)
        return shaped(data, dtype, shape, state.get("order") == "F")


_MEMO = {
    "PUT": PickleReader._put,
    "BINPUT": PickleReader._put,
    "LONG_BINPUT": PickleReader._put,
    "MEMOIZE": PickleReader._memoize,
    "GET": PickleReader._get,
    "BINGET": PickleReader._get,
    "LONG_BINGET": PickleReader._get,
}
_BUILDS = {
    "POP": PickleReader._pop,
    "POP_MARK": PickleReader._pop_mark,
    "DUP": PickleReader._dup,
    "TUPLE": PickleReader._tuple,
    "LIST": PickleReader._list,
    "DICT": PickleReader._dict,
    "FROZENSET": PickleReader._frozenset,
    "APPEND": PickleReader._append,
    "APPENDS": PickleReader._appends,
    "ADDITEMS": PickleReader._add_items,
    "SETITEM": PickleReader._set_item,
    "SETITEMS": PickleReader._set_items,
    "GLOBAL": PickleReader._global,
    "STACK_GLOBAL": PickleReader._stack_global,
    "REDUCE": PickleReader._reduce,
    "NEWOBJ": PickleReader._new,
    "BUILD": PickleReader._build,
}
