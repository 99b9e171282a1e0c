"""Contacts of a pair transformed from the frame of a fragment to the world."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.known_samples import ID_SAMPLE, ID_SIDE
from fracture_collision.core.memory.compiled import query_kernel


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
    other = step.pairs[p, 1] if side == 0 else step.pairs[p, 0]
    r, t = step.rotations[other], step.positions[other]
    points_a, points_b, normals, gaps, samples = out
    own_point, other_point = (points_a[o], points_b[o]) if side == 0 else (points_b[o], points_a[o])
    _to_world(r, t, row[0], row[1], row[2], own_point)
    _to_world(r, t, row[3], row[4], row[5], other_point)
    sign = -1.0 if side == 0 else 1.0
    gap = 0.0
    for d in range(3):
        n = sign * (r[d, 0] * row[6] + r[d, 1] * row[7] + r[d, 2] * row[8])
        normals[o, d] = n
        gap += n * (points_b[o, d] - points_a[o, d])
    gaps[o] = gap
    samples[o, 0], samples[o, 1] = side, ids[ID_SAMPLE]


@query_kernel
def _to_world(rotation, position, x, y, z, out):
    for k in range(3):
        out[k] = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z + position[k]
