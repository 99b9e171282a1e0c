"""The exact signed distance to a closed triangle mesh: the elementary queries for rigid bodies without tetrahedra.

A bounding-volume hierarchy of boxes finds the nearest triangle; the sign comes from the pseudonormal of the feature
(face, edge or corner) that holds the closest point: J. A. Baerentzen, H. Aanaes, "Signed distance computation using the
angle weighted pseudonormal", IEEE TVCG 11(3), 2005. For a closed mesh that does not touch itself both are exact: no
grid, no stored distance.

The hierarchy is stored in preorder: the first child of node i is i + 1, the second the `skip` of the first; `skip` is
the node behind the subtree. Triangles are stored in the order of the leaves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.pools import TriangleMeshPool
from fracture_collision.core.memory.tables import Table
from fracture_collision.core.mesh.closest_point import (
    DIRECTION_FLOOR,
    ON_FACE,
    box_distance_squared,
    closest_on_triangle,
    triangle_normal,
)
from fracture_collision.portable_math import arctangent2, lengths

# Four triangles per leaf: one more box costs about as much as one more triangle.
LEAF_TRIANGLES = 4
# The hierarchy halves its triangles at each node, so a descent of this depth covers 2^62 of them.
STACK = 64


class TriangleMesh(NamedTuple):
    """One mesh's preprocess, rows local to it; triangle rows in the order of the leaves."""

    corners: np.ndarray  # (t, 9) float64 [m], counter-clockwise from outside
    features: np.ndarray  # (t, 6) int32 rows of `pseudonormals`: edges ab, bc, ca, corners a, b, c
    pseudonormals: np.ndarray  # (e + n, 3) float64 unit, outward: edges, then vertices
    node_box: np.ndarray  # (b, 6) float64 [m], lower and upper corner
    node_skip: np.ndarray  # (b,) int32
    node_first: np.ndarray  # (b,) int32 first triangle of a leaf
    node_count: np.ndarray  # (b,) int32 number of triangles of a leaf, 0: inner node


def build_triangle_mesh(vertices: np.ndarray, triangles: np.ndarray) -> TriangleMesh:
    """Preprocess a closed mesh: vertices (n, 3) [m], triangles (t, 3) counter-clockwise from outside."""
    corners = vertices[triangles]
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    boxes = np.ascontiguousarray(np.concatenate([lower, upper], axis=1))
    order, node_box, node_skip, node_first, node_count = build_hierarchy(boxes, 0.5 * (lower + upper))
    pseudonormals, features = _pseudonormals(vertices, triangles)
    return TriangleMesh(
        np.ascontiguousarray(corners[order].reshape(-1, 9)), np.ascontiguousarray(features[order]), pseudonormals,
        node_box, node_skip, node_first, node_count,
    )  # fmt: skip


def append_triangle_mesh(table: Table[TriangleMeshPool], mesh: TriangleMesh) -> int:
    """Add a mesh to the columns of a TriangleMeshPool, rows made absolute; returns its row of `node_range`."""
    triangle, node = table["corners"].used, table["node_box"].used
    table["features"].append(mesh.features + table["pseudonormals"].used)
    edges = 3 * len(mesh.corners) // 2  # of a closed surface
    table["first_vertex"].append(np.array([table["pseudonormals"].used + edges], np.int32))
    for name in ("corners", "pseudonormals", "node_box", "node_count"):
        table[name].append(getattr(mesh, name))
    table["node_skip"].append(mesh.node_skip + node)
    table["node_first"].append(mesh.node_first + triangle)
    table["triangle_range"].append(np.array([[triangle, triangle + len(mesh.corners)]], np.int32))
    return table["node_range"].append(np.array([[node, node + len(mesh.node_box)]], np.int32))


def triangle_pool(mesh: TriangleMesh) -> TriangleMeshPool:
    """A TriangleMeshPool with this mesh alone, row 0."""
    return TriangleMeshPool(
        mesh.corners, mesh.features, mesh.pseudonormals, mesh.node_box, mesh.node_skip, mesh.node_first,
        mesh.node_count, np.array([[0, len(mesh.node_box)]], np.int32), np.array([[0, len(mesh.corners)]], np.int32),
        np.array([3 * len(mesh.corners) // 2], np.int32),
    )  # fmt: skip


def _pseudonormals(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pseudonormals of edges and vertices, and each triangle's rows among them (t, 6): section 3 of the source."""
    corners = vertices[triangles]
    sides = np.roll(corners, -1, axis=1) - corners  # from corner i to the next
    sides /= lengths(sides)[..., None]
    normals = np.cross(sides[:, 0], sides[:, 1])
    normals /= lengths(normals)[..., None]
    back = -np.roll(sides, 1, axis=1)
    sines = lengths(np.cross(sides, back))
    angles = arctangent2(sines, (sides * back).sum(axis=2))
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2).astype(np.int64)
    _, edge = np.unique(ends[..., 0] * len(vertices) + ends[..., 1], return_inverse=True)
    edge = edge.reshape(-1, 3)
    features = np.concatenate([edge, triangles + (edge.max() + 1)], axis=1)
    sums = np.zeros((edge.max() + 1 + len(vertices), 3))
    for i in range(3):
        np.add.at(sums, features[:, i], normals)
        np.add.at(sums, features[:, 3 + i], angles[:, i, None] * normals)
    length = lengths(sums)[..., None]
    return sums / np.where(length > 0.0, length, 1.0), features.astype(np.int32)


@kernel
def build_hierarchy(boxes, centers):
    """Halve the triangles at the median of the widest axis of their centres; ties keep their order.

    boxes (t, 6) [m] and centers (t, 3) [m] of the triangles. Returns (order (t,) of the triangles in the leaves, then
    node_box, node_skip, node_first and node_count as in TriangleMesh).
    """
    n = len(boxes)
    order = np.arange(n).astype(np.int32)
    capacity = 2 * n
    node_box = np.empty((capacity, 6))
    first = np.zeros(capacity, dtype=np.int32)
    count = np.zeros(capacity, dtype=np.int32)
    begin_of = np.empty(STACK, dtype=np.int64)
    end_of = np.empty(STACK, dtype=np.int64)
    begin_of[0], end_of[0] = 0, n
    top = 1
    used = 0
    while top:
        top -= 1
        begin, end = begin_of[top], end_of[top]
        box = node_box[used]
        box[:3], box[3:] = np.inf, -np.inf
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for i in range(begin, end):
            for k in range(3):
                box[k] = min(box[k], boxes[order[i], k])
                box[k + 3] = max(box[k + 3], boxes[order[i], k + 3])
                low[k] = min(low[k], centers[order[i], k])
                high[k] = max(high[k], centers[order[i], k])
        first[used] = begin
        if end - begin <= LEAF_TRIANGLES:
            count[used] = end - begin
        else:
            axis = np.argmax(high - low)
            part = order[begin:end].copy()
            order[begin:end] = part[np.argsort(centers[part, axis], kind="mergesort")]
            middle = (begin + end) // 2
            begin_of[top], end_of[top] = middle, end
            begin_of[top + 1], end_of[top + 1] = begin, middle
            top += 2
        used += 1
    skip = np.empty(used, dtype=np.int32)
    for i in range(used - 1, -1, -1):
        skip[i] = i + 1 if count[i] else skip[skip[i + 1]]
    return order, node_box[:used].copy(), skip, first[:used].copy(), count[:used].copy()


@query_kernel
def nearest_triangle(meshes, k, x, y, z, limit, toward, stack):
    """Nearest point of mesh `k` closer than `limit` [m]: (squared distance [m2], x, y, z, feature, triangle row or -1).

    `toward` (x, y, z): only triangles with an outward normal opposed to it; zeros: all. Depth first, the nearer child
    first; a box at least as far as the best so far is skipped. `stack` (STACK,) int32: working space.
    """
    ox, oy, oz = toward
    is_asked = ox != 0.0 or oy != 0.0 or oz != 0.0
    stack[0] = meshes.node_range[k, 0]
    top = 1
    best, qx, qy, qz, feature, source = limit * limit, 0.0, 0.0, 0.0, 0, -1
    while top:
        top -= 1
        node = stack[top]
        if box_distance_squared(x, y, z, meshes.node_box[node]) >= best:
            continue
        while meshes.node_count[node] == 0:
            left = node + 1
            right = meshes.node_skip[left]
            to_left = box_distance_squared(x, y, z, meshes.node_box[left])
            to_right = box_distance_squared(x, y, z, meshes.node_box[right])
            node, further, reach = (left, right, to_right) if to_left <= to_right else (right, left, to_left)
            if reach < best:
                stack[top] = further
                top += 1
        begin = meshes.node_first[node]
        for t in range(begin, begin + meshes.node_count[node]):
            c = meshes.corners[t]
            if is_asked:
                nx, ny, nz = triangle_normal(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
                if nx * ox + ny * oy + nz * oz >= 0.0:
                    continue
            d2, ex, ey, ez, part = closest_on_triangle(x, y, z, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
            if d2 < best:
                best, qx, qy, qz, feature, source = d2, ex, ey, ez, part, t
    return best, qx, qy, qz, feature, source


@query_kernel
def triangle_within(meshes, k, x, y, z, r):
    """Whether any triangle of mesh `k` is within `r` [m] of the point: the sphere's overlap with the surface."""
    node, end = meshes.node_range[k]
    r2 = r * r
    while node < end:
        if box_distance_squared(x, y, z, meshes.node_box[node]) > r2:
            node = meshes.node_skip[node]
            continue
        begin = meshes.node_first[node]
        for t in range(begin, begin + meshes.node_count[node]):
            c = meshes.corners[t]
            if closest_on_triangle(x, y, z, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])[0] <= r2:
                return True
        node += 1
    return False


@query_kernel
def triangle_distance(meshes, k, radius, x, y, z, stack):
    """(signed distance [m], positive outside; outward unit direction; closest point x, y, z) of mesh `k`.

    `radius` [m]: R of the body. The direction is the face's normal, or at an edge or corner the line between the two
    points; where these nearly coincide, the pseudonormal.
    """
    d2, qx, qy, qz, feature, t = nearest_triangle(meshes, k, x, y, z, math.inf, (0.0, 0.0, 0.0), stack)
    d = math.sqrt(d2)
    if feature == ON_FACE:
        c = meshes.corners[t]
        nx, ny, nz = triangle_normal(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
    else:
        n = meshes.pseudonormals[meshes.features[t, feature - 1]]
        nx, ny, nz = n[0], n[1], n[2]
    sign = -1.0 if (x - qx) * nx + (y - qy) * ny + (z - qz) * nz < 0.0 else 1.0
    if feature != ON_FACE and d > DIRECTION_FLOOR * radius:
        nx, ny, nz = sign * (x - qx) / d, sign * (y - qy) / d, sign * (z - qz) / d
    return sign * d, nx, ny, nz, qx, qy, qz
