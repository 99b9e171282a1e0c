"""Memory that a process keeps, and touches before it is needed.

The system has to find and clear each page that a process writes to for the first time: a quarter of a microsecond on a
physical machine, up to ten on a virtual one, a thousand times when a fracture makes a body's surfaces. Freed memory
usually goes back to the system, to be fetched again. Real-time programs do the same as this module (mallopt(3),
"M_TRIM_THRESHOLD"; the real-time pages of the Linux Foundation): touch once, return nothing.
"""

from __future__ import annotations

import ctypes

import numpy as np

# Of mallopt, in glibc's malloc.h.
M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4
NEVER = 2**31 - 1


def keep_memory(size: int) -> bool:
    """Take `size` bytes now and keep them, and all memory freed later, for this process's own arrays.

    Returns False and does nothing if the C library is not glibc.
    """
    library = ctypes.CDLL(None)
    if not hasattr(library, "gnu_get_libc_version"):
        return False
    library.mallopt(M_TRIM_THRESHOLD, NEVER)
    library.mallopt(M_MMAP_MAX, 0)  # large arrays would be returned one by one
    np.ones(size, np.uint8)
    return True
