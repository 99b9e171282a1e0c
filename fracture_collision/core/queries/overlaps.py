"""Which fragments overlap boxes along the world's axes, by their exact surfaces.

A box overlaps a fragment where it meets one of its triangles (separating axes: Akenine-Moeller 2001), or lies inside.
"""

from __future__ import annotations

from fracture_collision.core.field.elementary_queries import INSIDE, bounded_probe
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.kinds import PLANE, SPHERE
from fracture_collision.core.memory.transforms import to_other, turned_back
from fracture_collision.core.memory.vectors import corners_of, cross, dot, minus, vector, vector_at


@kernel
def box_overlaps(pools, trees, placed, boxes, scratch, out):
    """Write (box, place in `placed`) of each overlap to `out` (room, 2); returns how many there are, room or not.

    trees: SurfaceTrees; placed: PlacedFragments; boxes (k, 6) [m], lower and upper corner, world.
    """
    count = 0
    for i in range(len(boxes)):
        box = boxes[i]
        middle = 0.5 * (box[0] + box[3]), 0.5 * (box[1] + box[4]), 0.5 * (box[2] + box[5])
        half = 0.5 * (box[3] - box[0]), 0.5 * (box[4] - box[1]), 0.5 * (box[5] - box[2])
        for k in range(placed.bounded, len(placed.rows)):
            count = _add(_does_overlap(pools, trees, placed, k, middle, half, scratch), i, k, out, count)
        node = 0
        while node < len(placed.node_box):
            if not _do_meet(placed.node_box[node], middle, half):
                node = placed.node_skip[node]
                continue
            for k in range(placed.node_first[node], placed.node_first[node] + placed.node_count[node]):
                count = _add(_does_overlap(pools, trees, placed, k, middle, half, scratch), i, k, out, count)
            node += 1
    return count


@query_kernel
def _add(is_one, i, k, out, count):
    if is_one and count < len(out):
        out[count, 0], out[count, 1] = i, k
    return count + is_one


@query_kernel
def _do_meet(box, middle, half):
    """Whether two boxes overlap: one by its corners, one by its middle and half its sides."""
    for d in range(3):  # noqa: SIM110 (numba has no generators in expressions)
        if box[d] > middle[d] + half[d] or box[d + 3] < middle[d] - half[d]:
            return False
    return True


@query_kernel
def _does_overlap(pools, trees, placed, k, middle, half, scratch):
    """Whether the k-th fragment overlaps a box, given by its middle and half its sides."""
    row, turn, place = placed.rows[k], placed.rotations[k], vector(placed.positions, k)
    kind, shape = pools.fragment.kind[row], pools.fragment.shape[row]
    local = turned_back(turn, minus(middle, place))
    if kind == PLANE:
        n = vector_at(shape, 0)
        reach = 0.0
        for d in range(3):
            reach += half[d] * abs(turn[d, 0] * n[0] + turn[d, 1] * n[1] + turn[d, 2] * n[2])
        return dot(n, local) - shape[3] <= reach
    if kind == SPHERE:
        square = 0.0
        for d in range(3):
            away = max(abs(place[d] - middle[d]) - half[d], 0.0)
            square += away * away
        return square <= shape[0] * shape[0]
    node, end = trees.node_range[row]
    while node < end:
        if not _may_meet(trees.node_box[node], turn, place, middle, half):
            node = trees.node_skip[node]
            continue
        for t in range(trees.node_first[node], trees.node_first[node] + trees.node_count[node]):
            x, y, z = corners_of(trees.corners[t])
            x, y, z = to_other(turn, place, x), to_other(turn, place, y), to_other(turn, place, z)
            if _meets_triangle(minus(x, middle), minus(y, middle), minus(z, middle), half):
                return True
        node += 1
    return bounded_probe(pools, row, local, 0.0, 0.0, -1, False, scratch).status == INSIDE


@query_kernel
def _may_meet(box, turn, place, middle, half):
    """Whether a box that is turned and moved may meet one along the axes."""
    for d in range(3):
        center, reach = place[d] - middle[d], half[d]
        for e in range(3):
            center += turn[d, e] * 0.5 * (box[e] + box[e + 3])
            reach += abs(turn[d, e]) * 0.5 * (box[e + 3] - box[e])
        if abs(center) > reach:
            return False
    return True


@query_kernel
def _meets_triangle(x, y, z, half):
    """Whether a triangle meets a box about the origin."""
    for d in range(3):
        if min(x[d], y[d], z[d]) > half[d] or max(x[d], y[d], z[d]) < -half[d]:
            return False
    u, v, w = minus(y, x), minus(z, y), minus(x, z)
    n = cross(u, v)
    if abs(dot(n, x)) > half[0] * abs(n[0]) + half[1] * abs(n[1]) + half[2] * abs(n[2]):
        return False
    for side in (u, v, w):
        for axis in ((0.0, side[2], -side[1]), (-side[2], 0.0, side[0]), (side[1], -side[0], 0.0)):
            p, q, r = dot(axis, x), dot(axis, y), dot(axis, z)
            reach = half[0] * abs(axis[0]) + half[1] * abs(axis[1]) + half[2] * abs(axis[2])
            if min(p, q, r) > reach or max(p, q, r) < -reach:
                return False
    return True
