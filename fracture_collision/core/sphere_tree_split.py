"""Splitting, restructuring and extending a sphere tree at a fracture: Glondu 2014, sections 6.2 and 6.3.

Split: a node whose descendants belong to several fragments is replicated once for each; a copy with a single child is
left out. Restructure: a copy that lost its point takes the point of its subtree that is closest to the old one, and so
do all nodes between. Extend: a new surface point goes under the mesh node at its own end of the cut edge, at the lowest
node of that point's branch whose radius still exceeds their distance, else at the highest.

Without regard to the order (the paper's earlier version, its reference [27]): a copy that lost its point takes the
first one that it finds, a new surface point goes under the leaf at its own end of the cut edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import kernel
from fracture_collision.core.sphere_tree import SphereTree, update_radii

BATCH = 64  # fragments handled at a time: one bit each of an unsigned 64-bit mask


@kernel
def _presence(size, leaf_fragment, low, mask):
    """Bottom-up: which of the fragments low .. low + 63 each entry's subtree holds, a bit each."""
    one = np.uint64(1)
    for i in range(len(size) - 1, -1, -1):
        bits = np.uint64(0)
        if size[i] == 1:
            k = leaf_fragment[i] - low
            if 0 <= k < 64:
                bits = one << np.uint64(k)
        else:
            child = i + 1
            while child < i + size[i]:
                bits |= mask[child]
                child += size[child]
        mask[i] = bits


@kernel
def _extract(size, mask, bit, kept, new_size):
    """Preorder of one fragment's tree: `kept` gets the old entries, `new_size` their sizes; returns how many."""
    stack = np.empty(2 * len(size) + 2, dtype=np.int32)  # >= 0: an old entry to visit; < 0: ~ the new entry to close
    stack[0] = 0
    top, used = 0, 0
    if (mask[0] & bit) == 0:
        return 0
    while top >= 0:
        item = stack[top]
        top -= 1
        if item < 0:
            new_size[~item] = used - ~item
            continue
        # walk down through copies with a single child
        while True:
            children, only, child = 0, -1, item + 1
            while child < item + size[item]:
                if mask[child] & bit:
                    children += 1
                    only = child
                child += size[child]
            if children != 1:
                break
            item = only
        kept[used] = item
        if children == 0:
            new_size[used] = 1
            used += 1
            continue
        top += 1
        stack[top] = ~used
        used += 1
        slot = top + children
        top = slot
        child = item + 1
        while child < item + size[item]:
            if mask[child] & bit:
                stack[slot] = child
                slot -= 1
            child += size[child]
    return used


@kernel
def _restructure(center, size, sample, on_surface, lost, stale):
    """Give each entry that lost its point the closest one below it, and the same to all entries in between."""
    for i in range(len(size)):
        if not lost[i]:
            continue
        best, best_d2 = -1, np.inf
        for j in range(i + 1, i + size[i]):
            if size[j] == 1:
                dx, dy, dz = center[j, 0] - center[i, 0], center[j, 1] - center[i, 1], center[j, 2] - center[i, 2]
                d2 = dx * dx + dy * dy + dz * dz
                if d2 < best_d2:
                    best, best_d2 = j, d2
        entry = i
        while entry != best:
            center[entry] = center[best]
            sample[entry] = sample[best]
            on_surface[entry] = on_surface[best]
            lost[entry] = 0
            stale[entry] = 1
            child = entry + 1
            while child + size[child] <= best:
                child += size[child]
            entry = child


@kernel
def _take_first_points(center, size, sample, on_surface, lost, stale):
    """Give each entry that lost its point that of its first child."""
    for i in range(len(size) - 1, -1, -1):
        if lost[i]:
            center[i] = center[i + 1]
            sample[i] = sample[i + 1]
            on_surface[i] = on_surface[i + 1]
            stale[i] = 1


@kernel
def _insert(center, size, sample, radius, parent, leaf_of, new_points, new_parents, ordered, first_new, next_new):
    """Choose each new point's place and grow the spheres above it; fills linked lists first_new / next_new."""
    last_new = np.full(len(size), -1, dtype=np.int32)
    for q in range(len(new_points)):
        leaf = leaf_of[new_parents[q]]
        x, y, z = new_points[q]
        dx, dy, dz = x - center[leaf, 0], y - center[leaf, 1], z - center[leaf, 2]
        d = np.sqrt(dx * dx + dy * dy + dz * dz)
        entry = leaf
        while ordered and radius[entry] <= d and parent[entry] >= 0 and sample[parent[entry]] == sample[leaf]:
            entry = parent[entry]
        if first_new[entry] < 0:
            first_new[entry] = q
        else:
            next_new[last_new[entry]] = q
        last_new[entry] = q
        while entry >= 0:
            dx, dy, dz = x - center[entry, 0], y - center[entry, 1], z - center[entry, 2]
            d2 = dx * dx + dy * dy + dz * dz
            if d2 > radius[entry] * radius[entry]:
                radius[entry] = max(radius[entry], np.sqrt(d2))
            entry = parent[entry]


@kernel
def _parents(size, parent):
    parent[0] = -1
    for i in range(len(size)):
        child = i + 1
        while child < i + size[i]:
            parent[child] = i
            child += size[child]


@kernel
def _merge(old, first_new, next_new, new_points, new_samples, out):
    """Preorder of the old entries with the new leaves behind the children of their entries; returns the length.

    A leaf that gets children becomes an inner node above a leaf of its own point.
    """
    center, radius, size, sample, on_surface = old
    out_center, out_radius, out_size, out_sample, out_surface = out
    n = len(size)
    open_entry = np.empty(n + 1, dtype=np.int32)  # old entries whose subtree is being written
    written_at = np.empty(n + 1, dtype=np.int32)
    depth, used = 0, 0
    for i in range(n + 1):
        # close what ended before i, innermost first: its new leaves, then its size
        while depth and (i == n or i >= open_entry[depth - 1] + size[open_entry[depth - 1]]):
            depth -= 1
            e, w = open_entry[depth], written_at[depth]
            q = first_new[e]
            while q >= 0:
                for k in range(3):
                    out_center[used, k] = new_points[q, k]
                out_radius[used], out_size[used] = 0.0, 1
                out_sample[used], out_surface[used] = new_samples[q], 1
                used += 1
                q = next_new[q]
            out_size[w] = used - w
        if i == n:
            break
        for _ in range(2 if size[i] == 1 and first_new[i] >= 0 else 1):
            for k in range(3):
                out_center[used, k] = center[i, k]
            out_radius[used] = 0.0
            out_size[used] = 1
            out_sample[used], out_surface[used] = sample[i], on_surface[i]
            used += 1
        at = used - (2 if size[i] == 1 and first_new[i] >= 0 else 1)
        out_radius[at] = radius[i]
        open_entry[depth], written_at[depth] = i, at
        depth += 1
    return used


@kernel
def _take(center, radius, size, sample, on_surface, leaf_fragment, kept, new_size, fragment, ordered):
    """Copy the kept entries into a tree of their own, each with a point below it; radii exact."""
    n = len(kept)
    c = np.empty((n, 3))
    r = np.empty(n)
    s = np.empty(n, dtype=np.int32)
    surface = np.empty(n, dtype=np.uint8)
    lost = np.zeros(n, dtype=np.uint8)
    stale = np.zeros(n, dtype=np.uint8)
    for i in range(n):
        o = kept[i]
        for k in range(3):
            c[i, k] = center[o, k]
        r[i], s[i], surface[i] = radius[o], sample[o], on_surface[o]
        # a smaller subtree than before: descendants are missing
        stale[i] = 1 if new_size[i] != size[o] else 0
        lost[i] = 1 if leaf_fragment[o] != fragment else 0
    if ordered:
        _restructure(c, new_size, s, surface, lost, stale)
    else:
        _take_first_points(c, new_size, s, surface, lost, stale)
    update_radii(c, new_size, r, stale)
    return c, r, s, surface


class Forest(NamedTuple):
    """Trees one behind the other: fragment f's are entries begin[f] .. begin[f + 1] - 1."""

    trees: SphereTree
    begin: np.ndarray  # (fragments + 1,) int64


@kernel
def split_sphere_tree(
    tree, fragment_of_sample, fragments, new_points, new_samples, new_parents, new_fragments, ordered
):
    """A Forest of one tree a fragment, 0 .. fragments - 1, from the tree of the fragment that broke.

    fragment_of_sample: (entries,) int32, fragment of each entry's point; moved: some centres are
    not where the radii were computed. The new surface points: `new_points` (q, 3)
    [m], their sample indices, the samples of the mesh nodes they hang under, and their fragments (q,), int32. ordered:
    keep to the maximum-distance order.
    """
    n, leaves, most = len(tree.size), 0, 0
    for i in range(n):
        leaves += 1 if tree.size[i] == 1 else 0
        most = max(most, tree.sample[i])
    for q in range(len(new_points)):
        most = max(most, new_parents[q])
    # a tree has fewer inner nodes than leaves; a new point adds a leaf, and may make one of another leaf's point
    room = 2 * (leaves + len(new_points))
    forest = Forest(
        SphereTree(
            np.empty((room, 3)), np.empty(room), np.empty(room, np.int32), np.empty(room, np.int32),
            np.empty(room, np.uint8),
        ),
        np.zeros(fragments + 1, np.int64),
    )  # fmt: skip
    mask = np.zeros(n, np.uint64)
    kept, new_size = np.empty(n, np.int32), np.empty(n, np.int32)
    leaf_of = np.full(most + 1, -1, np.int32)
    by_fragment, bounds = _grouped(new_fragments, fragments)
    used = 0
    for fragment in range(fragments):
        if fragment % BATCH == 0:
            _presence(tree.size, fragment_of_sample, fragment, mask)
        count = _extract(tree.size, mask, np.uint64(1) << np.uint64(fragment % BATCH), kept, new_size)
        size = new_size[:count].copy()
        center, radius, sample, surface = _take(
            tree.center, tree.radius, tree.size, tree.sample, tree.on_surface, fragment_of_sample, kept[:count],
            size, fragment, ordered,
        )  # fmt: skip
        old = SphereTree(center, radius, size, sample, surface)
        own = by_fragment[bounds[fragment] : bounds[fragment + 1]]
        used += _extend(
            old, leaf_of, new_points[own], new_samples[own], new_parents[own], ordered, _from(forest.trees, used)
        )
        forest.begin[fragment + 1] = used
    return Forest(_upto(forest.trees, used), forest.begin)


@kernel
def _grouped(groups, count):
    """Indices by group 0 .. count - 1, ascending within each, and where each group begins (count + 1,)."""
    bounds = np.zeros(count + 1, np.int64)
    for g in groups:
        bounds[g + 1] += 1
    bounds = np.cumsum(bounds)
    at = bounds[:-1].copy()
    order = np.empty(len(groups), np.int64)
    for q in range(len(groups)):
        order[at[groups[q]]] = q
        at[groups[q]] += 1
    return order, bounds


@kernel
def _from(tree, first):
    return SphereTree(
        tree.center[first:], tree.radius[first:], tree.size[first:], tree.sample[first:], tree.on_surface[first:]
    )


@kernel
def _upto(tree, last):
    return SphereTree(
        tree.center[:last], tree.radius[:last], tree.size[:last], tree.sample[:last], tree.on_surface[:last]
    )


@kernel
def _extend(tree, leaf_of, points, samples, parents, ordered, out):
    """Write the tree with its new points to the first entries of `out`; returns how many. leaf_of: working space."""
    n = len(tree.size)
    parent = np.empty(n, np.int32)
    _parents(tree.size, parent)
    for i in range(n):
        if tree.size[i] == 1:
            leaf_of[tree.sample[i]] = i
    first_new, next_new = np.full(n, -1, np.int32), np.full(len(points), -1, np.int32)
    _insert(
        tree.center, tree.size, tree.sample, tree.radius, parent, leaf_of, points, parents, ordered, first_new, next_new
    )
    return _merge(tree, first_new, next_new, points, samples, out)
