"""The multi-level grid of Glondu 2014, section 4.5: whether a sphere outside may reach fragment f.

Level 0 is the location grid, restricted to the fragment's own cells, one word per cell: every cell has 4 x 4 x 4 parts,
and a part's bit is set if a tetrahedron that holds f may meet it. A cell of level k + 1 is set if ANY of its eight
children is (the paper's AND would cull touching spheres).
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.pools import BACK, FRONT, LABELS, OWNER, PARTED
from fracture_collision.core.mesh.tet_mesh import PARTS

# Cells that a sphere's diameter may span at the tested level: more cells cost loads, fewer cull less.
SPAN = 4.0
# Rounding error bound of a distance, as a share of it and of a cell.
ROUNDING = 1e-9


def _slabs(axis: int) -> np.ndarray:
    """Bits of the parts first .. last along an axis, in entry PARTS first + last of (PARTS * PARTS,) uint64."""
    part = np.indices((PARTS, PARTS, PARTS))[axis].ravel()
    bit = np.uint64(1) << np.arange(PARTS * PARTS * PARTS, dtype=np.uint64)
    chosen = [bit[(first <= part) & (part <= last)] for first in range(PARTS) for last in range(PARTS)]
    return np.array([np.bitwise_or.reduce(bits, initial=np.uint64(0)) for bits in chosen], dtype=np.uint64)


_SLABS_X, _SLABS_Y, _SLABS_Z = _slabs(0), _slabs(1), _slabs(2)


@query_kernel
def _slab(low, high):
    """Entry of the tables above for the interval [low, high], in cells from the cell's lower wall."""
    first, last = int(math.floor(PARTS * low)), int(math.floor(PARTS * high))
    return PARTS * min(max(first, 0), PARTS - 1) + min(max(last, 0), PARTS - 1)


@query_kernel
def parts_within(x, y, z, r):
    """Bits of a cell's parts that the box of half edge `r` about a point overlaps; in cells, from its lowest corner."""
    return _SLABS_X[_slab(x - r, x + r)] & _SLABS_Y[_slab(y - r, y + r)] & _SLABS_Z[_slab(z - r, z + r)]


@query_kernel
def part_at(x, y, z):
    """Bit of the part that holds a point of a cell."""
    i, j, k = min(int(PARTS * x), PARTS - 1), min(int(PARTS * y), PARTS - 1), min(int(PARTS * z), PARTS - 1)
    return np.uint64(1) << np.uint64((i * PARTS + j) * PARTS + k)


@query_kernel
def _mark(cells, i, j, k, parts, occupancy):
    i, j, k = i - cells[0], j - cells[1], k - cells[2]
    if 0 <= i < cells[3] and 0 <= j < cells[4] and 0 <= k < cells[5]:
        occupancy[cells[6] + (i * cells[4] + j) * cells[5] + k] |= parts


@query_kernel
def mark_all(mesh, k, cells, occupancy):
    """Mark the whole body of mesh `k`; `cells` (7,): see FragmentPool.cells, the whole grid; its words must be zero."""
    nx, ny, nz, first = mesh.grid_dims[k]
    for i in range(nx):
        for j in range(ny):
            for l in range(nz):  # noqa: E741
                c = first + (i * ny + j) * nz + l
                for e in range(mesh.cell_begin[c], mesh.cell_begin[c + 1]):
                    _mark(cells, i, j, l, mesh.cell_parts[e], occupancy)
    _fill_pyramid(cells, occupancy)


@kernel
def mark_fragments(mesh, body, fragment, occupancy, broken):
    """Mark the new fragments of a surface_rows.Broken in their cells; clears their words first."""
    low, high = broken.first, broken.end
    begin, end = fragment.cells[low, 6], fragment.cells[high - 1, 6] + pyramid_words(fragment.cells[high - 1])
    occupancy[begin:end] = 0
    cells = fragment.cells[low:high]
    words, holders = np.zeros(high - low, np.uint64), np.empty(high - low, np.int32)
    _mark_fragments(mesh, body, fragment, occupancy, broken, words, holders)
    for f in range(high - low):
        _fill_pyramid(cells[f], occupancy)


@query_kernel
def _mark_fragments(mesh, body, fragment, occupancy, broken, words, holders):
    """Mark level 0 for the new fragments of a Broken.

    Working space, one entry per new fragment: words (broken.end - broken.first,) uint64, zero, the parts of a cell that
    each holds; holders, of the same length, int32, the fragments that hold any.
    """
    low, high, tet_shift = broken.first, broken.end, broken.tet_shift
    cells = fragment.cells[low:high]
    ny, nz, first = mesh.grid_dims[broken.mesh, 1:]
    x0, y0, z0, nx, my, mz, at = fragment.cells[broken.parent]
    for i in range(x0, x0 + nx):
        for j in range(y0, y0 + my):
            for l in range(z0, z0 + mz):  # noqa: E741
                c = first + (i * ny + j) * nz + l
                begin, end = mesh.cell_begin[c], mesh.cell_begin[c + 1]
                whole = occupancy[at + ((i - x0) * my + (j - y0)) * mz + (l - z0)]
                if not whole:
                    continue
                # most cells pass from the parent to one fragment unchanged
                heir = body.regions[mesh.cell_tets[begin] + tet_shift, OWNER]
                if low <= heir < high:
                    e = begin + 1
                    while e < end and body.regions[mesh.cell_tets[e] + tet_shift, OWNER] == heir:
                        e += 1
                    if e == end:
                        _mark(cells[heir - low], i, j, l, whole, occupancy)
                        continue
                used = 0
                for e in range(begin, end):
                    t, parts = mesh.cell_tets[e], mesh.cell_parts[e]
                    alone = body.regions[t + tet_shift, OWNER]
                    if alone >= 0:
                        used = _hold(alone, low, high, parts, words, holders, used)
                    elif alone == PARTED:
                        region = body.regions[t + tet_shift]
                        used = _hold(region[FRONT], low, high, parts, words, holders, used)
                        used = _hold(region[BACK], low, high, parts, words, holders, used)
                    else:
                        for corner in range(4):
                            label = body.regions[t + tet_shift, LABELS + corner]
                            used = _hold(label, low, high, parts, words, holders, used)
                for k in range(used):
                    f = holders[k]
                    _mark(cells[f], i, j, l, words[f], occupancy)
                    words[f] = 0


@query_kernel
def _hold(label, low, high, parts, words, holders, used):
    """Record that a fragment holds these parts of a cell; returns the number of holders."""
    if low <= label < high:
        if words[label - low] == 0:
            holders[used] = label - low
            used += 1
        words[label - low] |= parts
    return used


@query_kernel
def pyramid_words(cells):
    """Number of words of all levels, for a fragment's cells (7,)."""
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
def ends_of_pyramids(cells):
    """Where the words of fragments with cells (n, 7) end: (n,) int64."""
    ends = np.empty(len(cells), np.int64)
    for i in range(len(cells)):
        ends[i] = cells[i, 6] + pyramid_words(cells[i])
    return ends


@query_kernel
def _fill_pyramid(cells, occupancy):
    """Fill the levels above 0, bottom-up by OR."""
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


@query_kernel
def sphere_may_touch(pools, f, x, y, z, r):
    """False only if no tetrahedron that holds f comes within `r` [m] of the point (body frame).

    Sharper than the paper's eight cells at one level: tests the cells that the sphere's box overlaps, at most SPAN + 1
    along each axis, and at level 0 the parts of them that it overlaps.
    """
    grid = pools.mesh.grid
    k = pools.fragment.mesh[f]
    cells = pools.fragment.cells[f]
    # from here on in units of level-0 cells
    per_cell = 1.0 / grid[k, 3]
    px, py, pz = (x - grid[k, 0]) * per_cell, (y - grid[k, 1]) * per_cell, (z - grid[k, 2]) * per_cell
    r = r * per_cell * (1.0 + ROUNDING) + ROUNDING
    x0, y0, z0 = cells[0], cells[1], cells[2]
    nx, ny, nz = cells[3], cells[4], cells[5]
    begin = cells[6]
    # the part that holds the centre decides most touching spheres
    i, j, l = math.floor(px), math.floor(py), math.floor(pz)  # noqa: E741
    a, b, c = int(i) - x0, int(j) - y0, int(l) - z0
    if 0 <= a < nx and 0 <= b < ny and 0 <= c < nz:
        word = pools.occupancy[begin + (a * ny + b) * nz + c]
        if word and word & part_at(px - i, py - j, pz - l):
            return True
    lowest = 2.0 * r <= SPAN
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
                word = pools.occupancy[begin + (a * ny + b) * nz + c]
                if word:
                    dz = max(c - pz, 0.0, pz - (c + 1))
                    if dz * dz <= left and (not lowest or word & parts_within(px - a, py - b, pz - c, r)):
                        return True
    return False


@query_kernel
def cells_of_boxes(boxes, grid, dims, first_word, cells):
    """Write the cells (n, 7), see FragmentPool.cells, of fragments with bounding boxes (n, 6) [m] in a location grid.

    grid, dims: rows of MeshPool.grid and grid_dims. The words of the fragments are consecutive from `first_word` on.
    Returns the number of words.
    """
    end = first_word
    for i in range(len(boxes)):
        for d in range(3):
            lower = int(min(max(math.floor((boxes[i, d] - grid[d]) / grid[3]), 0.0), dims[d] - 1.0))
            upper = int(min(max(math.floor((boxes[i, 3 + d] - grid[d]) / grid[3]), 0.0), dims[d] - 1.0))
            cells[i, d], cells[i, 3 + d] = lower, upper - lower + 1
        cells[i, 6] = end
        end += pyramid_words(cells[i])
    return end - first_word
