"""SIGINT and SIGTERM while a process starts; imports nothing that takes time."""

from __future__ import annotations

import os
import signal
from types import FrameType

INTERRUPTED = 130  # exit status, as a shell gives it after SIGINT


def signals_end_at_once(status: int) -> None:
    """Makes them end the process silently with exit `status`, until other handlers are set."""

    def end(_signal: int, _frame: FrameType | None) -> None:
        os._exit(status)

    for order in (signal.SIGINT, signal.SIGTERM):
        signal.signal(order, end)
