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
from contextlib import suppress
from pathlib import Path

FOLDER = Path("/dev/shm")
# A file that is younger may be one whose maker has not locked it yet.
YOUNG = 1.0  # [s]

_FILE = re.compile(r"(?:sem\.)?(fastrtps_(?:[0-9a-f]{16}|port\d+))(?:_[es]l|_mutex)?")
_LOCKS = ("_el", "_sl")  # of who listens at a port alone, and with others
_PORT = "fastrtps_port"


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
    groups = _groups(folder)
    locked = _locked_inodes()
    suspects = {name: files for name, files in groups.items() if _seems_unused(files, locked)}
    if suspects:
        for mapped in _mapped(folder):
            if (name := _FILE.fullmatch(mapped)) is not None:
                suspects.pop(name[1], None)
    # At last, as to try a lock is to hold it for a moment: a participant that opens the file then would fail, and be
    # deaf. Who takes the port of one that was killed opens it while others have it mapped still.
    return {
        file
        for files in suspects.values()
        if not any(_is_held(each) for each in files if each.name.endswith(_LOCKS))
        for file in files
    }


def dead_ports(folder: Path = FOLDER) -> list[int]:
    """Numbers of our ports that nobody listens at any more, the last one made first. Others may have them mapped."""
    locked = _locked_inodes()
    made: dict[int, float] = {}
    for name, files in _groups(folder).items():
        lock = folder / f"{name}_el"
        if name.startswith(_PORT) and lock in files and _seems_unused(files, locked):
            with suppress(OSError):  # it has gone in the meantime
                made[int(name.removeprefix(_PORT))] = lock.stat().st_mtime
    return sorted(made, key=made.__getitem__, reverse=True)


def _groups(folder: Path) -> dict[str, list[Path]]:
    """Files by the segment or port that they belong to."""
    groups: dict[str, list[Path]] = {}
    for file in folder.iterdir() if folder.is_dir() else ():
        if (name := _FILE.fullmatch(file.name)) is not None:
            groups.setdefault(name[1], []).append(file)
    return groups


def _seems_unused(files: list[Path], locked: set[int]) -> bool:
    try:
        stats = [file.stat() for file in files]
    except OSError:  # it has gone in the meantime
        return False
    return not any(
        each.st_uid != os.getuid() or time.time() - each.st_mtime < YOUNG or each.st_ino in locked for each in stats
    )


def _locked_inodes() -> set[int]:
    """Of all files that a process which we can see holds a lock of; proc(5)."""
    try:
        lines = Path("/proc/locks").read_text().splitlines()
    except OSError:
        return set()
    return {int(field.rpartition(":")[2]) for line in lines for field in line.split() if field.count(":") == 2}


def _is_held(lock: Path) -> bool:
    """Also by a process that we cannot see, of another container."""
    try:
        with lock.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # it is held, or has gone in the meantime
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
