"""The shortest translation that satisfies a few contacts, exactly: over all sets of up to three that bind."""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.vectors import cross, divided, dot, plus_scaled, scaled, vector

MOST_BINDING = 12
# Violations up to this share of the largest need are rounding.
ROUNDING = 1e-9
# Three directions whose determinant is below this are taken as dependent.
DEPENDENT = 1e-6


@kernel
def least_translation(normals, needs):
    """The shortest x (3,) with normals (n, 3) . x >= needs (n,) [m]; and whether there is one.

    Few of many contacts bind: starts with that of the largest need, then adds what is violated most.
    """
    x, order, used = np.zeros(3), np.empty(MOST_BINDING, np.int64), 0
    scale = 0.0
    for need in needs:
        scale = max(scale, need)
    while True:
        worst, most = -1, ROUNDING * scale
        for k in range(len(needs)):
            lacks = needs[k] - dot(vector(normals, k), x)
            if lacks > most:
                worst, most = k, lacks
        if worst < 0:
            return x, True
        if used == MOST_BINDING:
            return x, False
        order[used] = worst
        used += 1
        if not _least_of(normals, needs, order[:used], 0.5 * ROUNDING * scale, x):
            return x, False


@kernel
def _least_of(normals, needs, rows, slack, x):
    """Write the least translation that satisfies `rows` (k,) to x; returns whether there is one."""
    least = math.inf
    for i in range(len(rows)):
        m, of_m = vector(normals, rows[i]), needs[rows[i]]
        least = _better(normals, needs, rows, slack, scaled(of_m, m), least, x)
        for j in range(i):
            n, of_n = vector(normals, rows[j]), needs[rows[j]]
            c = dot(m, n)
            square = 1.0 - c * c
            if square > DEPENDENT * DEPENDENT:
                tried = plus_scaled(scaled((of_m - c * of_n) / square, m), (of_n - c * of_m) / square, n)
                least = _better(normals, needs, rows, slack, tried, least, x)
            for k in range(j):
                do_meet, tried = _meeting(m, n, vector(normals, rows[k]), (of_m, of_n, needs[rows[k]]))
                if do_meet:
                    least = _better(normals, needs, rows, slack, tried, least, x)
    return least < math.inf


@query_kernel
def _meeting(m, n, o, needs):
    """(whether three planes meet in one point, the point)."""
    across = cross(n, o)
    det = dot(m, across)
    if abs(det) < DEPENDENT:
        return False, across
    point = plus_scaled(plus_scaled(scaled(needs[0], across), needs[1], cross(o, m)), needs[2], cross(m, n))
    return True, divided(point, det)


@query_kernel
def _better(normals, needs, rows, slack, tried, least, x):
    """Copy `tried` to x if it satisfies all rows and is shorter than the square `least`; returns the least square."""
    square = dot(tried, tried)
    if not square < least:
        return least
    for r in rows:
        if dot(vector(normals, r), tried) < needs[r] - slack:
            return least
    x[0], x[1], x[2] = tried
    return square
