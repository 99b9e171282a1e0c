"""Bound on the depth of all points of two fragments' surfaces, including those between samples.

Contacts are searched at samples (Glondu 2014, section 6.3); between these, edges cross each other. So that nothing is
missed, either all of both surfaces is shown to be no deeper than a little more than the deepest contact, or a deeper
point is found. An element of a surface (surface_elements.py) is no deeper than s if it avoids the other fragment once
it is displaced by s; other elements are searched by bisection (surface_search.py). Before that, whole pairs are settled
by how far they have moved since they broke, and by the overlap of their hulls along a contact's normal: no point of
either is deeper than that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.known_samples import rounding_slack, share_a_body
from fracture_collision.core.memory.compiled import inlined_kernel, query_kernel
from fracture_collision.core.memory.kinds import TETRAHEDRA
from fracture_collision.core.memory.rotations import rotated, to_other
from fracture_collision.core.mesh.occupancy import sphere_may_touch
from fracture_collision.core.mesh.surface_elements import count_triangles, put_triangle
from fracture_collision.core.search.neighbour_lists import IN_PLACE, displacement
from fracture_collision.core.separation.leaf_separation import parting_plane_of_leaves
from fracture_collision.core.surfaces.surface_avoidance import (
    gather_near,
    hull_avoids,
    room_for_rounding,
)
from fracture_collision.core.surfaces.surface_search import (
    Margins,
    along,
    inward,
    middle_of,
    moved_triangle_avoids,
    search_triangle,
)
from fracture_collision.core.tree.sample_leaves import farthest_sample, leaves_of

# Shares of epsilon, beyond the deepest contact's depth: the depth bound to prove, where possible; the depth from which
# a point is listed; the resolution of the search. The last two sum to epsilon, less an allowance for rounding.
SHOWN, LISTED, FINEST = 0.6, 0.9, 0.09
# Maximum number of points queried per pair. If they do not suffice, only the thickness of the two bounds the depth.
MOST_ASKED = 1_000_000
# Resolution of the search for the deepest point of a triangle, as a share of epsilon.
SHARPEST = 0.05
NOBODY = -1


class Judgement(NamedTuple):
    """Result for a pair."""

    bound: float  # [m] no point is deeper than the larger of this and `depth`; infinity: MOST_ASKED did not suffice
    depth: float  # [m] of the deepest point found, or of the deepest contact, no less than 0
    side: int  # side of that point (0: a), NOBODY: none was found
    piece: int  # piece of its element
    triangle: int  # its triangle there, see surface_elements.put_triangle
    asked: int  # points queried


@query_kernel
def judge_surfaces(pools, elements, pair, deepest, normal, epsilon, scratch):
    """The Judgement of the surfaces of a Pair.

    elements: Elements of both. deepest [m]: the depth of their deepest contact; negative: none touches. normal (x, y,
    z): its normal, unit, out of b in b's frame; zeros: there is none. epsilon [m]: a point that is deeper by LISTED
    epsilon is found; then surface_work.best (3,) [m] is its place in the frame of the other fragment.
    """
    a, b, rotation, translation = pair
    slack = rounding_slack(pools, a, b, translation)
    deepest, shown, listed = max(deepest, 0.0), SHOWN * epsilon, LISTED * epsilon
    if share_a_body(pools, a, b):
        apart = displacement(pools, pair, IN_PLACE) + slack
        if apart <= deepest + listed:
            return Judgement(apart, deepest, NOBODY, 0, 0, 0)
    normal, low, high, rounding = _extents_of_hulls(pools, pair, normal, slack, scratch)
    overlap = high - low + rounding
    if overlap <= deepest + listed:
        return Judgement(overlap, deepest, NOBODY, 0, 0, 0)
    best, stack, deeper = scratch.surface_work.best, scratch.surface_work.stack, scratch.surface_work.found
    bound, side_of, piece_of, triangle_of, asked = deepest + shown, NOBODY, 0, 0, 0
    for side in range(2):
        own, other = (a, b) if side == 0 else (b, a)
        way, highest = _way_out(pair, side, normal, low, high)
        highest += rounding
        origin, corner_slack = elements.origin[own], room_for_rounding(pools, other, own)
        ox, oy, oz = to_other(rotation[side], translation[side], origin[0], origin[1], origin[2])
        for e in range(elements.begin[own], elements.end[own]):
            sphere = elements.spheres[e]
            x, y, z = rotated(rotation[side], np.float64(sphere[0]), np.float64(sphere[1]), np.float64(sphere[2]))
            x, y, z, r = x + ox, y + oy, z + oz, np.float64(sphere[3]) + corner_slack
            if not _may_be_deeper(pools, other, (x, y, z, r), deepest + listed, way, highest):
                continue
            s = deepest + shown
            near = scratch.heap_tet[: gather_near(pools, other, (x, y, z, r + s), corner_slack, scratch)]
            shift, room = along(way, s), scratch.surface_work.points
            points = room[: _put_corners(elements, e, rotation[side], (ox, oy, oz), shift, room)]
            ball = x + shift[0], y + shift[1], z + shift[2], r
            if len(near) == 0 or hull_avoids(pools, other, near, points, way, ball, corner_slack):
                bound = max(bound, s)
                continue
            piece, count = elements.piece[e], len(near)
            for k in range(count_triangles(pools, own, piece)):
                if not put_triangle(pools, own, piece, k, rotation[side], translation[side], stack[0]):
                    continue
                s = deepest + shown
                if count < 0:
                    count = gather_near(pools, other, (x, y, z, r + s), corner_slack, scratch)
                near, p = scratch.heap_tet[:count], stack[0]
                ball = middle_of(p)
                if moved_triangle_avoids(
                    pools, other, near, p, along(way, s), ball, corner_slack, scratch
                ) or moved_triangle_avoids(
                    pools, other, near, p, along(inward(p), s), ball, corner_slack, scratch
                ):
                    bound = max(bound, s)
                    continue
                margins = Margins(shown, listed, FINEST * epsilon, MOST_ASKED - asked)
                most, depth, more = search_triangle(
                    pools, other, deepest, margins, way, corner_slack, deeper, scratch
                )
                bound, asked, count = max(bound, most), asked + more, -1  # the search overwrites them
                if depth > deepest:
                    deepest, side_of, piece_of, triangle_of = depth, side, piece, k
                    best[0], best[1], best[2] = deeper[0], deeper[1], deeper[2]
                if most == math.inf:
                    return Judgement(most, deepest, side_of, piece_of, triangle_of, asked)
    return Judgement(bound + slack, deepest, side_of, piece_of, triangle_of, asked)


@inlined_kernel
def _extents_of_hulls(pools, pair, normal, slack, scratch):
    """Extents of the hulls of a Pair along `normal` or, if that is zeros, along a separating direction.

    Returns (unit vector in b's frame, the lowest of a along it, the highest of b, rounding), all but the first [m].
    """
    leaves = leaves_of(pools, pair.a), leaves_of(pools, pair.b)
    rounding = slack + leaves[0].middle[3] + leaves[1].middle[3]
    if normal[0] == 0.0 and normal[1] == 0.0 and normal[2] == 0.0:
        # no warm start: the same poses must give the same direction
        toward = scratch.point
        toward[0] = toward[1] = toward[2] = 0.0
        normal, low, high = parting_plane_of_leaves(pools, pair, leaves, rounding, toward, scratch.along)
    else:
        low, high = _extents(leaves, pair.rotation, pair.translation, normal, scratch.along)
    return normal, low, high, rounding


@inlined_kernel
def _way_out(pair, side, normal, low, high):
    """Direction out of the other fragment, in its frame, for elements of a side.

    Returns (unit vector, how far the other extends along it [m]).
    """
    if side == 0:
        return normal, high
    x, y, z = rotated(pair.rotation[1], -normal[0], -normal[1], -normal[2])
    t = pair.translation[1]
    return (x, y, z), x * t[0] + y * t[1] + z * t[2] - low


@inlined_kernel
def _extents(leaves, rotation, translation, n, bounds):
    """(lowest of a, highest of b) [m] along a unit vector n of b's frame, as in parting_plane_of_leaves.

    leaves: Leaves of a and of b.
    """
    of_a, of_b = leaves
    _, reach = farthest_sample(of_b, n, 0, bounds)
    high = n[0] * of_b.middle[0] + n[1] * of_b.middle[1] + n[2] * of_b.middle[2] + np.float64(reach)
    own, m, t = rotated(rotation[1], -n[0], -n[1], -n[2]), of_a.middle, translation[0]
    _, reach = farthest_sample(of_a, own, 0, bounds)
    middle = own[0] * m[0] + own[1] * m[1] + own[2] * m[2]
    return n[0] * t[0] + n[1] * t[1] + n[2] * t[2] - middle - np.float64(reach), high


@inlined_kernel
def _may_be_deeper(pools, f, ball, depth, way, highest):
    """Whether a point in a ball (x, y, z, r) [m] may be deeper than `depth` [m] in fragment f.

    way: unit vector; all of f is below `highest` [m] along it.
    """
    x, y, z, r = ball
    inner, box = r - depth, pools.fragment.box[f]
    if way[0] * x + way[1] * y + way[2] * z - highest >= inner:
        return False
    if box[0] - x >= inner or box[1] - y >= inner or box[2] - z >= inner:
        return False
    if x - box[3] >= inner or y - box[4] >= inner or z - box[5] >= inner:
        return False
    return pools.fragment.kind[f] != TETRAHEDRA or sphere_may_touch(pools, f, x, y, z, r)


@inlined_kernel
def _put_corners(elements, e, rotation, origin, shift, points):
    """Write the corners of element `e`, transformed to another frame and displaced, to `points` (., 3) [m].

    rotation (3, 3): to that frame; origin (x, y, z) [m]: where Elements.origin is there; shift (x, y, z) [m]: the
    displacement. Returns the rows used.
    """
    mx, my, mz = shift
    ox, oy, oz = origin
    count, first = 0, elements.first[e]
    for k in range(first, elements.first[e + 1]):
        p = elements.corners[k]
        px, py, pz = rotated(rotation, np.float64(p[0]), np.float64(p[1]), np.float64(p[2]))
        points[count, 0], points[count, 1], points[count, 2] = px + ox + mx, py + oy + my, pz + oz + mz
        count += 1
    return count
