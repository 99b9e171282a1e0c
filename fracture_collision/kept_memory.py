"""Memory that a process keeps and has touched before it is needed.

A page that a process writes to for the first time has to be found and cleared by the system: a quarter of a microsecond
on a machine of one's own, up to ten on a virtual one, a thousand times over where a fracture makes a body's surfaces.
And what is freed usually goes back to the system, to be fetched anew. Programs that must answer in time do as here
(mallopt(3), "M_TRIM_THRESHOLD"; the real-time pages of the Linux Foundation): touch once, give nothing back.
"""

from __future__ import annotations

import ctypes

import numpy as np

# Of mallopt, in glibc's malloc.h.
M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4
NEVER = 2**31 - 1


def keep_memory(size: int) -> bool:
    """Take `size` bytes now and keep them, and all that is freed later, for this process's own arrays.

    False, and nothing done, where the C library is not glibc.
    """
    library = ctypes.CDLL(None)
    if not hasattr(library, "gnu_get_libc_version"):
        return False
    library.mallopt(M_TRIM_THRESHOLD, NEVER)
    library.mallopt(M_MMAP_MAX, 0)  # large arrays would be given back one by one
    np.ones(size, np.uint8)
    return True
