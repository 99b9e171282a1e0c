"""A body's tetrahedral mesh with the data for queries: adjacency, boxes, barycentric rows, moments, a location grid.

Built once per geometry (the paper's preprocess, sections 4.1 and 4.3); fracture never changes it.
All indices are local to the mesh; `pools.py` shifts them when meshes are concatenated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.mesh.moments import tetrahedron_moments
from fracture_collision.geometry.tetrahedra import (
    boundary_triangles,
    face_neighbours,
    tetrahedron_edges,
    tetrahedron_volumes,
    unique_edges,
)
from fracture_collision.grouping import begins_of
from fracture_collision.portable_math import arctangent2, cube_root, dots, images, lengths

# A location grid with cells about the size of a tetrahedron's box is fastest; a hollow body's box holds more air than
# tetrahedra, so the number of cells is bounded too.
CELLS_PER_TETRAHEDRON = 4
# Parts of a cell along each axis: a word has 64 bits.
PARTS = 4
# Rounding error bound of a wall between parts, as a share of a part: coordinates may be 1e5 times as large.
WALL = 1e-6


class TetMesh(NamedTuple):
    """One mesh's preprocess, indices local to it."""

    nodes: np.ndarray  # (n, 3) float64 [m], body frame
    tetrahedra: np.ndarray  # (m, 4) int32, positive volume
    neighbours: np.ndarray  # (m, 4) int32, across the face opposite vertex i; -1: the old surface
    tetrahedron_edges: np.ndarray  # (m, 6) int32, order (0,1),(0,2),(0,3),(1,2),(1,3),(2,3)
    edges: np.ndarray  # (e, 2) int32, ascending, first < second
    edges_begin: np.ndarray  # (n + 1,) int32: CSR offsets of the edges with first node i
    edge_tets: np.ndarray  # (e,) int32, one tetrahedron incident to each edge
    boxes: np.ndarray  # (m, 6) float32 [m], lower and upper corner, rounded outwards
    barycentric: np.ndarray  # (m, 12) float64, rows (gx, gy, gz, c) of vertices 1, 2, 3: weight = g . x + c
    walls: np.ndarray  # (m, 16) float32: n_x, n_y, n_z and offsets [m] of faces 0 .. 3 from the grid's corner, outwards
    moments: np.ndarray  # (m, 10) float64 about grid_origin, see moments.py
    on_surface: np.ndarray  # (n,) uint8, 1: vertex of the old surface
    node_normals: np.ndarray  # (n, 3) float64 unit, outward, of the old surface; zero inside
    node_tets_begin: np.ndarray  # (n + 1,) int32
    node_tets: np.ndarray  # (4m,) int32
    surface: np.ndarray  # (t, 3) int32, counter-clockwise from outside
    grid_origin: np.ndarray  # (3,) float64 [m]
    grid_cell: float  # [m], edge of a cell of the location grid
    grid_dims: np.ndarray  # (3,) int32
    cell_begin: np.ndarray  # (cells + 1,) int32
    cell_tets: np.ndarray  # int32, ascending within a cell
    cell_parts: np.ndarray  # uint64, one bit per part of the cell (occupancy.py) that this tetrahedron may meet
    box: np.ndarray  # (6,) float64 [m]
    sampling_gap: float  # [m] upper bound of the distance from a point of the old surface to its nearest vertex


def build_tet_mesh(nodes: np.ndarray, tetrahedra: np.ndarray) -> TetMesh:
    """Preprocess a valid mesh (`nodes` (n, 3) [m], `tetrahedra` (m, 4), positive volume)."""
    nodes = np.ascontiguousarray(nodes, dtype=np.float64).reshape(-1, 3)
    tetrahedra = np.ascontiguousarray(tetrahedra, dtype=np.int32).reshape(-1, 4)
    edges = unique_edges(tetrahedra)
    surface = boundary_triangles(tetrahedra)
    corners = nodes[tetrahedra]
    boxes = np.ascontiguousarray(np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1))
    on_surface = np.zeros(len(nodes), dtype=np.uint8)
    on_surface[surface.ravel()] = 1
    order = np.argsort(tetrahedra.ravel(), kind="stable")
    begin = begins_of(np.bincount(tetrahedra.ravel(), minlength=len(nodes))).astype(np.int32)
    lower, upper = nodes.min(axis=0), nodes.max(axis=0)
    volume = float(tetrahedron_volumes(nodes, tetrahedra).sum())
    cell = _cell_size(volume, upper - lower, len(tetrahedra))
    # Half a cell of air around the mesh keeps a vertex of the boundary off the last cell's far face.
    origin = lower - 0.5 * cell
    dims = (np.floor((upper - origin) / cell) + 1).astype(np.int32)
    barycentric = _barycentric_rows(corners)
    edges_of = np.ascontiguousarray(tetrahedron_edges(tetrahedra, edges), dtype=np.int32)
    edge_tets = np.empty(len(edges), dtype=np.int32)
    edge_tets[edges_of] = np.arange(len(tetrahedra), dtype=np.int32)[:, None]
    cells = _register_tetrahedra(boxes, barycentric, origin, cell, dims)
    sides = nodes[surface] - nodes[np.roll(surface, 1, axis=1)]
    return TetMesh(
        nodes=nodes,
        tetrahedra=tetrahedra,
        neighbours=np.ascontiguousarray(face_neighbours(tetrahedra), dtype=np.int32),
        tetrahedron_edges=edges_of,
        edges=np.ascontiguousarray(edges, dtype=np.int32),
        edges_begin=np.searchsorted(edges[:, 0], np.arange(len(nodes) + 1)).astype(np.int32),
        edge_tets=edge_tets,
        boxes=_rounded_outwards(boxes),
        barycentric=barycentric,
        walls=_walls(barycentric, origin),
        moments=tetrahedron_moments(corners, origin),
        on_surface=on_surface,
        node_normals=vertex_normals(nodes, surface),
        node_tets_begin=begin,
        node_tets=(order // 4).astype(np.int32),
        surface=np.ascontiguousarray(surface, dtype=np.int32),
        grid_origin=origin,
        grid_cell=cell,
        grid_dims=dims,
        cell_begin=cells[0],
        cell_tets=cells[1],
        cell_parts=cells[2],
        box=np.concatenate([lower, upper]),
        # The corners of a triangle with longest side L cover it with balls of radius L / sqrt(3).
        sampling_gap=float(np.sqrt(dots(sides, sides).max() / 3.0)),
    )


def vertex_normals(nodes: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Outward unit normals (n, 3) of the vertices of a closed surface (t, 3): angle-weighted (Baerentzen, Aanaes 2005).

    Zero at nodes that are not its vertices.
    """
    corners = nodes[surface]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= lengths(face)[:, None]
    normals = np.zeros((len(nodes), 3))
    for i in range(3):
        u, v = corners[:, (i + 1) % 3] - corners[:, i], corners[:, (i + 2) % 3] - corners[:, i]
        angle = arctangent2(lengths(np.cross(u, v)), (u * v).sum(axis=1))
        np.add.at(normals, surface[:, i], angle[:, None] * face)
    length = lengths(normals)[:, None]
    # where sheets fold back onto themselves their normals cancel: use any one of them
    first = np.zeros((len(nodes), 3))
    first[surface[::-1].ravel()] = np.repeat(face[::-1], 3, axis=0)
    return np.where(length > 1e-9, normals / np.maximum(length, 1e-9), first)


def _rounded_outwards(boxes: np.ndarray) -> np.ndarray:
    """float32 boxes (m, 6) that contain the given ones: they only serve as bounds, and take half the cache."""
    rounded = boxes.astype(np.float32)
    lower, upper = rounded[:, :3], rounded[:, 3:]
    np.copyto(lower, np.nextafter(lower, np.float32(-np.inf)), where=lower > boxes[:, :3])
    np.copyto(upper, np.nextafter(upper, np.float32(np.inf)), where=upper < boxes[:, 3:])
    return rounded


def _cell_size(volume: float, extent: np.ndarray, count: int) -> float:
    """Edge [m] of a regular tetrahedron of the mesh's mean volume, or more: the number of cells is limited."""
    cell = cube_root(6.0 * np.sqrt(2.0) * volume / count)
    limit = CELLS_PER_TETRAHEDRON * count + 64
    while np.prod(np.floor(extent / cell) + 2) > limit:
        cell *= 1.1
    return float(cell)


def _barycentric_rows(corners: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)
    # Rows of the inverse of the matrix with the sides as columns, written out.
    normals = np.stack((np.cross(b, c), np.cross(c, a), np.cross(a, b)), axis=1)
    gradients = normals / (a * normals[:, 0]).sum(axis=1)[:, None, None]
    rows = np.empty((len(corners), 3, 4))
    rows[:, :, :3] = gradients
    rows[:, :, 3] = -images(gradients, corners[:, 0])
    return np.ascontiguousarray(rows.reshape(-1, 12))


def _walls(barycentric: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """The planes of the faces, n . (x - origin) <= offset within, as rows (m, 16) float32; see TetMesh.walls."""
    rows = barycentric.reshape(-1, 3, 4)
    gradients = np.concatenate((-rows[:, :, :3].sum(axis=1, keepdims=True), rows[:, :, :3]), axis=1)
    weights = images(gradients, np.broadcast_to(origin, (len(rows), 3)))
    weights[:, 0] += 1.0
    weights += np.concatenate((-rows[:, :, 3].sum(axis=1, keepdims=True), rows[:, :, 3]), axis=1)
    length = lengths(gradients)
    planes = np.concatenate((-gradients / length[:, :, None], (weights / length)[:, :, None]), axis=2)
    return np.ascontiguousarray(np.moveaxis(planes, 1, 2).reshape(-1, 16), dtype=np.float32)


@kernel
def _touches_cell(rows, x, y, z, half):
    """Whether a tetrahedron, given by its barycentric rows (12,), may meet a cube of half edge `half` about (x, y, z).

    Tests the four face planes as separating planes; with the box overlap test of the caller, a close outer bound.
    """
    last, last_reach = 1.0, 0.0
    gx = gy = gz = 0.0
    for i in range(3):
        a, b, c, d = rows[4 * i], rows[4 * i + 1], rows[4 * i + 2], rows[4 * i + 3]
        weight = a * x + b * y + c * z + d
        if weight + half * (abs(a) + abs(b) + abs(c)) < 0.0:
            return False
        last -= weight
        gx, gy, gz = gx + a, gy + b, gz + c
    last_reach = half * (abs(gx) + abs(gy) + abs(gz))
    return last + last_reach >= 0.0


@kernel
def _overlap(low, high, center, half):
    """Whether [low, high] and center +- half meet."""
    return low <= center + half and high >= center - half


@kernel
def _parts_met(box, rows, x, y, z, part):
    """Bits of the parts of a cell, with its lowest corner at (x, y, z), that a tetrahedron may meet."""
    # slightly more than half a part: rounding must not lose a tetrahedron that touches the wall between two
    half = 0.5 * part * (1.0 + WALL)
    parts = np.uint64(0)
    for i in range(PARTS):
        px = x + (i + 0.5) * part
        if not _overlap(box[0], box[3], px, half):
            continue
        for j in range(PARTS):
            py = y + (j + 0.5) * part
            if not _overlap(box[1], box[4], py, half):
                continue
            for k in range(PARTS):
                pz = z + (k + 0.5) * part
                if _overlap(box[2], box[5], pz, half) and _touches_cell(rows, px, py, pz, half):
                    parts |= np.uint64(1) << np.uint64((i * PARTS + j) * PARTS + k)
    return parts


@kernel
def _register_tetrahedra(boxes, barycentric, origin, cell, dims):
    """CSR lists from cells to tetrahedra, ascending: begin, items, and the parts of the cell that each may meet."""
    nx, ny, nz = dims
    cell_begin = np.zeros(nx * ny * nz + 1, dtype=np.int32)
    lo, hi = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    cell_tets, cell_parts = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint64)
    cursor = np.empty(0, dtype=np.int32)
    for fill in range(2):
        if fill == 1:
            for c in range(nx * ny * nz):
                cell_begin[c + 1] += cell_begin[c]
            cell_tets = np.empty(cell_begin[-1], dtype=np.int32)
            cell_parts = np.empty(cell_begin[-1], dtype=np.uint64)
            cursor = cell_begin.copy()
        for t in range(len(boxes)):
            for k in range(3):
                lo[k] = max(int(np.floor((boxes[t, k] - origin[k]) / cell - WALL)), 0)
                hi[k] = min(int(np.floor((boxes[t, k + 3] - origin[k]) / cell + WALL)), dims[k] - 1)
            for i in range(lo[0], hi[0] + 1):
                for j in range(lo[1], hi[1] + 1):
                    for k in range(lo[2], hi[2] + 1):
                        x, y, z = origin[0] + i * cell, origin[1] + j * cell, origin[2] + k * cell
                        parts = _parts_met(boxes[t], barycentric[t], x, y, z, cell / PARTS)
                        if not parts:
                            continue
                        c = (i * ny + j) * nz + k
                        if fill == 0:
                            cell_begin[c + 1] += 1
                        else:
                            cell_tets[cursor[c]], cell_parts[cursor[c]] = t, parts
                            cursor[c] += 1
    return cell_begin, cell_tets, cell_parts
