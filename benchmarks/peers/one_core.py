"""One core for everything. Imports nothing, so that it can be called before numpy reads the environment."""

from __future__ import annotations

import os

POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def pin_to_one_core() -> None:
    """Pins this process and the threads it starts to one core, and limits libraries' pools to one thread.

    The pools comply only if numpy has not been imported yet; the affinity always holds on Linux.
    """
    for name in POOLS:
        os.environ[name] = "1"
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def cores() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
