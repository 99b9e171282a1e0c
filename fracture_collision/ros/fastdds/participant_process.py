"""The process of this machine that a DDS participant belongs to, and whether it is alive.

Fast DDS builds a participant's GUID from its vendor id (2 bytes), the host id (2), the lower half of the process id
(2), two random bytes and a counter. So a killed process of this machine can be distinguished at once from a silent one.
A process is reported dead only if it was seen alive: one in another container has a pid of another namespace.
Independent of ROS.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import NamedTuple

_EPROSIMA = b"\x01\x0f"  # vendor id of Fast DDS, OMG's list
_PID_BITS = 16  # of the process id, in a GUID


class Process(NamedTuple):
    """A process, identified beyond the reuse of its pid."""

    pid: int
    started: int  # [clock ticks since boot]: pids are reused


def is_of_this_process(participant: bytes) -> bool:
    """Compares vendor and pid; a participant of another host may have the same."""
    return participant[:2] == _EPROSIMA and _pid_of(participant) == os.getpid() % 2**_PID_BITS


def are_of_one_host(participant: bytes, other: bytes) -> bool:
    """Whether both GUIDs have the same vendor and host id."""
    return participant[:4] == other[:4]


def process_of(participant: bytes) -> Process | None:
    """The living process of this machine that created `participant`; None if it is not certain.

    It is certain if exactly one process with the pid uses Fast DDS. The participant must be of this host.
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
    """Whether the process has ended; a zombie has."""
    status = _status(process.pid)
    if status is None or status.started != process.started:
        return True
    # A main thread that has ended while other threads run looks like a zombie, too.
    return status.state in "ZX" and status.threads <= 1


def is_stopped(process: Process) -> bool:
    """Whether the process is stopped by SIGSTOP or a debugger."""
    status = _status(process.pid)
    return status is not None and status.started == process.started and status.state in "Tt"


def age_of(pid: int) -> float:
    """[s] since a process was started, in ticks of 10 ms as in proc(5). Raises ProcessLookupError."""
    status = _status(pid)
    if status is None:
        raise ProcessLookupError(f"no process {pid}")
    return time.clock_gettime(time.CLOCK_BOOTTIME) - status.started / os.sysconf("SC_CLK_TCK")


class _Status(NamedTuple):
    state: str
    threads: int
    started: int


def _status(pid: int) -> _Status | None:
    """None if there is no such process."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return None
    return _Status(words[0], int(words[17]), int(words[19]))  # proc(5): fields 3, 20 and 22


def _uses_fast_dds(pid: int) -> bool:
    """Whether the process has the library or its shared memory mapped; False if we may not read its maps."""
    try:
        maps = Path(f"/proc/{pid}/maps").read_text()
    except OSError:
        return False
    return "fastrtps" in maps or "fastdds" in maps


def _pid_of(participant: bytes) -> int:
    return int.from_bytes(participant[4:6], "little")
