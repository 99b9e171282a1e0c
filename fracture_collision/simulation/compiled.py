"""How this package compiles its inner kernels."""

from __future__ import annotations

from numba import njit

# Kernels that allocate nothing count no references: counting costs more than the arithmetic of a contact.
uncounted = njit(cache=True, error_model="numpy", _nrt=False)
