"""Compare fracture events with the mesh, edge by edge: each check of fracture_gate.py in one pass."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.mesh.tet_mesh import TetMesh

# Problems that match_cuts reports. Its row is an edge of the mesh for DOUBLED, EXTRA, MISSING, else a message entry.
FINE, NO_EDGE, DOUBLED, EXTRA, MISSING, MISSED = 0, 1, 2, 3, 4, 5


class CutRecord(NamedTuple):
    """Result of match_cuts for a message with k cut edges and a mesh of n nodes."""

    order: np.ndarray  # (k,) int64: the entries of the message, ascending by the mesh edges they cut
    edges: np.ndarray  # (k,) int32 these edges
    planes: np.ndarray  # (k, 4) their planes, from the edge's first node in the mesh to its second
    pinched: np.ndarray  # (n,) uint8: a plane passes through the node, or next to it


def first_split(edges: np.ndarray, edges_begin: np.ndarray, part_of_node: np.ndarray, count: int) -> tuple[int, int]:
    """The first part that is not connected, -1 if there is none, and the number of edges that join two parts.

    A part, of 0 .. count - 1, is connected if edges between its own nodes join them all.

    edges (e, 2), edges_begin (n + 1,): as in TetMesh; part_of_node (n,), -1: of no part.
    """
    nodes = np.flatnonzero(part_of_node >= 0)
    root = np.arange(len(part_of_node), dtype=np.int32)
    return _first_split(edges, edges_begin, nodes, part_of_node, root, np.zeros(count, np.int64))


@query_kernel
def _first_split(edges, edges_begin, nodes, part_of_node, root, pieces):
    """Disjoint sets, each under its smallest node: root (n,), each node's own number; pieces (count,): zeros."""
    between = 0
    for n in nodes:
        p = part_of_node[n]
        for e in range(edges_begin[n], edges_begin[n + 1]):
            a, b = edges[e, 0], edges[e, 1]
            q = part_of_node[b]
            between += (p != q) & (q >= 0)
            # most edges join nodes that share a root already
            if (root[a] == root[b]) | (p != q):
                continue
            while root[a] != a:
                root[a] = root[root[a]]
                a = root[a]
            while root[b] != b:
                root[b] = root[root[b]]
                b = root[b]
            root[max(a, b)] = min(a, b)
    for n in nodes:
        if root[n] == n:
            pieces[part_of_node[n]] += 1
    for p in range(len(pieces)):
        if pieces[p] > 1:
            return p, between
    return -1, between


def match_cuts(
    mesh: TetMesh, part_of_node: np.ndarray, between: int, ends: np.ndarray, planes: np.ndarray, tolerance: float
) -> tuple[int, int, CutRecord]:
    """Compare the cut edges of a message with the mesh: (problem, row, record).

    part_of_node (n,): -1 where nothing breaks; `between`: number of edges that join two parts; ends (k, 2), planes
    (k, 4): as in the message; `tolerance`: how far beyond an edge's end its plane may pass, as a share of the edge; a
    plane no farther than this from a node pinches it.
    """
    k = len(ends)
    found = CutRecord(
        np.arange(k), np.empty(k, np.int32), np.empty((k, 4)), np.zeros(len(mesh.nodes), np.uint8)
    )  # fmt: skip
    row, in_order = _find_edges(mesh.edges, mesh.edges_begin, ends, found.edges)
    if row >= 0:
        return NO_EDGE, row, found
    # `between` distinct edges that all join two parts are exactly the edges to cut
    if not in_order or k != between or not _all_between(mesh.edges, part_of_node, found.edges):
        found.order[:] = np.argsort(found.edges, kind="stable")
        found.edges[:] = found.edges[found.order]
        problem, row = _compare(mesh.edges, part_of_node, found.edges)
        if problem != FINE:
            return problem, row, found
    row = _turn_planes(mesh.nodes, mesh.edges, ends, planes, tolerance, found)
    return (FINE if row < 0 else MISSED), row, found


@query_kernel
def _find_edges(edges, edges_begin, ends, found):
    """Fill `found`; (the first entry that is no edge, or -1; whether the edges `found` ascend)."""
    in_order, before = True, -1
    for i in range(len(ends)):
        a, b = min(ends[i, 0], ends[i, 1]), max(ends[i, 0], ends[i, 1])
        at, last = edges_begin[a], edges_begin[a + 1]
        while at < last and edges[at, 1] != b:
            at += 1
        if at == last:
            return i, False
        found[i] = at
        in_order = in_order and at > before
        before = at
    return -1, in_order


@query_kernel
def _is_between(edges, part_of_node, e):
    p, q = part_of_node[edges[e, 0]], part_of_node[edges[e, 1]]
    return (p != q) & (p >= 0) & (q >= 0)


@query_kernel
def _all_between(edges, part_of_node, cut):
    count = 0
    for e in cut:
        count += _is_between(edges, part_of_node, e)
    return count == len(cut)


@query_kernel
def _compare(edges, part_of_node, cut):
    """(problem, edge): how the edges `cut`, ascending, differ from those between parts."""
    for i in range(1, len(cut)):
        if cut[i] == cut[i - 1]:
            return DOUBLED, cut[i]
    missing, i = -1, 0
    for e in range(len(edges)):
        is_cut = i < len(cut) and cut[i] == e
        must = _is_between(edges, part_of_node, e)
        if is_cut and not must:
            return EXTRA, e
        if must and not is_cut and missing < 0:
            missing = e
        i += is_cut
    return (FINE, -1) if missing < 0 else (MISSING, missing)


@query_kernel
def _turn_planes(nodes, edges, ends, planes, tolerance, found):
    """Fill planes and pinched; return the first entry whose plane misses its edge, or -1."""
    missed = len(ends)
    for c in range(len(ends)):
        e, i = found.edges[c], found.order[c]
        p, a, b = planes[i], ends[i, 0], ends[i, 1]
        at_a = p[0] * nodes[a, 0] + p[1] * nodes[a, 1] + p[2] * nodes[a, 2] - p[3]
        at_b = p[0] * nodes[b, 0] + p[1] * nodes[b, 1] + p[2] * nodes[b, 2] - p[3]
        dx, dy, dz = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1], nodes[b, 2] - nodes[a, 2]
        slack = tolerance * math.sqrt(dx * dx + dy * dy + dz * dz)
        # `not ... >`: a NaN difference counts as missed too
        if at_a > slack or at_b < -slack or not at_b - at_a > 0.0:
            missed = min(missed, i)
        found.pinched[a] |= at_a >= -slack
        found.pinched[b] |= at_b <= slack
        sign = 1.0 if a == edges[e, 0] else -1.0
        turned = found.planes[c]
        turned[0], turned[1], turned[2], turned[3] = sign * p[0], sign * p[1], sign * p[2], sign * p[3]
    return missed if missed < len(ends) else -1


@query_kernel
def first_crooked(planes, tolerance):
    """The first of planes (k, 4) whose normal is not of length 1, to `tolerance`; -1 if there is none."""
    for i in range(len(planes)):
        x, y, z = planes[i, 0], planes[i, 1], planes[i, 2]
        if abs(math.sqrt(x * x + y * y + z * z) - 1.0) > tolerance:
            return i
    return -1
