"""Whether the ports of this process's DDS participant work.

If Fast DDS cannot open a port it tries other numbers and, if none of them can be opened, continues without one: the
node reports that it is ready, others write to a port without a reader, and nothing arrives. Neither rmw nor rclpy
reports it. Open sockets, and the locks and mappings of its ports in shared memory, show it.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from fracture_collision.ros.fastdds.farewell import PORT_BASE, PORTS_A_DOMAIN, own_metatraffic
from fracture_collision.ros.fastdds.shared_memory import FOLDER

_LOCK = re.compile(r"fastrtps_port(\d+)_el")
_SEGMENT_LOCK = re.compile(r"fastrtps_[0-9a-f]{16}_el")


def fault_of_own_ports(domain_id: int) -> str:
    """Describes the fault of this process's ports; "" if they work.

    For a participant with both default transports of Fast DDS, UDP and shared memory; on a system without shared memory
    Fast DDS works without it.
    """
    if not own_metatraffic(domain_id):
        return f"no UDP port of ROS domain {domain_id} could be opened for discovery"
    opened = _opened_in(FOLDER)
    if not any(_SEGMENT_LOCK.fullmatch(name) for name in opened):
        return ""
    first = PORT_BASE + PORTS_A_DOMAIN * domain_id
    ports = [int(lock[1]) for name in opened if (lock := _LOCK.fullmatch(name)) is not None]
    own = [port for port in ports if first <= port < first + PORTS_A_DOMAIN]
    if not own:
        return f"no port of ROS domain {domain_id} could be opened in shared memory ({FOLDER})"
    lost = [port for port in own if not _is_listened_at(port, opened)]
    if lost:
        return f"port {lost[0]} in shared memory ({FOLDER}) was removed by another process"
    return ""


def _opened_in(folder: Path) -> dict[str, int]:
    """Names and inodes of the folder's files that this process has open; removed files are named "... (deleted)"."""
    found = {}
    for file in Path("/proc/self/fd").iterdir():
        try:
            target = Path(os.readlink(file))
            if target.parent == folder:
                found[target.name] = file.stat().st_ino
        except OSError:  # closed in the meantime
            continue
    return found


def _is_listened_at(port: int, opened: dict[str, int]) -> bool:
    """Whether a process that opens the port by name finds the files that this process has locked and mapped."""
    lock, segment = f"fastrtps_port{port}_el", FOLDER / f"fastrtps_port{port}"
    try:
        if (FOLDER / lock).stat().st_ino != opened[lock]:
            return False
        inode = segment.stat().st_ino
    except FileNotFoundError:
        return False
    for line in Path("/proc/self/maps").read_text().splitlines():
        words = line.split(None, 5)
        if len(words) == 6 and words[5] == str(segment) and int(words[4]) == inode:
            return True
    return False
