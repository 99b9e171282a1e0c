"""Whether two boxes in general position are apart: separating axes.

Gottschalk, Lin, Manocha, "OBBTree" (1996), section 5.
"""

from __future__ import annotations

import math

from fracture_collision.core.compiled import inlined_kernel

# Two axes whose cross product is shorter than this are parallel; their own axes separate what theirs would.
PARALLEL = 1e-6


@inlined_kernel
def boxes_apart(box_a, box_b, rotation, translation, distance):
    """Whether two boxes (6,) in their own frames are more than `distance` [m] apart along one of the 15 candidate axes.

    rotation (3, 3), translation (3,): from a's frame to b's. Axes without length are left out, so a box may be called
    near that is not, never the other way round.
    """
    for i in range(3):
        # along b's axis i
        center = translation[i] - 0.5 * (box_b[i] + box_b[i + 3])
        reach = 0.5 * (box_b[i + 3] - box_b[i]) + distance
        for j in range(3):
            center += rotation[i, j] * 0.5 * (box_a[j] + box_a[j + 3])
            reach += abs(rotation[i, j]) * 0.5 * (box_a[j + 3] - box_a[j])
        if abs(center) > reach:
            return True
    for j in range(3):
        # along a's axis j
        center = 0.5 * (box_a[j] + box_a[j + 3])
        reach = 0.5 * (box_a[j + 3] - box_a[j]) + distance
        for i in range(3):
            center += rotation[i, j] * (translation[i] - 0.5 * (box_b[i] + box_b[i + 3]))
            reach += abs(rotation[i, j]) * 0.5 * (box_b[i + 3] - box_b[i])
        if abs(center) > reach:
            return True
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
            if abs(center) > reach + distance * length:
                return True
    return False
