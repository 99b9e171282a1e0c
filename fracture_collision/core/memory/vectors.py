"""Vectors of three numbers: points [m] and directions. Arguments are tuples or arrays, results are tuples.

Of longer arrays the first three entries count. Tuples need no memory, and LLVM inlines these functions. Sums run from
left to right as written: results depend on it to the last bit.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel


@query_kernel
def vector(a, k):
    """Row k of an array (n, 3 or more), its first three columns."""
    return a[k, 0], a[k, 1], a[k, 2]


@query_kernel
def vector_at(a, k):
    """Entries k, k + 1 and k + 2 of an array (n,)."""
    return a[k], a[k + 1], a[k + 2]


@query_kernel
def put(a, k, v):
    """Write v to row k of an array (n, 3 or more), its first three columns."""
    a[k, 0], a[k, 1], a[k, 2] = v[0], v[1], v[2]


@query_kernel
def plus(u, v):
    """The sum u + v."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@query_kernel
def minus(u, v):
    """The difference u - v."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@query_kernel
def opposite(v):
    """The vector -v."""
    return -v[0], -v[1], -v[2]


@query_kernel
def scaled(s, v):
    """The vector s v."""
    return s * v[0], s * v[1], s * v[2]


@query_kernel
def divided(v, s):
    """The vector v / s."""
    return v[0] / s, v[1] / s, v[2] / s


@query_kernel
def plus_scaled(p, s, v):
    """The point p + s v."""
    return p[0] + s * v[0], p[1] + s * v[1], p[2] + s * v[2]


@query_kernel
def between(p, q, share):
    """The point at a share of the segment from p to q."""
    return plus_scaled(p, share, minus(q, p))


@query_kernel
def dot(u, v):
    """The scalar product."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@query_kernel
def cross(u, v):
    """The vector product."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@query_kernel
def length(v):
    """The length of v."""
    return math.sqrt(dot(v, v))


@query_kernel
def distance(p, q):
    """The distance of two points."""
    return length(minus(p, q))


@query_kernel
def corners_of(t):
    """The corners of a triangle (9,)."""
    return vector_at(t, 0), vector_at(t, 3), vector_at(t, 6)


@query_kernel
def area_vector(triangle):
    """Right-handed normal of a triangle, given by its corners; its length is twice the area."""
    a, b, c = triangle
    return cross(minus(b, a), minus(c, a))


@query_kernel
def hash_of(v):
    """A hash of the bits of v; both zeros have the same."""
    h = _bits(v[0]) * 0x1F7B1EA1 ^ _bits(v[1]) * 0x2545F491 ^ _bits(v[2]) * 0x5851F42D
    h = (h ^ (h >> 33)) * 0x62A9D9ED799705F5
    return h ^ (h >> 29)


@query_kernel
def _bits(x):
    return np.float64(x + 0.0).view(np.int64)
