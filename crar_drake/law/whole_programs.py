"""Functions that compiled ones call become machine code with these, once.

Numba optimises every compiled function, and makes machine code of it, together with
all that it calls: what is called through five others is optimised and written six
times. But most of the equations are called by other equations only. So each function
here has two forms. Called from Python it is compiled as by `numba.njit`. Compiled for
a call from another one it is a *part*: it gets no wrapper for Python, and stays as
Numba wrote it until it is linked into what is called from Python, where all is
optimised at once. Numba's own functions, which ours call, become parts as well.

The means are Numba's own: a compiler class with another library for the code
(https://numba.readthedocs.io/en/stable/developer/custom_pipeline.html). They are its
insides, too, so that pyproject.toml allows the versions that were looked at.
"""

import gc
from contextlib import ExitStack, suppress
from functools import cached_property

from llvmlite import binding, ir
from numba.core import cgutils, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher

from crar_drake.files import WriteError, turn_to_write
from crar_drake.interrupts import undisturbed

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
    """Links libraries, and those that parts among them call, each once.

    By twos: whatever is linked into something, all of that is gone through anew.
    """
    called = list(dict.fromkeys(libraries))
    linked = []
    for library in called:  # grows
        own = library._final_module
        if isinstance(library, Part):
            called += [x for x in library._linking_libraries if x not in called]
        else:
            own = library._get_module_for_linking()
        linked.append(own.clone())
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
        return CPUDispatcher(
            self.py_func,
            targetoptions=self.targetoptions | {"no_cpython_wrapper": True},
        )

    @property
    def _numba_type_(self) -> types.Dispatcher:
        return types.Dispatcher(self.part)
