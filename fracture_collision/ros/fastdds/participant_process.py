"""The process of this machine that a DDS participant belongs to, and whether it lives.

Fast DDS makes a participant's GUID of its vendor's id (2 bytes), the host's (2), the lower half of the process's id
(2), two random bytes and a counter. So a process that was killed can be told at once from one that is silent, if it is
this machine's. Only one that was seen alive is ever called dead: who lives in another container has a pid of another
kind. Knows no ROS.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import NamedTuple

_EPROSIMA = b"\x01\x0f"  # vendor id of Fast DDS, OMG's list
_PID_BITS = 16  # of a process id that a GUID has


class Process(NamedTuple):
    pid: int
    started: int  # [clock ticks since boot]: a pid is given to another process one day


def is_of_this_process(participant: bytes) -> bool:
    """Of its vendor and pid; another host may have one with the same."""
    return participant[:2] == _EPROSIMA and _pid_of(participant) == os.getpid() % 2**_PID_BITS


def are_of_one_host(participant: bytes, other: bytes) -> bool:
    return participant[:4] == other[:4]


def process_of(participant: bytes) -> Process | None:
    """The living process of this machine that has made `participant`, if that can be told for certain: the only one of
    its pid that uses Fast DDS. Its host has to be this one.
    """
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and int(folder.name) % 2**_PID_BITS == _pid_of(participant):
            pid = int(folder.name)
            status = _status(pid)
            if status is not None and _uses_fast_dds(pid):
                found.append(Process(pid, status.started))
    return found[0] if len(found) == 1 else None


def is_dead(process: Process) -> bool:
    status = _status(process.pid)
    if status is None or status.started != process.started:
        return True
    # A main thread that has ended while others go on looks like a zombie, too.
    return status.state in "ZX" and status.threads <= 1


def is_stopped(process: Process) -> bool:
    """By SIGSTOP or a debugger."""
    status = _status(process.pid)
    return status is not None and status.started == process.started and status.state in "Tt"


def age_of(pid: int) -> float:
    """[s] since a process was started, to the tick (10 ms) that proc(5) tells it by. Raises ProcessLookupError."""
    status = _status(pid)
    if status is None:
        raise ProcessLookupError(f"no process {pid}")
    return time.clock_gettime(time.CLOCK_BOOTTIME) - status.started / os.sysconf("SC_CLK_TCK")


class _Status(NamedTuple):
    state: str
    threads: int
    started: int


def _status(pid: int) -> _Status | None:
    """None where there is no such process."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return None
    return _Status(words[0], int(words[17]), int(words[19]))  # proc(5): fields 3, 20 and 22


def _uses_fast_dds(pid: int) -> bool:
    """Whether it has its library or its shared memory mapped; False where we may not look."""
    try:
        maps = Path(f"/proc/{pid}/maps").read_text()
    except OSError:
        return False
    return "fastrtps" in maps or "fastdds" in maps


def _pid_of(participant: bytes) -> int:
    return int.from_bytes(participant[4:6], "little")
