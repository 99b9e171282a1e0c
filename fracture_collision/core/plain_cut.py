"""The common case at a fracture: a tetrahedron that one plane parts in two.

Where a crack is flat, nearly every tetrahedron it crosses holds two fragments, has the same plane at all its cut
edges, and no node in that. There the margin rule says which side of the plane a point is on, and polygons, moments and
crossings have closed forms. No step is possible in a face between two such tetrahedra, or beside one that a fragment
has alone: what cuts the face is the same on both sides of it. All others are cut_tetrahedron.py's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.closest_point import triangle_normal
from fracture_collision.core.compiled import inlined_kernel, kernel
from fracture_collision.core.cut_tetrahedron import EDGE_FIRST, EDGE_SECOND, FACE_VERTICES, INTERFACE
from fracture_collision.core.margin_clipping import TIE
from fracture_collision.core.moments import add_tetrahedron
from fracture_collision.core.surface_rows import (
    gap_of_triangle,
    grow,
    longest_side_squared,
    samples_in_tetrahedron,
    write_row,
)

# What a tetrahedron is to a fracture: of one fragment, parted by one plane, by the planes of cells (cell_cut.py), or
# anything else.
LONE, PLAIN, CELLS, MIXED = 1, 2, 3, 4
MAX_PLAIN_TRIANGLES = 14  # two between the fragments, three on each of four old faces
# Two tetrahedra compute the same crossing with different rounding.
ROUNDING = 1e-13


class PlainScratch(NamedTuple):
    """Working space: one tetrahedron as its plane parts it."""

    labels: np.ndarray  # (2,) int64: fragments below and above the plane, the smaller first
    plane: np.ndarray  # (4,) float64: unit normal from the first to the second, offset [m]
    heights: np.ndarray  # (4,) float64 [m] of the nodes above the plane
    order: np.ndarray  # (4,) int64: local nodes below, then those above
    points: np.ndarray  # (4, 3) float64 [m] where the plane crosses the edges, around the polygon
    sampled: np.ndarray  # (4, 2) uint8: whether that crossing is a sample of each fragment
    index: np.ndarray  # (4, 4) int64: row of `points` of the edge between two local nodes
    moments: np.ndarray  # (10,) float64 of one part


@kernel
def make_plain_scratch():
    return PlainScratch(
        np.zeros(2, np.int64), np.zeros(4), np.zeros(4), np.zeros(4, np.int64), np.zeros((4, 3)),
        np.zeros((4, 2), np.uint8), np.zeros((4, 4), np.int64), np.zeros(10),
    )  # fmt: skip


@inlined_kernel
def kind_of_cut(mesh, body, node_shift, edge_shift, t, work):
    """LONE, PLAIN or MIXED; fills labels, plane and heights of `work` (labels alone where it is LONE)."""
    nodes = mesh.tetrahedra[t]
    low = high = body.node_fragment[nodes[0] + node_shift]
    for i in range(1, 4):
        label = body.node_fragment[nodes[i] + node_shift]
        low, high = min(low, label), max(high, label)
    work.labels[0], work.labels[1] = low, high
    if low == high:
        return LONE
    for i in range(4):
        label = body.node_fragment[nodes[i] + node_shift]
        if label != low and label != high:
            return MIXED
    known = False
    plane = work.plane
    for e in range(6):
        edge = mesh.tetrahedron_edges[t, e]
        first = body.node_fragment[mesh.edges[edge, 0] + node_shift]
        if first == body.node_fragment[mesh.edges[edge, 1] + node_shift]:
            continue
        p = body.planes[body.edge_plane[edge + edge_shift]]
        sign = 1.0 if first == low else -1.0
        if not known:
            known = True
            for d in range(4):
                plane[d] = sign * p[d]
        elif plane[0] != sign * p[0] or plane[1] != sign * p[1] or plane[2] != sign * p[2] or plane[3] != sign * p[3]:
            return MIXED
    limit = 0.0
    for i in range(4):
        p = mesh.nodes[nodes[i]]
        limit = max(limit, abs(p[0]), abs(p[1]), abs(p[2]))
        work.heights[i] = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3]
    limit *= TIE
    for i in range(4):
        if abs(work.heights[i]) <= limit:
            return MIXED
        if (work.heights[i] > 0.0) != (body.node_fragment[nodes[i] + node_shift] == high):
            return MIXED
    return PLAIN


@inlined_kernel
def crossing(work, below, above):
    """Share of the edge between two local nodes that lies below the plane."""
    return work.heights[below] / (work.heights[below] - work.heights[above])


@inlined_kernel
def cut_edges(mesh, body, edge_shift, t, work):
    """The section's vertices in cyclic order, right-handed about the plane's normal: fills order, points, sampled and
    index; returns how many nodes are below, and how many vertices there are.
    """
    used = 0
    for upper in range(2):
        for i in range(4):
            if (work.heights[i] > 0.0) == (upper == 1):
                work.order[used] = i
                used += 1
        if upper == 0:
            below = used
    count = 4 if below == 2 else 3
    # tetrahedra are of positive volume: which way round the section runs follows from the order of its nodes
    for k in range(count):
        if below == 2:
            i, j = work.order[k // 2], work.order[2 + ((k + 1) // 2) % 2]
        elif below == 1:
            i, j = work.order[0], work.order[1 + k]
        else:
            i, j = work.order[k], work.order[3]
        _cross(mesh, body, edge_shift, t, i, j, k, work)
    a, b, c = work.points[0], work.points[1], work.points[2]
    nx, ny, nz = _cross_product(a, b, c)
    if nx * work.plane[0] + ny * work.plane[1] + nz * work.plane[2] < 0.0:
        first, last = (1, 3) if count == 4 else (1, 2)
        for d in range(3):
            work.points[first, d], work.points[last, d] = work.points[last, d], work.points[first, d]
        for d in range(2):
            work.sampled[first, d], work.sampled[last, d] = work.sampled[last, d], work.sampled[first, d]
        for i in range(4):
            for j in range(4):
                if work.index[i, j] == first:
                    work.index[i, j] = last
                elif work.index[i, j] == last:
                    work.index[i, j] = first
    return below, count


@inlined_kernel
def _cross_product(a, b, c):
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@inlined_kernel
def _cross(mesh, body, edge_shift, t, below, above, k, work):
    v, w = mesh.tetrahedra[t, below], mesh.tetrahedra[t, above]
    share = crossing(work, below, above)
    p, q = mesh.nodes[v], mesh.nodes[w]
    for d in range(3):
        work.points[k, d] = p[d] + share * (q[d] - p[d])
    work.index[below, above] = work.index[above, below] = k
    lower, upper = min(below, above), max(below, above)
    e = 0
    while EDGE_FIRST[e] != lower or EDGE_SECOND[e] != upper:
        e += 1
    edge = mesh.tetrahedron_edges[t, e] + edge_shift
    side = 0 if v < w else 1
    work.sampled[k, 0] = body.edge_share[edge, side] >= share * (1.0 - ROUNDING)
    work.sampled[k, 1] = body.edge_share[edge, 1 - side] >= (1.0 - share) * (1.0 - ROUNDING)


@inlined_kernel
def add_parts(mesh, t, work, below, low, high, moments):
    """Add the moments of both parts of a tetrahedron, as cut_edges left it, to fragments low .. high - 1."""
    nodes, o, index, solid = mesh.tetrahedra[t], work.order, work.index, work.moments
    solid[:] = 0.0
    part = 0
    if below == 1 or below == 3:
        lone = o[0] if below == 1 else o[3]
        part = 0 if below == 1 else 1
        _add_solid(mesh.nodes[nodes[lone]], work.points[0], work.points[1], work.points[2], solid)
    else:
        a, b = mesh.nodes[nodes[o[0]]], mesh.nodes[nodes[o[1]]]
        a2, a3 = work.points[index[o[0], o[2]]], work.points[index[o[0], o[3]]]
        b2, b3 = work.points[index[o[1], o[2]]], work.points[index[o[1], o[3]]]
        _add_solid(a, a2, a3, b, solid)
        _add_solid(a2, a3, b, b2, solid)
        _add_solid(a3, b, b2, b3, solid)
    own, rest = work.labels[part], work.labels[1 - part]
    if low <= own < high:
        for d in range(10):
            moments[own, d] += solid[d]
    if low <= rest < high:
        for d in range(10):
            moments[rest, d] += mesh.moments[t, d] - solid[d]


@inlined_kernel
def _add_solid(a, b, c, d, solid):
    """Add the moments of a tetrahedron of either orientation."""
    nx, ny, nz = _cross_product(a, b, c)
    p, q = (b, c) if nx * (d[0] - a[0]) + ny * (d[1] - a[1]) + nz * (d[2] - a[2]) > 0.0 else (c, b)
    add_tetrahedron(a[0], a[1], a[2], p[0], p[1], p[2], q[0], q[1], q[2], d[0], d[1], d[2], solid)


@inlined_kernel
def write_section(mesh, body, node_shift, edge_shift, t, work, count, out, written, boxes, gaps, samples):
    """Append what parts the two fragments, as rows of BodyPool; grows their boxes and gaps. Returns the row behind."""
    low, high = work.labels[0], work.labels[1]
    p, q = work.points, work.plane
    for k in range(1, count - 1):
        for side in range(2):
            known = work.sampled[0, side] and work.sampled[k, side] and work.sampled[k + 1, side]
            label = work.labels[side]
            _grow_gap(mesh, body, node_shift, edge_shift, t, label, known, p[0], p[k], p[k + 1], gaps, samples)
        written = write_row(p[0], p[k], p[k + 1], q[0], q[1], q[2], q[3], low, high, INTERFACE, out, written)
    for k in range(count):
        for side in range(2):
            grow(boxes[work.labels[side]], p[k, 0], p[k, 1], p[k, 2])
    return written


@inlined_kernel
def write_face(mesh, body, node_shift, edge_shift, t, face, work, out, written, gaps, samples):
    """Likewise the two fragments' shares of an old face."""
    i, j, k = FACE_VERTICES[face, 0], FACE_VERTICES[face, 1], FACE_VERTICES[face, 2]
    above_i, above_j, above_k = work.heights[i] > 0.0, work.heights[j] > 0.0, work.heights[k] > 0.0
    nodes = mesh.tetrahedra[t]
    a, b, c = mesh.nodes[nodes[i]], mesh.nodes[nodes[j]], mesh.nodes[nodes[k]]
    nx, ny, nz = triangle_normal(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
    o = nx * a[0] + ny * a[1] + nz * a[2]
    side = 1 if above_i else 0
    if above_i == above_j and above_i == above_k:
        label = work.labels[side]
        _grow_gap(mesh, body, node_shift, edge_shift, t, label, True, a, b, c, gaps, samples)
        return write_row(a, b, c, nx, ny, nz, o, label, -1, face, out, written)
    # turn the face until the node that is alone on its side comes first
    if above_i == above_k:
        i, j, k = j, k, i
    elif above_i == above_j:
        i, j, k = k, i, j
    a, b, c = mesh.nodes[nodes[i]], mesh.nodes[nodes[j]], mesh.nodes[nodes[k]]
    side = 1 if work.heights[i] > 0.0 else 0
    e, f = work.index[i, j], work.index[i, k]
    p, q = work.points[e], work.points[f]
    alone, others = work.labels[side], work.labels[1 - side]
    known = work.sampled[e, side] and work.sampled[f, side]
    _grow_gap(mesh, body, node_shift, edge_shift, t, alone, known, a, p, q, gaps, samples)
    written = write_row(a, p, q, nx, ny, nz, o, alone, -1, face, out, written)
    known = work.sampled[e, 1 - side] and work.sampled[f, 1 - side]
    _grow_gap(mesh, body, node_shift, edge_shift, t, others, known, p, b, c, gaps, samples)
    written = write_row(p, b, c, nx, ny, nz, o, others, -1, face, out, written)
    _grow_gap(mesh, body, node_shift, edge_shift, t, others, known, p, c, q, gaps, samples)
    return write_row(p, c, q, nx, ny, nz, o, others, -1, face, out, written)


@inlined_kernel
def _grow_gap(mesh, body, node_shift, edge_shift, t, label, known, a, b, c, gaps, samples):
    """The sampling gap of a triangle of a fragment's surface; `known`: all three corners are samples of it."""
    if known:
        gaps[label] = max(gaps[label], math.sqrt(longest_side_squared(a, b, c) / 3.0))
    else:
        count = samples_in_tetrahedron(mesh, body, node_shift, edge_shift, t, label, samples, 0)
        gaps[label] = max(gaps[label], gap_of_triangle(a, b, c, samples, count))
