"""Pairs whose world boxes overlap: sort along the axis of the widest spread, sweep, test the other two axes.

If few fragments have moved since the last step, only those are tested, against all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.lookahead.motion import NO_MOTION, Motion, sweep_box
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.kinds import PLANE, is_bounded

# All pairs are recomputed if more than one fragment in FEW has moved.
FEW = 16


class Paired(NamedTuple):
    """The pairs of a step, and the state they were computed from."""

    rows: np.ndarray  # (n,) int64 of FragmentPool
    rotations: np.ndarray  # (n, 3, 3)
    positions: np.ndarray  # (n, 3) [m]
    motion: Motion  # of the rows
    boxes: np.ndarray  # (n, 6) [m] in the world, with their margins, swept over the look-ahead time
    pairs: np.ndarray  # (p, 2) int64 of indices i < j into `rows`, ascending


NOTHING_PAIRED = Paired(
    np.zeros(0, np.int64), np.zeros((0, 3, 3)), np.zeros((0, 3)), NO_MOTION, np.zeros((0, 6)),
    np.zeros((0, 2), np.int64),
)  # fmt: skip


@kernel
def world_boxes(fragment_box, rows, rotations, positions, margins, boxes):
    """Write the world boxes of fragments `rows` (n,) to `boxes` (n, 6) [m].

    fragment_box (F, 6): of FragmentPool; rotations (n, 3, 3), positions (n, 3) [m]: world poses; each box is grown by
    its margin (n,) [m].
    """
    for i in range(len(rows)):
        _put_world_box(fragment_box[rows[i]], rotations[i], positions[i], margins[i], boxes[i])


@query_kernel
def _put_world_box(b, rotation, position, margin, box):
    for k in range(3):
        center = position[k]
        half = margin
        for j in range(3):
            center += rotation[k, j] * 0.5 * (b[j] + b[j + 3])
            half += abs(rotation[k, j]) * 0.5 * (b[j + 3] - b[j])
        box[k] = center - half
        box[k + 3] = center + half


@kernel
def _reaches_plane(shape, rotation, position, box):
    """Whether a world box reaches the half-space n.x <= offset of a plane fragment with the given pose."""
    lowest = -shape[3]
    for k in range(3):
        n = rotation[k, 0] * shape[0] + rotation[k, 1] * shape[1] + rotation[k, 2] * shape[2]
        lowest += n * ((box[k] if n > 0.0 else box[k + 3]) - position[k])
    return lowest <= 0.0


@kernel
def overlapping_pairs(boxes, kinds, shapes, rotations, positions, is_static, most):
    """Pairs (p, 2) of indices i < j, ascending, whose boxes overlap; never two static ones, never two planes.

    If there are more than `most`, some most + 1 of them: the search stops there.
    """
    n = len(boxes)
    bounded = np.flatnonzero(kinds != PLANE)
    found = np.empty((64, 2), dtype=np.int64)
    used = 0
    axis = 0
    widest = -1.0
    for k in range(3):
        if len(bounded):
            middle = boxes[bounded, k] + boxes[bounded, k + 3]
            spread = np.sum((middle - middle.mean()) ** 2)
            if spread > widest:
                axis, widest = k, spread
    order = bounded[np.argsort(boxes[bounded, axis], kind="mergesort")]
    u, v = (axis + 1) % 3, (axis + 2) % 3
    for p in range(len(order)):
        i = order[p]
        for q in range(p + 1, len(order)):
            j = order[q]
            if boxes[j, axis] > boxes[i, axis + 3]:
                break
            if is_static[i] and is_static[j]:
                continue
            if boxes[j, u] > boxes[i, u + 3] or boxes[i, u] > boxes[j, u + 3]:
                continue
            if boxes[j, v] > boxes[i, v + 3] or boxes[i, v] > boxes[j, v + 3]:
                continue
            if used == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            found[used, 0], found[used, 1] = min(i, j), max(i, j)
            used += 1
            if used > most:
                return found[:used]
    for i in range(n):
        if is_bounded(kinds[i]):
            continue
        for j in bounded:
            if is_static[i] and is_static[j]:
                continue
            if _reaches_plane(shapes[i], rotations[i], positions[i], boxes[j]):
                if used == len(found):
                    found = np.concatenate((found, np.empty_like(found)))
                found[used, 0], found[used, 1] = min(i, j), max(i, j)
                used += 1
                if used > most:
                    return found[:used]
    keys = found[:used, 0] * n + found[:used, 1]
    return found[:used][np.argsort(keys, kind="mergesort")]


@kernel
def pairs_within_reach(fragment, placed, motion, is_static, tolerance, most, before):
    """R (n,) [m] of fragments, and the Paired that may be within `tolerance` (a share of the smaller R) of each other.

    placed: rows (n,) of the fragments in a FragmentPool, poses (n, 3, 3), (n, 3); motion: they may be near later, too;
    is_static, most: see overlapping_pairs. before: the last step's, of the same pool, tolerance and static fragments.
    It makes the query faster and never changes its result.
    """
    rows, rotations, positions = placed
    radius = fragment.radius[rows]
    # boxes that each grow by their own tolerance overlap whenever their fragments come within the smaller one
    margins = np.where(np.isfinite(radius), tolerance * radius, 0.0)
    kinds, shapes = fragment.kind[rows], fragment.shape[rows]
    has_moved = _that_moved(before, rows, rotations, positions, motion)
    if len(before.rows) != len(rows) or FEW * np.count_nonzero(has_moved) > len(rows):
        boxes = np.empty((len(rows), 6))
        world_boxes(fragment.box, rows, rotations, positions, margins, boxes)
        for i in range(len(motion.reach)):
            sweep_box(motion, i, boxes[i])
        pairs = overlapping_pairs(boxes, kinds, shapes, rotations, positions, is_static, most)
        return radius, Paired(rows, rotations, positions, motion, boxes, pairs)
    boxes = before.boxes.copy()
    for i in np.flatnonzero(has_moved):
        _put_world_box(fragment.box[rows[i]], rotations[i], positions[i], margins[i], boxes[i])
        if motion.time > 0.0:
            sweep_box(motion, i, boxes[i])
    pairs = _renewed(before, has_moved, boxes, kinds, shapes, rotations, positions, is_static)
    return radius, Paired(rows, rotations, positions, motion, boxes, pairs)


@kernel
def _that_moved(before, rows, rotations, positions, motion):
    """(n,) bool: which fragments have another pose or velocity than before; all, if the fragments are not the same."""
    n = len(rows)
    if len(before.rows) != n or before.motion.time != motion.time:
        return np.ones(n, np.bool_)
    has_moved = np.zeros(n, np.bool_)
    for i in range(n):
        if rows[i] != before.rows[i]:
            return np.ones(n, np.bool_)
        for d in range(3):
            has_moved[i] |= positions[i, d] != before.positions[i, d]
            for k in range(3):
                has_moved[i] |= rotations[i, d, k] != before.rotations[i, d, k]
            if motion.time > 0.0:
                has_moved[i] |= motion.linear[i, d] != before.motion.linear[i, d]
                has_moved[i] |= motion.angular[i, d] != before.motion.angular[i, d]
    return has_moved


@kernel
def _renewed(before, has_moved, boxes, kinds, shapes, rotations, positions, is_static):
    """Pairs of `boxes`: from `before` where neither fragment has moved; of the others all that meet."""
    n, used = len(boxes), 0
    found = np.empty((64, 2), dtype=np.int64)
    for i in np.flatnonzero(has_moved):
        for j in range(n):
            if j == i or (has_moved[j] and j < i):
                continue
            if _meet(boxes, kinds, shapes, rotations, positions, is_static, i, j):
                if used == len(found):
                    found = np.concatenate((found, np.empty_like(found)))
                found[used, 0], found[used, 1] = min(i, j), max(i, j)
                used += 1
    found = found[:used][np.argsort(found[:used, 0] * n + found[:used, 1], kind="mergesort")]
    total = used
    for p in range(len(before.pairs)):
        total += not (has_moved[before.pairs[p, 0]] or has_moved[before.pairs[p, 1]])
    pairs = np.empty((total, 2), np.int64)
    p = q = 0
    for k in range(total):
        while p < len(before.pairs) and (has_moved[before.pairs[p, 0]] or has_moved[before.pairs[p, 1]]):
            p += 1
        of, at = before.pairs, p
        if p == len(before.pairs) or (
            q < used and found[q, 0] * n + found[q, 1] < before.pairs[p, 0] * n + before.pairs[p, 1]
        ):
            of, at = found, q
            q += 1
        else:
            p += 1
        pairs[k, 0], pairs[k, 1] = of[at, 0], of[at, 1]
    return pairs


@query_kernel
def _meet(boxes, kinds, shapes, rotations, positions, is_static, i, j):
    """Whether overlapping_pairs would list the two."""
    if is_static[i] and is_static[j]:
        return False
    if not is_bounded(kinds[i]):
        return is_bounded(kinds[j]) and _reaches_plane(shapes[i], rotations[i], positions[i], boxes[j])
    if not is_bounded(kinds[j]):
        return _reaches_plane(shapes[j], rotations[j], positions[j], boxes[i])
    are_apart = False
    for d in range(3):
        are_apart |= boxes[i, d] > boxes[j, d + 3] or boxes[j, d] > boxes[i, d + 3]
    return not are_apart
