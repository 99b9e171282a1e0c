"""Fracture events against the mesh, edge by edge: what the gate (fracture_gate.py) asks, answered in one pass each."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.compiled import kernel

# What match_cuts found wrong, and of what the row it gives is: an entry of the message or an edge of the mesh.
FINE, NO_EDGE, DOUBLED, EXTRA, MISSING, MISSED = 0, 1, 2, 3, 4, 5


@kernel
def first_split(edges, part_of_node, count):
    """The first of parts 0 .. count - 1 whose nodes no path of edges along its own nodes joins; -1 if there is none.

    edges (e, 2); part_of_node (n,), -1: of no part. Disjoint sets, each under its smallest node.
    """
    root = np.arange(len(part_of_node))
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        if part_of_node[a] < 0 or part_of_node[a] != part_of_node[b]:
            continue
        while root[a] != a:
            root[a] = root[root[a]]
            a = root[a]
        while root[b] != b:
            root[b] = root[root[b]]
            b = root[b]
        if a < b:
            root[b] = a
        else:
            root[a] = b
    pieces = np.zeros(count, np.int64)
    for n in range(len(part_of_node)):
        if part_of_node[n] >= 0 and root[n] == n:
            pieces[part_of_node[n]] += 1
    for p in range(count):
        if pieces[p] > 1:
            return p
    return -1


@kernel
def match_cuts(nodes, edges, edges_begin, part_of_node, ends, planes, tolerance):
    """Cut edges of a message against the mesh: (problem, row, edges (k,) ascending, planes (k, 4), room (n,) [m]).

    nodes (n, 3), edges (e, 2), edges_begin (n + 1,): the mesh's; part_of_node (n,): -1 where nothing breaks; ends
    (k, 2), planes (k, 4): as in the message; `tolerance`: how far beyond an edge's end its plane may pass, in parts of
    the edge. The planes returned point from the edge's first node in the mesh to its second. room: how far a node at
    least is from the farthest of the planes at its edges, minus infinity without any.
    """
    k = len(ends)
    entry = np.full(len(edges), -1, np.int32)
    found, turned, room = np.empty(k, np.int32), np.empty((k, 4)), np.full(len(nodes), -np.inf)
    doubled = -1
    for i in range(k):
        a, b = min(ends[i, 0], ends[i, 1]), max(ends[i, 0], ends[i, 1])
        at = -1
        for e in range(edges_begin[a], edges_begin[a + 1]):
            if edges[e, 1] == b:
                at = e
        if at < 0:
            return NO_EDGE, i, found, turned, room
        if entry[at] >= 0 and (doubled < 0 or at < doubled):
            doubled = at
        entry[at] = i
    if doubled >= 0:
        return DOUBLED, doubled, found, turned, room
    missing, used = -1, 0
    for e in range(len(edges)):
        p, q = part_of_node[edges[e, 0]], part_of_node[edges[e, 1]]
        must = p >= 0 and q >= 0 and p != q
        if entry[e] >= 0 and not must:
            return EXTRA, e, found, turned, room
        if must and entry[e] < 0 and missing < 0:
            missing = e
        if entry[e] >= 0:
            found[used] = e
            used += 1
    if missing >= 0:
        return MISSING, missing, found, turned, room
    for i in range(k):
        a, b, p = ends[i, 0], ends[i, 1], planes[i]
        at_a = p[0] * nodes[a, 0] + p[1] * nodes[a, 1] + p[2] * nodes[a, 2] - p[3]
        at_b = p[0] * nodes[b, 0] + p[1] * nodes[b, 1] + p[2] * nodes[b, 2] - p[3]
        dx, dy, dz = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1], nodes[b, 2] - nodes[a, 2]
        slack = tolerance * np.sqrt(dx * dx + dy * dy + dz * dz)
        # not <=: a difference that is no number has missed, too
        if at_a > slack or at_b < -slack or not at_b - at_a > 0.0:
            return MISSED, i, found, turned, room
        room[a], room[b] = max(room[a], -at_a - slack), max(room[b], at_b - slack)
    for i in range(k):
        e = found[i]
        sign = 1.0 if ends[entry[e], 0] == edges[e, 0] else -1.0
        for d in range(4):
            turned[i, d] = sign * planes[entry[e], d]
    return FINE, -1, found, turned, room
