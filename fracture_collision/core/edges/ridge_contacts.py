"""Contacts where ridges of two fragments cross between samples, found among all ridges of both.

Ridges of a that may reach b are tested one by one against b's leaves and then against the lines in these, in single
precision with an allowance for its rounding; the remaining pairs are tested exactly (ridge_crossing.py). Contacts wait
beside the candidate samples (contact_choice.py).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import ANSWER, DISTANCE, ENTRY, MOST_DEPTH, NUMBER, SIDE
from fracture_collision.core.contacts.known_samples import put_contact
from fracture_collision.core.edges.ridge_crossing import LEAST_SINE, MATTERS, OF_TURN, crossing, may_cross, overlap
from fracture_collision.core.edges.ridges import (
    ALONG,
    BEGIN,
    END,
    FIRST_FACE,
    LENGTH,
    LINE_BEGIN,
    LINE_LENGTH,
    LINE_TURN,
    NO_RIDGES,
    OUTWARD,
    RIDGE,
    TURN,
    Ridges,
)
from fracture_collision.core.field.elementary_queries import INSIDE
from fracture_collision.core.field.flood import NO_SOURCE
from fracture_collision.core.memory.compiled import inlined_kernel
from fracture_collision.core.memory.pools import LEAF
from fracture_collision.core.memory.rotations import rotated, to_other
from fracture_collision.core.mesh.closest_point import segment_distance
from fracture_collision.core.mesh.sample_numbers import FIRST_OF_RIDGES
from fracture_collision.core.separation.leaf_separation import half_spaces
from fracture_collision.core.tree.sample_leaves import Leaves, worst_of_leaves

# Crossings deeper than this share of R are not searched: such a pair has samples inside, or came through in one step.
DEEPEST = 0.1
# Between fragments of one body, nor are crossings deeper than this factor times how far a point of either has moved
# since they were one: in place they do not overlap, so no point is deeper than it has moved.
MOVED = 1.5
# Maximum number of contacts of a pair's ridges; sample numbers reserved for each ridge of a.
MOST_CROSSINGS, RIDGES_EACH = 512, 1 << 24
# Candidates are ordered by sample number: those of crossings come after all of a's samples.
_AFTER_SAMPLES = 1 << 30
# Single-precision rounding of a place along an edge, as a share of all lengths, for edges at a right angle.
_ROUNDING = 1e-6
# Lower and upper corners of a leaf's box, the greatest length and turn in it.
BOX_AND_MOST = 8
# An angle is no more than so many times its chord.
_OF_CHORD = 1.1


class RidgeWork(NamedTuple):
    """Working memory; leading dimension: thread."""

    worst: np.ndarray  # (threads, n) float32 [m]: how far leaves are beyond half-spaces
    of_a: np.ndarray  # (threads, n) int32: ridges of a that may reach b
    of_b: np.ndarray  # (threads, 2, n) int32: leaves of b that may reach a; those that may reach a leaf of a
    boxes: np.ndarray  # (threads, 2, BOX_AND_MOST, n) float32 [m]: of these leaves, see Ridges.boxes and most
    excess: np.ndarray  # (threads, n) float32 [m]: by how much leaves miss a ridge of a
    lanes: np.ndarray  # (threads, LEAF + padding) float32 [m]: by how much ridges of a leaf miss a ridge of a
    ends: np.ndarray  # (threads, LEAF + 1 + padding, 8) float64: ridges of a leaf of a in b's frame, see _carry_leaf
    row: np.ndarray  # (threads, RIDGE + padding) float64: a ridge of a in b's frame
    meeting: np.ndarray  # (threads, 10 + padding) float64 [m], see ridge_crossing.crossing


class RidgeSearch(NamedTuple):
    """Ridges and working memory of a search for crossings."""

    ridges: Ridges
    work: RidgeWork


def make_ridge_work(threads: int, room: int) -> RidgeWork:
    """Working memory for fragments with up to `room` ridges."""
    f4, n = np.float32, LEAF * (room // LEAF + 1)
    return RidgeWork(
        np.zeros((threads, n), f4), np.zeros((threads, n), np.int32), np.zeros((threads, 2, n), np.int32),
        np.zeros((threads, 2, BOX_AND_MOST, n), f4), np.zeros((threads, n), f4), np.zeros((threads, LEAF + 32), f4),
        np.zeros((threads, LEAF + 3, 8)), np.zeros((threads, RIDGE + 16)), np.zeros((threads, 32)),
    )  # fmt: skip


NO_RIDGE_SEARCH = RidgeSearch(NO_RIDGES, make_ridge_work(1, 0))


@inlined_kernel
def have_ridges(edges, a, b):
    """Whether both fragments have ridges, and the search for crossings is on."""
    return len(edges.ridges.count) > 0 and edges.ridges.count[a] > 0 and edges.ridges.count[b] > 0


@inlined_kernel
def add_crossings(
    pools, edges, a, b, rotation, translation, planes_beyond, rule, reach, ways, slack, apart, count, deep, listed,
    scratch, thread,
):  # fmt: skip
    """Store the contacts of crossing ridges as candidates in scratch, after `count` samples of which `deep` are deeper
    than epsilon.

    planes_beyond (of b, of a), ways (2, WAY): see leaf_separation.half_spaces; rule: of contact_choice; slack [m]: for
    rounding. apart [m]: how far a point of either has moved relative to the other since they were one; infinity: they
    never were. reach [m], 0: none: pairs that may cross after a relative motion of no more than `reach` are written to
    `listed` (., 2). Returns (count, deep, number of these pairs).
    """
    ridges, work = edges.ridges, edges.work
    of_a, of_b, near_b, row = work.of_a[thread], work.of_b[thread, 0], work.of_b[thread, 1], work.row[thread]
    boxes, near_boxes, ends = work.boxes[thread, 0], work.boxes[thread, 1], work.ends[thread]
    within = rule.near + slack
    turn = _OF_CHORD * reach / max(_half_diagonal(pools.fragment.box[a]), _half_diagonal(pools.fragment.box[b]))
    most, leaves, pairs = count + MOST_CROSSINGS, 0, 0
    many = _may_reach(
        pools, edges, a, b, 0, rotation, translation, planes_beyond[0], within, reach, ways[0], of_a, scratch, thread
    )
    if many > 0:
        leaves = _leaves_that_may(
            pools, edges, b, a, 1, rotation, translation, planes_beyond[1], within, reach, ways[1], of_b, boxes,
            scratch, thread,
        )  # fmt: skip
    if leaves == 0:
        return count, deep, 0
    deepest = _deepest(pools, a, b, apart, slack)
    # the possible overlap of fragments of one body grows as they move
    farthest = max(rule.near, deepest + MOVED * reach)
    margin, excess, lanes = farthest + reach + slack, work.excess[thread], work.lanes[thread]
    m = pools.fragment.middle[b]
    size = 2.0 * (_half_diagonal(pools.fragment.box[a]) + _half_diagonal(pools.fragment.box[b]))
    origin = pools.fragment.middle[a]
    origin = to_other(rotation[0], translation[0], origin[0], origin[1], origin[2])
    around, enough = margin + _ROUNDING * size, MATTERS * rule.epsilon * (1.0 - _ROUNDING)
    group, first_of_group, near_leaves = -1, 0, 0
    for i in range(many):
        if of_a[i] // LEAF != group:
            group, first_of_group = of_a[i] // LEAF, i
            _carry_leaf(ridges.lines[ridges.first[a] // LEAF + group], of_a[i:many], rotation[0], origin, ends)
            _see_boxes(ends[LEAF], m, boxes, leaves, around, enough, excess)
            near_leaves = _keep_near(of_b, boxes, leaves, excess, near_b, near_boxes)
        if near_leaves == 0:
            continue
        it, box = ends[i - first_of_group], ends[LEAF + 1]
        for d in range(3):
            box[d], box[3 + d] = min(it[d], it[3 + d]), max(it[d], it[3 + d])
        box[6], box[7] = it[6], it[7]
        _see_boxes(box, m, near_boxes, near_leaves, around, enough, excess)
        is_carried = False
        for l in range(near_leaves):  # noqa: E741
            if excess[l] > np.float32(0.0):
                continue
            leaf = ridges.first[b] // LEAF + near_b[l]
            _see_lines(it, m, ridges.lines[leaf], margin, reach, turn, farthest, size, enough, lanes)
            for lane in range(LEAF):
                j = LEAF * near_b[l] + lane
                if not lanes[lane] <= np.float32(0.0) or j >= ridges.count[b]:
                    continue
                if not is_carried:
                    is_carried = True
                    _carry_ridge(ridges.rows[ridges.first[a] + of_a[i]], rotation[0], translation[0], row)
                other = ridges.rows[ridges.first[b] + j]
                if reach > 0.0 and may_cross(row, other, rule, rule.near + reach, farthest + reach, turn):
                    if pairs < len(listed):
                        listed[pairs, 0], listed[pairs, 1] = of_a[i], j
                    pairs += 1
                count, deep = _add(
                    pools, edges, a, b, of_a[i], j, row, other, rotation, translation, rule, deepest, most, count, deep,
                    scratch, thread,
                )  # fmt: skip
    return count, deep, pairs


@inlined_kernel
def add_listed_crossings(
    pools, edges, a, b, rotation, translation, rule, slack, apart, listed, count, deep, scratch, thread
):
    """add_crossings for a pair where `listed` (n, 2) holds all pairs of ridges that can cross: (count, deep)."""
    ridges, row, carried = edges.ridges, edges.work.row[thread], -1
    deepest, most = _deepest(pools, a, b, apart, slack), count + MOST_CROSSINGS
    for k in range(len(listed)):
        i, j = listed[k, 0], listed[k, 1]
        own, other = ridges.rows[ridges.first[a] + i], ridges.rows[ridges.first[b] + j]
        if i != carried:
            _carry_ridge(own, rotation[0], translation[0], row)
            carried = i
        count, deep = _add(
            pools, edges, a, b, i, j, row, other, rotation, translation, rule, deepest, most, count, deep, scratch,
            thread,
        )  # fmt: skip
    return count, deep


@inlined_kernel
def least_apart(edges, a, b, rotation, translation, listed, near, of_far, thread):
    """Lower bound [m] of the distance beyond `near` between the ridges of all `listed` pairs (n, 2), no less than 0;
    infinity: there is none. of_far: only of those that are not near.
    """
    ridges, row, least = edges.ridges, edges.work.row[thread], math.inf
    for k in range(len(listed)):
        _carry_ends(ridges.rows[ridges.first[a] + listed[k, 0]], rotation[0], translation[0], row)
        apart = segment_distance(row, ridges.rows[ridges.first[b] + listed[k, 1]]) - near
        if apart > 0.0 or not of_far:
            least = min(least, apart)
    return max(least, 0.0)


@inlined_kernel
def _deepest(pools, a, b, apart, slack):
    """Depth [m] down to which crossings are searched."""
    return min(DEEPEST * min(pools.fragment.radius[a], pools.fragment.radius[b]), MOVED * apart + slack)


@inlined_kernel
def _half_diagonal(box):
    return 0.5 * math.sqrt((box[3] - box[0]) ** 2 + (box[4] - box[1]) ** 2 + (box[5] - box[2]) ** 2)


@inlined_kernel
def _carry_ends(own, rotation, translation, row):
    for k in range(BEGIN, END + 3, 3):
        row[k], row[k + 1], row[k + 2] = to_other(rotation, translation, own[k], own[k + 1], own[k + 2])


@inlined_kernel
def _carry_ridge(own, rotation, translation, row):
    _carry_ends(own, rotation, translation, row)
    for k in range(FIRST_FACE, OUTWARD + 3, 3):
        row[k], row[k + 1], row[k + 2] = rotated(rotation, own[k], own[k + 1], own[k + 2])
    row[LENGTH], row[TURN] = own[LENGTH], own[TURN]


@inlined_kernel
def _see_leaves(
    pools, edges, own, other, side, rotation, translation, plane, within, reach, way, out, scratch, thread
):
    """Write to work.worst how far leaves of own's ridges are beyond where `other` may come within `within` [m]: (how
    many leaves, how many half-spaces). reach, way: see leaf_separation.half_spaces; out: any integers, as many.
    """
    ridges, middle = edges.ridges, pools.fragment.middle[own]
    n, leaf = (ridges.count[own] + LEAF - 1) // LEAF, ridges.first[own] // LEAF
    planes = scratch.planes[thread]
    used = half_spaces(pools, own, other, middle, side, rotation, translation, plane, within, reach, way, planes)
    boxes = ridges.boxes[6 * leaf : 6 * (leaf + n)]
    worst_of_leaves(Leaves(boxes, out[: LEAF * n], middle), planes, used, edges.work.worst[thread])
    return n, used


@inlined_kernel
def _may_reach(
    pools, edges, own, other, side, rotation, translation, plane, within, reach, way, out, scratch, thread
):
    """Write to `out` the ridges of `own` that may come within `within` [m] of `other`, by half-spaces: how many."""
    n, used = _see_leaves(
        pools, edges, own, other, side, rotation, translation, plane, within, reach, way, out, scratch, thread
    )
    ridges, worst, planes = edges.ridges, edges.work.worst[thread], scratch.planes[thread]
    beyond, found = edges.work.lanes[thread], 0
    for l in range(n):  # noqa: E741
        if worst[l] > np.float32(0.0):
            continue
        lines = ridges.lines[ridges.first[own] // LEAF + l]
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
            if beyond[k] <= np.float32(0.0) and LEAF * l + k < ridges.count[own]:
                out[found] = LEAF * l + k
                found += 1
    return found


@inlined_kernel
def _leaves_that_may(
    pools, edges, own, other, side, rotation, translation, plane, within, reach, way, out, boxes, scratch, thread
):
    """The same for whole leaves, with their boxes (BOX_AND_MOST, .): how many."""
    n, _ = _see_leaves(
        pools, edges, own, other, side, rotation, translation, plane, within, reach, way, out, scratch, thread
    )
    leaf, worst, found = edges.ridges.first[own] // LEAF, edges.work.worst[thread], 0
    for l in range(n):  # noqa: E741
        if worst[l] > np.float32(0.0):
            continue
        out[found] = l
        for d in range(6):
            boxes[d, found] = edges.ridges.boxes[6 * leaf + n * d + l]
        boxes[6, found], boxes[7, found] = edges.ridges.most[leaf + l, 0], edges.ridges.most[leaf + l, 1]
        found += 1
    return found


@inlined_kernel
def _carry_leaf(lines, of, rotation, origin, ends):
    """Transform those of the ridges `of` that are in the same leaf as the first, from its `lines`: a row each of ends,
    length and turn; row LEAF is their box, from lower to upper corner, and the greatest length and turn.
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


@inlined_kernel
def _keep_near(of, boxes, count, excess, near, near_boxes):
    """Keep those of `count` leaves that have no excess: how many."""
    kept = 0
    for k in range(count):
        if excess[k] <= np.float32(0.0):
            near[kept] = of[k]
            for d in range(BOX_AND_MOST):
                near_boxes[d, kept] = boxes[d, k]
            kept += 1
    return kept


@inlined_kernel
def _see_boxes(own, m, boxes, count, margin, enough, excess):
    """Write by how much [m] boxes about `m` are farther than `margin` [m], along an axis, from the box `own`, which is
    followed by its greatest length and turn; also more than 0 where no ridge in one matters to any in the other.
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


@inlined_kernel
def _see_lines(row, m, lines, margin, reach, turn, farthest, size, enough, excess):
    """Write by how much [m] each ridge of a leaf fails to cross the ridge `row` (8,), see _carry_leaf, now or after
    motion; 0 or less: it may.

    A point of either moves by no more than `reach` [m], either rotates by no more than `turn`. So the line between the
    two, at most `farthest` [m] long when they cross, turns by OF_TURN turn / sine, and the crossing's foot on either
    moves by no more than the displacement due to this and `reach`, over the sine.
    """
    length = row[6]
    px, py, pz = np.float32(row[0] - m[0]), np.float32(row[1] - m[1]), np.float32(row[2] - m[2])
    ux, uy = np.float32((row[3] - row[0]) / length), np.float32((row[4] - row[1]) / length)
    uz, end = np.float32((row[5] - row[2]) / length), np.float32(length)
    far, near_by, most = np.float32(margin), np.float32(reach), np.float32(OF_TURN * turn * farthest)
    least, turns = np.float32(LEAST_SINE), np.float32(turn)
    rounding = np.float32(_ROUNDING * (size + length + abs(row[0] - m[0]) + abs(row[1] - m[1]) + abs(row[2] - m[2])))
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


@inlined_kernel
def _add(
    pools, edges, a, b, i, j, r, s, rotation, translation, rule, deepest, most, count, deep, scratch, thread
):  # fmt: skip
    """Store the contact of ridge r, number i of a, in b's frame, and ridge s, number j of b, if there is one: (count,
    deep). At most `most` are stored.
    """
    c = edges.work.meeting[thread]
    if count >= most or not crossing(r, s, rule, deepest, c):
        return count, deep
    gap = c[9]
    if gap < 0.0 and not overlap(pools, a, b, r, s, c, rotation[1], translation[1], scratch, thread):
        return count, deep
    node, point = scratch.node_int[thread, count], scratch.node_float[thread, count]
    node[ENTRY], node[SIDE], node[NUMBER], node[ANSWER] = -1, 0, _AFTER_SAMPLES + count, count
    point[0], point[1], point[2], point[DISTANCE] = c[0], c[1], c[2], gap
    scratch.spread[thread, MOST_DEPTH, count] = max(-gap, 0.0)
    number = FIRST_OF_RIDGES + RIDGES_EACH * np.int64(i) + j
    answer = (INSIDE, gap, c[6], c[7], c[8], c[3], c[4], c[5], -gap, NO_SOURCE, -1, -1)
    put_contact(scratch.kept[thread], scratch.kept_ids[thread], count, 0, number, c[0], c[1], c[2], answer)
    return count + 1, deep + (gap < -rule.epsilon)
