"""Loads kernels from numba's cache without the set-up that only compilation needs.

A killed service must restart within a second and has some forty kernels to load. Before numba loads the first from its
cache, it prepares to compile: it registers everything that it can compile and compiles its own runtime. For each kernel
it also parses the bitcode stored beside the machine code and enumerates its functions. Here all of that is deferred
until something must be compiled, or linked with a loaded kernel; the loaded code is the same.

This relies on numba internals: compiled.py uses it only with the versions it was tested with, and
test_core_kernel_cache.py detects where it no longer fits.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def _not_to_be_imported(*names: str) -> Iterator[None]:
    """Hide modules from import, unless they are already imported."""
    hidden = [name for name in names if name not in sys.modules]
    sys.modules |= dict.fromkeys(hidden)  # type: ignore[arg-type] # None: an import of it fails
    try:
        yield
    finally:
        for name in hidden:
            del sys.modules[name]


# numba imports both if they are installed: scipy to check its version, and in a module that kernels need for other
# reasons (without scipy it does not support np.cov); coverage to measure the coverage of compiled code.
with _not_to_be_imported("scipy", "coverage"):
    from llvmlite import binding as llvm
    from numba import njit, types
    from numba.core.caching import FunctionCache
    from numba.core.codegen import JITCodeLibrary
    from numba.core.environment import lookup_environment
    from numba.core.runtime import _nrt_python as runtime

    from fracture_collision.core.memory.callees import (
        callers_first,
        compiled_as_callee,
        is_callee,
        keep_callees_from_python,
        left_to_link,
        rebuilt,
        reduced,
    )

__all__ = ["ForKernels", "KernelCache", "keep_callees_from_python", "njit"]

_FUNCTION = "_ZN"  # prefix of the functions that numba compiles
_WRAPPER = "_ZN7cpython"  # prefix of the functions that Python calls; every cached kernel has one


class KernelCache(FunctionCache):
    """The cache of one kernel, in numba's own files; what other kernels call has keys of its own."""

    of_callees = False  # whether the code for other kernels is meant

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """As in FunctionCache, without target_context.refresh(), which numba's compiler calls itself."""
        codegen = target_context.codegen()
        if codegen._library_class is not _Library:
            codegen._library_class = _Library
            for name, address in runtime.c_helpers.items():  # as in rtsys.initialize
                llvm.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
        hidden = () if "numba.np.arraymath" in sys.modules else ("scipy",)
        with self._guard_against_spurious_io_errors(), _not_to_be_imported(*hidden):
            return self._load_overload(sig, target_context)

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        if not self.of_callees:
            return super()._load_overload(sig, target_context)
        parts = self._cache_file.load(self._index_key(sig, target_context.codegen()))
        return None if parts is None else rebuilt(target_context, parts)

    def _save_overload(self, sig: Any, data: Any) -> None:
        if not is_callee(data):
            super()._save_overload(sig, data)
        elif self._impl.check_cachable(data):
            self._impl.locator.ensure_cache_path()
            self._cache_file.save(self._index_key(sig, data.codegen), reduced(data))

    def _index_key(self, sig: Any, codegen: Any) -> tuple:
        return (*super()._index_key(sig, codegen), self.of_callees)


class ForKernels:
    """Resolves a call from one kernel to another, by the types of its arguments, not their values.

    The other is compiled as a callee (callees.py).

    Where an argument is a constant, or a variable that begins as one, numba would compile the kernel for that value,
    too: code that is rarely used and took a third of the build time.
    """

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher, self._resolve = dispatcher, dispatcher.get_call_template

    def __call__(self, args: tuple, kws: dict) -> Any:
        """Signature of a call with positional types `args` and keyword types `kws`, literal types made general."""
        with compiled_as_callee(self._dispatcher):
            return self._resolve(tuple(map(_general, args)), {name: _general(kind) for name, kind in kws.items()})


def _general(kind: Any) -> Any:
    """The type of a literal type's value; any other type unchanged."""
    return kind if isinstance(kind, types.BaseNamedTuple) else types.unliteral(kind)


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
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> JITCodeLibrary:
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        self = codegen.create_library(name)
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
