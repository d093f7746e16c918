"""Compiles the equations with Numba: once what call one another, and for good.

The functions of this package are written in the part of NumPy that Numba compiles. What
is compiled is kept in the user's cache, so that only the first process compiles.

*Linked once.* Numba optimises every compiled function, and makes machine code of it,
together with all that it calls: what is called through five others is optimised and
written six times. So each function here has two forms. Called from Python it is
compiled as by `numba.njit`. Compiled for a call from another one it is a *part*: it
gets no wrapper for Python, and stays as Numba wrote it until it is linked into what is
called from Python, where all is optimised at once. Numba's own functions, which ours
call, become parts as well. For the law of the main command's scenario, Numba alone
takes 117 s of processor time; linked once, it takes 51 s. The means are Numba's: a
compiler class with another library for the code
(https://numba.readthedocs.io/en/stable/developer/custom_pipeline.html). They are its
insides, too, so that pyproject.toml allows the versions that were looked at.

*Kept.* Numba's own cache looks at the file of a function only, but a compiled function
contains those that it calls, and the constants that it uses; it depends on where the
source lies, and trusts what it reads. Here what is damaged counts as not there, and is
compiled again; what cannot be written, on a full disk or one that is read only, is said
once.
"""

import gc
import hashlib
import logging
import pickle
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding, ir
from numba.core import cgutils, event, serialize, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.experimental import structref

from crar_drake.errors import WriteError
from crar_drake.files import turn_to_write, whole_file
from crar_drake.interrupts import undisturbed
from crar_drake.kept_files import digest_of, mark_used, remove_unused
from crar_drake.resources import cached

COMPILING = "compiling for this computer, once: this takes some minutes"

_REPORTED_EVERY = 5.0  # [s]

_PACKAGE = Path(__file__).parents[1]
_IMPORT = re.compile(r"^\s*from crar_drake\.(\S+) import (\([^)]*|.*)", re.MULTILINE)
# Of the variables by which functions find what surrounds them in Python.
_ENVIRONMENT = "_ZN08NumbaEnv"


class Part(JITCodeLibrary):
    """The code of a part: linked into other libraries, no machine code of its own."""

    def add_llvm_module(self, ll_module) -> None:
        self._final_module.link_in(ll_module)

    def finalize(self) -> None:
        self._raise_if_finalized()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        # The same function may come with several that call it.
        _relink(self._final_module, binding.Linkage.external, "linkonce_odr")
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        # Numba goes on by writing to these variables, so they have to be somewhere.
        variables = self._codegen._create_empty_module(self.name)
        for each in self._final_module.global_variables:
            if each.name.startswith(_ENVIRONMENT):
                variable = ir.GlobalVariable(variables, cgutils.voidptr_t, each.name)
                variable.linkage = "common"
                variable.initializer = ir.Constant(cgutils.voidptr_t, None)
        self._codegen._add_module(binding.parse_assembly(str(variables)))
        return 0  # as of any function without a wrapper

    def _get_module_for_linking(self):
        """The part with all that it calls, for others than a `Whole`."""
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            _link(self._linking_libraries, self._shared_module)
        return self._shared_module


class Whole(JITCodeLibrary):
    """The code of what is called from Python, with that of all its parts."""

    def finalize(self) -> None:
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        _link(self._linking_libraries, self._final_module)
        self._linking_libraries = []
        super().finalize()

    def _optimize_final_module(self) -> None:
        """In one go, and less than Numba does: on arrays of a dozen numbers more gains
        nothing that could be measured."""
        passes, builder = self._codegen._module_pass_manager(
            opt=1, loop_vectorize=False, slp_vectorize=False
        )
        with self._recorded_timings.record("Module passes", builder):
            passes.run(self._final_module, builder)


def _link(libraries: list, module: binding.ModuleRef) -> None:
    """Links libraries, and those that parts among them call, each once, by twos:
    whatever is linked into something, all of that is gone through anew."""
    called, linked = list(dict.fromkeys(libraries)), []
    for library in called:  # grows
        if isinstance(library, Part):
            called += [x for x in library._linking_libraries if x not in called]
            linked.append(library._final_module.clone())
        else:
            linked.append(library._get_module_for_linking().clone())
        # What nobody calls yet would be left out.
        _relink(linked[-1], binding.Linkage.linkonce_odr, "weak_odr")
    while len(linked) > 1:
        # The last one of an odd number waits.
        for one, other in zip(linked[::2], linked[1::2], strict=False):
            one.link_in(other)
        linked = linked[::2]
    for each in linked:
        module.link_in(each)
    _relink(module, binding.Linkage.weak_odr, "linkonce_odr")


def _relink(module: binding.ModuleRef, old: binding.Linkage, new: str) -> None:
    """Gives the module's functions with one linkage another one."""
    for function in module.functions:
        if not function.is_declaration and function.linkage == old:
            function.linkage = new


class ProgramCompiler(Compiler):
    """Compiles functions to what is called from Python, of parts."""

    def compile_extra(self, func):
        codegen = self.state.targetctx.codegen()
        library = Whole(codegen, func.__qualname__)
        library.enable_object_caching()
        self.state.library = library
        # Numba's own functions, which ours call, are parts like these.
        codegen._library_class = Part
        try:
            return super().compile_extra(func)
        finally:
            del codegen._library_class


class Program(CPUDispatcher):
    """What stands for a function: compiled where it is called from Python, its part
    where it is called by another one."""

    def compile(self, sig):
        """As Numba does, but processes that need the same compile it once: the others
        wait, and find it."""
        with ExitStack() as stack:
            # A KeyboardInterrupt between LLVM's taking a module and Python's letting
            # it go has it freed twice, and one while LLVM hands code over is lost.
            stack.enter_context(undisturbed("compiled"))
            stack.enter_context(global_compiler_lock)
            # Compiling makes millions of objects that stay for long: to go through all
            # of them again and again takes longer than all the rest.
            stack.callback(gc.set_threshold, *gc.get_threshold())
            gc.set_threshold(100_000, 50, 1000)
            # Where nothing can be written, nobody has to wait.
            with suppress(WriteError):
                stack.enter_context(turn_to_write(self._cache.cache_path))
            return super().compile(sig)

    @cached_property
    def part(self) -> CPUDispatcher:
        """The function as compiled ones call it."""
        options = self.targetoptions | {"no_cpython_wrapper": True}
        return CPUDispatcher(self.py_func, targetoptions=options)

    @property
    def _numba_type_(self) -> types.Dispatcher:
        return types.Dispatcher(self.part)


def compiled(function: Callable) -> Program:
    """Decorator: the function, compiled at its first call, and kept.

    As by `numba.njit(error_model="numpy")`, but see the top of the file.

    Args:
        function: in the part of NumPy that Numba compiles.
    """
    options = {
        "nopython": True,
        "boundscheck": None,
        "error_model": "numpy",
        "no_cfunc_wrapper": True,
    }
    made = Program(function, targetoptions=options, pipeline_class=ProgramCompiler)
    made._cache = Kept(function)
    return made


class Kept:
    """What was compiled of one function: what Numba asks of a cache.

    A file for each signature begins with a digest of what is in it: machine code of
    which a bit is wrong could do anything.
    """

    def __init__(self, function: Callable) -> None:
        if function.__closure__:
            raise TypeError(f"{function} is not made of its sources alone")
        folder = cache_folder(Path(function.__code__.co_filename))
        self.cache_path = folder / function.__qualname__
        self._line = function.__code__.co_firstlineno

    def load_overload(self, signature, target) -> CompileResult | None:
        """What was kept for a signature; None if nothing that can be used, as of a type
        that stands in another file by now."""
        target.refresh()
        with suppress(OSError, ImportError, AttributeError):
            digest, _, content = (
                self._file(signature, target).read_bytes().partition(b"\n")
            )
            if hashlib.sha256(content).hexdigest().encode() == digest:
                return CompileResult._rebuild(target, *pickle.loads(content))
        return None

    def save_overload(self, signature, result: CompileResult) -> None:
        """Keeps what was compiled, if that can be done."""
        if result.library.has_dynamic_globals:
            return  # places in this process's memory
        content = serialize.dumps(result._reduce())
        digest = hashlib.sha256(content).hexdigest().encode()
        try:
            with whole_file(self._file(signature, result.target_context)) as path:
                path.write_bytes(digest + b"\n" + content)
        except WriteError as error:
            _say_once(self.cache_path.parents[1], error)

    def _file(self, signature, target) -> Path:
        known = f"{self._line} {signature} {target.codegen().magic_tuple()}"
        return self.cache_path / hashlib.sha256(known.encode()).hexdigest()[:32]


_SAID: set[Path] = set()  # folders of which it was said that nothing is kept there


def _say_once(folder: Path, error: WriteError) -> None:
    if folder not in _SAID:
        _SAID.add(folder)
        logging.getLogger("crar_drake").warning(
            f"what is compiled cannot be kept ({error}): every process compiles it "
            "again; NUMBA_CACHE_DIR names another folder"
        )


@cache
def _imported(source: Path) -> frozenset[Path]:
    """The files of the package that a file takes names from."""
    found = set()
    for module, names in _IMPORT.findall(source.read_text(encoding="utf-8")):
        place = _PACKAGE.joinpath(*module.split("."))
        inside = ("__init__", *re.findall(r"\w+", names)) if place.is_dir() else ()
        found |= {place.with_suffix(".py"), *(place / f"{name}.py" for name in inside)}
    return frozenset(place for place in found if place.is_file())


def sources_of(source: Path) -> list[Path]:
    """All files that what is compiled of a file can be made of: itself, those of the
    package that it takes names from, and those that these do."""
    found, left = {source}, [source]
    while left:
        more = _imported(left.pop()) - found
        found |= more
        left += more
    return sorted(found)


@cache
def cache_folder(source: Path) -> Path:
    """Where the compiled functions of a file are kept: another folder for other
    `sources_of` it, and for another Numba or Python.

    In the user's cache, or in NUMBA_CACHE_DIR where that is set. A new folder in the
    user's cache takes the places of those that nobody used for long. All copies of the
    sources find what one has compiled.
    """
    theirs = numba.config.CACHE_DIR
    by = f"{numba.__version__}-{sys.implementation.cache_tag}"
    name = f"{source.stem}-{by}-{digest_of(sources_of(source))[:16]}"
    folder = (Path(theirs) if theirs else cached("compiled")) / name
    if folder.is_dir():
        mark_used(folder)
    elif not theirs:
        remove_unused(folder.parent)
    return folder


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
