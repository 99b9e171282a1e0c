"""Loads kernels from numba's cache without the set-up that only compilation needs.

A killed service must restart within a second and has some forty kernels to load. Before numba loads the first from its
cache, it prepares to compile: it registers everything that it can compile and compiles its own runtime. For each kernel
it also parses the bitcode stored beside the machine code and enumerates its functions. Here all of that is deferred
until something must be compiled, or linked with a loaded kernel; the loaded code is the same.

This relies on numba internals: compiled.py uses it only with the versions it was tested with, and
test_core_kernel_cache.py detects where it no longer fits.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from llvmlite import binding as llvm
from numba.core import compiler
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_machinery import register_pass
from numba.core.environment import lookup_environment
from numba.core.runtime import _nrt_python as runtime
from numba.core.typed_passes import NativeLowering

from fracture_collision.core.memory import compile_locks
from fracture_collision.core.memory.callees import (
    callers_first,
    is_callee,
    left_to_link,
    rebuilt,
    reduced,
    with_lowering,
)
from fracture_collision.kernel_sources import SourceCache

_FUNCTION = "_ZN"  # prefix of the functions that numba compiles
_WRAPPER = "_ZN7cpython"  # prefix of the functions that Python calls; every cached kernel has one


class KernelCache(SourceCache):
    """The cache of one kernel, in numba's own files; what other kernels call has keys of its own."""

    of_callees = False  # whether the code for other kernels is meant
    _is_locked = False  # whether this process compiles the kernel, and others wait

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """As in FunctionCache, without target_context.refresh(), which numba's compiler calls itself."""
        for name, address in runtime.c_helpers.items():  # as in rtsys.initialize
            llvm.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        key = self._index_key(sig, target_context.codegen())
        parts = self._cache_file.load(key)
        if parts is None and not self._is_locked:
            self._is_locked = compile_locks.lock(Path(self.cache_path), self._impl.filename_base)
            parts = self._cache_file.load(key)  # another process may have compiled it meanwhile
        if parts is None:
            return None
        self.unlock()
        return (rebuilt if self.of_callees else _rebuilt_whole)(target_context, parts)

    def _save_overload(self, sig: Any, data: Any) -> None:
        if not is_callee(data):
            super()._save_overload(sig, data)
        elif self._impl.check_cachable(data):
            self._impl.locator.ensure_cache_path()
            self._cache_file.save(self._index_key(sig, data.codegen), reduced(data))

    def unlock(self) -> None:
        """Let other processes compile the kernel. Called after each compilation, also a failed one."""
        if self._is_locked:
            self._is_locked = False
            compile_locks.unlock(Path(self.cache_path), self._impl.filename_base)

    def _index_key(self, sig: Any, codegen: Any) -> tuple:
        return (*super()._index_key(sig, codegen), self.of_callees)


def _rebuilt_whole(target_context: Any, parts: tuple) -> Any:
    """As CompileResult._rebuild, with a library of ours."""
    library_data, descriptor, environment, signature, object_mode, lifted, annotation, reload_init, environments = parts
    for function in reload_init:
        function()
    library = _Library.loaded(target_context.codegen(), library_data)
    return compiler.compile_result(
        typing_context=target_context.typing_context, target_context=target_context, library=library, fndesc=descriptor,
        entry_point=target_context.get_executable(library, descriptor, environment), environment=environment,
        signature=signature, objectmode=object_mode, lifted=lifted, type_annotation=annotation,
        reload_init=reload_init, referenced_envs=environments,
    )  # fmt: skip


class _Library(JITCodeLibrary):
    """A library that parses its bitcode only when another is linked with it, and links what callees left to link."""

    _bitcode = b""  # not parsed yet
    _module: Any = None
    _linking_libraries: list[Any]  # numba's

    def add_linking_library(self, library: Any) -> None:
        super().add_linking_library(library)
        self._linking_libraries += left_to_link(library)

    def finalize(self) -> None:
        self._linking_libraries = callers_first(self._linking_libraries)
        super().finalize()
        for variable in self._final_module.global_variables:  # the environments of callees are in this library only
            environment = lookup_environment(variable.name)
            if environment is not None and not variable.is_declaration:
                self._codegen.set_env(variable.name, environment)

    def _optimize_final_module(self) -> None:
        # Nobody else links this library's copies of callees: private to it, they lose unused arguments.
        for function in self._final_module.functions:
            if function.linkage == llvm.Linkage.linkonce_odr and function.name.startswith(_FUNCTION):
                function.linkage = llvm.Linkage.internal
        super()._optimize_final_module()

    @classmethod
    def loaded(cls, codegen: Any, state: tuple[str, str, Any]) -> _Library:
        """The library that numba stored as object code, with its bitcode."""
        name, _, data = state
        self = cls(codegen, name)
        self.enable_object_caching()
        code, self._bitcode = data
        self._set_compiled_object(code)
        self._finalize_final_module()
        return self

    @property
    def _shared_module(self) -> Any:
        if self._bitcode:
            bitcode, self._bitcode = self._bitcode, b""
            self._module = llvm.parse_bitcode(bitcode)
            self._codegen._engine._load_defined_symbols(self._module)
        return self._module

    @_shared_module.setter
    def _shared_module(self, module: Any) -> None:
        self._module = module

    def get_pointer_to_function(self, name: str) -> int:
        if self._bitcode and name.startswith(_WRAPPER):
            return self._codegen._engine.get_function_address(name)
        _ = self._shared_module  # parses the bitcode, which defines the names for numba
        return super().get_pointer_to_function(name)


@register_pass(mutates_CFG=True, analysis_only=False)
class KernelLowering(NativeLowering):
    """Lowers what Python calls into a library of ours."""

    _name = "kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        """As numba's."""
        state.library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().run_pass(state)


KernelCompiler = with_lowering(KernelLowering)
