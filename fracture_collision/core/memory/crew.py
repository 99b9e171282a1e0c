"""A thread pool that splits one kernel's work; each thread has its own memory (prange takes no nested tuples)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor


class Crew:
    """`threads` workers, including the caller's thread."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool = self._new_pool()

    def _new_pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(max(self.threads - 1, 1), thread_name_prefix="narrow_phase")  # starts when used

    def share(self, kernel: Callable[..., None], *arguments: object, own: Sequence[object]) -> None:
        """Call kernel(*arguments, own[thread], (thread, threads)) for each thread from 0 on in parallel; wait for all.

        own: one thread's working memory each.
        """
        try:
            others = [self._pool.submit(kernel, *arguments, own[t], (t, self.threads)) for t in range(1, self.threads)]
            kernel(*arguments, own[0], (0, self.threads))
            for other in others:
                other.result()
        except BaseException:  # as KeyboardInterrupt: the others still write to memory that the next call uses
            self._end_pool()
            raise

    def _end_pool(self) -> None:
        """Wait for the workers, whatever interrupts the waiting; the next call starts new ones."""
        pool, self._pool = self._pool, self._new_pool()
        while True:
            try:
                pool.shutdown(wait=True, cancel_futures=True)
                return
            except KeyboardInterrupt:
                continue  # the first one is on its way already
