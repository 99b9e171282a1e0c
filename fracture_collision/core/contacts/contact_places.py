"""Contacts of a pair transformed from the frame of a fragment to the world."""

from __future__ import annotations

from fracture_collision.core.contacts.known_samples import ID_SAMPLE, ID_SIDE
from fracture_collision.core.memory.compiled import inlined_kernel


@inlined_kernel
def put_in_world(pair, rotations, positions, row, ids, o, points_a, points_b, normals, gaps, samples):
    """Write a contact of `pair` (i, j), a row of query_pair's with its ids, to row `o` of PairContacts' columns."""
    side = ids[ID_SIDE]
    other = pair[1] if side == 0 else pair[0]
    r, t = rotations[other], positions[other]
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


@inlined_kernel
def _to_world(rotation, position, x, y, z, out):
    for k in range(3):
        out[k] = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z + position[k]
