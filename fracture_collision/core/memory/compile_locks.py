"""One process at a time compiles a kernel; another that needs it waits for the machine code.

Each folder of cache files has one lock file, and each kernel locks a byte of it: POSIX record locks, which the system
releases when a process ends, however it ends. Kernels are locked in the order of their calls, callers first, so no two
processes wait for each other. Nothing is locked where the folder cannot be written to or the system has no such locks.
"""

from __future__ import annotations

import os
import zlib
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

NAME = "kernels.lock"
BYTES = 1 << 30
_files: dict[Path, int] = {}  # opened once and never closed: closing one would release all locks on it


def lock(folder: Path, kernel: str) -> bool:
    """Wait until no other process compiles `kernel`, then keep others from it. False: there is no lock."""
    return _change(folder, kernel, fcntl.LOCK_EX) if fcntl is not None else False


def unlock(folder: Path, kernel: str) -> None:
    """Let others compile `kernel`."""
    if fcntl is not None:
        _change(folder, kernel, fcntl.LOCK_UN)


def _change(folder: Path, kernel: str, operation: int) -> bool:
    try:
        if folder not in _files:
            folder.mkdir(parents=True, exist_ok=True)
            _files[folder] = os.open(folder / NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        fcntl.lockf(_files[folder], operation, 1, zlib.crc32(kernel.encode()) % BYTES)
    except OSError:
        return False
    return True
