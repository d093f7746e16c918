"""Compiles the equations with Numba where it is installed.

The functions of this package are written in the part of NumPy that Numba compiles.
Without Numba, or with NUMBA_DISABLE_JIT=1 in the environment, the same source runs as
plain NumPy: the answers agree but for rounding.

What is compiled is kept in the user's cache, so that only the first process compiles.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from crar_drake.kept_files import digest_of, mark_used, remove_unused
from crar_drake.resources import cached

try:
    import numba
except ImportError:
    numba = None

IS_COMPILED = numba is not None and not numba.config.DISABLE_JIT

# `whole_programs` builds on Numba's insides, which were looked at in this version. With
# another one everything is compiled in Numba's usual way, which takes longer.
_KNOWN_INSIDE = "0.68."

COMPILING = "compiling for this computer, once: this takes some minutes"

_REPORTED_EVERY = 5.0  # [s]


def arithmetic() -> str:
    """What computes the equations, for people: "compiled by Numba ..." or "NumPy"."""
    if IS_COMPILED:
        return f"compiled by Numba {numba.__version__}"
    return "plain NumPy"


SOURCES = sorted(Path(__file__).parent.glob("*.py"))


def cache_folder() -> Path:
    """Where the compiled functions are kept: another folder for other sources.

    In the user's cache, or in NUMBA_CACHE_DIR where that is set. A new folder in the
    user's cache takes the places of those that nobody used for long.

    Numba looks at the file of a function only, but a compiled function contains those
    that it calls, and the constants that it uses.
    """
    theirs = numba.config.CACHE_DIR if numba is not None else ""
    folder = (Path(theirs) if theirs else cached("compiled")) / digest_of(SOURCES)[:16]
    if folder.is_dir():
        mark_used(folder)
    elif not theirs:
        remove_unused(folder.parent)
    return folder


_CACHE_FOLDER = cache_folder()


def _compile_quickly() -> None:
    """Makes Numba optimise our functions less than it does by default, but for loops.

    On arrays of a dozen numbers the full optimisation of array expressions gains
    nothing that could be measured, and takes most of the time of compiling. Numba has
    one setting for all: it is borrowed while a function of this package is compiled.
    """
    from numba.core import config, event

    quick = {"OPT": config._OptLevel(1), "LOOP_VECTORIZE": 0, "SLP_VECTORIZE": 0}
    usual = {name: getattr(config, name) for name in quick}
    before: list[dict] = []

    class Borrower(event.Listener):
        def on_start(self, start: event.Event) -> None:
            function = start.data["dispatcher"].py_func
            if before or function.__module__.startswith(__package__):
                before.append({name: getattr(config, name) for name in quick})
                full = function.__qualname__ in IN_LOOPS
                for name, value in (usual if full else quick).items():
                    setattr(config, name, value)

        def on_end(self, end: event.Event) -> None:
            if before:
                for name, value in before.pop().items():
                    setattr(config, name, value)

    event.register("numba:compile", Borrower())


if IS_COMPILED:
    from crar_drake.equations.kept_programs import Cache

    _compile_quickly()
    if numba.__version__.startswith(_KNOWN_INSIDE):
        from crar_drake.equations.whole_programs import IN_LOOPS, program
    else:
        IN_LOOPS: set[str] = set()

        def program(function: Callable) -> Any:
            """As of `whole_programs`."""
            return numba.njit(function, error_model="numpy")


def compiled(
    function: Callable | None = None, *, loops: Callable | bool | None = None
) -> Any:
    """Decorator: the function compiled at its first call, or as it is without Numba.

    Args:
        function: in the part of NumPy that Numba compiles.
        loops: True if it is written in loops, which are optimised in full. Or what is
            compiled in its place, the same result from loops: where the function calls
            a library that Numba does not reach, or where in plain NumPy loops would
            make a control step longer by more than 5 %.
    """
    if function is None:
        return lambda decorated: compiled(decorated, loops=loops)
    if not IS_COMPILED:
        return function
    # Numba has one setting for everybody's functions: it is only borrowed.
    theirs = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_CACHE_FOLDER)
    chosen = loops if callable(loops) else function
    if loops is not None:
        IN_LOOPS.add(chosen.__qualname__)
    chosen.__doc__ = function.__doc__
    try:
        made = program(chosen)
        made._cache = Cache(chosen)
        return made
    finally:
        numba.config.CACHE_DIR = theirs


class Held:
    """A value, of any type that the equations take, that stays where it is.

    Handing a compiled function a tuple takes a microsecond for each of its arrays; a
    `Held` takes as long as two, whatever is in it. Made by `hold`.

    Attributes:
        value: usually a NamedTuple of arrays.
    """

    def __init__(self, value: Any) -> None:
        self.value = value


def hold(value: Any) -> Held:
    """A `Held` with the value, to be handed to compiled functions again and again."""
    return Held(value)


if IS_COMPILED:
    from numba.experimental import structref

    @structref.register
    class HeldType(numba.types.StructRef):
        """Numba's type of a `Held`."""

        def preprocess_fields(self, fields):
            return tuple((name, numba.types.unliteral(kind)) for name, kind in fields)

    class Held(structref.StructRefProxy):
        """As above, where Numba keeps the value."""

        # Asked twice of every argument: the inherited property takes a Python call.
        _numba_type_ = structref.StructRefProxy._type

        def __new__(cls, value: Any):
            return hold(value)

        @property
        def value(self) -> Any:
            return _held(self)

    structref.define_proxy(Held, HeldType, ["value"])

    @compiled
    def hold(value):
        return Held(value)

    @compiled
    def _held(holder):
        return holder.value


@contextmanager
def when_compiling(tell: Callable[[str], None]) -> Iterator[None]:
    """Tells of it in sentences if Numba compiles anything within the block.

    Args:
        tell: is called with one at the first function, and every few seconds from then
            on with how many are compiled.
    """
    if not IS_COMPILED:
        yield
        return
    from numba.core import event

    class Listener(event.Listener):
        functions = 0
        start = reported = 0.0

        def on_start(self, _: event.Event) -> None:
            now = time.monotonic()
            if not self.reported:
                self.start = self.reported = now
                tell(COMPILING)
            elif now - self.reported >= _REPORTED_EVERY:
                self.reported = now
                tell(f"{self.functions} functions compiled in {now - self.start:.0f} s")

        def on_end(self, _: event.Event) -> None:
            self.functions += 1

    listener = Listener()
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)
