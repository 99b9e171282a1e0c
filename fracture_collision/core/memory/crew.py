"""A crew of threads that share one kernel's work, each its own slots (numba's prange takes no nested tuples)."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


class Crew:
    """`threads` workers; the caller's thread is one of them."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads - 1, thread_name_prefix="narrow_phase") if threads > 1 else None

    def share(self, kernel: Callable[..., None], *arguments: object) -> None:
        """Call kernel(*arguments, threads, thread) for every thread 0 .. threads - 1, side by side; wait for all."""
        others = [self._pool.submit(kernel, *arguments, self.threads, t) for t in range(1, self.threads)]
        kernel(*arguments, self.threads, 0)
        for other in others:
            other.result()
