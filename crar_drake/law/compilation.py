"""Compiles the equations with Numba.

The functions of this package are written in the part of NumPy that Numba compiles. What
is compiled is kept in the user's cache, so that only the first process compiles.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numba
from numba.core import event
from numba.experimental import structref

from crar_drake.law.programs import Program, compiled

COMPILING = "compiling for this computer, once: this takes some minutes"

_REPORTED_EVERY = 5.0  # [s]


@structref.register
class HeldType(numba.types.StructRef):
    """Numba's type of a `Held`."""

    def preprocess_fields(self, fields):
        return tuple((name, numba.types.unliteral(kind)) for name, kind in fields)


class Held(structref.StructRefProxy):
    """A value, of any type that the equations take, that stays where it is.

    Handing a compiled function a tuple takes a microsecond for each of its arrays; a
    `Held` takes as long as two, whatever is in it. Made by `hold`.
    """

    # Asked twice of every argument: the inherited property takes a Python call.
    _numba_type_ = structref.StructRefProxy._type

    def __new__(cls, value: Any):
        return hold(value)

    @property
    def value(self) -> Any:
        """What is held, usually a NamedTuple of arrays."""
        return _held(self)


structref.define_proxy(Held, HeldType, ["value"])


@compiled
def hold(value: Any) -> Held:
    """A `Held` with the value, to be handed to compiled functions again and again."""
    return Held(value)


@compiled
def _held(holder):
    return holder.value


class _Teller(event.Listener):
    """Tells that Numba compiles: on stderr once, unless `when_compiling`."""

    count, begun, told, said = 0, 0.0, 0.0, False

    def __init__(self) -> None:
        self.tellers: list[Callable[[str], None]] = []  # of blocks; the last is used

    def on_start(self, of: event.Event) -> None:
        now, tell = time.monotonic(), next(reversed(self.tellers), None)
        if not self.begun and isinstance(of.data["dispatcher"], Program):
            self.count, self.begun, self.told = 0, now, now
            if tell:
                tell(COMPILING)
            elif not self.said:
                self.said = True
                with suppress(OSError, ValueError, AttributeError):  # closed, or none
                    print(f"crar_drake: {COMPILING}", file=sys.stderr, flush=True)
        elif self.begun and tell and now - self.told >= _REPORTED_EVERY:
            self.told, passed = now, now - self.begun
            tell(f"{self.count} functions compiled in {passed:.0f} s")

    def on_end(self, _: event.Event) -> None:
        self.count += 1


_teller = _Teller()
event.register("numba:compile", _teller)


@contextmanager
def when_compiling(tell: Callable[[str], None]) -> Iterator[None]:
    """Tells of it in sentences if Numba compiles anything within the block. Outside of
    one a line on stderr says so, once. Of several blocks, which may end in any order,
    the one begun last is told.

    Args:
        tell: is called with one at the first function, and every few seconds from then
            on with how many are compiled.
    """
    _teller.tellers.append(tell)
    _teller.begun = 0.0
    try:
        yield
    finally:
        _teller.tellers.remove(tell)
        _teller.begun = 0.0
