"""Other ports than those of a node that was killed just before, for the one that takes its place.

Fast DDS takes the lowest ports that are free: those of the one that was killed. Whoever spoke with that one has its
port of shared memory mapped still, and goes on writing there for a second or two until it notices that nobody reads;
what it says to the successor meanwhile is lost, the latched log among it. So these ports are held until the successor
has chosen others.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from fracture_collision.ros.farewell import PORT_BASE, PORTS_A_DOMAIN
from fracture_collision.ros.shared_memory import FOLDER, dead_ports

# Ports of longer ago have been noticed; and numbers must not climb, as discovery looks at the lowest 32 pairs only.
MOST = 2


@contextmanager
def ports_of_the_dead_held(domain_id: int, folder: Path = FOLDER) -> Iterator[list[int]]:
    """While a participant is made; yields which: a pair of UDP ports for each of shared memory (DDSI-RTPS 2.2,
    9.6.1.1).
    """
    first = PORT_BASE + PORTS_A_DOMAIN * domain_id
    dead = [port for port in dead_ports(folder) if first < port < first + PORTS_A_DOMAIN][:MOST]
    with ExitStack() as stack:
        held = []
        for port in (each for user in dead for each in (user - 1, user)):
            holder = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            try:
                holder.bind(("127.0.0.1", port))
            except OSError:  # somebody has it already
                continue
            held.append(port)
        yield held
