"""The shortest translation that satisfies a few contacts, exactly: over all sets of up to three that bind."""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel

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
            lacks = needs[k] - (normals[k, 0] * x[0] + normals[k, 1] * x[1] + normals[k, 2] * x[2])
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
    least, tried = math.inf, np.empty(3)
    for i in range(len(rows)):
        m = normals[rows[i]]
        for d in range(3):
            tried[d] = needs[rows[i]] * m[d]
        least = _better(normals, needs, rows, slack, tried, least, x)
        for j in range(i):
            n = normals[rows[j]]
            c = m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
            square = 1.0 - c * c
            if square > DEPENDENT * DEPENDENT:
                of_m = (needs[rows[i]] - c * needs[rows[j]]) / square
                of_n = (needs[rows[j]] - c * needs[rows[i]]) / square
                for d in range(3):
                    tried[d] = of_m * m[d] + of_n * n[d]
                least = _better(normals, needs, rows, slack, tried, least, x)
            for k in range(j):
                if _meeting(m, n, normals[rows[k]], (needs[rows[i]], needs[rows[j]], needs[rows[k]]), tried):
                    least = _better(normals, needs, rows, slack, tried, least, x)
    return least < math.inf


@query_kernel
def _meeting(m, n, o, needs, out):
    """Write the point where three planes meet; returns whether they do in one."""
    det = 0.0
    for d in range(3):
        e, f = (d + 1) % 3, (d + 2) % 3
        det += m[d] * (n[e] * o[f] - n[f] * o[e])
    if abs(det) < DEPENDENT:
        return False
    for d in range(3):
        e, f = (d + 1) % 3, (d + 2) % 3
        out[d] = needs[0] * (n[e] * o[f] - n[f] * o[e]) + needs[1] * (o[e] * m[f] - o[f] * m[e])
        out[d] = (out[d] + needs[2] * (m[e] * n[f] - m[f] * n[e])) / det
    return True


@query_kernel
def _better(normals, needs, rows, slack, tried, least, x):
    """Copy `tried` to x if it satisfies all rows and is shorter than the square `least`; returns the least square."""
    square = tried[0] * tried[0] + tried[1] * tried[1] + tried[2] * tried[2]
    if not square < least:
        return least
    for r in rows:
        if normals[r, 0] * tried[0] + normals[r, 1] * tried[1] + normals[r, 2] * tried[2] < needs[r] - slack:
            return least
    x[0], x[1], x[2] = tried[0], tried[1], tried[2]
    return square
