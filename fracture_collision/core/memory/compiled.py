"""The one way core compiles: cached on disk, IEEE arithmetic as written (no fastmath), division by zero as in numpy."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from typing import Any

# Loading kernels quicker goes by numba's inside (kernel_cache.py): with other versions they are loaded numba's way.
TRIED_WITH = "0.68."

if version("numba").startswith(TRIED_WITH):
    from fracture_collision.core.memory.kernel_cache import KernelCache, njit
else:
    from numba import njit

    KernelCache = None


def _cached(**options: Any) -> Callable[[Callable], Any]:
    if KernelCache is None:
        return njit(error_model="numpy", cache=True, **options)
    compiled = njit(error_model="numpy", **options)

    def decorate(function: Callable) -> Any:
        dispatcher = compiled(function)
        if dispatcher is not function:  # as it is with NUMBA_DISABLE_JIT
            dispatcher._cache = KernelCache(function)  # in place of what cache=True would put there
        return dispatcher

    return decorate


kernel = _cached()
# The kernels of a query allocate nothing, so they count no references: with counting, six sevenths of a query's time
# went into atomic increments for arrays taken out of the pools.
query_kernel = _cached(_nrt=False)
# For what runs inside a query's inner loops: a call would copy the pools, several hundred words, onto the stack.
inlined_kernel = _cached(_nrt=False, forceinline=True)
# For what a crew of threads runs side by side: the interpreter's lock is let go.
threaded_kernel = _cached(_nrt=False, nogil=True)
