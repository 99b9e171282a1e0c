"""Contacts of pairs of which one is concave, where their surfaces overlap: what parts them, part by part.

Each sample that is deep in the other takes the direction to its own nearest face. Where a body is thinner than the
others are deep, or its faces are flush, these directions contradict each other, and hold the pair where it is. Coarse
triangles may pierce each other with no sample inside. So the contacts found are tried: b is moved by the least
translation that satisfies them. Where no edge of one surface passes through the other then (piercing.py), they suffice,
and no point of either is deeper than that translation is long.

Else each overlap that remains gets one direction: of the faces pierced, those found, and that in which the overlap
shrinks fastest, the one along which its two sides overlap least (facing_points.py). Its corners there are contacts
more, and the next translation satisfies them, too: so the directions of all overlaps are chosen together.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.contacts.contact_places import make_world_contacts, put_in_world
from fracture_collision.core.contacts.known_samples import ID_SAMPLE, share_a_body
from fracture_collision.core.lookahead.motion import MOST_TURN, Motion, Moving, closing_speed, put_pose, turned_in
from fracture_collision.core.lookahead.staying_apart import gap_of_hulls
from fracture_collision.core.memory.compiled import allocating_kernel, kernel, query_kernel, threaded_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.kinds import TETRAHEDRA, WITH_FACES
from fracture_collision.core.memory.pair import Sink, Step, put_pair
from fracture_collision.core.memory.pools import NEVER_BROKEN, Pools
from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.memory.tables import Moves, Table, moves_of_ranges
from fracture_collision.core.memory.transforms import turned_back
from fracture_collision.core.memory.vectors import (
    area_vector,
    distance,
    dot,
    length,
    minus,
    opposite,
    plus,
    plus_scaled,
    put,
    vector,
    vector_at,
)
from fracture_collision.core.patches.facing_points import (
    FacingPoints,
    Posed,
    box_around,
    facing_points,
    overlap_along,
)
from fracture_collision.core.patches.least_translation import least_translation
from fracture_collision.core.patches.pair_contacts import (
    MOVED,
    ONE_PLACE,
    Placing,
    Wanted,
    listed_patch,
    posed_at,
    put_contact,
    seen_from,
)
from fracture_collision.core.patches.piercing import (
    close_pairs,
    do_listed_pierce,
    do_pierce,
    in_order,
    no_overlaps,
    overlaps_of,
    pierced_of,
    pierced_pairs,
    triangles_within,
)
from fracture_collision.core.patches.shapes import Geometry, triangles_of
from fracture_collision.core.patches.surface import CONVEX_EDGE, CORNER, FACET, Surface, make_surface
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.core.search.neighbour_lists import IN_PLACE, NeighbourLists, displacement, keep_pose
from fracture_collision.core.search.passes import bound_by_thickness
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.core.separation.oriented_boxes import box_clearance
from fracture_collision.grouping import begins_of

# Deeper than so many detection tolerances, samples may be past the middle of something thin: they are not asked.
DEEP = 5.0
# Directions of one kind tried are at least so far from each other, by the cosine; at most so many.
APART, MOST_TRIED = 0.99, 4
# Directions tried for an overlap are so near to that in which it shrinks fastest, by the cosine.
SAME = 0.5
# One body passes right through the other where what enters and what leaves are alike: the area left is less than this.
# Then no direction undoes the overlap alone, and whole surfaces are parted.
THROUGH = 0.3
# Overlaps are alike within this share of the tolerance.
ALIKE = 0.25
# Those up to this share of the tolerance need no contacts; a translation leaves the other more than is needed, so that
# what it parts is apart.
LEAST, SLACK = 0.5, 0.1
# Translations tried, and directions added, at most.
MOST_TURNS, MOST_ADDED = 4, 8
# Points of what is moved aside, by little, move by no more than this times the body's own.
BESIDE = 1.1
# One direction for the whole surfaces is taken if they overlap along it by no more than this times the deepest contact
# and so many tolerances.
MOST_TIMES, MORE = 3.0, 2.0
# Contacts across those added, by the cosine, and no deeper than the tolerance, stay where samples are not asked.
OTHER = 0.5
# Who wants more contacts of a pair wants all that were found.
MOST_WANTED = 256
_LEAVE, _ALL = -1, -2
_DIRECTION_BIT = 59  # of a contact's number: above kind and feature


class Surfaces(Struct):
    """Surfaces of some fragments; rows count from a fragment's first."""

    begin: np.ndarray  # (F, 3) int64 first row of: corners, triangles, edges; -1: not made
    end: np.ndarray  # (F, 3) int64
    stamps: np.ndarray  # (F,) int64: no two surfaces ever made have the same
    all: Surface


_STAMPS = itertools.count(1)


class SurfaceTable:
    """Surfaces of fragments, made when first asked for. Valid until their body breaks: others are divided anew then."""

    def __init__(self) -> None:
        self._begin, self._end, self._stamps = np.full((0, 3), -1), np.full((0, 3), -1), np.zeros(0, np.int64)
        self._rows = Table(Surface)
        self._surfaces: Surfaces | None = None  # until one is added

    def forget(self, rows: np.ndarray) -> None:
        """Make those of `rows` (n,) anew when they are asked for."""
        rows = rows[rows < len(self._begin)]
        self._begin[rows] = self._end[rows] = -1

    def renumber(self, moves: Moves) -> None:
        """Keep the surfaces of fragments that stay, whose rows have moved."""
        stays = moves.stays[: len(self._begin)]
        self._begin, self._end, self._stamps = self._begin[stays], self._end[stays], self._stamps[stays]
        self._surfaces = None

    def of(self, pools: Pools, rows: np.ndarray) -> Surfaces:
        """Surfaces of at least `rows` (n,), ascending, of FragmentPool."""
        more = len(pools.fragment.kind) - len(self._begin)
        if more > 0:
            nothing = np.full((more, 3), -1)
            self._begin, self._end = np.vstack((self._begin, nothing)), np.vstack((self._end, nothing))
            self._stamps = np.append(self._stamps, np.zeros(more, np.int64))
            self._surfaces = None
        new = rows[self._begin[rows, 0] < 0]
        if len(new):
            self._drop_forgotten()
            self._add(pools, new)
            self._surfaces = None
        if self._surfaces is None:
            self._surfaces = Surfaces(self._begin, self._end, self._stamps, self._rows.view)
        return self._surfaces

    def _add(self, pools: Pools, new: np.ndarray) -> None:
        """Make those of `new` (n,), ascending; a body's fragments whose rows follow each other are divided at once."""
        fragment = pools.fragment
        shift = fragment.tet_shift[new]
        body = np.column_stack((fragment.mesh[new], shift, new - np.arange(len(new))))
        is_other = (body[1:] != body[:-1]).any(axis=1) | (shift[1:] == NEVER_BROKEN)
        runs = np.hstack((0, np.flatnonzero(is_other) + 1, len(new)))
        made = list[Surface]()
        for first, end in itertools.pairwise(runs.tolist()):
            triangles, begin = triangles_of(pools, new[first], new[end - 1] + 1)
            made += [_surface_of(triangles[k:m]) for k, m in itertools.pairwise(begin.tolist())]
        for k, name in enumerate(("corners", "triangles", "edges")):
            end = self._rows[name].used + np.cumsum([len(getattr(each, name)) for each in made])
            self._end[new, k], self._begin[new, k] = end, np.append(self._rows[name].used, end[:-1])
        self._stamps[new] = [next(_STAMPS) for _ in new]
        for column, parts in zip(self._rows, zip(*made, strict=True), strict=True):
            column.append(np.concatenate(parts))

    def _drop_forgotten(self) -> None:
        """Give the memory of surfaces that were forgotten back, once it is more than that of the others."""
        kept = self._begin[:, 0] >= 0
        begin, end = self._begin[kept], self._end[kept]
        if 2 * (end - begin)[:, 1].sum() >= self._rows["triangles"].used:
            return
        moves = {}
        for k, (name, rows) in enumerate((("corners", CORNER), ("triangles", FACET), ("edges", CONVEX_EDGE))):
            moves[rows] = moves_of_ranges(self._rows[name].used, begin[:, k], end[:, k])
            self._begin[kept, k], self._end[kept, k] = moves[rows].of(begin[:, k]), moves[rows].of(end[:, k])
        self._rows.move(moves)


@kernel
def _surface_of(triangles):
    """make_surface of triangles (n, 9) [m] in the order in which close_pairs is quick."""
    return make_surface(triangles[in_order(triangles)])


class _Out(NamedTuple):
    """What threads write, each pair its own rows."""

    counts: np.ndarray  # (p,) int64 contacts of the whole surfaces, _LEAVE: the pair stays as it is
    bounds: np.ndarray  # (p,) float64 [m]
    stays: np.ndarray  # (c,) bool: which contacts found before stay
    found: Sink  # `wanted` rows for each pair looked at


def part_interlocked(
    geometry: Geometry, table: SurfaceTable, moving: tuple[Step, Motion],
    work: tuple[NeighbourLists, np.ndarray, np.ndarray], rule: Rule, searched: tuple[PairContacts, np.ndarray],
    own: tuple[tuple[Scratch, ...], Crew],
) -> tuple[PairContacts, np.ndarray]:  # fmt: skip
    """Contacts with those of whole surfaces, where a concave pair is deep or pierces; and which pairs' changed.

    work: the lists, each pair's slot (p,), and the pairs (m,) that were searched; searched: their contacts, and how
    many of each pair's (p,), the last ones, lie in the future. rule: with epsilon and near as shares of the smaller R;
    own: a Scratch for each thread of the Crew.
    """
    (step, _), (lists, slots, todo), (scratch, crew), pools = moving, work, own, geometry.pools
    found, ahead = searched
    offsets, bounds = begins_of(found.counts), found.bounds.copy()
    if rule.wanted > MOST_WANTED:
        bound_unsearched(geometry, (step, todo), rule, bounds, scratch[0])
        return found._replace(bounds=bounds), todo[:0]
    todo = _candidates(geometry, (step, todo), rule, bounds, scratch[0])
    if not len(todo):
        return found._replace(bounds=bounds), todo
    surfaces = table.of(pools, np.unique(step.rows[step.pairs[todo]]))
    p, wanted = len(step.pairs), rule.wanted
    sink = Sink(np.empty((len(todo) * wanted, 10)), np.empty((len(todo) * wanted, 5), np.int64))
    out = _Out(np.full(p, _LEAVE), bounds, np.ones(len(found.gaps), np.bool_), sink)
    known = rule, (found.normals, _gaps_now(found.gaps, offsets, ahead)), offsets, slots, todo
    crew.share(_part_share, surfaces, pools, lists, moving, known, out, own=scratch)
    changed = np.flatnonzero(out.counts >= 0)
    if not len(changed):
        return found._replace(bounds=out.bounds), changed
    stay = np.append(0, np.cumsum(out.stays))
    counts = stay[offsets[1:]] - stay[offsets[:-1]] + np.maximum(out.counts, 0)
    columns = make_world_contacts(int(counts.sum()))
    slot = np.full(p, -1)
    slot[todo] = wanted * np.arange(len(todo))
    _merge(step, offsets, found, out, slot, columns)
    return PairContacts(counts, out.bounds, found.visits, found.exhausted, *columns), changed


def bound_unsearched(
    geometry: Geometry, pairs: tuple[Step, np.ndarray], rule: Rule, bounds: np.ndarray, scratch: Scratch
) -> None:
    """Raise the missed depth bounds (p,) [m] of those pairs, a Step's and their numbers, whose surfaces may pierce.

    For pairs that are not looked at: pieces that have run into each other are no deeper than the thinner one is thick.
    """
    before = bounds.copy()
    bound_by_thickness(geometry.pools, pairs[0], _candidates(geometry, pairs, rule, bounds, scratch), bounds, scratch)
    np.maximum(before, bounds, out=bounds)


def _candidates(geometry, pairs, rule, bounds, scratch):
    """Pairs (k,) of those asked about, a Step's and their numbers, that are to be looked at.

    Sets the missed depth bounds (p,) [m] of pieces that are where they were one.
    """
    kept = np.empty(len(pairs[1]), np.int64)
    return kept[: _put_candidates(geometry, pairs, rule, bounds, scratch, kept)]


@query_kernel
def _put_candidates(geometry, pairs, rule, bounds, scratch, out):
    (step, todo), used = pairs, 0
    pools, is_convex = geometry.pools, geometry.shapes.is_convex
    for p in todo:
        a, b = step.rows[step.pairs[p, 0]], step.rows[step.pairs[p, 1]]
        if is_convex[a] and is_convex[b]:
            continue
        if pools.fragment.kind[a] not in WITH_FACES or pools.fragment.kind[b] not in WITH_FACES:
            continue
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        if share_a_body(pools, pair.a, pair.b):
            moved = displacement(pools, pair, IN_PLACE)
            if MOVED * moved <= rule.epsilon * min(pools.fragment.radius[a], pools.fragment.radius[b]):
                bounds[p] = moved
                continue
        if box_clearance(pools.fragment.box[a], pools.fragment.box[b], pair.rotation[0], pair.translation[0], 0.0) > 0:
            continue
        out[used] = p
        used += 1
    return used


@kernel
def _gaps_now(gaps, offsets, ahead):
    """Gaps (N,) [m] of which those of contacts ahead are not negative.

    A contact ahead has the normal of its moment: on a fragment that turns fast its gap may be negative now, though the
    two are apart there.
    """
    now = gaps.copy()
    for p in range(len(ahead)):
        for c in range(offsets[p + 1] - ahead[p], offsets[p + 1]):
            now[c] = max(now[c], 0.0)
    return now


@threaded_kernel
def _part_share(surfaces, pools, lists, moving, known, out, scratch, part):
    """Process every pair that is a thread's, see Crew.share.

    known: a Rule, normals and gaps of all contacts, their offsets, the slot of each pair in the lists, and the pairs.
    """
    step, motion = moving
    rule, (normals, gaps), offsets, slots, todo = known
    thread, threads = part
    for turn in range(thread, len(todo), threads):
        p = todo[turn]
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        tolerance = rule.near * min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])
        moved, rows = math.inf, (offsets[p], offsets[p + 1])
        if share_a_body(pools, pair.a, pair.b):
            moved = displacement(pools, pair, IN_PLACE)
        along, slot, reach = scratch.toward, slots[p], 0.0
        # how far the two may yet move until other triangles may pierce each other than those listed [m]
        left = _left_of(pools, surfaces, pair, lists.close, slot)
        i, j = step.pairs[p, 0], step.pairs[p, 1]
        if not (motion.time > 0.0 and closing_speed(motion, i, j, 0.0, motion.time) * motion.time > tolerance):
            reach = tolerance
        if rows[0] == rows[1]:
            is_listed = left >= 0.0 and left >= length(vector(lists.close.by, slot))
            gap = math.inf if is_listed and lists.close.counts[slot] == 0 else 0.0
            if not is_listed:
                for d in range(3):
                    along[d] = lists.toward[slot, d] if slot >= 0 else 0.0
                gap, n = gap_of_hulls(pools, pair, reach, along, scratch)
                along[0], along[1], along[2] = n
                if gap > 0.0 and slot >= 0 and reach > 0.0:
                    _keep_list(lists.close, slot, surfaces, pair, (0, (0.0, 0.0, 0.0), gap))
            if gap > 0.0:
                out.bounds[p] = 0.0
                continue
        is_sampled = pools.fragment.kind[pair.a] == TETRAHEDRA and pools.fragment.kind[pair.b] == TETRAHEDRA
        its = Wanted(tolerance, moved, rule.wanted), is_sampled, along
        begin, end = rule.wanted * turn, rule.wanted * (turn + 1)
        sink = Sink(out.found.contacts[begin:end], out.found.ids[begin:end])
        out.counts[p], out.bounds[p] = put_interlocked(
            (surfaces, lists.close, slot, left, reach), pair, Moving(i, j, step.rotations, step.positions, motion), its,
            (normals, gaps, rows), out.stays, sink,
        )  # fmt: skip


@query_kernel
def _left_of(pools, surfaces, pair, lists, slot):
    """By how much [m] the motion of a Pair falls short of the reach of its list; -1: it has none."""
    if slot < 0 or lists.counts[slot] < 0:
        return -1.0
    if lists.surfaces[slot, 0] != surfaces.stamps[pair.a] or lists.surfaces[slot, 1] != surfaces.stamps[pair.b]:
        return -1.0
    return lists.reach[slot] - BESIDE * displacement(pools, pair, lists.at[slot])


class _Planes(NamedTuple):
    """Half-spaces n . x >= need of b's translations x, those of contacts found first."""

    normals: np.ndarray  # (c + MOST_ADDED, 3) unit, from a to b
    needs: np.ndarray  # (c + MOST_ADDED,) [m]
    at: np.ndarray  # (c + MOST_ADDED, 3) [m] b's translation when it was found


class _Rules(NamedTuple):
    whole: tuple[Posed, Posed]
    given: np.ndarray  # (c, 3) directions of contacts found
    along: np.ndarray  # (3,) that of the deepest: see close_pairs
    placings: tuple[Placing, Placing]
    wanted: Wanted
    boxes: tuple[np.ndarray, np.ndarray]  # (6,) [m] around each: least and most
    size: float  # [m] of the smaller
    most: float  # [m] how long the translation may be


class _Parted(NamedTuple):
    """What was tried."""

    used: int  # half-spaces
    x: np.ndarray  # (3,) [m] b's translation
    is_apart: bool  # where b is moved by it: tried
    begun: int  # half-spaces up to those of the overlaps met first


_NOT_PARTED = _Parted(0, np.zeros(3), False, 0)


@allocating_kernel
def put_interlocked(surfaces, pair, moving, wanted, known, stays, sink):
    """Write contacts that part what overlaps of a Pair to a Sink; marks which of the known ones stay.

    surfaces: Surfaces, CloseTriangles, the pair's slot of these, how far it may move until its list ends [m], and the
    reach [m] of a new one, 0: none. wanted: Wanted, whether both are full of samples, a direction along which the hulls
    overlap little. known: normals (c, 3), from a to b in the world, and gaps
    (c,) [m] of all contacts, the pair's rows of these. Returns (contacts, -1: the pair stays as it is; bound [m]).
    """
    wanted, is_sampled, hulls = wanted
    kept, surfaces, tolerance = surfaces, surfaces[0], wanted.near
    normals, gaps, (begin, end) = known
    found = end - begin
    planes = _planes_of(normals[begin:end], gaps[begin:end], moving.rotations[moving.j])
    deepest = max(planes.needs[:found].max(), 0.0) if found > 0 else 0.0
    given, along = planes.normals[:found].copy(), hulls[:3].copy()
    if found > 0:
        along[:] = given[np.argmax(planes.needs[:found])]
    elif not dot(along, along) > 0.0:
        along[2] = 1.0
    is_asked, is_apart, x = _try_contacts(kept, pair, (given, planes.needs[:found], deepest), tolerance, along)
    if is_apart:
        return _LEAVE, min(length(x), wanted.moved)
    if is_sampled and max(deepest, wanted.moved) <= DEEP * tolerance:
        # pieces nearly in place: how far they have moved says enough, and hardly ever anything parts them
        return _LEAVE, wanted.moved
    placings = _placings(moving)
    a = posed_at(_surface_at(surfaces, pair.a), placings[0], 0.0)
    b = posed_at(_surface_at(surfaces, pair.b), placings[1], 0.0)
    boxes = box_around(a.corners), box_around(b.corners)
    size = min(_longest(boxes[0]), _longest(boxes[1]))
    bound = min(_box_overlap(boxes), wanted.moved)
    likely = MOST_TIMES * deepest + MORE * tolerance
    rules = _Rules((a, b), given, along, placings, wanted, boxes, size, MOVED * wanted.moved)
    parted = _part(x, (found, found), False, rules, planes) if is_asked else _NOT_PARTED
    first = found if parted.is_apart else 0
    if not parted.is_apart:
        parted = _part(np.zeros(3), (0, 0), deepest > DEEP * tolerance, rules, planes)
    is_whole, is_long = parted.is_apart, not parted.is_apart or dot(parted.x, parted.x) > likely * likely
    if wanted.moved > likely and is_long:
        others = _planes_of(normals[:0], gaps[:0], moving.rotations[moving.j])
        whole = _part_whole(parted, rules, others)
        if whole.is_apart or (whole.used > 0 and not parted.is_apart):
            parted, planes, first, is_whole = whole, others, 0, True
    x = parted.x
    if parted.is_apart:
        bound = min(bound, length(x))
    # where no translation parts the two, turning by a little may: every overlap is pushed out on its own
    rows = first, parted.used if is_whole else parted.begun
    count = _put_corners(planes, rows, rules, sink)
    if count == 0:
        return _LEAVE, bound
    if is_whole and first < found:
        _mark_those_across(planes, rows, given, x, (gaps[begin:end], tolerance), stays[begin:end])
    else:
        stays[begin:end] = True
    return count, bound


@kernel
def _mark_those_across(planes, rows, given, x, found, stays):
    """Which contacts found stay (c,): shallow ones across the half-spaces in rows (first, end), that x brings near.

    given: their directions (c, 3); found: their gaps (c,) [m] and the tolerance [m].
    """
    gaps, tolerance = found
    for c in range(len(gaps)):
        n = vector(given, c)
        gap = gaps[c] + dot(x, n)
        stays[c] = gaps[c] >= -tolerance and -LEAST * tolerance <= gap <= tolerance
        for k in range(rows[0], rows[1]):
            stays[c] = stays[c] and abs(dot(vector(planes.normals, k), n)) < OTHER


@kernel
def _planes_of(normals, gaps, rotation):
    """The _Planes of contacts with normals (c, 3), in the world, and gaps (c,) [m]; rotation: b's, to the world."""
    found, rows = len(gaps), len(gaps) + MOST_ADDED
    planes = _Planes(np.empty((rows, 3)), np.empty(rows), np.empty((rows, 3)))
    for c in range(found):
        put(planes.normals, c, turned_back(rotation, vector(normals, c)))
        planes.needs[c] = -gaps[c]
    return planes


@kernel
def _try_contacts(kept, pair, known, tolerance, n):
    """(whether contacts are asked, whether what satisfies them parts a Pair, this translation of b (3,) [m]).

    kept: see put_interlocked; known: directions of the contacts (c, 3), needs (c,) [m], the deepest [m]; n: see
    close_pairs. Where they touch, gaps are opened: rounding might pierce there.
    """
    (surfaces, lists, slot, left, reach), (given, needs, deepest) = kept, known
    x, is_asked = np.zeros(3), False
    for opened in (LEAST * tolerance, SLACK * tolerance):
        if opened > SLACK * tolerance and (len(needs) == 0 or deepest > opened):
            continue
        # samples that are deep in something thin may be past its middle, and contradict each other
        x, is_possible = _satisfying(given, needs, opened)
        is_asked = is_possible and deepest <= DEEP * tolerance
        if not is_asked:
            continue
        is_listed = left >= 0.0 and left >= distance(x, vector(lists.by, slot))
        if _are_apart(surfaces, pair, x, n, (lists, slot, is_listed, reach)):
            return True, True, x
        if not is_listed:
            left = -1.0  # the list is another one
    return is_asked, False, x


@kernel
def _satisfying(normals, needs, more):
    """least_translation that leaves so much more [m] than the needs of each, if that is possible."""
    x, is_possible = least_translation(normals, needs + more)
    if not is_possible:
        x, is_possible = least_translation(normals, needs)
    return x, is_possible


@kernel
def _are_apart(surfaces, pair, x, n, kept):
    """Whether nothing pierces anything where b of a Pair is moved by x (3,) [m]; n: see close_pairs.

    kept: CloseTriangles, the pair's slot, whether its list holds; else the reach [m] of a new one.
    """
    lists, slot, is_listed, reach = kept
    a, b = _surface_at(surfaces, pair.a), _surface_at(surfaces, pair.b)
    poses = (pair.rotation[0], pair.translation[0]), (np.eye(3), x)
    if is_listed:
        return not do_listed_pierce(a, b, poses, lists.pairs[slot, : lists.counts[slot]])
    if slot < 0 or not reach > 0.0:
        return not do_pierce(a, b, poses, n, (np.empty((0, 2), np.int32), 0.0))[0]
    pierces, count = do_pierce(a, b, poses, n, (lists.pairs[slot], reach))
    _keep_list(lists, slot, surfaces, pair, (count, vector_at(x, 0), reach))
    return not pierces


@query_kernel
def _keep_list(lists, slot, surfaces, pair, listed):
    """Describe the triangles that were listed of a Pair: how many, b's translation [m], and the reach [m]."""
    lists.counts[slot], by, lists.reach[slot] = listed
    put(lists.by, slot, by)
    lists.surfaces[slot, 0], lists.surfaces[slot, 1] = surfaces.stamps[pair.a], surfaces.stamps[pair.b]
    keep_pose(pair.rotation, pair.translation, lists.at[slot])


@kernel
def _placings(moving):
    """The Placing of both, now and at the end of the step; only now where they turn by much."""
    i, j, rotations, positions, motion = moving
    turns, places = np.empty((6, 3, 3)), np.empty((6, 3))
    fast = max(turned_in(motion, i, motion.time), turned_in(motion, j, motion.time)) if motion.time > 0.0 else math.inf
    for row in range(6):
        k = i if row < 3 else j
        if row % 3 > 0 and fast <= MOST_TURN:
            put_pose(motion, rotations, positions, k, motion.time, turns[row], places[row])
        else:
            turns[row], places[row] = rotations[k], positions[k]
    return seen_from(turns, places, 0), seen_from(turns, places, 3)


@kernel
def _part(x, rows, is_inside, rules, planes):
    """Add half-spaces until both surfaces are apart: a _Parted.

    x: least translation by those there are; rows: their number, and that of those of contacts found; is_inside: one may
    be inside the other, and pierce nothing.
    """
    (used, first), begun = rows, rows[0]
    origin, reach, close, near = x, -1.0, np.empty((0, 2), np.int64), rules.whole
    for turn in range(MOST_TURNS):
        if not distance(x, origin) <= reach:
            # most are apart at once; those that are not are moved by little from there
            origin, reach = x, turn * rules.wanted.near
            near = _in_common(x, reach, rules)
            close = close_pairs(near[0], _shifted(near[1], x), rules.along, reach)
        a, there = near[0], _shifted(near[1], x)
        pairs = pierced_of(a, there, close)
        if len(pairs) == 0:
            return _Parted(used, x, turn > 0 or not is_inside, begun)
        overlaps = overlaps_of(a, there, pairs)
        for k in range(len(overlaps.spreads)):
            n, overlap = _way_out((a, there), pairs, overlaps, k, x, rules)
            if not overlap < math.inf or used == first + MOST_ADDED:
                return _Parted(used, x, False, begun)
            planes.normals[used], planes.needs[used], planes.at[used] = n, overlap + dot(x, n), x
            used += 1
            begun += turn == 0
        x, is_possible = _satisfying(planes.normals[:used], planes.needs[:used], SLACK * rules.wanted.near)
        if not is_possible or dot(x, x) > rules.most * rules.most:
            break
    return _Parted(used, x, False, begun)


@kernel
def _in_common(x, reach, rules):
    """What of a and of b, not moved, may meet the other where b is moved by x (3,) and up to `reach` [m] more."""
    (a, b), by = rules.whole, reach + ONE_PLACE * rules.size
    box_a, box_b = rules.boxes[0].copy(), rules.boxes[1].copy()
    for d in range(3):
        box_a[d], box_a[3 + d] = box_a[d] - x[d], box_a[3 + d] - x[d]
        box_b[d], box_b[3 + d] = box_b[d] + x[d], box_b[3 + d] + x[d]
    of_a = triangles_within(a.triangles, a.corners, box_b, by)
    of_b = triangles_within(b.triangles, b.corners, box_a, by)
    return _part_of(a, of_a), _part_of(b, of_b)


@kernel
def _part_whole(parted, rules, planes):
    """A _Parted of first that direction along which whole surfaces overlap least, if that is less than another's."""
    most = rules.most
    if parted.is_apart:
        most = min(most, length(parted.x))
    x = np.zeros(3)
    near = _in_common(x, 0.0, rules)
    n, overlap = _least_way(
        near, pierced_pairs(near[0], near[1], rules.along), (no_overlaps(), _ALL, True), x, x, rules
    )
    if not overlap < most:
        return _NOT_PARTED
    planes.normals[0], planes.needs[0], planes.at[0] = n, overlap, x
    # faces nearly along the direction have no overlap along it
    x = n * (overlap + SLACK * rules.wanted.near)
    parted = _part(x, (1, 0), False, rules, planes)
    if parted.is_apart:
        return parted
    return _Parted(1, x, False, 1)


@kernel
def _put_corners(planes, rows, rules, sink):
    """Write the corners of the half-spaces in rows (first, end) to a Sink, of each as many; returns how many."""
    count, (first, end) = 0, rows
    for k in range(first, end):
        each = min(max(len(sink.contacts) // (end - first), 1), len(sink.contacts) - count)
        rest = Sink(sink.contacts[count : count + each], sink.ids[count : count + each])
        plane = planes.normals[k], planes.needs[k], planes.at[k]
        more = _put_points(plane, rules, rest)
        count = _keep_distinct(sink, count, more, planes.normals[k])
    return count


@kernel
def _put_points(plane, rules, sink):
    """Write the corners of the facing surfaces that a half-space is of to a Sink; returns how many.

    plane: n, its need [m], b's translation (3,) [m] when it was found.
    """
    (n, need, x), (a, b), wanted, size = plane, rules.whole, rules.wanted, rules.size
    along = dot(x, n)
    if abs(need - along) + abs(along) <= LEAST * wanted.near:
        return 0
    # where other directions move b farther along this one, its corners are apart now, and listed all the same
    near = wanted.near + max(-need, 0.0)
    deepest = -need - ALIKE * wanted.near  # what is deeper is of other overlaps
    found = facing_points(a, _shifted(b, x), n, (deepest + along, near + along), size)
    now = FacingPoints(found.points, found.gaps - along, found.features)
    patch = listed_patch(
        now, rules.placings, (0.0, 0.0), n, 0, Wanted(near, wanted.moved, len(sink.contacts)), size
    )  # fmt: skip
    for k in range(len(patch.gaps)):
        # straight on b, then back with it
        other = minus(plus_scaled(vector(patch.others, k), along, n), x)
        put_contact(sink, k, vector(patch.points, k), other, n, patch.numbers[k])
    return len(patch.gaps)


@kernel
def _keep_distinct(sink, count, more, n):
    """Number `more` contacts along n behind the first `count` anew if one of these has their number: (contacts kept).

    A corner may be of two directions; then the axis nearest to the later one tells them apart.
    """
    axis = 0
    for d in range(1, 3):
        if abs(n[d]) > abs(n[axis]):
            axis = d
    direction = np.int64(1 + 2 * axis + (n[axis] < 0.0)) << _DIRECTION_BIT
    kept = count
    for c in range(count, count + more):
        is_new = True
        for turn in range(2):
            is_new = True
            for k in range(kept):
                is_new = is_new and sink.ids[k, ID_SAMPLE] != sink.ids[c, ID_SAMPLE]
            if is_new or turn == 1:
                break
            sink.ids[c, ID_SAMPLE] += direction
        if is_new:
            sink.contacts[kept], sink.ids[kept] = sink.contacts[c], sink.ids[c]
            kept += 1
    return kept


@kernel
def _way_out(posed, pairs, overlaps, part, x, rules):
    """(direction (3,), how far [m] b must be moved along it to undo one overlap, of a number).

    x (3,) [m]: how far b was moved.
    """
    toward = overlaps.areas[part].copy()
    area = length(toward)
    if area > 0.0:
        toward /= area
    is_through = not area > THROUGH * overlaps.spreads[part]
    n, overlap = _least_way(posed, pairs, (overlaps, part, is_through), toward, x, rules)
    if is_through and area > 0.0 and not overlap < math.inf:
        # more of it leaves than enters
        n, overlap = _least_way(posed, pairs, (overlaps, part, False), toward, x, rules)
    return n, overlap


@kernel
def _least_way(posed, pairs, which, toward, x, rules):
    """_way_out of an overlap, or _ALL. which: Overlaps, its number, whether one body passes right through the other.

    toward: the unit vector (3,) along which it shrinks fastest.
    """
    (a, b), given, wanted, size = posed, rules.given, rules.wanted, rules.size
    overlaps, part, is_through = which
    ways, tried = np.empty((2 * MOST_TRIED + 1, 3)), 0
    areas, at = _pierced_areas(posed, pairs, overlaps.of_a, part)
    for k in np.argsort(-areas, kind="mergesort"):
        if not areas[k] > 0.0 or tried == MOST_TRIED:
            break
        side, t = at[k]
        n = vector(a.normals, t) if side == 0 else opposite(vector(b.normals, t))
        if is_through or dot(n, toward) > SAME:
            tried = _add_new(ways, tried, n)
    most = tried + MOST_TRIED
    for c in range(len(given)):
        n = vector(given, c)
        if tried < most and (is_through or dot(n, toward) > SAME):
            tried = _add_new(ways, tried, n)
    enough = math.inf
    if is_through:
        a, b = rules.whole[0], _shifted(rules.whole[1], x)
    else:
        others = tried
        tried = _add_new(ways, tried, toward)
        a = _part_of(a, np.flatnonzero(overlaps.of_a == part))
        b = _part_of(b, np.flatnonzero(overlaps.of_b == part))
        if tried > others:
            # nearly the least, most often: what overlaps more is not looked at closer
            lowest = dot(x, toward) - MOVED * wanted.moved - ONE_PLACE * size
            overlap = overlap_along(a, b, toward, lowest, math.inf, size)
            enough = overlap + ALIKE * wanted.near if overlap > 0.0 else math.inf
    best, least = 0, math.inf
    for k in range(tried):
        along = dot(x, vector(ways, k))
        lowest = -math.inf if is_through else along - MOVED * wanted.moved - ONE_PLACE * size
        less = min(least - ALIKE * wanted.near, enough, rules.most - along)
        if not less > 0.0:
            continue
        overlap = overlap_along(a, b, ways[k], lowest, less, size)
        if 0.0 < overlap < less:
            best, least = k, overlap
    return ways[best].copy(), least


@kernel
def _pierced_areas(posed, pairs, of_a, part):
    """Twice the areas (k,) [m2] of the triangles of one overlap that are pierced, and their sides and rows (k, 2).

    a's before b's, each once and ascending; part: the number of the overlap, or _ALL.
    """
    a, b = posed
    in_a, in_b = np.zeros(len(a.triangles), np.bool_), np.zeros(len(b.triangles), np.bool_)
    for k in range(len(pairs)):
        t, s = pairs[k]
        if part == _ALL or of_a[t] == part:
            in_a[t] = in_b[s] = True
    areas, at, used = np.empty(2 * len(pairs)), np.empty((2 * len(pairs), 2), np.int64), 0
    for t in np.flatnonzero(in_a):
        areas[used], at[used, 0], at[used, 1] = _area(a.corners, a.triangles, t), 0, t
        used += 1
    for t in np.flatnonzero(in_b):
        areas[used], at[used, 0], at[used, 1] = _area(b.corners, b.triangles, t), 1, t
        used += 1
    return areas[:used], at[:used]


@kernel
def _part_of(posed, rows):
    """The Posed surface of some triangles (k,)."""
    row, corner = np.full(len(posed.triangles), -1, np.int32), np.full(len(posed.corners), -1, np.int32)
    triangles, used = np.empty((len(rows), 3), np.int32), 0
    for k in range(len(rows)):
        row[rows[k]] = k
        for i in range(3):
            c = posed.triangles[rows[k], i]
            if corner[c] < 0:
                corner[c] = used
                used += 1
            triangles[k, i] = corner[c]
    corners, is_sharp = np.empty((used, 3)), np.empty(used, np.bool_)
    for c in range(len(corner)):
        if corner[c] >= 0:
            corners[corner[c]], is_sharp[corner[c]] = posed.corners[c], posed.is_sharp[c]
    edges, beside, count = np.empty_like(posed.edges), np.empty_like(posed.beside), 0
    for e in range(len(edges)):
        left, right = row[posed.beside[e, 0]], row[posed.beside[e, 1]]
        if max(left, right) >= 0:
            edges[count, 0], edges[count, 1] = corner[posed.edges[e, 0]], corner[posed.edges[e, 1]]
            beside[count, 0], beside[count, 1] = left if left >= 0 else right, right if right >= 0 else left
            count += 1
    return Posed(corners, triangles, posed.normals[rows], edges[:count].copy(), beside[:count].copy(), is_sharp)


@kernel
def _shifted(posed, x):
    corners = np.empty_like(posed.corners)
    for k in range(len(corners)):
        put(corners, k, plus(vector(posed.corners, k), x))
    return Posed(corners, posed.triangles, posed.normals, posed.edges, posed.beside, posed.is_sharp)


@query_kernel
def _box_overlap(boxes):
    """How far [m] b must be moved along an axis at most."""
    a, b, least = boxes[0], boxes[1], math.inf
    for d in range(3):
        least = min(least, a[3 + d] - b[d], b[3 + d] - a[d])
    return max(least, 0.0)


@kernel
def _surface_at(surfaces, f):
    c, d, s = surfaces.begin[f], surfaces.end[f], surfaces.all
    return Surface(
        s.corners[c[0] : d[0]], s.triangles[c[1] : d[1]], s.normals[c[1] : d[1]], s.edges[c[2] : d[2]],
        s.beside[c[2] : d[2]], s.is_sharp[c[0] : d[0]],
    )  # fmt: skip


@query_kernel
def _longest(box):
    return max(box[3] - box[0], box[4] - box[1], box[5] - box[2])


@query_kernel
def _add_new(ways, tried, n):
    """Add a direction to the first `tried` of `ways`, if it is far from all of them; returns their number."""
    for k in range(tried):
        if dot(vector(ways, k), n) >= APART:
            return tried
    put(ways, tried, n)
    return tried + 1


@query_kernel
def _area(c, triangles, t):
    """Twice the area [m2] of a triangle with corners `c`."""
    p, q, r = triangles[t]
    return length(area_vector((vector(c, p), vector(c, q), vector(c, r))))


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
