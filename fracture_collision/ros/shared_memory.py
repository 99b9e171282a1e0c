"""Fast DDS's files in shared memory that nobody uses any more.

A participant has a segment, and ports that it listens at, as files with a lock beside each that is held while it lives.
Who is killed cannot remove them; and a port whose other users outlive it stays even where nobody was killed. Fast DDS
sweeps up only when told to (`fastdds shm clean`, which knows the files with a lock), and whoever runs a service for
weeks would have to know of that.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

FOLDER = Path("/dev/shm")
# A file that is younger may be one whose maker has not locked it yet.
YOUNG = 1.0  # [s]

_FILE = re.compile(r"(?:sem\.)?(fastrtps_(?:[0-9a-f]{16}|port\d+))(?:_[es]l|_mutex)?")
_LOCKS = ("_el", "_sl")


def remove_left_behind(folder: Path = FOLDER) -> int:
    """Removes what `left_behind` finds; returns how many files. What the system does not let us remove stays."""
    removed = 0
    for file in sorted(left_behind(folder)):
        try:
            file.unlink(missing_ok=True)
        except OSError:
            continue
        removed += 1
    return removed


def left_behind(folder: Path = FOLDER) -> set[Path]:
    """Files of segments and ports whose lock nobody holds; where there is none, those of our own that no process of
    ours has mapped.
    """
    groups: dict[str, list[Path]] = {}
    for file in folder.iterdir() if folder.is_dir() else ():
        if (name := _FILE.fullmatch(file.name)) is not None:
            groups.setdefault(name[1], []).append(file)
    left, unlocked = set(), []
    for files in groups.values():
        try:
            if any(time.time() - file.stat().st_mtime < YOUNG for file in files):
                continue
            locks = [file for file in files if file.name.endswith(_LOCKS)]
            if not locks:
                unlocked += [file for file in files if file.stat().st_uid == os.getuid()]
            elif not any(map(_is_held, locks)):
                left.update(files)
        except OSError:  # it has gone in the meantime, or is none of ours
            continue
    if unlocked:
        mapped = set(_mapped(folder))
        left.update(file for file in unlocked if file.name not in mapped)
    return left


def _is_held(lock: Path) -> bool:
    with lock.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _mapped(folder: Path) -> Iterator[str]:
    """Names of the folder's files that processes which we may look into have in their memory."""
    for maps in Path("/proc").glob("[0-9]*/maps"):
        try:
            lines = maps.read_text().splitlines()
        except OSError:
            continue
        for line in lines:
            path = line.rpartition(" ")[2]
            if path.startswith(f"{folder}/"):
                yield path[len(str(folder)) + 1 :]
