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

from crar_drake.law.kept_programs import Kept
from crar_drake.law.whole_programs import Program, ProgramCompiler

COMPILING = "compiling for this computer, once: this takes some minutes"

_REPORTED_EVERY = 5.0  # [s]


def compiled(function: Callable) -> Program:
    """Decorator: the function, compiled at its first call.

    As by `numba.njit(error_model="numpy")`, but see `whole_programs`; and kept.

    Args:
        function: in the part of NumPy that Numba compiles.
    """
    made = Program(
        function,
        targetoptions={
            "nopython": True,
            "boundscheck": None,
            "error_model": "numpy",
            "no_cfunc_wrapper": True,
        },
        pipeline_class=ProgramCompiler,
    )
    made._cache = Kept(function)
    return made


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


class _Told(event.Listener):
    """Who is told that Numba compiles: on stderr once, unless somebody else wants to
    be."""

    def __init__(self) -> None:
        self.by_others: list[Callable[[str], None]] = []
        self._functions, self._start, self._reported, self._said = 0, 0.0, 0.0, False

    def on_start(self, of: event.Event) -> None:
        now = time.monotonic()
        if not self._reported:
            if not isinstance(of.data["dispatcher"], Program):
                return  # of other packages
            self._start = self._reported = now
            self._functions = 0
            self._tell(COMPILING)
        elif now - self._reported >= _REPORTED_EVERY and self.by_others:
            self._reported, passed = now, now - self._start
            self._tell(f"{self._functions} functions compiled in {passed:.0f} s")

    def on_end(self, _: event.Event) -> None:
        self._functions += 1

    def _tell(self, line: str) -> None:
        if self.by_others:
            self.by_others[-1](line)
        elif not self._said:
            self._said = True
            with suppress(OSError, ValueError, AttributeError):  # closed, or none
                print(f"crar_drake: {line}", file=sys.stderr, flush=True)

    def begin_anew(self) -> None:
        """Forgets what was told."""
        self._reported = 0.0


_told = _Told()
event.register("numba:compile", _told)


@contextmanager
def when_compiling(tell: Callable[[str], None]) -> Iterator[None]:
    """Tells of it in sentences if Numba compiles anything within the block. Outside of
    one a line on stderr says so, once.

    Args:
        tell: is called with one at the first function, and every few seconds from then
            on with how many are compiled.
    """
    _told.by_others.append(tell)
    _told.begin_anew()
    try:
        yield
    finally:
        _told.by_others.remove(tell)
        _told.begin_anew()
