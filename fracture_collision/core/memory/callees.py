"""Compiles a kernel that another kernel calls without machine code of its own.

numba makes every compiled function callable from Python: a wrapper that unpacks all arguments (a kernel's pools are
several hundred arrays), optimized code that contains all it calls, machine code. A kernel that another one calls needs
none of that: its code is linked into the caller and optimized there. Two thirds of the compile time were spent on code
that nothing ran.

A kernel compiled as a callee keeps its own LLVM module and the list of those it calls. What is called from Python links
all of them and optimizes once. If Python calls a kernel that was compiled as a callee, it is compiled again, as usual.

This relies on numba internals: kernel_cache.py uses it, only with the versions it was tested with.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import binding as llvm
from numba.core import compiler, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

COLLECT_AFTER = 100_000  # new objects, while a kernel is compiled; Python's default is 700


class CallableFromKernels:
    """What numba finds a callee by, in place of a function that Python can call."""


class UnlinkedLibrary(JITCodeLibrary):
    """The code of one function, neither linked with what it calls nor optimized as a whole."""

    def finalize(self) -> None:
        """Nothing is added to the execution engine."""
        self._raise_if_finalized()
        self._finalize_dynamic_globals()
        self._finalized = True

    def add_linking_library(self, library: Any) -> None:
        """Also what that library left for its callers to link."""
        super().add_linking_library(library)
        self._linking_libraries += left_to_link(library)

    def as_bitcode(self) -> bytes:
        """The function and all it calls."""
        module = self._get_module_for_linking().clone()
        for library in callers_first(self._linking_libraries):
            module.link_in(library._get_module_for_linking(), preserve=True)
        return module.as_bitcode()

    @classmethod
    def from_bitcode(cls, codegen: Any, name: str, bitcode: bytes) -> UnlinkedLibrary:
        """The library of which `as_bitcode` was stored."""
        self = cls(codegen, name)
        self._final_module = self._shared_module = llvm.parse_bitcode(bitcode)
        self._finalized = True
        return self


def callers_first(libraries: list[Any]) -> list[Any]:
    """Each library once, before those that it calls: LLVM links of a library only what something linked before uses.

    In the list, each library is followed by all that it left to link.
    """
    return list(dict.fromkeys(reversed(libraries)))[::-1]


def left_to_link(library: Any) -> list[Any]:
    """The libraries that a caller of this one must link besides."""
    return library._linking_libraries if isinstance(library, UnlinkedLibrary) else []


@register_pass(mutates_CFG=True, analysis_only=False)
class CalleeLowering(NativeLowering):
    """Lowers into an UnlinkedLibrary, without wrappers."""

    _name = "callee_lowering"

    def run_pass(self, state: Any) -> bool:
        """As numba's, up to the execution."""
        flags = state.flags
        flags.no_cpython_wrapper = flags.no_cfunc_wrapper = flags.no_compile = True
        state.library = UnlinkedLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        super().run_pass(state)
        state.library.finalize()
        key = CallableFromKernels()
        state.targetctx.insert_user_function(key, state["cr"].fndesc, [state.library])
        state.reload_init.extend(state.library._reload_init)
        state["cr"] = state["cr"]._replace(cfunc=key)
        return True


def with_lowering(lowering: type) -> type:
    """Numba's compiler, with its lowering replaced."""

    class Compiler(compiler.Compiler):
        def define_pipelines(self) -> list[Any]:
            managers = super().define_pipelines()
            for manager in managers:
                manager.passes = [
                    (lowering if each is NativeLowering else each, words) for each, words in manager.passes
                ]
            return managers

    return Compiler


CalleeCompiler = with_lowering(CalleeLowering)


def is_callee(result: Any) -> bool:
    """Whether a CompileResult is one of a callee."""
    return isinstance(result.entry_point, CallableFromKernels)


def reduced(result: Any) -> tuple:
    """A callee's CompileResult in parts that can be stored."""
    descriptor = result.fndesc
    descriptor.typemap = descriptor.calltypes = None  # not needed, and perhaps not storable
    library = result.library
    return library.name, library.as_bitcode(), descriptor, result.environment, result.signature, result.reload_init


def rebuilt(target_context: Any, parts: tuple) -> Any:
    """The CompileResult of which the parts were stored."""
    name, bitcode, descriptor, environment, signature, reload_init = parts
    for function in reload_init:
        function()
    return compiler.compile_result(
        typing_context=target_context.typing_context, target_context=target_context, entry_point=CallableFromKernels(),
        library=UnlinkedLibrary.from_bitcode(target_context.codegen(), name, bitcode), fndesc=descriptor,
        environment=environment, signature=signature, reload_init=reload_init, objectmode=False, lifted=(),
        type_annotation="", referenced_envs=(),
    )  # fmt: skip


@contextmanager
def _fewer_collections() -> Iterator[None]:
    """Within, Python's garbage collector runs less often; numba's many long-lived objects take it a tenth of the time.

    Under numba's lock: one thread at a time changes the thresholds.
    """
    youngest, *older = gc.get_threshold()
    gc.set_threshold(max(youngest, COLLECT_AFTER), *older)
    try:
        yield
    finally:
        gc.set_threshold(youngest, *older)


class KernelCalls:
    """What of a dispatcher's work differs from numba's; it concerns this dispatcher only.

    A call from another kernel is resolved by the types of its arguments, not their values, and compiled as a callee.
    For an argument that is a constant, or a variable that begins as one, numba would compile the kernel for that value,
    too: code that is rarely used and took a third of the build time. A call from Python, or from a function that is no
    kernel, compiles the kernel as usual, even if it exists as a callee.
    """

    _inside = 0  # kernels that are being compiled; read and written under numba's lock

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher = dispatcher
        self._add, self._resolve = dispatcher.add_overload, dispatcher.get_call_template
        self._compile, self._compile_for_args = dispatcher.compile, dispatcher._compile_for_args
        dispatcher.add_overload, dispatcher.get_call_template = self.add_overload, self.get_call_template
        dispatcher.compile, dispatcher._compile_for_args = self.compile, self.compile_for_args

    def add_overload(self, result: Any) -> None:
        """Python cannot call a callee."""
        if is_callee(result):
            self._dispatcher.overloads[tuple(result.signature.args)] = result
        else:
            self._add(result)

    def get_call_template(self, args: tuple, kws: dict) -> Any:
        """Signature of a call with positional types `args` and keyword types `kws`, literal types made general."""
        if not KernelCalls._inside:
            self._drop_callees()
            return self._resolve(args, kws)
        dispatcher = self._dispatcher
        before, dispatcher._compiler.pipeline_class = dispatcher._compiler.pipeline_class, CalleeCompiler
        dispatcher._cache.of_callees = True
        try:
            return self._resolve(tuple(map(_general, args)), {name: _general(kind) for name, kind in kws.items()})
        finally:
            dispatcher._cache.of_callees = False
            dispatcher._compiler.pipeline_class = before

    def compile(self, signature: Any) -> Any:
        """Compile, or load from the cache."""
        with global_compiler_lock:
            KernelCalls._inside += 1
            try:
                return self._compile(signature)
            finally:
                KernelCalls._inside -= 1
                self._dispatcher._cache.unlock()

    def compile_for_args(self, *args: Any, **named: Any) -> Callable:
        """Compile for a call from Python."""
        with global_compiler_lock, _fewer_collections():
            self._drop_callees()
            return self._compile_for_args(*args, **named)

    def _drop_callees(self) -> None:
        for signature, result in list(self._dispatcher.overloads.items()):
            if is_callee(result):
                del self._dispatcher.overloads[signature]


def _general(kind: Any) -> Any:
    """The type of a literal type's value; any other type unchanged."""
    return kind if isinstance(kind, types.BaseNamedTuple) else types.unliteral(kind)  # type: ignore[attr-defined]
