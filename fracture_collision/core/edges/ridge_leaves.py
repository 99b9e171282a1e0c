"""Which ridges of two fragments may cross: tests of whole leaves and of the lines in them, in single precision."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.edges.ridge_crossing import LEAST_SINE, OF_TURN
from fracture_collision.core.edges.ridge_work import BOX_AND_MOST
from fracture_collision.core.edges.ridges import ALONG, LINE_BEGIN, LINE_LENGTH, LINE_TURN
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.pools import LEAF
from fracture_collision.core.memory.rotations import rotated
from fracture_collision.core.samples.sample_leaves import Leaves, worst_of_leaves
from fracture_collision.core.separation.leaf_separation import half_spaces

# Single-precision rounding of a place along an edge, as a share of all lengths, for edges at a right angle.
ROUNDING = 1e-6
# An angle is no more than its chord times this factor.
OF_CHORD = 1.1


class Window(NamedTuple):
    """What crossings are searched for."""

    margin: float  # [m] lines farther apart than this cannot cross
    reach: float  # [m] how far a point of either may move
    turn: float  # how far either may rotate
    farthest: float  # [m] the longest distance of two ridges that cross
    size: float  # [m] of both fragments together, for rounding
    enough: float  # [m] crossings of ridges that are less deep do not matter (ridge_crossing.matters)


@query_kernel
def _see_leaves(pools, edges, pair, side, approach, out, scratch):
    """Measure how far leaves of one side's ridges are beyond where they may come near the other by an Approach.

    Writes the distances [m] to ridge_work.worst and the half-spaces to scratch.planes. out: any integers, LEAF per
    leaf. Returns (number of leaves, number of half-spaces).
    """
    own = pair.a if side == 0 else pair.b
    middle = pools.fragment.middle[own]
    n, leaf = (edges.count[own] + LEAF - 1) // LEAF, edges.first[own]
    planes = scratch.planes
    used = half_spaces(pools, pair, side, middle, approach, planes)
    boxes = edges.boxes[6 * leaf : 6 * (leaf + n)]
    worst_of_leaves(Leaves(boxes, out[: LEAF * n], middle), planes, used, scratch.ridge_work.worst)
    return n, used


@query_kernel
def may_reach(pools, edges, pair, side, approach, out, scratch):
    """Write to `out` the ridges of one side that may come near the other by an Approach; returns their number."""
    n, used = _see_leaves(pools, edges, pair, side, approach, out, scratch)
    own = pair.a if side == 0 else pair.b
    worst, planes = scratch.ridge_work.worst, scratch.planes
    beyond, found = scratch.ridge_work.lanes, 0
    for l in range(n):  # noqa: E741
        if worst[l] > np.float32(0.0):
            continue
        lines = edges.lines[edges.first[own] + l]
        for k in range(LEAF):
            beyond[k] = np.float32(-1.0)
        for p in range(used):
            x, y, z, offset = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
            for k in range(LEAF):
                begin = x * lines[LINE_BEGIN, k] + y * lines[LINE_BEGIN + 1, k] + z * lines[LINE_BEGIN + 2, k] - offset
                rise = x * lines[ALONG, k] + y * lines[ALONG + 1, k] + z * lines[ALONG + 2, k]
                rise = rise * lines[LINE_LENGTH, k]
                least = begin + (rise if rise < np.float32(0.0) else np.float32(0.0))
                beyond[k] = least if least > beyond[k] else beyond[k]
        for k in range(LEAF):
            if beyond[k] <= np.float32(0.0) and LEAF * l + k < edges.count[own]:
                out[found] = LEAF * l + k
                found += 1
    return found


@query_kernel
def leaves_that_may(pools, edges, pair, side, approach, out, boxes, scratch):
    """may_reach for whole leaves; writes their boxes to `boxes` (BOX_AND_MOST, .), too. Returns their number."""
    n, _ = _see_leaves(pools, edges, pair, side, approach, out, scratch)
    own = pair.a if side == 0 else pair.b
    leaf, worst, found = edges.first[own], scratch.ridge_work.worst, 0
    for l in range(n):  # noqa: E741
        if worst[l] > np.float32(0.0):
            continue
        out[found] = l
        for d in range(6):
            boxes[d, found] = edges.boxes[6 * leaf + n * d + l]
        boxes[6, found], boxes[7, found] = edges.most[leaf + l, 0], edges.most[leaf + l, 1]
        found += 1
    return found


@query_kernel
def carry_leaf(lines, of, rotation, origin, ends):
    """Transform to another frame those of the ridges `of` that are in the same leaf as the first.

    lines: of that leaf, see Ridges; rotation (3, 3), origin (3,) [m]: to that frame. Writes to `ends` a row per ridge:
    ends [m], length [m] and turn; row LEAF is their box, lower and upper corner, and the greatest length and turn.
    """
    box, leaf = ends[LEAF], of[0] // LEAF
    box[0] = box[1] = box[2] = math.inf
    box[3] = box[4] = box[5] = -math.inf
    box[6] = box[7] = 0.0
    for k in range(min(LEAF, len(of))):
        if of[k] // LEAF != leaf:
            break
        row, lane = ends[k], of[k] % LEAF
        x, y, z = rotated(rotation, lines[LINE_BEGIN, lane], lines[LINE_BEGIN + 1, lane], lines[LINE_BEGIN + 2, lane])
        row[0], row[1], row[2] = x + origin[0], y + origin[1], z + origin[2]
        row[6], row[7] = lines[LINE_LENGTH, lane], lines[LINE_TURN, lane]
        x, y, z = rotated(rotation, lines[ALONG, lane], lines[ALONG + 1, lane], lines[ALONG + 2, lane])
        row[3], row[4], row[5] = row[0] + row[6] * x, row[1] + row[6] * y, row[2] + row[6] * z
        for d in range(3):
            box[d] = min(box[d], row[d], row[3 + d])
            box[3 + d] = max(box[3 + d], row[d], row[3 + d])
        box[6], box[7] = max(box[6], row[6]), max(box[7], row[7])


@query_kernel
def keep_near(of, boxes, count, excess, near, near_boxes):
    """Copy those of `count` leaves that have no excess to `near` and `near_boxes`; returns their number."""
    kept = 0
    for k in range(count):
        if excess[k] <= np.float32(0.0):
            near[kept] = of[k]
            for d in range(BOX_AND_MOST):
                near_boxes[d, kept] = boxes[d, k]
            kept += 1
    return kept


@query_kernel
def see_boxes(own, m, boxes, count, margin, enough, excess):
    """Write to `excess` by how much [m] boxes about `m` are farther than `margin` [m] from a box along an axis.

    own: that box, lower and upper corner, then the greatest length and turn in it. The excess is also more than 0 where
    no ridge in one box matters to any in the other, see Window.enough.
    """
    lx, hx = np.float32(own[0] - m[0] - margin), np.float32(own[3] - m[0] + margin)
    ly, hy = np.float32(own[1] - m[1] - margin), np.float32(own[4] - m[1] + margin)
    lz, hz = np.float32(own[2] - m[2] - margin), np.float32(own[5] - m[2] + margin)
    length, turn, least = np.float32(own[6]), np.float32(own[7]), np.float32(enough)
    # whole SIMD groups: a scalar remainder would take longer
    for k in range((count + LEAF - 1) // LEAF * LEAF):
        x, other = boxes[0, k] - hx, lx - boxes[3, k]
        x = x if x > other else other
        y, other = boxes[1, k] - hy, ly - boxes[4, k]
        y = y if y > other else other
        z, other = boxes[2, k] - hz, lz - boxes[5, k]
        z = z if z > other else other
        x = x if x > y else y
        x = x if x > z else z
        depth, other = length * boxes[7, k], boxes[6, k] * turn
        depth = depth if depth < other else other
        excess[k] = x if depth >= least else np.float32(1.0)


@query_kernel
def see_lines(row, m, lines, window, excess):
    """Write to `excess` by how much [m] each ridge of a leaf fails to cross another ridge; 0 or less: it may cross.

    row (8,): the other ridge, of carry_leaf; lines: of the leaf, about `m`. The result holds now and after motion: a
    point of either ridge moves by no more than window.reach, either rotates by no more than window.turn. So the line
    between the two, at most window.farthest long when they cross, turns by OF_TURN turn / sine, and the crossing's foot
    on either moves by no more than the displacement due to this and reach, over the sine.
    """
    margin, reach, turn, farthest, size, enough = window
    length = row[6]
    px, py, pz = np.float32(row[0] - m[0]), np.float32(row[1] - m[1]), np.float32(row[2] - m[2])
    ux, uy = np.float32((row[3] - row[0]) / length), np.float32((row[4] - row[1]) / length)
    uz, end = np.float32((row[5] - row[2]) / length), np.float32(length)
    far, near_by, most = np.float32(margin), np.float32(reach), np.float32(OF_TURN * turn * farthest)
    least, turns = np.float32(LEAST_SINE), np.float32(turn)
    rounding = np.float32(ROUNDING * (size + length + abs(row[0] - m[0]) + abs(row[1] - m[1]) + abs(row[2] - m[2])))
    own_turn, enough = np.float32(row[7]), np.float32(enough)
    # equals LEAF; with a constant here the loop would not be vectorised
    for k in range(lines.shape[1]):
        wx, wy, wz = px - lines[LINE_BEGIN, k], py - lines[LINE_BEGIN + 1, k], pz - lines[LINE_BEGIN + 2, k]
        vx, vy, vz = lines[ALONG, k], lines[ALONG + 1, k], lines[ALONG + 2, k]
        length_of_other = lines[LINE_LENGTH, k]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        n2 = nx * nx + ny * ny + nz * nz
        uv, uw, vw = ux * vx + uy * vy + uz * vz, ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
        sine, inverse = np.sqrt(n2), np.float32(1.0) / n2
        along = nx * wx + ny * wy + nz * wz
        worst = (along if along > np.float32(0.0) else -along) * (sine * inverse) - far
        worst = worst - rounding * inverse
        on_a, on_b = (uv * vw - uw) * inverse, (vw - uv * uw) * inverse
        less = sine - turns
        less = less if less > least else least
        less = np.float32(1.0) / (less if less < sine else sine)
        room = (near_by + most * less) * less + rounding * inverse
        off = -on_a if -on_a > on_a - end else on_a - end
        off_b = -on_b if -on_b > on_b - length_of_other else on_b - length_of_other
        off = (off if off > off_b else off_b) - room
        worst = worst if worst > off else off
        # parallel ridges have no crossing
        worst = worst if sine > least - turns - rounding / end else np.float32(1.0)
        depth, depth_of_other = end * lines[LINE_TURN, k], length_of_other * own_turn
        depth = depth if depth < depth_of_other else depth_of_other
        excess[k] = worst if depth >= enough else np.float32(1.0)
