"""Contacts of a later moment, given where their points are now (first_touch.py)."""

from __future__ import annotations

import math

from fracture_collision.core.contacts.known_samples import ID_SAMPLE, ID_SIDE
from fracture_collision.core.lookahead.motion import put_pose
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import SPHERE
from fracture_collision.core.memory.rotations import relative_pose, rotated, to_other, turned_back


@query_kernel
def put_poses(moving, t, of_world, place, pair):
    """Compute the poses of the two fragments of a Moving after `t` [s].

    Writes world rotations to of_world (2, 3, 3), world positions to place (2, 3) [m], and the relative poses to the
    Pair.
    """
    put_pose(moving.motion, moving.rotations, moving.positions, moving.i, t, of_world[0], place[0])
    put_pose(moving.motion, moving.rotations, moving.positions, moving.j, t, of_world[1], place[1])
    relative_pose(of_world[0], place[0], of_world[1], place[1], pair.rotation[0], pair.translation[0])
    relative_pose(of_world[1], place[1], of_world[0], place[0], pair.rotation[1], pair.translation[1])


@query_kernel
def keep_new(sink, known, found, near):
    """Of `found` contacts behind the `known` ones, keep those that are apart now and not among the known.

    near [m]: contacts with a larger gap are apart. Returns the number kept.
    """
    contacts, ids = sink
    kept = known
    for c in range(known, known + found):
        is_new = contacts[c, 9] > near
        for k in range(known):
            is_new &= ids[k, ID_SIDE] != ids[c, ID_SIDE] or ids[k, ID_SAMPLE] != ids[c, ID_SAMPLE]
        if is_new:
            for d in range(contacts.shape[1]):
                contacts[kept, d] = contacts[c, d]
            for d in range(ids.shape[1]):
                ids[kept, d] = ids[c, d]
            kept += 1
    return kept - known


@query_kernel
def gap_then(sink, begin, end, moving, pair):
    """The least gap [m] of contacts begin .. end - 1 of a Sink, given in current frames, at the Pair's relative poses.

    Each gap is along the contact's normal, which turns with the fragment that does not own the sample.
    """
    contacts, ids = sink
    _, _, rotation, translation = pair
    i, j, rotations, positions, _ = moving
    least = math.inf
    for c in range(begin, end):
        side, row = ids[c, ID_SIDE], contacts[c]
        own, other = (i, j) if side == 0 else (j, i)
        x, y, z = to_other(rotations[other], positions[other], row[0], row[1], row[2])
        p = positions[own]
        x, y, z = turned_back(rotations[own], x - p[0], y - p[1], z - p[2])
        x, y, z = to_other(rotation[side], translation[side], x, y, z)
        least = min(least, row[6] * (x - row[3]) + row[7] * (y - row[4]) + row[8] * (z - row[5]))
    return least


@query_kernel
def bring_back(pools, moving, of_world, pair, sink, count):
    """Transform the first `count` contacts of a Sink from a later moment to current frames.

    Points stay with their fragments, but for those of a sphere, which rolls over them: they are carried back without
    its spin.

    pair, of_world (2, 3, 3): relative poses and world rotations at that moment, see put_poses.
    """
    contacts, ids = sink
    _, _, rotation, translation = pair
    i, j, rotations, positions, _ = moving
    for c in range(count):
        side, row = ids[c, ID_SIDE], contacts[c]
        own, other = (i, j) if side == 0 else (j, i)
        x, y, z = to_other(rotation[1 - side], translation[1 - side], row[0], row[1], row[2])
        if pools.fragment.kind[pair.a if side == 0 else pair.b] == SPHERE:
            x, y, z = rotated(of_world[side], x, y, z)
            x, y, z = turned_back(rotations[own], x, y, z)
        elif pools.fragment.kind[pair.b if side == 0 else pair.a] == SPHERE:
            row[3], row[4], row[5] = rotated(of_world[1 - side], row[3], row[4], row[5])
            row[3], row[4], row[5] = turned_back(rotations[other], row[3], row[4], row[5])
        x, y, z = to_other(rotations[own], positions[own], x, y, z)
        p, back = positions[other], rotations[other]
        row[0], row[1], row[2] = turned_back(back, x - p[0], y - p[1], z - p[2])
        x, y, z = rotated(of_world[1 - side], row[6], row[7], row[8])
        row[6], row[7], row[8] = turned_back(back, x, y, z)
        row[9] = row[6] * (row[0] - row[3]) + row[7] * (row[1] - row[4]) + row[8] * (row[2] - row[5])
