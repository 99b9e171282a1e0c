"""The one way core compiles: cached on disk, IEEE arithmetic as written (no fastmath), division by zero as in numpy."""

from __future__ import annotations

from numba import njit

kernel = njit(cache=True, error_model="numpy")
# The kernels of a query allocate nothing, so they count no references: with counting, six sevenths of a query's time
# went into atomic increments for arrays taken out of the pools.
query_kernel = njit(cache=True, error_model="numpy", _nrt=False)
# For what runs inside a query's inner loops: a call would copy the pools, several hundred words, onto the stack.
inlined_kernel = njit(cache=True, error_model="numpy", _nrt=False, forceinline=True)
# For what a crew of threads runs side by side: the interpreter's lock is let go.
threaded_kernel = njit(cache=True, error_model="numpy", _nrt=False, nogil=True)
