"""penetration(p; D(f)) from one averaged distance and direction per node: Glondu 2014, section 4.4, eq. 1 and 2.

Symbols of eq. 1-2: p the point; j its neighbours, here the nodes of its tetrahedron; d_j, n_j their stored distance and
unit direction to the nearest surface; w_j = 1 / |p_j - p|^2.

    d = sum w_j (d_j + n_j . (p_j - p)) / sum w_j        n = sum w_j n_j, normalized

d carries no error bound. The certificate uses a separate value: `most`, an upper bound of the point's depth, its
distance from the nearest of some points that are certainly not strictly inside the fragment.
"""

from __future__ import annotations

import math

from fracture_collision.core.field.flood import (
    EVERYTHING,
    NO_SOURCE,
    nearest_in_tetrahedron,
    nothing_within,
    outward_direction,
)
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.pools import OWNER


@query_kernel
def propagated_distance(stored, px, py, pz):
    """Distance [m] to the plane that a node's distance and direction (node_field row) define at the nearest surface.

    (px, py, pz): from the point to the node.
    """
    return stored[0] + stored[1] * px + stored[2] * py + stored[3] * pz


@query_kernel
def whole_body_depth(field, k, x, y, z):
    """Depth [m] in the unbroken body of mesh `k`, trilinear on its dense grid, and its gradient (depth, gx, gy, gz)."""
    grid, dims = field.grid[k], field.grid_dims[k]
    cell = grid[3]
    u, v, w = (x - grid[0]) / cell, (y - grid[1]) / cell, (z - grid[2]) / cell
    i = min(max(int(math.floor(u)), 0), dims[0] - 2)
    j = min(max(int(math.floor(v)), 0), dims[1] - 2)
    l = min(max(int(math.floor(w)), 0), dims[2] - 2)  # noqa: E741
    u, v, w = u - i, v - j, w - l
    a = dims[3] + (i * dims[1] + j) * dims[2] + l
    b = a + dims[1] * dims[2]
    n = dims[2]
    g = field.grid_depth
    # along z, then y, then x; each difference is taken before the next axis is interpolated
    a0, a1 = g[a] + w * (g[a + 1] - g[a]), g[a + n] + w * (g[a + n + 1] - g[a + n])
    b0, b1 = g[b] + w * (g[b + 1] - g[b]), g[b + n] + w * (g[b + n + 1] - g[b + n])
    a2, b2 = a0 + v * (a1 - a0), b0 + v * (b1 - b0)
    za = (1.0 - v) * (g[a + 1] - g[a]) + v * (g[a + n + 1] - g[a + n])
    zb = (1.0 - v) * (g[b + 1] - g[b]) + v * (g[b + n + 1] - g[b + n])
    gx, gy, gz = b2 - a2, (1.0 - u) * (a1 - a0) + u * (b1 - b0), (1.0 - u) * za + u * zb
    return a2 + u * (b2 - a2), gx / cell, gy / cell, gz / cell


@query_kernel
def averaged_penetration(pools, field, f, t, x, y, z):
    """(depth [m], nx, ny, nz, most [m]) of a point that fragment `f` of a broken body owns in tetrahedron `t`.

    depth >= 0, n the unit direction out of f: the witness is the point + depth n. In a tetrahedron crossed by cracks
    both are exact for the surface within it, elsewhere eq. 1-2 over its nodes; capped by the grid of the whole body.
    """
    mesh, body = pools.mesh, pools.body
    best = nearest_in_tetrahedron(pools, f, t, x, y, z, EVERYTHING, nothing_within(math.inf))
    most2 = best[0]
    shift = pools.fragment.node_shift[f]
    d, nx, ny, nz, total = 0.0, 0.0, 0.0, 0.0, 0.0
    at_node = False
    for i in range(4):
        v = mesh.tetrahedra[t, i]
        if body.node_fragment[v + shift] != f:
            continue
        row = field.node_field[v + shift]
        sx, sy, sz = row[4] - x, row[5] - y, row[6] - z
        most2 = min(most2, sx * sx + sy * sy + sz * sz)
        px, py, pz = mesh.nodes[v, 0] - x, mesh.nodes[v, 1] - y, mesh.nodes[v, 2] - z
        r2 = px * px + py * py + pz * pz
        if at_node:
            continue
        if r2 == 0.0:
            at_node = True
            d, nx, ny, nz, total = row[0], row[1], row[2], row[3], 1.0
            continue
        weight = 1.0 / r2
        d += weight * propagated_distance(row, px, py, pz)
        nx, ny, nz = nx + weight * row[1], ny + weight * row[2], nz + weight * row[3]
        total += weight
    most = math.sqrt(most2)
    if best[5] != NO_SOURCE and body.regions[t + pools.fragment.tet_shift[f], OWNER] < 0:
        d = math.sqrt(best[0])
        nx, ny, nz = outward_direction(pools, f, x, y, z, best, True)
    else:
        d = max(d / total, 0.0)
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 0.0:
            nx, ny, nz = nx / length, ny / length, nz / length
        else:
            nx, ny, nz = 0.0, 0.0, 1.0
    cap, gx, gy, gz = whole_body_depth(field, pools.fragment.mesh[f], x, y, z)
    if cap < d:
        d = max(cap, 0.0)
        length = math.sqrt(gx * gx + gy * gy + gz * gz)
        if length > 0.0:
            nx, ny, nz = -gx / length, -gy / length, -gz / length
    return d, nx, ny, nz, most
