"""Removes unused files of Fast DDS from shared memory.

A participant has a segment, and ports that it listens at, as files, each with a lock file that is held while it lives.
A killed process cannot remove them, and a port that its other users outlive stays even without a kill. Fast DDS removes
them only on command (`fastdds shm clean`, which handles the files with a lock), and an operator who runs a service for
weeks would have to know that.

A segment's name is random and used once. A port's name is its number: the next process opens the same files, and
receives nothing if they are then removed. Fast DDS opens each port under the port's mutex, a POSIX semaphore, which is
taken here too, so no port is opened while it is checked and removed. The mutex itself (32 bytes) stays: a process that
waits for a removed mutex and one that creates the next would not exclude each other.
"""

from __future__ import annotations

import ctypes
import fcntl
import mmap
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

FOLDER = Path("/dev/shm")
# A younger file may not have been locked by its creator yet.
YOUNG = 1.0  # [s]

_FILE = re.compile(r"(fastrtps_(?:[0-9a-f]{16}|port\d+))(?:_[es]l)?")
_LOCKS = ("_el", "_sl")  # of a port's only listener, and of listeners that share it
_PORT = "fastrtps_port"
_LIBC = ctypes.CDLL(None, use_errno=True)


def remove_left_behind(folder: Path = FOLDER) -> int:
    """Removes unused files; returns how many. Files that the system does not let us remove stay."""
    return sum(_remove(folder, name) for name in sorted(_unused(folder)))


def left_behind(folder: Path = FOLDER) -> set[Path]:
    """Our own files of segments and ports that no process of ours has mapped and no visible process has locked.

    A dead participant's port must stay while any process has it mapped: from it Fast DDS detects that the port is dead,
    and sends to the next one of that number.
    """
    return {file for files in _unused(folder).values() for file in files}


def _unused(folder: Path) -> dict[str, list[Path]]:
    """Segments and ports by name. Tries no lock: that would hold it for a moment in which others fail."""
    locked = _locked_inodes()
    suspects = {name: files for name, files in _groups(folder).items() if _seems_unused(files, locked)}
    if suspects:
        for mapped in _mapped(folder):
            if (name := _FILE.fullmatch(mapped)) is not None:
                suspects.pop(name[1], None)
    return suspects


def _remove(folder: Path, name: str) -> int:
    """Removes a segment or port if it is still unused, while no process can open it; returns how many files."""
    if not name.startswith(_PORT):
        return _remove_unlocked(folder, name)
    with _port_mutex(folder, name) as is_ours:
        # another process may have opened it since the check
        return _remove_unlocked(folder, name) if is_ours and name in _unused(folder) else 0


def _remove_unlocked(folder: Path, name: str) -> int:
    """Holds its locks meanwhile; an invisible process, of another container, may hold them already."""
    removed, held = 0, []
    try:
        for lock in (folder / f"{name}{ending}" for ending in _LOCKS):
            with suppress(FileNotFoundError):
                held.append(lock.open("rb"))
                fcntl.flock(held[-1], fcntl.LOCK_EX | fcntl.LOCK_NB)
        for ending in ("", *_LOCKS):
            with suppress(FileNotFoundError):
                (folder / f"{name}{ending}").unlink()
                removed += 1
    except OSError:
        pass  # it is held, or not ours
    finally:
        for file in held:
            file.close()
    return removed


@contextmanager
def _port_mutex(folder: Path, name: str) -> Iterator[bool]:
    """Holds the mutex under which Fast DDS opens a port; yields whether it is held.

    It is not if another process holds it or it does not exist.
    """
    try:
        with (folder / f"sem.{name}_mutex").open("r+b") as file:
            memory = mmap.mmap(file.fileno(), 0)
    except (OSError, ValueError):
        yield False
        return
    semaphore = ctypes.c_char.from_buffer(memory)
    is_ours = _LIBC.sem_trywait(ctypes.byref(semaphore)) == 0
    try:
        yield is_ours
    finally:
        if is_ours:
            _LIBC.sem_post(ctypes.byref(semaphore))
        del semaphore
        memory.close()


def orphaned_ports(folder: Path = FOLDER) -> set[int]:
    """Numbers of ports that some process has mapped and will write to although they have no listener any more.

    The listener has died, and the next process to open the port creates a new file of its name, or has already done so.
    In both cases the others use the old file until they notice, usually within two seconds. They never notice if the
    listener died while it took a message.
    """
    locked = _locked_inodes()
    found = set()
    for mapped in set(_mapped(folder)):
        name, _, removed = mapped.partition(" ")
        if not re.fullmatch(_PORT + r"\d+", name):
            continue
        with suppress(FileNotFoundError):
            # a port without a lock file is opened as it is
            if removed or (folder / f"{name}_el").stat().st_ino not in locked:
                found.add(int(name.removeprefix(_PORT)))
    return found


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
    except OSError:  # removed in the meantime
        return False
    return not any(
        each.st_uid != os.getuid() or time.time() - each.st_mtime < YOUNG or each.st_ino in locked for each in stats
    )


def _locked_inodes() -> set[int]:
    """Of all files on which a visible process holds a lock; proc(5)."""
    try:
        lines = Path("/proc/locks").read_text().splitlines()
    except OSError:
        return set()
    return {int(field.rpartition(":")[2]) for line in lines for field in line.split() if field.count(":") == 2}


def _mapped(folder: Path) -> Iterator[str]:
    """Names of the folder's files that are mapped by processes with maps that we may read.

    Names of removed files end with " (deleted)".
    """
    for process in os.listdir("/proc"):  # a glob would stat each entry, and fail if one has gone
        if not process.isdigit():
            continue
        try:
            lines = Path("/proc", process, "maps").read_text().splitlines()
        except OSError:
            continue
        for line in lines:
            at = line.find(f"{folder}/")
            if at >= 0:
                yield line[at + len(str(folder)) + 1 :]
