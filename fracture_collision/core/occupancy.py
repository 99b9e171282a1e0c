"""The multi-level grid of Glondu 2014, section 4.5: does a sphere outside reach any tetrahedron that holds fragment f?

Level 0 is the location grid, restricted to the fragment's own cells; a cell of level k + 1 is set if ANY of its eight
children is (the text's AND would cull what touches).
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.compiled import inlined_kernel, query_kernel

# Cells that a sphere's diameter may span at the level that is asked: more of them cost loads, fewer cull less.
SPAN = 4.0
# What rounding may take from a distance, as a share of it and of a cell.
ROUNDING = 1e-9


@query_kernel
def mark_tetrahedron(mesh, k, t, cells, occupancy):
    """Set the level-0 bytes of all cells that tetrahedron `t` of mesh `k` touches, within the fragment's cells (7,)."""
    ny, nz = mesh.grid_dims[k, 1], mesh.grid_dims[k, 2]
    for e in range(mesh.tet_cells_begin[t + k], mesh.tet_cells_begin[t + k + 1]):
        c = mesh.tet_cells[e]
        i, j, l = c // (ny * nz) - cells[0], c // nz % ny - cells[1], c % nz - cells[2]  # noqa: E741
        if 0 <= i < cells[3] and 0 <= j < cells[4] and 0 <= l < cells[5]:
            occupancy[cells[6] + (i * cells[4] + j) * cells[5] + l] = 1


@query_kernel
def mark_all(mesh, k, first, last, cells, occupancy):
    """Mark tetrahedra first .. last - 1 of mesh `k`."""
    for t in range(first, last):
        mark_tetrahedron(mesh, k, t, cells, occupancy)


@query_kernel
def pyramid_bytes(cells):
    """Bytes of all levels together, for a fragment's cells (7,)."""
    total, level = 0, 0
    while True:
        nx = ((cells[0] + cells[3] - 1) >> level) - (cells[0] >> level) + 1
        ny = ((cells[1] + cells[4] - 1) >> level) - (cells[1] >> level) + 1
        nz = ((cells[2] + cells[5] - 1) >> level) - (cells[2] >> level) + 1
        total += nx * ny * nz
        if nx == 1 and ny == 1 and nz == 1:
            return total
        level += 1


@query_kernel
def fill_pyramid(cells, occupancy):
    """Levels above 0, bottom-up by OR."""
    x0, y0, z0 = cells[0], cells[1], cells[2]
    nx, ny, nz = cells[3], cells[4], cells[5]
    begin = cells[6]
    while nx > 1 or ny > 1 or nz > 1:
        above = begin + nx * ny * nz
        ux, uy, uz = x0 >> 1, y0 >> 1, z0 >> 1
        mx = ((x0 + nx - 1) >> 1) - ux + 1
        my = ((y0 + ny - 1) >> 1) - uy + 1
        mz = ((z0 + nz - 1) >> 1) - uz + 1
        for i in range(nx):
            for j in range(ny):
                for l in range(nz):  # noqa: E741
                    if occupancy[begin + (i * ny + j) * nz + l]:
                        p = (((x0 + i) >> 1) - ux) * my + (((y0 + j) >> 1) - uy)
                        occupancy[above + p * mz + (((z0 + l) >> 1) - uz)] = 1
        x0, y0, z0, nx, ny, nz, begin = ux, uy, uz, mx, my, mz, above


@inlined_kernel
def sphere_may_touch(pools, f, x, y, z, r):
    """False only if no tetrahedron that holds f comes within `r` [m] of the point (body frame).

    Sharper than the paper's eight cells at one level: the cells that the sphere's box overlaps, at most SPAN + 1 along
    each axis.
    """
    grid = pools.mesh.grid
    k = pools.fragment.mesh[f]
    cells = pools.fragment.cells[f]
    # in cells of level 0 from here on
    per_cell = 1.0 / grid[k, 3]
    px, py, pz = (x - grid[k, 0]) * per_cell, (y - grid[k, 1]) * per_cell, (z - grid[k, 2]) * per_cell
    r = r * per_cell * (1.0 + ROUNDING) + ROUNDING
    x0, y0, z0 = cells[0], cells[1], cells[2]
    nx, ny, nz = cells[3], cells[4], cells[5]
    begin = cells[6]
    # the cell that holds the centre answers most spheres that touch
    a, b, c = int(math.floor(px)) - x0, int(math.floor(py)) - y0, int(math.floor(pz)) - z0
    if 0 <= a < nx and 0 <= b < ny and 0 <= c < nz and pools.occupancy[begin + (a * ny + b) * nz + c]:
        return True
    while 2.0 * r > SPAN:
        if nx == 1 and ny == 1 and nz == 1:
            return True
        begin += nx * ny * nz
        ux, uy, uz = x0 >> 1, y0 >> 1, z0 >> 1
        nx = ((x0 + nx - 1) >> 1) - ux + 1
        ny = ((y0 + ny - 1) >> 1) - uy + 1
        nz = ((z0 + nz - 1) >> 1) - uz + 1
        x0, y0, z0 = ux, uy, uz
        px, py, pz, r = 0.5 * px, 0.5 * py, 0.5 * pz, 0.5 * r
    r2 = r * r
    px, py, pz = px - x0, py - y0, pz - z0
    c0, c1 = max(int(math.floor(pz - r)), 0), min(int(math.floor(pz + r)), nz - 1)
    b0, b1 = max(int(math.floor(py - r)), 0), min(int(math.floor(py + r)), ny - 1)
    for a in range(max(int(math.floor(px - r)), 0), min(int(math.floor(px + r)), nx - 1) + 1):
        dx = max(a - px, 0.0, px - (a + 1))
        for b in range(b0, b1 + 1):
            dy = max(b - py, 0.0, py - (b + 1))
            left = r2 - dx * dx - dy * dy
            if left < 0.0:
                continue
            for c in range(c0, c1 + 1):
                if pools.occupancy[begin + (a * ny + b) * nz + c]:
                    dz = max(c - pz, 0.0, pz - (c + 1))
                    if dz * dz <= left:
                        return True
    return False


def cells_of_box(box: np.ndarray, origin: np.ndarray, cell: float, dims: np.ndarray, first_byte: int) -> np.ndarray:
    """The cells row (7,) of a fragment with bounding box (6,) [m] in a location grid."""
    lower = np.clip(np.floor((box[:3] - origin) / cell), 0, dims - 1).astype(np.int32)
    upper = np.clip(np.floor((box[3:] - origin) / cell), 0, dims - 1).astype(np.int32)
    return np.concatenate([lower, upper - lower + 1, [first_byte]]).astype(np.int32)
