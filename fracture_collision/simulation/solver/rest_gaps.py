"""Rest gaps: the distance at which bodies rest.

Bodies resting at zero gap would overlap by whatever the solver leaves uncorrected. A sample that little inside a face
and just below an edge is as near to the side that it should slide down as to the top, which would hold it: a shard
would hang there by an invisible depth. So bodies rest a little apart, as with the rest offset of PhysX. Fragments of
one body stay in contact, as they broke, until they have moved relative to each other.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.portable_math import dots
from fracture_collision.simulation.solver.contact_memory import ContactMemory

# Two fragments are in place at a contact that has moved by less than this many rest gaps since their body was whole.
IN_PLACE = 2.5


def rest_gaps_of(memory: ContactMemory, one_body: np.ndarray, rest_gap: np.ndarray) -> np.ndarray:
    """(N,) [m] rest gap of each contact in `memory`: its pair's `rest_gap` (p,), or 0 between fragments in place.

    `one_body` (p,) bool: pairs of fragments of one body; their body frames coincided when they broke.
    """
    moved = memory.points_a - memory.points_b
    counts: np.ndarray = np.diff(memory.pair_begin)
    gaps = np.repeat(rest_gap, counts)
    reach = IN_PLACE * gaps
    in_place = dots(moved, moved) < reach * reach
    return np.where(np.repeat(one_body, counts) & in_place, 0.0, gaps)
