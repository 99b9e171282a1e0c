"""A thread pool that splits one kernel's work; each thread has its own memory (prange takes no nested tuples)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor


class Crew:
    """`threads` workers, including the caller's thread."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool = ThreadPoolExecutor(max(threads - 1, 1), thread_name_prefix="narrow_phase")  # starts when used

    def share(self, kernel: Callable[..., None], *arguments: object, own: Sequence[object]) -> None:
        """Call kernel(*arguments, own[thread], (thread, threads)) for each thread from 0 on in parallel; wait for all.

        own: one thread's working memory each.
        """
        others = [self._pool.submit(kernel, *arguments, own[t], (t, self.threads)) for t in range(1, self.threads)]
        kernel(*arguments, own[0], (0, self.threads))
        for other in others:
            other.result()
