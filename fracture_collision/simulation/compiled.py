"""How this package compiles its inner kernels."""

from __future__ import annotations

from fracture_collision.kernel_sources import cached_njit

# Kernels that allocate nothing count no references: counting costs more than the arithmetic of a contact.
uncounted = cached_njit(error_model="numpy", _nrt=False)
