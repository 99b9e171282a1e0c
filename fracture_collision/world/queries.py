"""Questions about the fragments of a step beside their contacts: rays, closest points, which points are inside.

Depths, distances and normals are those of the exact surfaces, cracks included, whatever `method` the contacts have.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.kinds import PLANE
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.mesh.triangle_field import build_hierarchy
from fracture_collision.core.pair.broad_phase import world_boxes
from fracture_collision.core.queries.closest_points import closest, contained
from fracture_collision.core.queries.distances import make_room, pair_distances
from fracture_collision.core.queries.overlaps import box_overlaps
from fracture_collision.core.queries.rays import NOTHING, PlacedFragments, first_hits
from fracture_collision.core.queries.surface_trees import SurfaceTrees
from fracture_collision.core.search.scratch import make_scratch
from fracture_collision.portable_math import lengths, products
from fracture_collision.records import documented
from fracture_collision.world.gates.checks import LARGEST_LENGTH, floats, identifier, refuse
from fracture_collision.world.present import Present

ROUNDING = 1e-12  # of places in the world, as a share
# Fragments so near to each other, as a share of R, touch; how often one is advanced at most: it needs a few dozen.
TOUCHING, MOST_ADVANCES = 1e-7, 1000


@documented
class RayHits(NamedTuple):
    """What n rays meet first.

    Fields:
      fragment_ids: (n,) int64, -1 where a ray meets nothing
      distances: (n,) float64 [m] from the origin; infinity where a ray meets nothing
      normals: (n, 3) float64, outward normal of the surface there, world; zeros where a ray meets nothing
    """

    fragment_ids: np.ndarray
    distances: np.ndarray
    normals: np.ndarray


@documented
class ClosestPoints(NamedTuple):
    """The points of a fragment's surface that are nearest to n points.

    Fields:
      distances: (n,) float64 [m], negative inside the fragment: minus the depth
      points: (n, 3) float64 [m] of the surface, world
      normals: (n, 3) float64, unit, world, from the surface outward: along the shortest way
    """

    distances: np.ndarray
    points: np.ndarray
    normals: np.ndarray


@documented
class Distances(NamedTuple):
    """How far the fragments of p pairs are from each other.

    Fields:
      distances: (p,) float64 [m]; negative where they overlap: minus the depth of the deepest contact, which `points_a`
        and `points_b` are of
      points_a: (p, 3) float64 [m] the point of the first that is nearest to the second, world
      points_b: (p, 3) float64 [m] likewise of the second
    """

    distances: np.ndarray
    points_a: np.ndarray
    points_b: np.ndarray


@documented
class Overlaps(NamedTuple):
    """Which fragments overlap boxes: m overlaps, by ascending box, then by ascending id.

    Fields:
      boxes: (m,) int64, indices of boxes
      fragment_ids: (m,) int64
    """

    boxes: np.ndarray
    fragment_ids: np.ndarray


@documented
class Sweep(NamedTuple):
    """What a fragment that moves along a straight line touches first.

    Fields:
      share: float, of the way before it touches; infinity if it touches nothing
      fragment_id: int, of what it touches, -1: nothing
      point: (3,) float64 [m] of what it touches, world; zeros: nothing
      normal: (3,) float64, unit, world, from there to the moving fragment; zeros: nothing, or they overlap at the start
    """

    share: float
    fragment_id: int
    point: np.ndarray
    normal: np.ndarray


def places_of(here: Present, pairs: np.ndarray) -> np.ndarray:
    """Indices (k, 2) of fragments (k, 2) among those that take part. Raises InvalidMessage if one does not."""
    absent = np.setdiff1d(pairs, here.ids)
    if len(absent):
        refuse("unknown_id", f"pairs: fragment {absent[0]} does not take part at these states")
    return np.searchsorted(here.ids, pairs)


def place_of(here: Present, fragment_id: int) -> int:
    """Index of a fragment among those that take part. Raises InvalidMessage if it does not."""
    number = identifier("fragment_id", fragment_id)
    k = int(np.searchsorted(here.ids, number))
    if k == len(here.ids) or here.ids[k] != number:
        refuse("unknown_id", f"fragment_id: {number} does not take part at these states")
    return k


def distances(pools: Pools, trees: SurfaceTrees, here: Present, pairs: np.ndarray, crew: Crew) -> Distances:
    """Of pairs (p, 2), indices of fragments `here`; 0 where they overlap. Raises InvalidMessage for two planes."""
    is_plane = pools.fragment.kind[here.rows] == PLANE
    both = np.flatnonzero(is_plane[pairs].all(axis=1))
    if len(both):
        a, b = here.ids[pairs[both[0]]]
        refuse("out_of_range", f"pairs: {a} and {b} are unbounded planes, which have no distance")
    found = Distances(np.empty(len(pairs)), np.empty((len(pairs), 3)), np.empty((len(pairs), 3)))
    placed = here.rows, here.positions, here.rotations
    rooms = [make_room(_scratch(pools)) for _ in range(crew.threads)]
    crew.share(pair_distances, pools, trees, placed, pairs, tuple(found), own=rooms)
    return found


def check_way(pools: Pools, here: Present, fragment_id: int, way: np.ndarray) -> np.ndarray:
    """The way (3,) [m] of a fragment. Raises InvalidMessage if it is none, or the fragment is an unbounded plane."""
    given = floats("way", way, 3, LARGEST_LENGTH)
    if len(given) != 1 or not lengths(given[0]) > 0.0:
        refuse("out_of_range", "way: needs one vector (3,) that is not 0")
    if pools.fragment.kind[here.rows[place_of(here, fragment_id)]] == PLANE:
        refuse("out_of_range", f"fragment_id: {fragment_id} is an unbounded plane, which cannot move")
    return given[0]


def sweep(pools: Pools, trees: SurfaceTrees, here: Present, k: int, way: np.ndarray, crew: Crew) -> Sweep:
    """What the k-th fragment touches first on its way (3,) [m], by conservative advancement (Mirtich 1996).

    It is moved by the distance from what is nearest, which it cannot touch before, until that is TOUCHING of R or less.
    """
    length = float(lengths(way))
    touching = TOUCHING * float(pools.fragment.radius[here.rows[k]])
    others = np.delete(np.arange(len(here.ids)), k)
    share = 0.0
    for advance in range(MOST_ADVANCES):
        there = here._replace(positions=here.positions.copy())
        there.positions[k] += share * way
        found = distances(pools, trees, there, np.column_stack((np.full(len(others), k), others)), crew)
        is_near = found.distances <= (1.0 - share) * length + touching
        if not is_near.any():
            break
        nearest = int(np.argmin(found.distances))
        distance, point = float(found.distances[nearest]), found.points_b[nearest]
        if distance <= touching or advance + 1 == MOST_ADVANCES:  # so slow only where it slides along another
            away = found.points_a[nearest] - point
            return Sweep(share, int(here.ids[others[nearest]]), point, away / distance if distance > 0.0 else away)
        share += (distance - 0.5 * touching) / length  # which leaves a line between the two, for the normal
        others = others[is_near]
    return Sweep(np.inf, NOTHING, np.zeros(3), np.zeros(3))


def cast_rays(pools: Pools, trees: SurfaceTrees, here: Present, origins: np.ndarray, directions: np.ndarray) -> RayHits:
    """The first surface that each ray meets. Raises InvalidMessage for directions of length 0, and other sizes."""
    origins, directions = floats("origins", origins, 3, LARGEST_LENGTH), floats("directions", directions, 3)
    if len(origins) != len(directions):
        refuse("wrong_size", f"directions: {len(directions)} for {len(origins)} origins")
    length = lengths(directions)
    if len(length) and not length.min() > 0.0:
        refuse("out_of_range", f"directions: ray {int(np.argmin(length))} has a direction of length 0")
    placed, order = _placed(pools, here)
    hits, distances, normals = np.empty(len(origins), np.int64), np.empty(len(origins)), np.empty((len(origins), 3))
    first_hits(pools, trees, placed, (origins, directions / length[:, None]), (hits, distances, normals))
    ids = np.append(here.ids[order], NOTHING)  # which is the last
    return RayHits(ids[hits], distances, normals)


def overlaps(pools: Pools, trees: SurfaceTrees, here: Present, boxes: np.ndarray) -> Overlaps:
    """Of boxes (k, 6) [m], lower and upper corner, world. Raises InvalidMessage if one is inside out."""
    given = floats("boxes", boxes, 6, LARGEST_LENGTH)
    wrong = np.flatnonzero((given[:, :3] > given[:, 3:]).any(axis=1))
    if len(wrong):
        refuse("out_of_range", f"boxes: box {wrong[0]} has its lower corner, the first three, above the upper one")
    placed, order = _placed(pools, here)
    out, scratch, count = np.empty((0, 2), np.int64), _scratch(pools), len(given)
    while count > len(out):
        out = np.empty((count, 2), np.int64)
        count = box_overlaps(pools, trees, placed, given, scratch, out)
    box, ids = out[:count, 0], here.ids[order[out[:count, 1]]]
    ascending = np.lexsort((ids, box))
    return Overlaps(box[ascending], ids[ascending])


def closest_points(pools: Pools, trees: SurfaceTrees, here: Present, k: int, points: np.ndarray) -> ClosestPoints:
    """Those of the k-th fragment to points (n, 3) [m], world."""
    row, rotation = int(here.rows[k]), here.rotations[k]
    local = _in_body(here, k, points)
    distances, nearest, normals = np.empty(len(local)), np.empty_like(local), np.empty_like(local)
    closest(pools, trees, row, local, _scratch(pools), (distances, nearest, normals))
    return ClosestPoints(distances, products(nearest, rotation.T) + here.positions[k], products(normals, rotation.T))


def contains(pools: Pools, here: Present, k: int, points: np.ndarray) -> np.ndarray:
    """Which of the points (n, 3) [m], world, the k-th fragment contains: (n,) bool."""
    local = _in_body(here, k, points)
    out = np.empty(len(local), np.bool_)
    contained(pools, int(here.rows[k]), local, _scratch(pools), out)
    return out


def _in_body(here: Present, k: int, points: np.ndarray) -> np.ndarray:
    given = floats("points", points, 3, LARGEST_LENGTH)
    return np.ascontiguousarray(products(given - here.positions[k], here.rotations[k]))


def _scratch(pools: Pools):
    return make_scratch(len(pools.mesh.tetrahedra), 1)


def _placed(pools: Pools, here: Present) -> tuple[PlacedFragments, np.ndarray]:
    """The fragments under a tree of their boxes, and their order there: rows of `here`."""
    fragment, boxes = pools.fragment, np.empty((len(here.rows), 6))
    margins = ROUNDING * (fragment.radius[here.rows] + np.abs(here.positions).sum(axis=1))
    world_boxes(fragment.box, here.rows, here.rotations, here.positions, margins, boxes)
    is_bounded = fragment.kind[here.rows] != PLANE
    bounded, order = np.flatnonzero(is_bounded), np.flatnonzero(~is_bounded)
    node_box, nothing = np.empty((0, 6)), np.empty(0, np.int32)
    skip, first, count = nothing, nothing, nothing
    if len(bounded):
        finite = boxes[bounded]
        leaves, node_box, skip, first, count = build_hierarchy(finite, 0.5 * (finite[:, :3] + finite[:, 3:]))
        order = np.append(bounded[leaves], order)
    rows, positions, rotations = here.rows[order], here.positions[order], here.rotations[order]
    return PlacedFragments(rows, positions, rotations, node_box, skip, first, count, len(bounded)), order
