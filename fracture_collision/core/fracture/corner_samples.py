"""Samples where cracks meet: hubs and face points of tetrahedra shared by three or more fragments.

Glondu 2014, section 6.3, samples a crack where it crosses edges of the mesh. Where three fragments meet, their borders
have corners in between (cut_tetrahedron.py), the sharpest ones of fresh shards, and an unsampled corner penetrates
undetected. Other hubs lie between samples: the hub of two fragments is the mean of crossings that both have, the hub of
three made at once is half-way between two of their face points. So are the points that neighbours' cracks add to a
fragment's border later. The hull of a fragment's samples contains its whole surface.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.fracture.cut_patterns import FACE_NODES, GROUP, GROUPS
from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.mesh.cut_tetrahedron import FACE_POINT, HUB
from fracture_collision.core.mesh.sample_numbers import FIRST_NODE, OF_FACE, OF_HUB, NewSamples, corner_number

# Corners of a tetrahedron, counted once per fragment: a hub of four fragments, and four face points of three.
MOST_CORNERS = 16


@kernel
def room_for_corners(tetrahedra):
    """NewSamples with capacity for the corners of `tetrahedra` tetrahedra."""
    count = MOST_CORNERS * tetrahedra
    return NewSamples(
        np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.int32)
    )


@query_kernel
def add_corners(mesh, broken, t, work, pattern, at_once, new, used):
    """Append to `new` the corners that the new fragments of a Broken have in tetrahedron t; returns its new length.

    work, pattern: the divided tetrahedron; at_once: divided by one fracture.
    Face points are numbered with one of the two tetrahedra that share them.
    """
    if GROUPS[pattern] < 3:
        return used
    first = mesh.first[broken.mesh]
    for i in range(4):
        if GROUP[pattern, i] == i and not (at_once and GROUPS[pattern] == 3):
            number = corner_number(first, t, OF_HUB)
            used = _append(mesh, broken, t, (i, work.labels[i], number), work.points[HUB], new, used)
    for face in range(4):
        v = FACE_NODES[pattern, face]
        a, b, c = GROUP[pattern, v[0]], GROUP[pattern, v[1]], GROUP[pattern, v[2]]
        if a in (b, c) or b == c or 0 <= mesh.neighbours[t, face] < t:
            continue
        number = corner_number(first, t, OF_FACE + face)
        for k in range(3):
            point = work.points[FACE_POINT + face]
            used = _append(mesh, broken, t, (v[k], work.labels[v[k]], number), point, new, used)
    return used


@query_kernel
def _append(mesh, broken, t, corner, point, new, used):
    """Append a corner to `new` at row `used` if its fragment is one of the Broken's new ones; returns the new length.

    corner: (node of the tetrahedron, its fragment, sample number).
    """
    i, label, number = corner
    if broken.first <= label < broken.end:
        for d in range(3):
            new.points[used, d] = point[d]
        new.samples[used], new.parts[used] = number, label - broken.first
        new.parents[used] = mesh.tetrahedra[t, i] - mesh.first[broken.mesh, FIRST_NODE]
        return used + 1
    return used
