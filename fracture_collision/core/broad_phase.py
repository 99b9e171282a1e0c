"""Pairs whose world boxes overlap: sort along the axis of the widest spread, sweep, test the other two axes."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.compiled import kernel
from fracture_collision.core.crowds import overlaps_of
from fracture_collision.core.kinds import PLANE


@kernel
def world_boxes(fragment_box, rows, rotations, positions, margins, boxes):
    """World boxes (n, 6) [m] of fragments `rows` with poses (n, 3, 3) and (n, 3), grown by margins (n,)."""
    for i in range(len(rows)):
        b = fragment_box[rows[i]]
        for k in range(3):
            center = positions[i, k]
            half = margins[i]
            for j in range(3):
                center += rotations[i, k, j] * 0.5 * (b[j] + b[j + 3])
                half += abs(rotations[i, k, j]) * 0.5 * (b[j + 3] - b[j])
            boxes[i, k] = center - half
            boxes[i, k + 3] = center + half


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

    If there are more than `most`, some most + 1 of them: the search ends there.
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
        if kinds[i] != PLANE:
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
def pairs_within_reach(fragment, rows, rotations, positions, is_static, tolerance, most):
    """Of fragments `rows` (n,) of a FragmentPool with poses (n, 3, 3), (n, 3): their R (n,) [m]; the pairs that may be
    within `tolerance` (a share of the smaller R) of each other, see overlapping_pairs; and their Overlaps.
    """
    radius, boxes = fragment.radius[rows], np.empty((len(rows), 6))
    # two boxes grown by half the tolerance each meet whenever their fragments come within it
    margins = np.where(np.isfinite(radius), tolerance * radius, 0.0)
    world_boxes(fragment.box, rows, rotations, positions, margins, boxes)
    pairs = overlapping_pairs(
        boxes, fragment.kind[rows], fragment.shape[rows], rotations, positions, is_static, most
    )
    return radius, pairs, overlaps_of(boxes, pairs)
