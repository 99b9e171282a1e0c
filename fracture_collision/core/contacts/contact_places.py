"""Contacts of a pair transformed from the frame of a fragment to the world."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.known_samples import ID_SAMPLE, ID_SIDE
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.transforms import rotated, to_other
from fracture_collision.core.memory.vectors import dot, minus, put, scaled, vector_at


class WorldContacts(NamedTuple):
    """Columns of n contacts in the world."""

    points_a: np.ndarray  # (n, 3) float64 [m]
    points_b: np.ndarray  # (n, 3) float64 [m]
    normals: np.ndarray  # (n, 3) float64, from a to b
    gaps: np.ndarray  # (n,) float64 [m]
    samples: np.ndarray  # (n, 2) int64: side whose sample it is (0: a), sample index, see Sink


def make_world_contacts(n: int) -> WorldContacts:
    """Columns for n contacts, not initialized."""
    return WorldContacts(
        np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty((n, 2), np.int64)
    )


@query_kernel
def put_in_world(step, p, sink, c, out, o):
    """Write contact `c` of a Sink, found for pair `p` of a Step, to row `o` of WorldContacts."""
    row, ids = sink.contacts[c], sink.ids[c]
    side = ids[ID_SIDE]
    frame = step.pairs[p, 1] if side == 0 else step.pairs[p, 0]
    r, t = step.rotations[frame], step.positions[frame]
    points_a, points_b, normals, gaps, samples = out
    own, other = to_other(r, t, row), to_other(r, t, vector_at(row, 3))
    a, b = (own, other) if side == 0 else (other, own)
    n = scaled(-1.0 if side == 0 else 1.0, rotated(r, vector_at(row, 6)))
    put(points_a, o, a)
    put(points_b, o, b)
    put(normals, o, n)
    gaps[o] = 0.0 + dot(n, minus(b, a))  # 0.0 +: never -0.0
    samples[o, 0], samples[o, 1] = side, ids[ID_SAMPLE]
