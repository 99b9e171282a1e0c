"""All triangles that queries measure a fragment's surface by, in pool order: for tests and plots.

Triangles without area are left out, so that others may end in the middle of a side; core/fracture/closed_surface.py has
a surface whose triangles share all sides.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.memory.pools import BACK_SIDE, FRONT_SIDE, NEVER_BROKEN, OWNER, ROW, Pools
from fracture_collision.core.mesh.cut_tetrahedron import FACE_VERTICES
from fracture_collision.core.mesh.point_location import holds_fragment

# Initial capacity in triangles; a fragment that has more is collected again.
FIRST_ROOM = 4096


@kernel
def _collect(pools, f, first_tet, last_tet, out, crack):
    """Write the triangles to out (n, 9) as far as it has room; returns their total number."""
    mesh, body = pools.mesh, pools.body
    shift = pools.fragment.tet_shift[f]
    used = 0
    for t in range(first_tet, last_tet):
        if not holds_fragment(pools, f, t):
            continue
        if shift == NEVER_BROKEN or body.regions[t + shift, OWNER] >= 0:
            for face in range(4):
                if mesh.neighbours[t, face] < 0:
                    if used < len(out):
                        for i in range(3):
                            out[used, 3 * i : 3 * i + 3] = mesh.nodes[mesh.tetrahedra[t, FACE_VERTICES[face, i]]]
                        crack[used] = 0
                    used += 1
        if shift == NEVER_BROKEN:
            continue
        begin = body.regions[t + shift, ROW]
        for i in range(begin, begin + body.cut_count[t + shift]):
            # a triangle without a plane is degenerate by rounding
            if (body.sides[i, FRONT_SIDE] != f and body.sides[i, BACK_SIDE] != f) or math.isnan(body.faces[i, 3]):
                continue
            if used < len(out):
                out[used] = body.triangles[i]
                if body.sides[i, FRONT_SIDE] != f:
                    out[used, 3:6] = body.triangles[i, 6:9]
                    out[used, 6:9] = body.triangles[i, 3:6]
                crack[used] = 0 if body.sides[i, BACK_SIDE] < 0 else 1
            used += 1
    return used


def surface_triangles(pools: Pools, row: int, tets: range) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3, 3) [m], counter-clockwise from outside, and is_crack (n,) of a tetrahedral fragment.

    `tets`: the rows of its body's mesh.
    """
    room, count = 0, FIRST_ROOM
    while count > room:
        room = count
        out, crack = np.empty((room, 9)), np.empty(room, np.uint8)
        count = _collect(pools, row, tets.start, tets.stop, out, crack)
    return out[:count].reshape(-1, 3, 3), crack[:count].astype(np.bool_)
