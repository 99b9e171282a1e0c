"""The scene that receives bad messages: a body of each kind, one broken, one removed, and little spare capacity."""

from __future__ import annotations

import numpy as np
from worlds.gate_world import FIRST, REFERENCE, SECOND, box, plane, record_bytes, rigid, sphere, tetrahedral

from fracture_collision.records import REMOVE
from fracture_collision.world import Settings

REMOVED = 5
# 53 nodes are in use; two more bodies of 45 fit, a larger one does not. 7 fragments have been made.
SETTINGS = Settings(threads=1, max_nodes=160, max_fragments=40)
FULL = SETTINGS._replace(max_bodies=4)  # no further body fits
# Its four fragments and the plane can form one pair more.
SPARSE = SETTINGS._replace(max_pairs=9)
AHEAD = SETTINGS._replace(lookahead=0.01)
FAST = REFERENCE._replace(linear_velocities=np.full(3 * len(REFERENCE.fragment_ids), 1e8))
AT_ONE_PLACE = REFERENCE._replace(positions=np.tile([0.0, 0.0, -0.2], len(REFERENCE.fragment_ids)))

_BODIES = (
    tetrahedral(1), plane(2), sphere(3), box(REMOVED, is_static=True), box(REMOVED, operation=REMOVE), rigid(4)
)  # fmt: skip
# (topic, record), in order; afterwards the scene answers REFERENCE
CLEAN = (
    *(("bodies", body._replace(sequence=number)) for number, body in enumerate(_BODIES, 1)),
    ("fracture_events", FIRST), ("fragment_states", REFERENCE),
)  # fmt: skip
# The rest of the scene: the second fracture, and states of both registries.
_STILL = REFERENCE._replace(step=8, fracture_sequence=2, fragment_ids=np.array([3, 4, 10, 12]))
ENDING = (
    ("fragment_states", REFERENCE),
    ("fracture_events", SECOND),
    *(("fragment_states", _STILL._replace(step=8 + i, positions=_STILL.positions - 0.01 * i)) for i in range(4)),
    ("fragment_states", REFERENCE._replace(step=12)),
)

__all__ = [
    "AHEAD", "AT_ONE_PLACE", "CLEAN", "ENDING", "FAST", "FULL", "REFERENCE", "REMOVED", "SETTINGS", "SPARSE",
    "record_bytes",
]  # fmt: skip
