"""The numba decorators of core: cached on disk, IEEE arithmetic as written (no fastmath), numpy's division by zero."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from typing import Any

from fracture_collision.kernel_sources import cached_njit

# The faster kernel loading relies on numba internals (kernel_cache.py): other versions use numba's own cache.
TRIED_WITH = "0.68."

if version("numba").startswith(TRIED_WITH):
    from fracture_collision.core.memory.callees import KernelCalls
    from fracture_collision.core.memory.kernel_cache import KernelCache, KernelCompiler
else:
    KernelCache = None  # type: ignore[assignment, misc] # as a missing optional import


def _cached(**options: Any) -> Callable[[Callable], Any]:
    if KernelCache is None:
        return cached_njit(error_model="numpy", **options)

    def decorate(function: Callable) -> Any:
        dispatcher = cached_njit(function, error_model="numpy", pipeline_class=KernelCompiler, **options)
        if dispatcher is not function:  # they are the same under NUMBA_DISABLE_JIT
            dispatcher._cache = KernelCache(function)
            KernelCalls(dispatcher)
        return dispatcher

    return decorate


kernel = _cached()
# Queries allocate nothing, so reference counting is off: with it, six sevenths of a query's time went into atomic
# increments for arrays taken out of the pools.
query_kernel = _cached(_nrt=False)
# For kernels that allocate and that query kernels call: numba would otherwise let them inherit that reference counting
# is off. They return no arrays.
allocating_kernel = _cached(_nrt=True)
# For kernels that a crew of threads runs in parallel: releases the GIL.
threaded_kernel = _cached(_nrt=False, nogil=True)
