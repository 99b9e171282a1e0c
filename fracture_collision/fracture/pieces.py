"""Pieces into which seeds divide the nodes of a fragment, and the edges this cuts: the loops of `pattern`.

Nodes and edges are those of the fragment, numbered within it.
"""

from __future__ import annotations

import numpy as np

from fracture_collision import grouping, portable_math
from fracture_collision.kernel_sources import cached_njit

_root_of = cached_njit(grouping.root_of)
_sine_after = cached_njit(portable_math.sine_after)
# Halvings of an edge, after which a crossing is known to a millionth of a millionth of it.
HALVINGS = 40


@cached_njit
def inside_fragment(node_fragments, edges, fragment_id):
    """The fragment's nodes (k,) int64, ascending, and its inner edges (i, 2) int64 as indices into these."""
    place = np.full(node_fragments.size, -1)
    nodes, count = np.empty(node_fragments.size, np.int64), 0
    for node in range(node_fragments.size):
        if node_fragments[node] == fragment_id:
            nodes[count], place[node] = node, count
            count += 1
    inside, edge_count = np.empty((len(edges), 2), np.int64), 0
    for e in range(len(edges)):
        a, b = place[edges[e, 0]], place[edges[e, 1]]
        if a >= 0 and b >= 0:
            inside[edge_count, 0], inside[edge_count, 1] = a, b
            edge_count += 1
    return nodes[:count].copy(), inside[:edge_count].copy()


@cached_njit
def edge_lengths(points, edges):
    """Lengths (e,) [m] of the edges."""
    lengths = np.empty(len(edges))
    for e in range(len(edges)):
        lengths[e] = np.sqrt(_squared_distance(points[edges[e, 0]], points[edges[e, 1]]))
    return lengths


@cached_njit
def nearest_seeds(points, seeds):
    """Index of the seed (s, 3) nearest to each point (k, 3), the lowest of several: (k,) int64."""
    nearest = np.zeros(len(points), np.int64)
    for i in range(len(points)):
        least = np.inf
        for s in range(len(seeds)):
            square = _squared_distance(points[i], seeds[s])
            if square < least:
                least, nearest[i] = square, s
    return nearest


@cached_njit
def connected_pieces(labels, edges, minimum_nodes):
    """Connected pieces of equal label, the small ones joined to neighbours: (k,) int64, numbered by their first nodes.

    Returns the pieces, their count, and the edges between two of them (c, 2).
    """
    root = np.arange(labels.size)
    between, between_count = np.empty_like(edges), 0
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        if labels[a] == labels[b]:
            a, b = _root_of(root, a), _root_of(root, b)
            root[max(a, b)] = min(a, b)
        else:
            between[between_count, 0], between[between_count, 1] = a, b
            between_count += 1
    pieces = np.empty(labels.size, np.int64)
    for i in range(labels.size):
        pieces[i] = _root_of(root, i)
    count = _number_by_first(pieces)
    between = between[:between_count]
    _join_small(pieces, count, between, minimum_nodes)
    count, cut_count = _number_by_first(pieces), 0
    for e in range(between_count):
        if pieces[between[e, 0]] != pieces[between[e, 1]]:
            between[cut_count] = between[e]
            cut_count += 1
    return pieces, count, between[:cut_count].copy()


@cached_njit
def seed_pairs(labels, cut, seed_count):
    """Pairs of seeds (p, 2) on both sides of cut edges (c, 2), ascending, and each edge's row among them (c,)."""
    row_of = np.full(seed_count * seed_count, -1)
    for e in range(len(cut)):
        row_of[labels[cut[e, 0]] * seed_count + labels[cut[e, 1]]] = 0
    pairs, count = np.empty((min(len(cut), row_of.size), 2), np.int64), 0
    for key in range(row_of.size):
        if row_of[key] == 0:
            pairs[count, 0], pairs[count, 1], row_of[key] = key // seed_count, key % seed_count, count
            count += 1
    rows = np.empty(len(cut), np.int64)
    for e in range(len(cut)):
        rows[e] = row_of[labels[cut[e, 0]] * seed_count + labels[cut[e, 1]]]
    return pairs[:count].copy(), rows


@cached_njit
def range_between(sides, rows, count):
    """For each of `count` pairs the highest first end and the lowest second end of its edges; sides (c, 2) [m]."""
    highest, lowest = np.full(count, -np.inf), np.full(count, np.inf)
    for e in range(len(rows)):
        highest[rows[e]] = max(highest[rows[e]], sides[e, 0])
        lowest[rows[e]] = min(lowest[rows[e]], sides[e, 1])
    return highest, lowest


@cached_njit
def warped(points, warp):
    """Images (k, 3) [m] of points (k, 3) [m] by three waves: each its amplitude (3) [m], its K (3) [1/m], its phase."""
    out = np.empty_like(points)
    for i in range(len(points)):
        out[i, 0], out[i, 1], out[i, 2] = _image(warp, (points[i, 0], points[i, 1], points[i, 2]))
    return out


@cached_njit
def bisector_crossings(start, way, s, t, warp):
    """Shares (c,) of edges at which they are as far from s as from t, where they are warped; see `warped`.

    start, way: (3, c) [m], one end, nearer to s, and from there to the other, nearer to t; s, t: (3, c) [m] warped
    seeds.
    """
    low, high = np.zeros(start.shape[1]), np.ones(start.shape[1])
    # without branches, all edges at once: several fit into one instruction
    for _ in range(HALVINGS):
        for e in range(len(low)):
            middle = 0.5 * (low[e] + high[e])
            place = start[0, e] + middle * way[0, e], start[1, e] + middle * way[1, e], start[2, e] + middle * way[2, e]
            x, y, z = _image(warp, place)
            from_s = (x - s[0, e]) * (x - s[0, e]) + (y - s[1, e]) * (y - s[1, e]) + (z - s[2, e]) * (z - s[2, e])
            from_t = (x - t[0, e]) * (x - t[0, e]) + (y - t[1, e]) * (y - t[1, e]) + (z - t[2, e]) * (z - t[2, e])
            low[e] = middle if from_s <= from_t else low[e]
            high[e] = high[e] if from_s <= from_t else middle
    return 0.5 * (low + high)


@cached_njit(inline="always")
def _image(warp, place):
    (x, y, z), (first, second, third) = place, warp
    u, v, w = _wave(first, x, y, z), _wave(second, x, y, z), _wave(third, x, y, z)
    return (
        x + (u * first[0] + v * second[0] + w * third[0]),
        y + (u * first[1] + v * second[1] + w * third[1]),
        z + (u * first[2] + v * second[2] + w * third[2]),
    )


@cached_njit(inline="always")
def _wave(wave, x, y, z):
    return _sine_after(x * wave[3] + y * wave[4] + z * wave[5] + wave[6], 0.0)


@cached_njit
def _squared_distance(a, b):
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return x * x + y * y + z * z


@cached_njit
def _number_by_first(pieces):
    """Renumber (k,) labels below k, 0 .. count - 1 in the order of their first nodes; returns the count."""
    number, count = np.full(pieces.size, -1), 0
    for i in range(pieces.size):
        if number[pieces[i]] < 0:
            number[pieces[i]] = count
            count += 1
        pieces[i] = number[pieces[i]]
    return count


@cached_njit
def _join_small(pieces, count, between, minimum_nodes):
    """Join the smallest piece below `minimum_nodes` to the neighbour with most shared edges, until none is left."""
    sizes = np.bincount(pieces, minlength=count)
    is_alone, shared = np.zeros(count, np.bool_), np.empty(count, np.int64)
    while True:
        smallest = -1
        for piece in range(count):
            is_small = 0 < sizes[piece] < minimum_nodes and not is_alone[piece]
            if is_small and (smallest < 0 or sizes[piece] < sizes[smallest]):
                smallest = piece
        if smallest < 0:
            return
        shared[:] = 0
        for e in range(len(between)):
            a, b = pieces[between[e, 0]], pieces[between[e, 1]]
            if a != b and a == smallest:
                shared[b] += 1
            elif a != b and b == smallest:
                shared[a] += 1
        other = shared.argmax()
        if shared[other] == 0:
            is_alone[smallest] = True
            continue
        sizes[other] += sizes[smallest]
        sizes[smallest] = 0
        for i in range(pieces.size):
            if pieces[i] == smallest:
                pieces[i] = other
