"""How far apart bodies rest.

Bodies that rested in contact would rest inside each other by whatever a solver leaves uncorrected. A sample so little
inside a face and just below an edge is as near to the side that it should slide down as to the top, which would hold
it: a shard would hang there by a depth that nobody can see. So what rests is a little apart, as with the rest offset of
PhysX. Fragments of one body stay as they broke, in contact, until they have moved against each other.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.portable_math import dots
from fracture_collision.simulation.solver.contact_memory import ContactMemory

# Two fragments are in place at a contact that has moved by less than this many gaps at rest since their body was whole.
IN_PLACE = 2.5


def rest_gaps_of(memory: ContactMemory, one_body: np.ndarray, rest_gap: float) -> np.ndarray:
    """(N,) [m] the gap at rest of each contact in `memory`: `rest_gap`, or 0 between fragments in place.

    `one_body` (p,) bool: pairs of fragments of one body, whose frames were one frame when they broke.
    """
    moved = memory.points_a - memory.points_b
    reach = IN_PLACE * rest_gap
    in_place = dots(moved, moved) < reach * reach
    return np.where(np.repeat(one_body, np.diff(memory.pair_begin)) & in_place, 0.0, rest_gap)
