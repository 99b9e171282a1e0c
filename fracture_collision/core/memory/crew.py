"""A thread pool that splits one kernel's work; each thread has its own memory (prange takes no nested tuples)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from time import thread_time

# [s] Work that took less in all is not shared: waking a thread, and taking turns with it at the interpreter's lock
# until its kernel has begun, takes about a third of this.
WORTH_SHARING = 3e-4


class Crew:
    """`threads` workers, including the caller's thread."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool = self._new_pool()
        self._took: dict[Callable[..., None], float] = {}  # [s] of processor time by the last call, in all threads

    def _new_pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(max(self.threads - 1, 1), thread_name_prefix="narrow_phase")  # starts when used

    def share(self, kernel: Callable[..., None], *arguments: object, own: Sequence[object]) -> None:
        """Call kernel(*arguments, own[thread], (thread, threads)) for each thread from 0 on in parallel; wait for all.

        own: one thread's working memory each. Where the last call of this kernel took little, one thread does it all.
        """
        threads = self.threads if self._took.get(kernel, WORTH_SHARING) >= WORTH_SHARING else 1
        began = thread_time()
        try:
            others = [self._pool.submit(kernel, *arguments, own[t], (t, threads)) for t in range(1, threads)]
            kernel(*arguments, own[0], (0, threads))
            self._took[kernel] = threads * (thread_time() - began)
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
