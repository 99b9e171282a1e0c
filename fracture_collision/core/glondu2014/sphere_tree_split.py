"""Splitting, restructuring and extending a sphere tree at a fracture: Glondu 2014, sections 6.2 and 6.3.

Split: a node with descendants in several fragments is replicated once for each; a copy with a single child is omitted.
Restructure: a copy that lost its point takes the point of its subtree that is closest to the old one, and so do all
nodes between. Extend: a new surface point goes under the mesh node at its own end of the cut edge, at the lowest node
of that point's branch whose radius still exceeds their distance, else at the highest.

Every tree is in preorder, and so is a fragment's part of it: one walk over the old tree deals out its entries to all
fragments, and prefix sums place the new points. Per-entry decisions are branchless where possible, since the shape of a
tree is unpredictable for the processor.

Without the order (the paper's earlier version, its reference [27]): a copy that lost its point takes the point of its
first child, a new surface point goes under the leaf at its own end of the cut edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision import grouping
from fracture_collision.core.glondu2014.paper_pools import NONE_BELOW, OWN_SAMPLE, SAMPLE, SIZE, SURFACE
from fracture_collision.core.glondu2014.sphere_tree_deal import deal_tree, find_parents
from fracture_collision.core.memory.compiled import kernel, query_kernel

_grouped = kernel(grouping.grouped)
NONE = -1


class _Share(NamedTuple):
    """Working space for one fragment's tree before its new points are inserted; one row per entry, and one more."""

    spheres: np.ndarray  # (s, 4) float64 [m], centre and radius
    sample: np.ndarray  # (s,) int32
    on_surface: np.ndarray  # (s,) uint8
    lost: np.ndarray  # (s,) uint8: its point went to another fragment
    stale: np.ndarray  # (s,) uint8: its radius must be recomputed, as its points changed
    parent: np.ndarray  # (s,) int32
    farthest: np.ndarray  # (s,) float64 [m]: of a leaf, the distance to the farthest new point of its mesh node
    watched: np.ndarray  # (s,) int32: the nearest watched entry (_place) from each one upwards, itself included
    new_before: np.ndarray  # (s,) int32: number of new points under entries before it
    added: np.ndarray  # (s,) int32: number of new points under it
    start: np.ndarray  # (s,) int32: output row of the first of them
    closing: np.ndarray  # (s,) int32: rows that inner subtrees with the same end add before its own new rows
    shift: np.ndarray  # (s,) int32: rows added before the entry
    surface_before: np.ndarray  # (s,) int32: number of entries before it with a point on the surface


class _New(NamedTuple):
    """Working space for the new points."""

    entry: np.ndarray  # (q,) int32: the entry it is inserted under
    distance: np.ndarray  # (q,) float64 [m] from the leaf of its mesh node
    rank: np.ndarray  # (q,) int32: its index among the entry's new points
    x: np.ndarray  # (q,) float64 [m]: one fragment's points, in the order of their entries
    y: np.ndarray  # (q,)
    z: np.ndarray  # (q,)


class TreeArrays(NamedTuple):
    """Rows of TreePool."""

    spheres: np.ndarray  # (s, 4) float64 [m]
    entries: np.ndarray  # (s, 3) int32


@kernel
def split_sphere_tree(tree, fragment_of_entry, fragments, added, ordered, out):
    """Write one tree per fragment, consecutively, from the tree of the broken fragment.

    tree, out: TreeArrays, `out` with rows_of_split rows; fragment_of_entry (s,) int32: the fragment that gets each
    entry's point, or NOBODYS; added: NewSamples, inserted under their parents; ordered: keep the maximum-distance
    order. Returns the first row of each tree and the end row, (fragments + 1,) int64.
    """
    spheres, entries = tree
    points, parents = added.points, added.parents
    deal = deal_tree(entries, fragment_of_entry, fragments)
    room = 0
    for f in range(fragments):
        room = max(room, deal.last[f] - deal.first[f] + 1)
    share = _Share(
        np.empty((room, 4)), np.empty(room, np.int32), np.empty(room, np.uint8), np.empty(room, np.uint8),
        np.empty(room, np.uint8), np.empty(room, np.int32), np.empty(room), np.empty(room, np.int32),
        np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32),
        np.empty(room, np.int32), np.empty(room, np.int32),
    )  # fmt: skip
    order, bounds = _grouped(added.parts, fragments)
    q = len(points)
    new = _New(
        np.empty(q, np.int32), np.empty(q), np.empty(q, np.int32), np.empty(q), np.empty(q), np.empty(q)
    )
    leaf_of = np.empty(parents.max() + 1 if len(parents) else 0, np.int32)  # by mesh node, up to the largest parent
    begin = np.zeros(fragments + 1, np.int64)
    for f in range(fragments):
        kept, size = deal.kept[deal.first[f] : deal.last[f]], deal.size[deal.first[f] : deal.last[f]]
        _take(spheres, entries, fragment_of_entry, kept, size, f, share)
        if ordered:
            _restructure(size, share)
        else:
            _take_first_points(size, share)
        _update_radii(size, share)
        own = order[bounds[f] : bounds[f + 1]]
        _place(size, share, own, points, parents, ordered, leaf_of, new)
        _grow(size, share, own, points, new)
        more = _make_room(size, share)
        at = begin[f]
        _write(size, share, own, added, new, TreeArrays(out.spheres[at:], out.entries[at:]))
        begin[f + 1] = at + len(size) + more
    return begin


def rows_of_split(entries: np.ndarray, new_points: int) -> int:
    """Upper bound of the rows that split_sphere_tree writes for its trees."""
    # A tree has fewer inner nodes than leaves; a new point adds a leaf, and may turn another leaf into an inner node
    # above a new leaf. One unused row is written behind the last entry.
    return 2 * (int((entries[:, SIZE] == 1).sum()) + new_points) + 1


@query_kernel
def _take(spheres, entries, fragment_of_entry, kept, size, fragment, share):
    for i in range(len(kept)):
        o = kept[i]
        s, c = share.spheres[i], spheres[o]
        s[0], s[1], s[2], s[3] = c[0], c[1], c[2], c[3]
        share.sample[i], share.on_surface[i] = entries[o, SAMPLE], entries[o, SURFACE] == OWN_SAMPLE
        # a smaller subtree than before: it lost descendants
        share.stale[i] = size[i] != entries[o, SIZE]
        share.lost[i] = fragment_of_entry[o] != fragment


@query_kernel
def _restructure(size, share):
    """Give each entry that lost its point the closest point below it, and the same to all entries in between."""
    spheres = share.spheres
    for i in range(len(size)):
        if not share.lost[i]:
            continue
        best, best_d2 = -1, np.inf
        for j in range(i + 1, i + size[i]):
            d2 = _squared(spheres[j], spheres[i])
            d2 = d2 if size[j] == 1 else np.inf
            best, best_d2 = (j, d2) if d2 < best_d2 else (best, best_d2)
        entry = i
        while entry != best:
            _take_point(share, entry, best)
            share.lost[entry] = 0
            child = entry + 1
            while child + size[child] <= best:
                child += size[child]
            entry = child


@query_kernel
def _take_first_points(size, share):
    """Give each entry that lost its point the point of its first child."""
    for i in range(len(size) - 1, -1, -1):
        if share.lost[i]:
            _take_point(share, i, i + 1)


@query_kernel
def _take_point(share, entry, other):
    s, c = share.spheres[entry], share.spheres[other]
    s[0], s[1], s[2] = c[0], c[1], c[2]
    share.sample[entry], share.on_surface[entry] = share.sample[other], share.on_surface[other]
    share.stale[entry] = 1


@query_kernel
def _squared(p, q):
    dx, dy, dz = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    return dx * dx + dy * dy + dz * dz


@query_kernel
def _update_radii(size, share):
    """Exact radii of all stale entries: the distance to the furthest point below (inner nodes repeat leaf points)."""
    spheres = share.spheres
    for i in range(len(size)):
        if not share.stale[i]:
            continue
        a = b = c = d = 0.0
        j, end = i + 1, i + size[i]
        # four independent maxima, as each waits for the one before
        while j + 4 <= end:
            a, b = max(a, _squared(spheres[j], spheres[i])), max(b, _squared(spheres[j + 1], spheres[i]))
            c, d = max(c, _squared(spheres[j + 2], spheres[i])), max(d, _squared(spheres[j + 3], spheres[i]))
            j += 4
        while j < end:
            a = max(a, _squared(spheres[j], spheres[i]))
            j += 1
        spheres[i, 3] = np.sqrt(max(a, b, c, d))


@query_kernel
def _place(size, share, own, points, parents, ordered, leaf_of, new):
    """Choose the entry that each of the `own` new points is inserted under: fills `added` of the share, and `new`.

    A point is compared with an entry's current sphere, grown by the points before it. This matters only for entries
    that some point of their own sample may climb past; these are watched and grow with each point, the others later,
    all at once (_grow).
    """
    spheres, sample, parent = share.spheres, share.sample, share.parent
    watched, farthest = share.watched, share.farthest
    find_parents(size, parent)
    for i in range(len(size)):
        # the last entry with a sample is its leaf
        if sample[i] < len(leaf_of):
            leaf_of[sample[i]] = i
        share.added[i], farthest[i] = 0, -1.0
    for q in own:
        leaf = leaf_of[parents[q]]
        d = np.sqrt(_squared(points[q], spheres[leaf]))
        new.entry[q], new.distance[q], farthest[leaf] = leaf, d, max(farthest[leaf], d)
    for i in range(len(size)):
        above = watched[parent[i]] if i else NONE
        is_parent = size[i] > 1 and sample[i] < len(leaf_of)
        watched[i] = i if is_parent and spheres[i, 3] <= farthest[leaf_of[sample[i]]] else above
    for q in own:
        entry, d = new.entry[q], new.distance[q]
        if ordered:
            own_sample = sample[entry]
            while spheres[entry, 3] <= d and parent[entry] >= 0 and sample[parent[entry]] == own_sample:
                entry = parent[entry]
            up = watched[entry]
            while up >= 0:
                _reach(spheres[up], _squared(points[q], spheres[up]))
                up = watched[parent[up]] if up else NONE
        new.entry[q], new.rank[q] = entry, share.added[entry]
        share.added[entry] += 1


@query_kernel
def _reach(sphere, d2):
    if d2 > sphere[3] * sphere[3]:
        sphere[3] = max(sphere[3], np.sqrt(d2))


@query_kernel
def _grow(size, share, own, points, new):
    """Grow all spheres by the new points below them, which are contiguous in the order of their entries."""
    spheres, before = share.spheres, share.new_before
    x, y, z = new.x, new.y, new.z
    count = 0
    for i in range(len(size)):
        before[i] = count
        count += share.added[i]
    before[len(size)] = count
    for q in own:
        at = before[new.entry[q]] + new.rank[q]
        x[at], y[at], z[at] = points[q, 0], points[q, 1], points[q, 2]
    for i in range(len(size)):
        j, end, p = before[i], before[i + size[i]], spheres[i]
        px, py, pz = p[0], p[1], p[2]
        a = b = c = d = 0.0
        # four independent maxima, as each waits for the one before
        while j + 4 <= end:
            a = max(a, (x[j] - px) ** 2 + (y[j] - py) ** 2 + (z[j] - pz) ** 2)
            b = max(b, (x[j + 1] - px) ** 2 + (y[j + 1] - py) ** 2 + (z[j + 1] - pz) ** 2)
            c = max(c, (x[j + 2] - px) ** 2 + (y[j + 2] - py) ** 2 + (z[j + 2] - pz) ** 2)
            d = max(d, (x[j + 3] - px) ** 2 + (y[j + 3] - py) ** 2 + (z[j + 3] - pz) ** 2)
            j += 4
        while j < end:
            a = max(a, (x[j] - px) ** 2 + (y[j] - py) ** 2 + (z[j] - pz) ** 2)
            j += 1
        _reach(p, max(a, b, c, d))


@query_kernel
def _make_room(size, share):
    """Compute the output rows with the new leaves behind the children of their entries; returns the rows added.

    A leaf that gets children becomes an inner node above a leaf of its own point. Of several subtrees that end at one
    entry the inner ones come first.
    """
    n, shift = len(size), share.shift
    for i in range(n + 1):
        shift[i] = 0
    for i in range(n - 1, -1, -1):
        end, added = i + size[i], share.added[i]
        share.closing[i] = shift[end]
        shift[end] += added + (added > 0 and size[i] == 1)
    rows = surface = 0
    for i in range(n):
        rows += shift[i]
        shift[i] = rows
        share.surface_before[i] = surface
        surface += share.on_surface[i]
    share.surface_before[n] = surface
    return rows + shift[n]


@query_kernel
def _write(size, share, own, added_points, new, out):
    """Write the share's entries and its `own` new points to the first rows of `out`."""
    before = share.surface_before
    for i in range(len(size)):
        end, added, at = i + size[i], share.added[i], i + share.shift[i]
        share.start[i] = end + share.shift[end - 1] + share.closing[i] + (added > 0 and size[i] == 1)
        rows = share.start[i] + added - at
        p, own_mark = share.spheres[i], OWN_SAMPLE if share.on_surface[i] else NONE_BELOW
        # new points are on the surface
        mark = 0 if own_mark == NONE_BELOW and (before[end] > before[i] or rows > size[i]) else own_mark
        _write_entry(out, at, p, p[3], (rows, share.sample[i], mark))
        # the new leaf of a leaf that becomes an inner node; for other entries the next row overwrites it
        _write_entry(out, at + 1, p, 0.0, (1, share.sample[i], own_mark))
    for q in own:
        p, at = added_points.points[q], share.start[new.entry[q]] + new.rank[q]
        _write_entry(out, at, p, 0.0, (1, added_points.samples[q], OWN_SAMPLE))


@query_kernel
def _write_entry(out, at, center, radius, entry):
    """Write a sphere (centre, radius) [m] and its `entry` (size, sample, mark) to row `at` of TreeArrays."""
    s, e = out.spheres[at], out.entries[at]
    s[0], s[1], s[2], s[3] = center[0], center[1], center[2], radius
    e[SIZE], e[SAMPLE], e[SURFACE] = entry
