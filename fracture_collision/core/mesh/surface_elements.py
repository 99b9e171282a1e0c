"""The triangles of a fragment's surface by elements.

An *element* is a fragment's surface within one tetrahedron of its mesh, a triangle of a rigid mesh, or a side of a box.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import BOX, TRIANGLES
from fracture_collision.core.memory.pools import BACK_SIDE, FRONT_SIDE, NEVER_BROKEN, OWNER, ROW
from fracture_collision.core.memory.rotations import to_other
from fracture_collision.core.mesh.cut_tetrahedron import FACE_VERTICES

# The sides of a box, 2 d at the lower end of axis d and 2 d + 1 at its upper one, by their corners, counter-clockwise
# from outside; bit d of a corner is its end along axis d.
CORNERS_OF_SIDE = np.array([[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]])


@query_kernel
def has_triangle(body, i, f):
    """Whether row `i` of body.triangles belongs to f's surface; one without a plane is degenerate by rounding."""
    return (body.sides[i, FRONT_SIDE] == f or body.sides[i, BACK_SIDE] == f) and not math.isnan(body.faces[i, 3])


@query_kernel
def count_triangles(pools, f, piece):
    """Upper bound of the number of f's triangles in an element: the range of `k` in put_triangle."""
    kind = pools.fragment.kind[f]
    if kind == BOX:
        return 2
    if kind == TRIANGLES:
        return 1
    shift = pools.fragment.tet_shift[f]
    return 4 if shift == NEVER_BROKEN else 4 + pools.body.cut_count[piece + shift]


@query_kernel
def put_triangle(pools, f, piece, k, rotation, translation, out):
    """Write the corners of the k-th triangle of an element, transformed to another frame, to out (9,) [m].

    Corners are counter-clockwise from outside; rotation (3, 3), translation (3,) [m]: to that frame. Returns whether
    the triangle exists.
    """
    kind = pools.fragment.kind[f]
    if kind == TRIANGLES:
        c = pools.triangles.corners[piece]
        _put_moved(rotation, translation, c[0:3], c[3:6], c[6:9], out)
        return True
    if kind == BOX:
        half, corners = pools.fragment.shape[f], CORNERS_OF_SIDE[piece]
        for i in range(3):
            put_box_corner(half, corners[0 if i == 0 else i + k], out[3 * i : 3 * i + 3])
        _put_moved(rotation, translation, out[0:3], out[3:6], out[6:9], out)
        return True
    mesh, body, shift = pools.mesh, pools.body, pools.fragment.tet_shift[f]
    if k < 4:
        if mesh.neighbours[piece, k] >= 0 or (shift != NEVER_BROKEN and body.regions[piece + shift, OWNER] != f):
            return False
        v, w = mesh.tetrahedra[piece], FACE_VERTICES[k]
        _put_moved(rotation, translation, mesh.nodes[v[w[0]]], mesh.nodes[v[w[1]]], mesh.nodes[v[w[2]]], out)
        return True
    i = body.regions[piece + shift, ROW] + k - 4
    if not has_triangle(body, i, f):
        return False
    c = body.triangles[i]
    if body.sides[i, FRONT_SIDE] == f:
        _put_moved(rotation, translation, c[0:3], c[3:6], c[6:9], out)
    else:
        _put_moved(rotation, translation, c[0:3], c[6:9], c[3:6], out)
    return True


@query_kernel
def _put_moved(rotation, translation, p, q, r, out):
    out[0], out[1], out[2] = to_other(rotation, translation, p[0], p[1], p[2])
    out[3], out[4], out[5] = to_other(rotation, translation, q[0], q[1], q[2])
    out[6], out[7], out[8] = to_other(rotation, translation, r[0], r[1], r[2])


@query_kernel
def put_box_corner(half, bits, out):
    """Write a corner [m] of a box with half edges `half`; bit d of `bits`: its end along axis d."""
    for d in range(3):
        out[d] = half[d] if (bits >> d) & 1 else -half[d]
