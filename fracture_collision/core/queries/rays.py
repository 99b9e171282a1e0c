"""The first surface that a ray meets, of all fragments of a step.

A ray meets a triangle where it passes its three sides the same way round. The volumes that tell this (Plucker
coordinates) are equal for two triangles with a common side, up to the sign, to the last bit: no ray slips through
between them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel
from fracture_collision.core.memory.kinds import PLANE, SPHERE
from fracture_collision.core.memory.transforms import rotated, turned_back
from fracture_collision.core.memory.vectors import (
    corners_of,
    cross,
    divided,
    dot,
    minus,
    plus_scaled,
    vector,
    vector_at,
)
from fracture_collision.core.mesh.closest_point import unit_normal
from fracture_collision.core.mesh.ray_crossings import may_meet_box

NOTHING = -1


class PlacedFragments(NamedTuple):
    """The n fragments of a step under a hierarchy of their world boxes; unbounded ones come after those in the tree."""

    rows: np.ndarray  # (n,) int64 of FragmentPool, in the order of the leaves
    positions: np.ndarray  # (n, 3) [m]
    rotations: np.ndarray  # (n, 3, 3) body frame to world
    node_box: np.ndarray  # (b, 6) [m]
    node_skip: np.ndarray  # (b,) int32
    node_first: np.ndarray  # (b,) int32
    node_count: np.ndarray  # (b,) int32
    bounded: int  # how many are in the tree


@kernel
def first_hits(pools, trees, placed, rays, out):
    """Write the first hit of each ray: its fragment's place in `placed`, or NOTHING, distance [m], and outward normal.

    trees: SurfaceTrees; placed: PlacedFragments; rays: origins (n, 3) [m] and unit directions (n, 3);
    out: (n,) int64, (n,) float64, (n, 3) float64.
    """
    (origins, directions), (hits, distances, normals) = rays, out
    for r in range(len(origins)):
        ray = vector(origins, r), vector(directions, r)
        found = NOTHING, math.inf, (0.0, 0.0, 0.0)
        for k in range(placed.bounded, len(placed.rows)):
            found = _nearer(pools, trees, placed, k, ray, found)
        node = 0
        while node < len(placed.node_box):
            if not may_meet_box(placed.node_box[node], ray[0], ray[1], found[1]):
                node = placed.node_skip[node]
                continue
            for k in range(placed.node_first[node], placed.node_first[node] + placed.node_count[node]):
                found = _nearer(pools, trees, placed, k, ray, found)
            node += 1
        hits[r], distances[r], n = found
        normals[r, 0], normals[r, 1], normals[r, 2] = n


@query_kernel
def _nearer(pools, trees, placed, k, ray, found):
    """(place, distance [m], normal) of the hit with fragment k, if that is nearer than the hit `found`."""
    rotation, (origin, direction) = placed.rotations[k], ray
    o, d = turned_back(rotation, minus(origin, vector(placed.positions, k))), turned_back(rotation, direction)
    distance, n = _first_of(pools, trees, placed.rows[k], o, d, found[1])
    if distance < found[1]:
        return k, distance, rotated(rotation, n)
    return found


@query_kernel
def _first_of(pools, trees, row, o, d, best):
    """(distance [m], outward normal) of a fragment's first hit, in its body frame; `best` [m] if none is nearer."""
    kind, shape = pools.fragment.kind[row], pools.fragment.shape[row]
    if kind == PLANE:
        n = vector_at(shape, 0)
        toward = dot(n, d)
        distance = (shape[3] - dot(n, o)) / toward if toward != 0.0 else math.inf
        return (distance, n) if 0.0 <= distance < best else (best, n)
    if kind == SPHERE:
        return _first_of_sphere(shape[0], o, d, best)
    node, end = trees.node_range[row]
    found, at = NOTHING, best
    while node < end:
        if not may_meet_box(trees.node_box[node], o, d, at):
            node = trees.node_skip[node]
            continue
        for t in range(trees.node_first[node], trees.node_first[node] + trees.node_count[node]):
            distance = _along(o, d, corners_of(trees.corners[t]))
            if distance < at:
                found, at = t, distance
        node += 1
    if found == NOTHING:
        return best, d
    return at, unit_normal(corners_of(trees.corners[found]))


@query_kernel
def _first_of_sphere(radius, o, d, best):
    """_first_of for a sphere about the origin."""
    middle = -dot(o, d)
    across = plus_scaled(o, middle, d)
    square = radius * radius - dot(across, across)
    if not square >= 0.0:
        return best, d
    half = math.sqrt(square)
    distance = middle - half if middle - half >= 0.0 else middle + half
    if not 0.0 <= distance < best:
        return best, d
    return distance, divided(plus_scaled(o, distance, d), radius)


@query_kernel
def _along(o, d, triangle):
    """Distance [m] at which a ray meets a triangle, from either side; infinity: it does not."""
    p, q, r = minus(triangle[0], o), minus(triangle[1], o), minus(triangle[2], o)
    u, v, w = dot(d, cross(q, r)), dot(d, cross(r, p)), dot(d, cross(p, q))
    if not ((u >= 0.0 and v >= 0.0 and w >= 0.0) or (u <= 0.0 and v <= 0.0 and w <= 0.0)):
        return math.inf
    n = cross(minus(triangle[1], triangle[0]), minus(triangle[2], triangle[0]))
    toward = dot(n, d)
    if toward == 0.0:
        return math.inf
    distance = dot(n, p) / toward
    return distance if distance >= 0.0 else math.inf

