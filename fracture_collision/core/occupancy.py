"""The multi-level grid of Glondu 2014, section 4.5: does a sphere outside reach any tetrahedron that holds fragment f?

Level 0 is the location grid, restricted to the fragment's own cells; a cell of level k + 1 is set if ANY of its eight
children is (the text's AND would cull what touches). A level with cells of at least 2 r is asked: the eight cells
around the grid point nearest to the centre cover the sphere, so the test is conservative.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.compiled import inlined_kernel, kernel


@kernel
def mark_tetrahedron(mesh, k, t, cells, occupancy):
    """Set the level-0 bytes of all cells that tetrahedron `t` of mesh `k` touches, within the fragment's cells (7,)."""
    ny, nz = mesh.grid_dims[k, 1], mesh.grid_dims[k, 2]
    for e in range(mesh.tet_cells_begin[t + k], mesh.tet_cells_begin[t + k + 1]):
        c = mesh.tet_cells[e]
        i, j, l = c // (ny * nz) - cells[0], c // nz % ny - cells[1], c % nz - cells[2]  # noqa: E741
        if 0 <= i < cells[3] and 0 <= j < cells[4] and 0 <= l < cells[5]:
            occupancy[cells[6] + (i * cells[4] + j) * cells[5] + l] = 1


@kernel
def mark_all(mesh, k, first, last, cells, occupancy):
    """Mark tetrahedra first .. last - 1 of mesh `k`."""
    for t in range(first, last):
        mark_tetrahedron(mesh, k, t, cells, occupancy)


@kernel
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


@kernel
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
    """False only if no tetrahedron that holds f comes within `r` [m] of the point (body frame)."""
    k = pools.fragment.mesh[f]
    cell = pools.mesh.grid[k, 3]
    cells = pools.fragment.cells[f]
    x0, y0, z0 = cells[0], cells[1], cells[2]
    nx, ny, nz = cells[3], cells[4], cells[5]
    begin = cells[6]
    while cell < 2.0 * r:
        if nx == 1 and ny == 1 and nz == 1:
            return True
        begin += nx * ny * nz
        ux, uy, uz = x0 >> 1, y0 >> 1, z0 >> 1
        nx = ((x0 + nx - 1) >> 1) - ux + 1
        ny = ((y0 + ny - 1) >> 1) - uy + 1
        nz = ((z0 + nz - 1) >> 1) - uz + 1
        x0, y0, z0 = ux, uy, uz
        cell *= 2.0
    i = int(math.floor((x - pools.mesh.grid[k, 0]) / cell + 0.5)) - x0
    j = int(math.floor((y - pools.mesh.grid[k, 1]) / cell + 0.5)) - y0
    l = int(math.floor((z - pools.mesh.grid[k, 2]) / cell + 0.5)) - z0  # noqa: E741
    for a in range(max(i - 1, 0), min(i + 1, nx)):
        for b in range(max(j - 1, 0), min(j + 1, ny)):
            for c in range(max(l - 1, 0), min(l + 1, nz)):
                if pools.occupancy[begin + (a * ny + b) * nz + c]:
                    return True
    return False


def cells_of_box(box: np.ndarray, origin: np.ndarray, cell: float, dims: np.ndarray, first_byte: int) -> np.ndarray:
    """The cells row (7,) of a fragment with bounding box (6,) [m] in a location grid."""
    lower = np.clip(np.floor((box[:3] - origin) / cell), 0, dims - 1).astype(np.int32)
    upper = np.clip(np.floor((box[3:] - origin) / cell), 0, dims - 1).astype(np.int32)
    return np.concatenate([lower, upper - lower + 1, [first_byte]]).astype(np.int32)
