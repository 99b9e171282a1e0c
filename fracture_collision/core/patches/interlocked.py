"""Contacts of pairs of which one is concave, where they are deep in each other: one direction for their whole surfaces.

Each sample that is deep in the other takes the direction to its own nearest face. Where a body is thinner than the
others are deep, or its faces are flush, these directions contradict each other, and hold the pair where it is. Of all
directions found, that is taken along which the whole surfaces overlap least (facing_points.py): moving by that much
makes them disjoint, so it bounds the depth of every point, too. What was found along other directions stays where that
translation leaves it in contact.

Coarse triangles may pierce each other with no sample inside. Then the directions are those of the faces pierced.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.contacts.contact_places import make_world_contacts, put_in_world
from fracture_collision.core.contacts.known_samples import share_a_body
from fracture_collision.core.lookahead.motion import Motion, Moving, put_pose, turned_in
from fracture_collision.core.lookahead.staying_apart import gap_of_hulls
from fracture_collision.core.memory.compiled import (
    allocating_kernel,
    inlined_kernel,
    kernel,
    query_kernel,
    threaded_kernel,
)
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.kinds import TETRAHEDRA, WITH_FACES
from fracture_collision.core.memory.pair import Sink, Step, put_pair
from fracture_collision.core.memory.pools import GrowableArray, Pools
from fracture_collision.core.memory.rotations import turned_back
from fracture_collision.core.patches.facing_points import facing_points
from fracture_collision.core.patches.pair_contacts import (
    MOST_TURN,
    Wanted,
    listed_patch,
    posed_at,
    put_contact,
    seen_from,
)
from fracture_collision.core.patches.shapes import Shapes, triangles_of
from fracture_collision.core.patches.surface import Surface, make_surface
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.core.search.neighbour_lists import IN_PLACE, displacement
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.grouping import begins_of

# Deeper than so many detection tolerances, samples may be past the middle of something thin. Looking at all pairs
# deeper than one doubles the time of a step of bricks.
DEEP = 5.0
# Directions tried are at least so far from each other, by the cosine; at most so many.
APART, MOST_TRIED = 0.99, 8
# The overlap of the whole is accepted up to this times the deepest contact, and the other share of it at least: else it
# is of another place. And so many tolerances more.
MOST_TIMES, LEAST_TIMES, MORE = 3.0, 0.3, 2.0
# But where deep contacts push in opposite directions, by the cosine, none of them is the way out, and that of the whole
# is.
OPPOSITE = -0.5
# Overlaps are alike within this share of the tolerance.
ALIKE = 0.25
# Contacts across that of the whole, by the cosine, and no deeper than the tolerance, are patches of their own.
OTHER = 0.5
# Who wants more contacts of a pair wants all that were found.
MOST_WANTED = 256
_LEAVE = -1


class Surfaces(NamedTuple):
    """Surfaces of some fragments; rows count from a fragment's first."""

    begin: np.ndarray  # (F, 3) int64 first row of: corners, triangles, edges; -1: not made
    end: np.ndarray  # (F, 3) int64
    all: Surface


class SurfaceTable:
    """Surfaces of fragments, made when first asked for. Valid as long as no row of the pools is renumbered."""

    def __init__(self) -> None:
        self._begin, self._end = np.full((0, 3), -1), np.full((0, 3), -1)
        self._columns = [
            GrowableArray(3, np.float64), GrowableArray(3, np.int32), GrowableArray(3, np.float64),
            GrowableArray(2, np.int32), GrowableArray(2, np.int32), GrowableArray(0, np.bool_),
        ]  # fmt: skip

    def of(self, pools: Pools, rows: np.ndarray) -> Surfaces:
        """Surfaces of at least `rows` (n,) of FragmentPool."""
        more = len(pools.fragment.kind) - len(self._begin)
        if more > 0:
            nothing = np.full((more, 3), -1)
            self._begin, self._end = np.vstack((self._begin, nothing)), np.vstack((self._end, nothing))
        for f in rows[self._begin[rows, 0] < 0].tolist():
            made = make_surface(triangles_of(pools, f, f + 1)[0])
            self._begin[f] = [self._columns[k].used for k in (0, 1, 3)]
            for column, values in zip(self._columns, made, strict=True):
                column.append(values)
            self._end[f] = [self._columns[k].used for k in (0, 1, 3)]
        return Surfaces(self._begin, self._end, Surface(*(column.view for column in self._columns)))


class _Out(NamedTuple):
    """What threads write, each pair its own rows."""

    counts: np.ndarray  # (p,) int64 contacts of the whole surfaces, _LEAVE: the pair stays as it is
    bounds: np.ndarray  # (p,) float64 [m]
    stays: np.ndarray  # (c,) bool: which contacts found before stay
    found: Sink  # `wanted` rows for each pair looked at


def part_interlocked(
    pools: Pools, table: SurfaceTable, step: Step, motion: Motion, work: tuple[np.ndarray, Shapes],
    rules: tuple[Rule, int], found: PairContacts, own: tuple[tuple[Scratch, ...], Crew],
) -> tuple[PairContacts, np.ndarray]:  # fmt: skip
    """`found` with contacts of whole surfaces, where a concave pair is deep or pierces; and which pairs' changed.

    work: pairs `todo` (m,) that `found` was searched for, and the Shapes that say which are convex; rules: a Rule with
    epsilon and near as shares of the smaller R, its limit that of each pair, and how many contacts all may have; own: a
    Scratch for each thread of the Crew.
    """
    (todo, shapes), (rule, most), (scratch, crew) = work, rules, own
    offsets = begins_of(found.counts)
    chosen = np.empty(len(todo), np.int64)
    used = _candidates(pools, (step, todo), shapes.is_convex, rule, (found.gaps, offsets), scratch[0], chosen)
    todo = chosen[:used]
    if not len(todo) or rule.wanted > MOST_WANTED:
        return found, todo
    surfaces = table.of(pools, np.unique(step.rows[step.pairs[todo]]))
    p, wanted = len(step.pairs), min(rule.wanted, rule.limit)
    spare = (most - len(found.gaps)) // len(todo)
    sink = Sink(np.empty((len(todo) * wanted, 10)), np.empty((len(todo) * wanted, 5), np.int64))
    out = _Out(np.full(p, _LEAVE), found.bounds.copy(), np.ones(len(found.gaps), np.bool_), sink)
    crew.share(_part_share, (pools, surfaces), (step, motion), todo, rule, (found, offsets, spare), out, own=scratch)
    changed = np.flatnonzero(out.counts >= 0)
    if not len(changed):
        return found._replace(bounds=out.bounds), changed
    kept = np.append(0, np.cumsum(out.stays))
    counts = kept[offsets[1:]] - kept[offsets[:-1]] + np.maximum(out.counts, 0)
    columns = make_world_contacts(int(counts.sum()))
    slot = np.full(p, -1)
    slot[todo] = wanted * np.arange(len(todo))
    _merge(step, offsets, found, out, slot, columns)
    return PairContacts(counts, out.bounds, found.visits, found.exhausted, *columns), changed


@query_kernel
def _candidates(pools, pairs, is_convex, rule, found, scratch, out):
    """Write the pairs that are to be looked at to `out`; returns their number.

    pairs: the Step and the numbers of its pairs that are asked about; found: gaps of contacts, and their offsets.
    """
    (step, todo), (gaps, offsets), used = pairs, found, 0
    for p in todo:
        a, b = step.rows[step.pairs[p, 0]], step.rows[step.pairs[p, 1]]
        if is_convex[a] and is_convex[b]:
            continue
        kind_a, kind_b = pools.fragment.kind[a], pools.fragment.kind[b]
        if kind_a not in WITH_FACES or kind_b not in WITH_FACES:
            continue
        radius = min(pools.fragment.radius[a], pools.fragment.radius[b])
        least = math.inf
        for c in range(offsets[p], offsets[p + 1]):
            least = min(least, gaps[c])
        is_one = least < -DEEP * rule.near * radius
        # samples of fragments are as close to each other as their faces are large
        if not is_one and (kind_a != TETRAHEDRA or kind_b != TETRAHEDRA):
            pair = put_pair(step, p, scratch.rotation, scratch.translation)
            scratch.toward[0] = scratch.toward[1] = scratch.toward[2] = 0.0
            is_one = gap_of_hulls(pools, pair, 0.0, scratch.toward, scratch)[0] < -rule.epsilon * radius
        if is_one:
            out[used] = p
            used += 1
    return used


@threaded_kernel
def _part_share(geometry, moving, todo, rule, known, out, scratch, part):
    """Process every pair of `todo` that is a thread's, see Crew.share.

    known: PairContacts, their offsets, and how many contacts more each pair may have.
    """
    pools, surfaces = geometry
    step, motion = moving
    found, offsets, spare = known
    thread, threads = part
    wanted = min(rule.wanted, rule.limit)
    for turn in range(thread, len(todo), threads):
        p = todo[turn]
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        radius = min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])
        moved = math.inf
        if share_a_body(pools, pair.a, pair.b):
            moved = displacement(pools, pair, IN_PLACE)
        moves = Moving(step.pairs[p, 0], step.pairs[p, 1], step.rotations, step.positions, motion)
        rows = offsets[p], offsets[p + 1]
        most = min(rule.limit, rows[1] - rows[0] + spare)
        its = Wanted(rule.near * radius, moved, min(wanted, most)), rule.epsilon * radius, most
        begin, end = wanted * turn, wanted * turn + min(wanted, most)
        sink = Sink(out.found.contacts[begin:end], out.found.ids[begin:end])
        out.counts[p], out.bounds[p] = put_interlocked(
            surfaces, pair, moves, its, (found.normals, found.gaps, rows, out.bounds[p]), out.stays, sink
        )


@allocating_kernel
def put_interlocked(surfaces, pair, moving, wanted, known, stays, sink):
    """Write the contacts of the whole surfaces of a Pair to a Sink; marks which of the known ones stay.

    wanted: Wanted, the penetration tolerance [m], how many contacts the pair may have; known: normals (c, 3), from a to
    b in the world, and gaps (c,) [m] of all contacts, the pair's rows of these, its bound [m]. Returns (contacts, -1:
    the pair stays as it is; bound [m]).
    """
    wanted, epsilon, most = wanted
    tolerance = wanted.near
    normals, gaps, (begin, end), bound = known
    i, j, rotations, positions, motion = moving
    turns, places = np.empty((6, 3, 3)), np.empty((6, 3))
    fast = max(turned_in(motion, i, motion.time), turned_in(motion, j, motion.time)) if motion.time > 0.0 else math.inf
    for row in range(6):
        k = i if row < 3 else j
        if row % 3 > 0 and fast <= MOST_TURN:
            put_pose(motion, rotations, positions, k, motion.time, turns[row], places[row])
        else:
            turns[row], places[row] = rotations[k], positions[k]
    placings = seen_from(turns, places, 0), seen_from(turns, places, 3)
    of_a, of_b = _surface_at(surfaces, pair.a), _surface_at(surfaces, pair.b)
    a, b = posed_at(of_a, placings[0], 0.0), posed_at(of_b, placings[1], 0.0)
    size = min(_size(a.corners), _size(b.corners))
    ways, tried, deepest = np.empty((2 * MOST_TRIED + 1, 3)), 0, 0.0
    if end > begin:
        tried, deepest = _add_found(normals[begin:end], gaps[begin:end], rotations[j], ways)
    is_deep = deepest > DEEP * tolerance
    if not is_deep:
        before, tried = tried, _add_pierced(a, b, ways, tried)
        if tried == before:
            return _LEAVE, bound
    best, least = -1, math.inf
    for k in range(tried):
        overlap = _overlap(a, b, ways[k], wanted.moved, size)
        if overlap < least - ALIKE * tolerance:
            best, least = k, overlap
    bound = max(bound, min(least, wanted.moved))
    is_jammed = False
    if is_deep and least > MOST_TIMES * deepest + MORE * tolerance:
        is_jammed = _jam(normals[begin:end], gaps[begin:end], DEEP * tolerance)
        if not is_jammed:
            return _LEAVE, bound
    if least < LEAST_TIMES * deepest - tolerance or not least > (epsilon if begin == end else tolerance):
        return _LEAVE, bound
    n = ways[best].copy()
    points = facing_points(a, b, n, tolerance, size)
    patch = listed_patch(points, placings, (0.0, least), n, 0, wanted, size)
    count = len(patch.gaps)
    if not 0 < count <= len(sink.contacts):
        return _LEAVE, bound
    for k in range(count):
        put_contact(sink, k, patch.points[k], patch.others[k], n, patch.numbers[k])
    shift = max(-patch.gaps.min(), 0.0) + MORE * tolerance
    left = most - count
    for c in range(begin, end):
        x, y, z = turned_back(rotations[j], normals[c, 0], normals[c, 1], normals[c, 2])
        along = x * n[0] + y * n[1] + z * n[2]
        is_left = gaps[c] >= -tolerance and gaps[c] + shift * along <= tolerance
        stays[c] = is_left and not is_jammed and abs(along) < OTHER and left > 0
        left -= stays[c]
    return count, bound


@kernel
def _surface_at(surfaces, f):
    c, d, s = surfaces.begin[f], surfaces.end[f], surfaces.all
    return Surface(
        s.corners[c[0] : d[0]], s.triangles[c[1] : d[1]], s.normals[c[1] : d[1]], s.edges[c[2] : d[2]],
        s.beside[c[2] : d[2]], s.is_sharp[c[0] : d[0]],
    )  # fmt: skip


@kernel
def _size(corners):
    size = 0.0
    for d in range(3):
        size = max(size, corners[:, d].max() - corners[:, d].min())
    return size


@kernel
def _overlap(a, b, n, moved, size):
    """How far [m] b must be moved along n so that the surfaces are disjoint; moved [m]: see Wanted."""
    found = facing_points(a, b, n, 0.0, size)
    overlap = 0.0
    for gap in found.gaps:
        if gap >= -(1.5 * moved + 1e-6 * size):
            overlap = max(overlap, -gap)
    return overlap


@kernel
def _add_found(normals, gaps, rotation, ways):
    """Write distinct normals of contacts in b's frame by depth, then their mean: (their number, the deepest [m])."""
    order, tried, mean = np.argsort(gaps, kind="mergesort"), 0, np.zeros(3)
    for c in order:
        x, y, z = turned_back(rotation, normals[c, 0], normals[c, 1], normals[c, 2])
        depth = max(-gaps[c], 0.0)
        mean[0] += depth * x
        mean[1] += depth * y
        mean[2] += depth * z
        if tried < MOST_TRIED:
            tried = _add_new(ways, tried, x, y, z)
    length = math.sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2])
    if length > 0.0:
        tried = _add_new(ways, tried, mean[0] / length, mean[1] / length, mean[2] / length)
    return tried, max(-gaps[order[0]], 0.0)


@kernel
def _jam(normals, gaps, depth):
    """Whether contacts deeper than `depth` [m] push in opposite directions."""
    for c in range(len(gaps)):
        for d in range(c):
            if max(gaps[c], gaps[d]) < -depth:
                m, n = normals[c], normals[d]
                if m[0] * n[0] + m[1] * n[1] + m[2] * n[2] < OPPOSITE:
                    return True
    return False


@inlined_kernel
def _add_new(ways, tried, x, y, z):
    """Add a direction to the first `tried` of `ways`, if it is far from all of them; returns their number."""
    for k in range(tried):
        if ways[k, 0] * x + ways[k, 1] * y + ways[k, 2] * z >= APART:
            return tried
    ways[tried, 0], ways[tried, 1], ways[tried, 2] = x, y, z
    return tried + 1


@kernel
def _add_pierced(a, b, ways, tried):
    """Add directions from a to b of faces that an edge of the other pierces, the largest first; returns how many."""
    low, high = np.full(3, -math.inf), np.full(3, math.inf)
    for d in range(3):
        low[d] = max(a.corners[:, d].min(), b.corners[:, d].min())
        high[d] = min(a.corners[:, d].max(), b.corners[:, d].max())
    in_a, in_b = _within(a, low, high), _within(b, low, high)
    of_a, of_b = np.zeros(len(a.triangles)), np.zeros(len(b.triangles))
    for t in in_a:
        for s in in_b:
            if _boxes_meet(a, t, b, s):
                if _pierces(a, t, b, s):
                    of_b[s] = _area(b, s)
                if _pierces(b, s, a, t):
                    of_a[t] = _area(a, t)
    area = np.append(of_a, of_b)
    most = tried + MOST_TRIED
    for k in np.argsort(-area, kind="mergesort"):
        if not area[k] > 0.0 or tried == most:
            break
        n = a.normals[k].copy() if k < len(of_a) else -b.normals[k - len(of_a)]
        tried = _add_new(ways, tried, n[0], n[1], n[2])
    return tried


@kernel
def _within(posed, low, high):
    """Triangles (k,) whose boxes meet a box."""
    out, used = np.empty(len(posed.triangles), np.int64), 0
    for t in range(len(posed.triangles)):
        p, q, r = posed.triangles[t]
        meets = True
        for d in range(3):
            x, y, z = posed.corners[p, d], posed.corners[q, d], posed.corners[r, d]
            meets = meets and min(x, y, z) <= high[d] and max(x, y, z) >= low[d]
        if meets:
            out[used] = t
            used += 1
    return out[:used]


@inlined_kernel
def _boxes_meet(a, t, b, s):
    meet = True
    for d in range(3):
        p, q, r = a.corners[a.triangles[t, 0], d], a.corners[a.triangles[t, 1], d], a.corners[a.triangles[t, 2], d]
        u, v, w = b.corners[b.triangles[s, 0], d], b.corners[b.triangles[s, 1], d], b.corners[b.triangles[s, 2], d]
        meet = meet and min(p, q, r) <= max(u, v, w) and max(p, q, r) >= min(u, v, w)
    return meet


@kernel
def _area(posed, t):
    """Twice the area [m2] of a triangle."""
    p, q, r = posed.triangles[t]
    c = posed.corners
    ux, uy, uz = c[q, 0] - c[p, 0], c[q, 1] - c[p, 1], c[q, 2] - c[p, 2]
    vx, vy, vz = c[r, 0] - c[p, 0], c[r, 1] - c[p, 1], c[r, 2] - c[p, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return math.sqrt(x * x + y * y + z * z)


@kernel
def _pierces(a, t, b, s):
    """Whether an edge of triangle t of a passes through triangle s of b."""
    u, v, w = b.corners[b.triangles[s, 0]], b.corners[b.triangles[s, 1]], b.corners[b.triangles[s, 2]]
    for k in range(3):
        p, q = a.corners[a.triangles[t, k]], a.corners[a.triangles[t, (k + 1) % 3]]
        if _volume(u, v, w, p) * _volume(u, v, w, q) >= 0.0:
            continue
        x, y, z = _volume(p, q, u, v), _volume(p, q, v, w), _volume(p, q, w, u)
        if (x > 0.0 and y > 0.0 and z > 0.0) or (x < 0.0 and y < 0.0 and z < 0.0):
            return True
    return False


@inlined_kernel
def _volume(a, b, c, d):
    """Six times the signed volume [m3] of a tetrahedron."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)


@kernel
def _merge(step, offsets, found, out, slot, columns):
    """Write the contacts of all pairs to WorldContacts: those of whole surfaces before those that stay."""
    points_a, points_b, normals, gaps, samples = columns
    o = 0
    for p in range(len(step.pairs)):
        for k in range(out.counts[p]):
            put_in_world(step, p, out.found, slot[p] + k, columns, o)
            o += 1
        for c in range(offsets[p], offsets[p + 1]):
            if out.stays[c]:
                points_a[o], points_b[o], normals[o] = found.points_a[c], found.points_b[c], found.normals[c]
                gaps[o], samples[o] = found.gaps[c], found.samples[c]
                o += 1
