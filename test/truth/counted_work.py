"""Work counted instead of timed, so that results do not depend on the machine or its load."""

from __future__ import annotations

import sys
import tracemalloc
from collections.abc import Callable
from typing import Any


def calls_of(act: Callable[[], Any]) -> int:
    """Number of function calls, in Python or C, while `act` runs. A loop over elements makes some per element."""
    count = 0

    def note(_frame: Any, event: str, _argument: Any) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        act()
    finally:
        sys.setprofile(before)
    return count


def most_memory_of(act: Callable[[], Any]) -> int:
    """Peak memory [bytes] allocated by `act`, including numpy arrays."""
    tracemalloc.start()
    try:
        act()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
