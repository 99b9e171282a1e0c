"""Kernels out of numba's cache, without what only compiling needs.

A service that was killed shall be back in a second, and has some forty kernels to load. Before numba takes the first
from its cache it makes itself ready to compile: it registers all that it could compile, and compiles its own runtime.
With each it reads the bitcode that lies beside the machine code and asks every function in it for its name. Here all
that is done when something is to be compiled, or to be linked with what was loaded; what is loaded is the same.

Goes by the inside of numba: compiled.py uses it with the versions that it was tried with, and test_core_kernel_cache.py
tells where it no longer fits.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def _not_to_be_imported(*names: str) -> Iterator[None]:
    """Unless they are there already."""
    hidden = [name for name in names if name not in sys.modules]
    sys.modules |= dict.fromkeys(hidden)
    try:
        yield
    finally:
        for name in hidden:
            del sys.modules[name]


# numba imports both where they are installed: scipy to look at its version, and for a module of which kernels need
# other things, where without scipy it knows no np.cov; coverage to measure that of what it compiles.
with _not_to_be_imported("scipy", "coverage"):
    from llvmlite import binding as llvm
    from numba import njit
    from numba.core.caching import FunctionCache
    from numba.core.codegen import JITCodeLibrary
    from numba.core.runtime import _nrt_python as runtime

__all__ = ["KernelCache", "njit"]

_WRAPPER = "_ZN7cpython"  # how the names of functions begin that Python calls; every cached kernel has one


class KernelCache(FunctionCache):
    """Of one kernel: numba's own files."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """As FunctionCache does, less target_context.refresh(); numba's compiler calls that itself."""
        codegen = target_context.codegen()
        if codegen._library_class is not _Library:
            codegen._library_class = _Library
            for name, address in runtime.c_helpers.items():  # as rtsys.initialize does
                llvm.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
        hidden = () if "numba.np.arraymath" in sys.modules else ("scipy",)
        with self._guard_against_spurious_io_errors(), _not_to_be_imported(*hidden):
            return self._load_overload(sig, target_context)


class _Library(JITCodeLibrary):
    """One whose bitcode is read when others are to be linked with it."""

    _bitcode = b""  # that is not read yet
    _module: Any = None

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
        _ = self._shared_module  # numba knows then which names there are
        return super().get_pointer_to_function(name)
