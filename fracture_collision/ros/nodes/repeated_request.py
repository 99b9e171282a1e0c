"""A request that is sent again until it has a response.

A request or its response may be lost: a writer that has not discovered its reader sends into nothing, and rmw_fastrtps
drops a response if it has not discovered the client's reader 100 ms after the request, although it knew the client's
writer.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.task import Future

ASK_AGAIN = 0.5  # [s]


class RepeatedRequest:
    """One request at a time, which may be executed more than once. `look` must be called regularly."""

    def __init__(self, is_ready: Callable[[], bool]) -> None:
        """`is_ready`: whether the service has been discovered; nothing is sent before."""
        self._is_ready = is_ready
        self._wanted: tuple[Callable[[], Future], Callable[[Future], object]] | None = None  # without a response yet
        self._due = 0.0  # time.monotonic() of the next sending

    def begin(self, call: Callable[[], Future], then: Callable[[Future], object]) -> None:
        """Sends `call` until it has a response, which `then` gets; drops an earlier request."""
        self._wanted, self._due = (call, then), 0.0
        self.look()

    def drop(self) -> None:
        """Neither sends the request again nor takes its response."""
        self._wanted = None

    def look(self) -> None:
        """Sends the request if it is due."""
        wanted = self._wanted
        if wanted is None or time.monotonic() < self._due or not self._is_ready():
            return
        self._due = time.monotonic() + ASK_AGAIN
        call, then = wanted

        def answered(done: Future) -> None:
            if wanted is self._wanted:  # the first response to it
                self._wanted = None
                then(done)

        call().add_done_callback(answered)
