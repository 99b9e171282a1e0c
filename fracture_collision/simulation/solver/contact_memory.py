"""Contacts of the last steps that the service has not listed again, carried along with their bodies.

The service lists a pair's first few contacts and beyond them only those deeper than a tolerance (Glondu 2014, section
5.2). The selection changes from step to step, so a shard at rest would lose a support, sink by the tolerance, get it
back, and never come to rest. A contact therefore stays in the pair's manifold, as in Bullet's persistent manifolds,
while the service lists another that pushes the same way, and until its witness points, each fixed to its body, separate
or slip too far. A sample that slips over an edge is nearest to another face from then on, while its remembered contact
keeps the normal of the first. If no listed contact of the pair pushed that way, it would hold a shard beside the edge.

Bodies resting at zero gap would overlap by whatever the solver leaves uncorrected. A sample that little inside a face
and just below an edge is as near to the side that it should slide down as to the top, which would hold it: a shard
would hang there by an invisible depth. So bodies rest a little apart (`rest_gaps_of`), as with the rest offset of
PhysX. Fragments of one body stay in contact, as they broke, until they have moved relative to each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.kernel_sources import cached_njit
from fracture_collision.portable_math import dots
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.simulation.compiled import uncounted
from fracture_collision.simulation.rotations import rotation_matrices

# Cosine of the angle (25 degrees) within which two contacts push the same way: more than the normals of one curved face
# differ between neighbouring samples, less than those of two faces that meet in an edge.
SAME_WAY = 0.9


class ContactMemory(NamedTuple):
    """All contacts of a step, remembered ones included, each point in its body's frame."""

    fragment_a: np.ndarray  # (p,) uint32, ascending by (a, b)
    fragment_b: np.ndarray
    pair_begin: np.ndarray  # (p + 1,) int64
    contact_ids: np.ndarray  # (N,) uint64
    points_a: np.ndarray  # (N, 3) [m], frame of a
    points_b: np.ndarray  # (N, 3) [m], frame of b
    normals: np.ndarray  # (N, 3), frame of a


class _Listed(NamedTuple):
    """Contacts of the service, in the world frame."""

    fragment_a: np.ndarray  # (p,) uint32, ascending by (a, b)
    fragment_b: np.ndarray
    begin: np.ndarray  # (p + 1,) int64
    contact_ids: np.ndarray  # (N,) uint64
    points_a: np.ndarray  # (N, 3) [m]
    points_b: np.ndarray  # (N, 3) [m]
    normals: np.ndarray  # (N, 3)
    gaps: np.ndarray  # (N,) [m]


class _Frames(NamedTuple):
    """Body frames of the fragments, and the rows of each pair's two."""

    of_a: np.ndarray  # (p,) int64
    of_b: np.ndarray  # (p,) int64
    positions: np.ndarray  # (f, 3) [m]
    rotations: np.ndarray  # (f, 3, 3)


NOTHING = ContactMemory(
    np.zeros(0, np.uint32), np.zeros(0, np.uint32), np.zeros(1, np.int64), np.zeros(0, np.uint64),
    np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)),
)  # fmt: skip


def with_remembered(
    contacts: ContactConstraintArray, states: FragmentStates, memory: ContactMemory, reach: np.ndarray
) -> tuple[ContactConstraintArray, ContactMemory]:
    """The contacts, each pair's followed by its remembered ones, and the memory of both for the next step.

    `states` are those that `contacts` were computed for; a fragment missing there is static, its frame the world's.
    `reach` (p,) is the distance [m] by which a remembered contact of each pair may open or slip.
    """
    order = np.argsort(states.fragment_ids, kind="stable")
    ids = states.fragment_ids[order]
    positions = np.concatenate((states.positions[order], np.zeros((1, 3))))
    quaternions = np.concatenate((states.orientations[order], [[0.0, 0.0, 0.0, 1.0]]))

    def frames_of(fragments: np.ndarray) -> np.ndarray:
        rows = np.searchsorted(ids, fragments)
        return np.where(np.append(ids, 0)[rows] == fragments, rows, len(ids))

    listed = _Listed(
        contacts.fragment_a, contacts.fragment_b, contacts.pair_begin.astype(np.int64), contacts.contact_ids,
        contacts.points_a, contacts.points_b, contacts.normals,
        contacts.gaps,
    )  # fmt: skip
    frames = _Frames(
        frames_of(contacts.fragment_a), frames_of(contacts.fragment_b), positions, rotation_matrices(quaternions)
    )
    begin, contact_ids, points_a, points_b, normals, gaps, *local = _merge(listed, frames, memory, reach)
    merged = contacts._replace(
        pair_begin=begin, contact_ids=contact_ids, points_a=points_a, points_b=points_b,
        normals=normals, gaps=gaps,
    )  # fmt: skip
    return merged, ContactMemory(contacts.fragment_a, contacts.fragment_b, begin, contact_ids, *local)


@cached_njit
def _merge(listed, frames, memory, reach):
    fragment_a, fragment_b, begin, contact_ids, points_a, points_b, normals, gaps = listed
    frame_a, frame_b, positions, rotations = frames
    room = len(gaps) + len(memory.contact_ids)
    out_begin = np.zeros(len(fragment_a) + 1, dtype=np.int64)
    out_ids = np.empty(room, dtype=np.uint64)
    out_a, out_b, out_normals, out_gaps = np.empty((room, 3)), np.empty((room, 3)), np.empty((room, 3)), np.empty(room)
    local_a, local_b, local_normals = np.empty((room, 3)), np.empty((room, 3)), np.empty((room, 3))
    nowhere = np.zeros(3)
    count = 0
    old = 0
    for pair in range(len(fragment_a)):
        a, b = fragment_a[pair], fragment_b[pair]
        position_a, rotation_a = positions[frame_a[pair]], rotations[frame_a[pair]]
        position_b, rotation_b = positions[frame_b[pair]], rotations[frame_b[pair]]
        for c in range(begin[pair], begin[pair + 1]):
            out_ids[count] = contact_ids[c]
            out_a[count], out_b[count] = points_a[c], points_b[c]
            out_normals[count], out_gaps[count] = normals[c], gaps[c]
            _into_frame(rotation_a, position_a, points_a[c], local_a[count])
            _into_frame(rotation_b, position_b, points_b[c], local_b[count])
            _into_frame(rotation_a, nowhere, normals[c], local_normals[count])
            count += 1
        while old < len(memory.fragment_a) and (
            memory.fragment_a[old] < a or (memory.fragment_a[old] == a and memory.fragment_b[old] < b)
        ):
            old += 1
        if old < len(memory.fragment_a) and memory.fragment_a[old] == a and memory.fragment_b[old] == b:
            for m in range(memory.pair_begin[old], memory.pair_begin[old + 1]):
                if _listed(contact_ids, begin[pair], begin[pair + 1], memory.contact_ids[m]):
                    continue
                # Written into the next slot, which the next contact overwrites if this one is dropped.
                _out_of_frame(rotation_a, position_a, memory.points_a[m], out_a[count])
                _out_of_frame(rotation_b, position_b, memory.points_b[m], out_b[count])
                _out_of_frame(rotation_a, nowhere, memory.normals[m], out_normals[count])
                gap, square = 0.0, 0.0
                for i in range(3):
                    apart = out_b[count, i] - out_a[count, i]
                    gap += apart * out_normals[count, i]
                    square += apart * apart
                if gap > reach[pair] or square - gap * gap > reach[pair] * reach[pair]:
                    continue
                if not _pushes_as_one_of(normals, begin[pair], begin[pair + 1], out_normals[count]):
                    continue
                out_ids[count] = memory.contact_ids[m]
                out_gaps[count] = gap
                local_a[count], local_b[count] = memory.points_a[m], memory.points_b[m]
                local_normals[count] = memory.normals[m]
                count += 1
        out_begin[pair + 1] = count
    return (
        out_begin, out_ids[:count], out_a[:count], out_b[:count], out_normals[:count], out_gaps[:count],
        local_a[:count], local_b[:count], local_normals[:count],
    )  # fmt: skip


@cached_njit
def _listed(contact_ids, first, end, wanted):
    for c in range(first, end):  # noqa: SIM110 (compiled)
        if contact_ids[c] == wanted:
            return True
    return False


@cached_njit
def _pushes_as_one_of(normals, first, end, normal):
    for c in range(first, end):  # noqa: SIM110 (compiled)
        if normals[c, 0] * normal[0] + normals[c, 1] * normal[1] + normals[c, 2] * normal[2] > SAME_WAY:
            return True
    return False


@uncounted
def _into_frame(rotation, position, point, out):
    x, y, z = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    for i in range(3):
        out[i] = rotation[0, i] * x + rotation[1, i] * y + rotation[2, i] * z


@uncounted
def _out_of_frame(rotation, position, point, out):
    for i in range(3):
        turned = rotation[i, 0] * point[0] + rotation[i, 1] * point[1] + rotation[i, 2] * point[2]
        out[i] = turned + position[i]


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
