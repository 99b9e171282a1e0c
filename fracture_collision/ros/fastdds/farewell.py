"""Sends our own participant the dispose message that a killed DDS participant could not send.

DDS considers a silent participant alive until its lease expires, after 20 s. A process that ends in order announces
that its participant is disposed, and the participant is removed at once. A process that detects the death of another
can send the same message to its own middleware; no other process receives it. Where it does not arrive (other
middleware, ports set by a user's profile, DDS security) the lease expires as usual.
"""

from __future__ import annotations

import os
import re
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

# DDSI-RTPS 2.2: 9.6.1.1 (ports), 9.3.1.3 (entities), 9.4.5.3 (Data), 9.6.3 (inline parameters)
PORT_BASE, PORTS_A_DOMAIN = 7400, 250
_METATRAFFIC_OFFSET, _PORTS_A_PARTICIPANT = 10, 2
_PARTICIPANT = bytes.fromhex("000001c1")
_ANNOUNCER, _LISTENER = bytes.fromhex("000100c2"), bytes.fromhex("000100c7")
_DATA, _LITTLE_ENDIAN_WITH_INLINE_QOS, _TO_INLINE_QOS = 0x15, 0x03, 16
_KEY_HASH, _STATUS_INFO, _SENTINEL = 0x70, 0x71, 0x01
_DISPOSED_AND_UNREGISTERED = bytes([0, 0, 0, 3])
_LAST_WORD = 2**31 - 1, 0  # sequence number, high and low: later than any of its own


def say_farewell_of(participant: bytes, domain_id: int) -> None:
    """`participant`: the first 12 bytes of its GUID. Takes effect a moment later, in threads of DDS."""
    datagram = farewell(participant)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as speaker:
        for address in own_metatraffic(domain_id):
            speaker.sendto(datagram, address)


def farewell(participant: bytes) -> bytes:
    """The RTPS message with which the participant would have announced its end."""
    inline = struct.pack("<HH", _KEY_HASH, 16) + participant + _PARTICIPANT
    inline += struct.pack("<HH", _STATUS_INFO, 4) + _DISPOSED_AND_UNREGISTERED + struct.pack("<HH", _SENTINEL, 0)
    body = struct.pack("<HH", 0, _TO_INLINE_QOS) + _LISTENER + _ANNOUNCER + struct.pack("<iI", *_LAST_WORD) + inline
    header = b"RTPS\x02\x03" + participant[:2] + participant
    return header + struct.pack("<BBH", _DATA, _LITTLE_ENDIAN_WITH_INLINE_QOS, len(body)) + body


def participants_here(domain_id: int) -> int:
    """Number of participants on this machine (in its network namespace), counted by their ports."""
    return len({port for _, port, _ in _metatraffic(domain_id)})


def own_metatraffic(domain_id: int) -> list[tuple[str, int]]:
    """Addresses at which participants of this process receive discovery messages."""
    inodes = _sockets_of(os.getpid())
    found = [(host, port) for host, port, inode in _metatraffic(domain_id) if inode in inodes]
    return [("127.0.0.1" if host == "0.0.0.0" else host, port) for host, port in found]


def processes_here(domain_id: int) -> list[int]:
    """Ids of the processes of this machine with participants in the domain; those of other users only for root."""
    inodes = {inode for _, _, inode in _metatraffic(domain_id)}
    if not inodes:
        return []
    pids = sorted(int(folder.name) for folder in Path("/proc").iterdir() if folder.name.isdigit())
    return [pid for pid in pids if not inodes.isdisjoint(_sockets_of(pid))]


def _sockets_of(pid: int) -> set[str]:
    """Inodes of a process's sockets; none if we may not read them, or it has ended."""
    inodes = set()
    with suppress(OSError):
        for file in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):  # closed in the meantime
                if (inode := re.fullmatch(r"socket:\[(\d+)\]", os.readlink(file))) is not None:
                    inodes.add(inode[1])
    return inodes


def _metatraffic(domain_id: int) -> Iterator[tuple[str, int, str]]:
    """Address, port and inode of each socket at which a participant of this machine receives discovery messages."""
    first = PORT_BASE + PORTS_A_DOMAIN * domain_id + _METATRAFFIC_OFFSET
    ports = range(first, first + PORTS_A_DOMAIN - _METATRAFFIC_OFFSET, _PORTS_A_PARTICIPANT)
    for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]:
        words = line.split()
        address, port = words[1].split(":")
        if int(port, 16) in ports:
            yield socket.inet_ntoa(struct.pack("=I", int(address, 16))), int(port, 16), words[9]
