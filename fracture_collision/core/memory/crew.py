"""A thread pool that splits one kernel's work; each thread has its own slots (prange takes no nested tuples)."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


class Crew:
    """`threads` workers, including the caller's thread."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads - 1, thread_name_prefix="narrow_phase") if threads > 1 else None

    def share(self, kernel: Callable[..., None], *arguments: object) -> None:
        """Call kernel(*arguments, threads, thread) for every thread 0 .. threads - 1 in parallel; wait for all."""
        others = [self._pool.submit(kernel, *arguments, self.threads, t) for t in range(1, self.threads)]
        kernel(*arguments, self.threads, 0)
        for other in others:
            other.result()
