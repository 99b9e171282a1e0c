"""Work counted instead of timed: what does not depend on the machine or on who else uses it."""

from __future__ import annotations

import sys
import tracemalloc
from collections.abc import Callable
from typing import Any


def calls_of(act: Callable[[], Any]) -> int:
    """Functions that the interpreter calls while `act` runs, in Python or in C. A loop over elements makes some for
    each."""
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
    """[bytes] that `act` has allocated at its peak, arrays of numpy included."""
    tracemalloc.start()
    try:
        act()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
