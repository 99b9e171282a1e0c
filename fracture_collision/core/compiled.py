"""The one way core compiles: cached on disk, IEEE arithmetic as written (no fastmath), division by zero as in numpy."""

from __future__ import annotations

from numba import njit

kernel = njit(cache=True, error_model="numpy")
# for what a crew of threads runs side by side: the interpreter's lock is let go
threaded_kernel = njit(cache=True, error_model="numpy", nogil=True)
