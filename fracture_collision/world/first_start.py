"""The first start after an installation: kernels are compiled on two processors.

While this process compiles what it meets first, bodies and fractures, another one compiles the largest kernel, which
searches for contacts, and ends. This process loads it, or waits until it is there (core/memory/compile_locks.py).
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading

# In the environment of processes that compile for others, or divide the work themselves.
ALONE = "FRACTURE_COLLISION_COMPILES_ALONE"
LATER = 10  # niceness
_helper: subprocess.Popen | None = None


def cache_is_cold() -> bool:
    """Whether the largest kernel can be cached, and is not: the first start compiles."""
    from fracture_collision.core.pair.pair_search import search_sampled
    from fracture_collision.kernel_sources import can_be_cached, is_cached  # a node announces itself before numba is

    return can_be_cached(search_sampled) and not is_cached(search_sampled)


def compile_beside() -> None:
    """Start the other process, once, if the cache has no kernels yet and there is a processor for it."""
    global _helper
    if _helper is not None or ALONE in os.environ or not _has_two_processors():
        return
    if not cache_is_cold():
        return
    # It ends when this process does: then it reads the end of its standard input.
    _helper = subprocess.Popen(
        [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True, env=os.environ | {ALONE: "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip
    threading.Thread(target=_helper.wait, daemon=True).start()  # or it would stay as a zombie


def _has_two_processors() -> bool:
    return len(os.sched_getaffinity(0)) > 1 if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1) > 1


def main() -> None:
    """Compiles the largest kernel, until it is done or the parent process has ended."""
    from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
    from fracture_collision.core.pair.narrow_phase import compile_largest

    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(LATER)
    compile_largest(CollisionGeometry().searched)


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


if __name__ == "__main__":
    main()
