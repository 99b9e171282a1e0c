"""Other ports than those of nodes that were killed before, for one that takes a place of theirs.

Fast DDS takes the lowest ports that are free: those of the one that was killed. Whoever spoke with that one has its
port of shared memory mapped still, and goes on writing there until it notices that nobody reads: for a second or two,
or for ever where the listener was killed while it took a message (`shared_memory.orphaned_ports`). What it sends to the
successor meanwhile is lost, the latched log among it. So these ports are held until the successor has chosen others.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from fracture_collision.ros.fastdds.farewell import PORT_BASE, PORTS_A_DOMAIN
from fracture_collision.ros.fastdds.shared_memory import FOLDER, orphaned_ports

# The ports of readers with a network flow of their own, which rmw gives to the one that hears of nodes, of all domains.
FIRST_OF_FLOWS = 7000
# Discovery looks at the lowest 32 pairs only, and the living have some.
MOST = 20


@contextmanager
def orphaned_ports_held(domain_id: int, folder: Path = FOLDER) -> Iterator[list[int]]:
    """While a participant is made; yields which. Of the domain a pair of UDP ports for each of shared memory (DDSI-RTPS
    2.2, 9.6.1.1).
    """
    first = PORT_BASE + PORTS_A_DOMAIN * domain_id
    orphans = sorted(orphaned_ports(folder))
    pairs = [port for port in orphans if first < port < first + PORTS_A_DOMAIN][:MOST]
    flows = [port for port in orphans if FIRST_OF_FLOWS <= port < PORT_BASE]
    with ExitStack() as stack:
        held = []
        for port in (*(each for user in pairs for each in (user - 1, user)), *flows):
            holder = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            try:
                holder.bind(("127.0.0.1", port))
            except OSError:  # somebody has it already
                continue
            held.append(port)
        yield held
