"""Rows of a broken body's surface as a fracture makes them: polygons, boxes, and how far they are from samples."""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.compiled import inlined_kernel, query_kernel

# A triangle thinner than this (area against its longest side squared) is a clipping residue; others hold its rim.
RESIDUE = 1e-13
# Samples of one fragment in a tetrahedron and the one behind a face: four nodes and six edges each.
MAX_SAMPLES = 20


@inlined_kernel
def longest_side_squared(a, b, c):
    """[m2] of the triangle (a, b, c)."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
    return max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)


@query_kernel
def gap_of_triangle(a, b, c, samples, count):
    """Upper bound [m] of the distance from a point of the triangle to the nearest of the samples (count, 3)."""
    furthest = 0.0
    for corner in (a, b, c):
        nearest = np.inf
        for s in range(count):
            dx, dy, dz = corner[0] - samples[s, 0], corner[1] - samples[s, 1], corner[2] - samples[s, 2]
            nearest = min(nearest, dx * dx + dy * dy + dz * dz)
        furthest = max(furthest, nearest)
    # balls of radius (longest side) / sqrt(3) around the corners cover a triangle
    return math.sqrt(longest_side_squared(a, b, c) / 3.0) + math.sqrt(furthest)


@query_kernel
def samples_in_tetrahedron(mesh, body, node_shift, edge_shift, t, label, samples, count):
    """Append one fragment's surface samples in tetrahedron `t`: its nodes of the old surface, its ends of cut edges."""
    for i in range(4):
        v = mesh.tetrahedra[t, i]
        if mesh.on_surface[v] and body.node_fragment[v + node_shift] == label:
            for d in range(3):
                samples[count, d] = mesh.nodes[v, d]
            count += 1
    for e in range(6):
        edge = mesh.tetrahedron_edges[t, e]
        if body.edge_plane[edge + edge_shift] < 0:
            continue
        for side in range(2):
            own, far = mesh.edges[edge, side], mesh.edges[edge, 1 - side]
            if body.node_fragment[own + node_shift] == label:
                share = body.edge_share[edge + edge_shift, side]
                for d in range(3):
                    samples[count, d] = mesh.nodes[own, d] + share * (mesh.nodes[far, d] - mesh.nodes[own, d])
                count += 1
    return count


@inlined_kernel
def grow(box, x, y, z):
    box[0], box[1], box[2] = min(box[0], x), min(box[1], y), min(box[2], z)
    box[3], box[4], box[5] = max(box[3], x), max(box[4], y), max(box[5], z)


@inlined_kernel
def write_row(a, b, c, nx, ny, nz, offset, front, back, kind, out, at):
    """Write a triangle of the plane n . x = offset to row `at`; returns the next row, `at` again for a residue."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    mx, my, mz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    span = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
    if mx * mx + my * my + mz * mz <= (RESIDUE * span) ** 2:
        return at
    triangle, plane = out.triangles[at], out.faces[at]
    for d in range(3):
        triangle[d], triangle[3 + d], triangle[6 + d] = a[d], b[d], c[d]
    plane[0], plane[1], plane[2], plane[3] = nx, ny, nz, offset
    out.front[at], out.back[at], out.kind[at] = front, back, kind
    return at + 1
