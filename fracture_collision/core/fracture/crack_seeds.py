"""Crack seeds: a few crossings per pair, far apart on the shared crack, where two fragments of a body touch in place.

A cut edge gives both its fragments a sample at its crossing (Glondu 2014, 6.3), so in place these touch. Two fragments
that have moved by at most epsilon relative to each other cannot be deeper: only the requested contacts remain to be
found, and testing the seeds first, where contacts are most likely, replaces a search.
"""

from __future__ import annotations

import numpy as np

from fracture_collision import grouping
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.mesh.cut_tetrahedron import point_on_edge

# Crossings kept per pair. More find contacts where only a small part of a crack still touches; each costs one useless
# query in a pair that does not touch.
MOST_SEEDS = 32
# Seeds are chosen farthest first from this many evenly spaced crossings.
CANDIDATES = 48

_grouped = kernel(grouping.grouped)


@query_kernel
def seed_key(a, b):
    """Key of SeedPool for two rows of FragmentPool, in any order: int64 smaller row << 32 | larger row."""
    return np.int64(min(a, b)) << np.int64(32) | np.int64(max(a, b))


@query_kernel
def find_seeds(fragment, seeds, a, b):
    """(first row of SeedPool.edges, end row) of two fragments of one body; an empty range if they share no crack."""
    key = seed_key(a, b)
    begin, end = fragment.seeds[a, 0], fragment.seeds[a, 1]
    while begin < end:
        middle = (begin + end) // 2
        if seeds.keys[middle] < key:
            begin = middle + 1
        else:
            end = middle
    if begin < fragment.seeds[a, 1] and seeds.keys[begin] == key:
        return seeds.ranges[begin, 0], seeds.ranges[begin, 1]
    return 0, 0


@kernel
def choose_seeds(pools, broken, edges, cut_tetrahedra, first_key, first_seed):
    """The body's rows of SeedPool after a fragment broke, from rows `first_key` and `first_seed` on.

    Rows of pairs without the broken fragment are kept; pairs that share edges of `cut_tetrahedra` (n,) get new ones.
    pools: mesh, body, fragment and seeds are used, with labels and crossings as after the fracture; broken: a Broken;
    edges: number of the mesh's edges. Writes FragmentPool.seeds of all fragments with rows. Returns (keys, ranges,
    edges).
    """
    mesh, body, fragment, seeds = pools.mesh, pools.body, pools.fragment, pools.seeds
    parent, first_edge = broken.parent, mesh.first[broken.mesh, 1]
    own = first_edge, first_edge + edges
    new_keys, new_ranges, chosen = _choose_seeds(mesh, body, broken, own, cut_tetrahedra, first_seed)
    begin, end = fragment.seeds[parent, 0], fragment.seeds[parent, 1]
    room = end - begin + len(new_keys)
    keys, ranges, used, new = np.empty(room, np.int64), np.empty((room, 2), np.int32), 0, 0
    for known in range(begin, end + 1):
        # merge: both lists are sorted
        while new < len(new_keys) and (known == end or new_keys[new] < seeds.keys[known]):
            keys[used], ranges[used, 0], ranges[used, 1] = new_keys[new], new_ranges[new, 0], new_ranges[new, 1]
            used, new = used + 1, new + 1
        if known < end and seeds.keys[known] >> 32 != parent and seeds.keys[known] & 0xFFFFFFFF != parent:
            keys[used] = seeds.keys[known]
            ranges[used, 0], ranges[used, 1] = seeds.ranges[known, 0], seeds.ranges[known, 1]
            used += 1
    for i in range(used):
        for f in (keys[i] >> 32, keys[i] & 0xFFFFFFFF):
            fragment.seeds[f, 0], fragment.seeds[f, 1] = first_key, first_key + used
    return keys[:used], ranges[:used], chosen


@kernel
def _choose_seeds(mesh, body, broken, own, cut_tetrahedra, first_seed):
    """choose_seeds for the new pairs alone: returns (sorted keys, ranges, edges).

    own: first row and end row of the mesh's edges in the pool.
    """
    edge_shift = broken.edge_shift
    cut, low, high = _cut_edges(mesh, body, broken, own, cut_tetrahedra)
    # order by the smaller label, then the larger: stable sorts, the larger label first
    labels = max(high - low, 0) + 1
    order, _ = _grouped(cut[:, 2] - low, labels)
    order = order[_grouped(cut[order, 1] - low, labels)[0]]
    keys, ranges = np.empty(len(cut), np.int64), np.empty((len(cut), 2), np.int32)
    edges = np.empty(len(cut), np.int32)
    points, near, work = np.empty((3, CANDIDATES)), np.empty(CANDIDATES), np.empty(3)
    chosen = np.empty(CANDIDATES, np.int32)
    pairs, used, begin = 0, 0, 0
    while begin < len(cut):
        first, end = order[begin], begin + 1
        while end < len(cut) and cut[order[end], 1] == cut[first, 1] and cut[order[end], 2] == cut[first, 2]:
            end += 1
        count = min(end - begin, CANDIDATES)
        for k in range(count):
            e = cut[order[begin + k * (end - begin) // count], 0]
            chosen[k] = e
            point_on_edge(mesh.nodes, mesh.edges[e, 0], mesh.edges[e, 1], body.edge_share[e + edge_shift], work)
            points[0, k], points[1, k], points[2, k] = work[0], work[1], work[2]
        keys[pairs] = seed_key(cut[first, 1], cut[first, 2])
        ranges[pairs, 0], ranges[pairs, 1] = first_seed + used, first_seed + used + min(count, MOST_SEEDS)
        used = _farthest_first(points, near, chosen, count, edges, used)
        pairs, begin = pairs + 1, end
    return keys[:pairs], ranges[:pairs], edges[:used]


@kernel
def _cut_edges(mesh, body, broken, own, cut_tetrahedra):
    """Cut edges of tetrahedra with an end in a new fragment, and the labels of their ends.

    Returns (cut (n, 3) int32: edge, ascending, smaller label, larger label; least label; largest label).
    """
    first_edge, last_edge = own
    node_shift, edge_shift = broken.node_shift, broken.edge_shift
    words = np.zeros((last_edge - first_edge + 63) // 64, np.uint64)  # a bit per edge, as edges occur several times
    for t in cut_tetrahedra:
        for k in range(6):
            e = mesh.tetrahedron_edges[t, k]
            if body.edge_plane[e + edge_shift] >= 0:
                words[(e - first_edge) >> 6] |= np.uint64(1) << np.uint64((e - first_edge) & 63)
    cut, count = np.empty((min(6 * len(cut_tetrahedra), last_edge - first_edge), 3), np.int32), 0
    low, high = np.iinfo(np.int32).max, -1
    for w in range(len(words)):
        if words[w] == 0:
            continue
        for bit in range(64):
            if not (words[w] >> np.uint64(bit)) & np.uint64(1):
                continue
            e = first_edge + 64 * w + bit
            a = body.node_fragment[mesh.edges[e, 0] + node_shift]
            b = body.node_fragment[mesh.edges[e, 1] + node_shift]
            if max(a, b) < broken.first:
                continue
            cut[count, 0], cut[count, 1], cut[count, 2] = e, min(a, b), max(a, b)
            low, high = min(low, a, b), max(high, a, b)
            count += 1
    return cut[:count], low, high


@query_kernel
def _farthest_first(points, near, chosen, count, edges, used):
    """Append at most MOST_SEEDS of `chosen` (count,), at points (3, .) [m], to `edges`; returns the end row."""
    x, y, z = points[0], points[1], points[2]
    mx = my = mz = 0.0
    for k in range(count):
        mx, my, mz = mx + x[k], my + y[k], mz + z[k]
    # the first is the one farthest from the mean
    px, py, pz = mx / count, my / count, mz / count
    for k in range(count):
        near[k] = np.inf
    for taken in range(min(count, MOST_SEEDS)):
        farthest, last = -1.0, 0
        for k in range(count):
            dx, dy, dz = x[k] - px, y[k] - py, z[k] - pz
            near[k] = min(near[k], dx * dx + dy * dy + dz * dz)
        for k in range(count):
            if near[k] > farthest:
                farthest, last = near[k], k
        edges[used + taken] = chosen[last]
        px, py, pz = x[last], y[last], z[last]
        if taken == 0:
            for k in range(count):
                near[k] = np.inf
        near[last] = -1.0
    return used + min(count, MOST_SEEDS)
