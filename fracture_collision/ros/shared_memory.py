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
    """Files of our own, of segments and ports, that no process of ours has mapped and whose lock nobody holds.

    As long as somebody has a dead one's port mapped it must stay: Fast DDS tells by it that the port is dead, and sends
    to the next one of that number.
    """
    groups: dict[str, list[Path]] = {}
    for file in folder.iterdir() if folder.is_dir() else ():
        if (name := _FILE.fullmatch(file.name)) is not None:
            groups.setdefault(name[1], []).append(file)
    left: set[Path] = set()
    for files in groups.values():
        try:
            stats = [file.stat() for file in files]
            is_ours = all(each.st_uid == os.getuid() for each in stats)
            is_young = any(time.time() - each.st_mtime < YOUNG for each in stats)
            if is_ours and not is_young and not any(_is_held(file) for file in files if file.name.endswith(_LOCKS)):
                left.update(files)
        except OSError:  # it has gone in the meantime
            continue
    if left:
        mapped = set(_mapped(folder))
        used = {name[1] for each in mapped if (name := _FILE.fullmatch(each)) is not None}
        left = {file for file in left if _FILE.fullmatch(file.name)[1] not in used}
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
