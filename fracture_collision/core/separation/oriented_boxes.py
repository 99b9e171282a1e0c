"""Separating axis test and relative position of two oriented boxes.

Gottschalk, Lin, Manocha, "OBBTree" (1996), section 5.
"""

from __future__ import annotations

import math

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.rotations import to_other

# Two axes with a shorter cross product are parallel; the axes themselves cover what the product would separate.
PARALLEL = 1e-6


@query_kernel
def way_between(box_a, box_b, rotation, translation):
    """From the centre of b's box to that of a's, in b's frame; rotation, translation: from a's frame to b's."""
    x, y, z = to_other(
        rotation, translation, 0.5 * (box_a[0] + box_a[3]), 0.5 * (box_a[1] + box_a[4]), 0.5 * (box_a[2] + box_a[5])
    )
    return x - 0.5 * (box_b[0] + box_b[3]), y - 0.5 * (box_b[1] + box_b[4]), z - 0.5 * (box_b[2] + box_b[5])


@query_kernel
def box_clearance(box_a, box_b, rotation, translation, distance):
    """Lower bound [m] of the distance between two oriented boxes, by the 15 candidate axes.

    box_a, box_b (6,) [m]: in their own frames; rotation (3, 3), translation (3,) [m]: from a's frame to b's. Returns 0
    if they are no more than `distance` [m] apart along every axis; else the largest distance over b's axes, else over
    a's and b's axes, else that of the first separating cross product. Axes without length are skipped, so the test may
    report separated boxes as near, never the reverse.
    """
    clearance = 0.0
    for i in range(3):
        # along b's axis i
        center = translation[i] - 0.5 * (box_b[i] + box_b[i + 3])
        reach = 0.5 * (box_b[i + 3] - box_b[i])
        for j in range(3):
            center += rotation[i, j] * 0.5 * (box_a[j] + box_a[j + 3])
            reach += abs(rotation[i, j]) * 0.5 * (box_a[j + 3] - box_a[j])
        clearance = max(clearance, abs(center) - reach)
    if clearance > distance:
        return clearance
    for j in range(3):
        # along a's axis j
        center = 0.5 * (box_a[j] + box_a[j + 3])
        reach = 0.5 * (box_a[j + 3] - box_a[j])
        for i in range(3):
            center += rotation[i, j] * (translation[i] - 0.5 * (box_b[i] + box_b[i + 3]))
            reach += abs(rotation[i, j]) * 0.5 * (box_b[i + 3] - box_b[i])
        clearance = max(clearance, abs(center) - reach)
    if clearance > distance:
        return clearance
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            # along (b's axis i) x (a's axis j) = (0, -R[i2, j], R[i1, j]) in the axes i, i1, i2
            n1, n2 = -rotation[i2, j], rotation[i1, j]
            length = math.sqrt(n1 * n1 + n2 * n2)
            if length < PARALLEL:
                continue
            center = n1 * (translation[i1] - 0.5 * (box_b[i1] + box_b[i1 + 3]))
            center += n2 * (translation[i2] - 0.5 * (box_b[i2] + box_b[i2 + 3]))
            reach = abs(n1) * 0.5 * (box_b[i1 + 3] - box_b[i1]) + abs(n2) * 0.5 * (box_b[i2 + 3] - box_b[i2])
            for q in range(3):
                along = n1 * rotation[i1, q] + n2 * rotation[i2, q]
                center += along * 0.5 * (box_a[q] + box_a[q + 3])
                reach += abs(along) * 0.5 * (box_a[q + 3] - box_a[q])
            if abs(center) - reach > distance * length:
                return (abs(center) - reach) / length
    return 0.0
