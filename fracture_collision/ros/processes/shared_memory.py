"""Removes the shared memory of killed nodes.

Fast DDS gives each participant a segment in /dev/shm, 4 MB with config/this_machine.xml, and a lock file that is held
while it lives. Other nodes of the domain remove most segments of killed ones. Those of which no node noticed the end
stay for ever: 43 MB after 101 kills beside a running scene, more than half of what a container often has. Names of
segments are random and used once, so that removing one cannot cut off another node. Ports are small, have fixed names,
and are used again.
"""

from __future__ import annotations

import fcntl
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

FOLDER = Path("/dev/shm")
YOUNG = 1.0  # [s] Fast DDS may not have locked a younger file yet
_LOCK = f"fastrtps_{'[0-9a-f]' * 16}_el"


def dead_segments(folder: Path = FOLDER) -> set[Path]:
    """Segments of this user whose participants are dead."""
    found = set()
    for lock in folder.glob(_LOCK):
        if (held := _held_if_dead(lock)) is not None:
            held.close()
            found.add(_segment_of(lock))
    return found


def remove_dead_segments(folder: Path = FOLDER) -> None:
    """Removes them, with their locks."""
    for lock in folder.glob(_LOCK):
        if (held := _held_if_dead(lock)) is not None:
            with held, suppress(OSError):  # another process removes them, too
                _segment_of(lock).unlink(missing_ok=True)
                lock.unlink(missing_ok=True)


def _segment_of(lock: Path) -> Path:
    return lock.with_name(lock.name.removesuffix("_el"))


def _held_if_dead(lock: Path) -> BinaryIO | None:
    """The file, locked, if it is old and ours and nobody holds its lock."""
    with suppress(OSError):
        state = lock.stat()
        if state.st_uid == os.getuid() and time.time() - state.st_mtime > YOUNG:
            file = lock.open("rb")
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                file.close()
                return None
            return file
    return None
