"""Says that kernels are being compiled, while a first call waits for minutes.

numba reports the beginning and the end of each compilation, and nothing where a kernel comes from the cache.
"""

from __future__ import annotations

import logging
import threading
import time
from typing import Any

from numba.core import event

LOGGER = logging.getLogger("fracture_collision")
FIRST, EVERY = 1.5, 4.0  # [s] to the first line, and between two
_reporters: list[_Reporter] = []


class _Reporter(event.Listener):
    """Counts compilations of this package's functions; a thread reports them until all are done."""

    def __init__(self) -> None:
        self._depth = 0  # kernels are compiled inside those that call them
        self._done = 0
        self._began = 0.0
        self._changed = threading.Condition()

    def on_start(self, event: Any) -> None:
        if not _is_ours(event):
            return
        with self._changed:
            self._depth += 1
            if self._depth == 1 and not self._done:
                self._began = time.monotonic()
                threading.Thread(target=self._report, name="compile progress", daemon=True).start()

    def on_end(self, event: Any) -> None:
        if not _is_ours(event):
            return
        with self._changed:
            self._depth -= 1
            self._done += 1
            self._changed.notify()

    def _report(self) -> None:
        wait = FIRST
        with self._changed:
            while True:
                # between two kernels nothing is compiled for a moment
                until = time.monotonic() + wait
                while (left := until - time.monotonic()) > 0.0:
                    self._changed.wait(left)
                if not self._depth:
                    break
                LOGGER.warning("compiling kernels, once per installation: %d after %.0f s", self._done, self._spent())
                wait = EVERY
            if self._spent() > FIRST + EVERY:
                LOGGER.warning("compiled %d kernels in %.0f s", self._done, self._spent())
            self._done = 0

    def _spent(self) -> float:
        return time.monotonic() - self._began


def _is_ours(event: Any) -> bool:
    return event.data["dispatcher"].py_func.__module__.split(".")[0] == __name__.split(".")[0]


def report_compilation() -> None:
    """From now on, log what is compiled to the logger `fracture_collision`, as warnings: they are shown by default."""
    if not _reporters:
        _reporters.append(_Reporter())
        event.register("numba:compile", _reporters[0])
