"""Makes a node that replaces a killed one choose other ports than the killed one had.

Fast DDS takes the lowest free ports: those of the killed node. Processes that wrote to it still have its shared memory
port mapped, and keep writing to it until they notice that it has no reader: for a second or two, or for ever if the
listener was killed while it took a message (`shared_memory.orphaned_ports`). What they send to the successor meanwhile
is lost, including the latched log. So these ports are held until the successor has chosen others.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from fracture_collision.ros.fastdds.farewell import PORT_BASE, PORTS_A_DOMAIN
from fracture_collision.ros.fastdds.shared_memory import FOLDER, orphaned_ports

# Ports, in all domains, of readers with a network flow of their own, which rmw gives to its reader of node discovery.
FIRST_OF_FLOWS = 7000
# Discovery tries the lowest 32 pairs only, and living nodes have some of them.
MOST = 20


@contextmanager
def orphaned_ports_held(domain_id: int, folder: Path = FOLDER) -> Iterator[list[int]]:
    """Holds UDP ports while a participant is created; yields which.

    In the domain each shared memory port stands for a pair of UDP ports (DDSI-RTPS 2.2, 9.6.1.1).
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
            except OSError:  # already in use
                continue
            held.append(port)
        yield held
