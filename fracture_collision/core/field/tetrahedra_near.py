"""Tetrahedra that hold part of a fragment near a point, by the cells of the location grid; marks of those visited."""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.mesh.occupancy import ROUNDING, parts_within
from fracture_collision.core.mesh.point_location import holds_fragment


@query_kernel
def next_stamp(scratch):
    """A stamp that no entry of `visited` holds."""
    if scratch.stamp[0] == np.iinfo(np.int32).max:
        scratch.visited[:] = 0
        scratch.stamp[0] = 0
    scratch.stamp[0] += 1
    return scratch.stamp[0]


@query_kernel
def tetrahedra_near(pools, f, x, y, z, limit, scratch):
    """Find the tetrahedra that hold part of f and may be within `limit` [m] of a point.

    Writes them to scratch.heap_tet and returns their number. None is missed: the parts of the location grid's cells
    bound them.
    """
    mesh, k = pools.mesh, pools.fragment.mesh[f]
    near, visited, stamp, count = scratch.heap_tet, scratch.visited, next_stamp(scratch), 0
    nx, ny, nz, first = mesh.grid_dims[k]
    cells = pools.fragment.cells[f]
    per_cell = 1.0 / mesh.grid[k, 3]
    px, py, pz = (x - mesh.grid[k, 0]) * per_cell, (y - mesh.grid[k, 1]) * per_cell, (z - mesh.grid[k, 2]) * per_cell
    r = limit * per_cell * (1.0 + ROUNDING) + ROUNDING
    i0, i1 = max(math.floor(px - r), cells[0]), min(math.floor(px + r), cells[0] + cells[3] - 1)
    j0, j1 = max(math.floor(py - r), cells[1]), min(math.floor(py + r), cells[1] + cells[4] - 1)
    l0, l1 = max(math.floor(pz - r), cells[2]), min(math.floor(pz + r), cells[2] + cells[5] - 1)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for l in range(l0, l1 + 1):  # noqa: E741
                bit = ((i - cells[0]) * cells[4] + (j - cells[1])) * cells[5] + (l - cells[2])
                word = pools.occupancy[cells[6] + bit]
                if not word:
                    continue
                within = word & parts_within(px - i, py - j, pz - l, r)
                if not within:
                    continue
                c = first + (i * ny + j) * nz + l
                for e in range(mesh.cell_begin[c], mesh.cell_begin[c + 1]):
                    t = mesh.cell_tets[e]
                    if mesh.cell_parts[e] & within and visited[t] != stamp:
                        visited[t] = stamp
                        if holds_fragment(pools, f, t):
                            near[count] = t
                            count += 1
    return count
