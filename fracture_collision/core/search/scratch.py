"""Working memory of one thread, for floods and traversals. Leftover content never affects an answer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.memory.pools import LEAF, Pools
from fracture_collision.core.mesh.triangle_field import STACK
from fracture_collision.core.search.neighbour_lists import MOST_AHEAD, PLACE
from fracture_collision.core.separation.approach import ANY_WAY, WAY

# Limits for spheres: triangles of the other's surface within a sphere's reach, places among them where it touches, and
# triangles at one point.
MOST_WITHIN = 8192
MOST_PLACES = 1024
MOST_TOUCHING = 256
# Behind each face of a tetrahedron, at most three planes separate fragments.
ROOTS = 12


class Scratch(NamedTuple):
    """Leading dimension: thread."""

    visited: np.ndarray  # (threads, tetrahedra) int32: stamp of the last flood that reached it
    stamp: np.ndarray  # (threads,) int32
    heap_key: np.ndarray  # (threads, tetrahedra) float64: squared box distance [m2]
    heap_tet: np.ndarray  # (threads, tetrahedra) int32
    roots: np.ndarray  # (threads, ROOTS) float64: where a ray may change its owner within a tetrahedron
    node_int: np.ndarray  # (threads, nodes, 4) int32: entry, side, next child, status
    node_float: np.ndarray  # (threads, nodes, 4) float64: point in the other's frame [m], depth bound [m]
    queue: np.ndarray  # (threads, 2, 2 nodes) int32: rows of the two above
    spread: np.ndarray  # (threads, 2, nodes) float64 [m2], [m]: see sample_search
    ways: np.ndarray  # (threads, 8 + padding, 5) float64: directions out of a fragment, see deep_choice
    along: np.ndarray  # (threads, nodes) float32: extents of leaves of samples [m]
    looked_at: np.ndarray  # (threads, 4, nodes + LEAF) float32 [m]: places of samples, distance beyond planes
    leaves: np.ndarray  # (threads, nodes) int32: leaves of these samples
    candidates: np.ndarray  # (threads, nodes, 4) float64 [m]: samples to be queried, see sample_search
    candidate_ids: np.ndarray  # (threads, nodes, 2) int32: likewise
    planes: np.ndarray  # (threads, 8 + padding, 4) float32: half-spaces
    rotation: np.ndarray  # (threads, 2 + padding, 3, 3) float64: a pair's relative poses
    translation: np.ndarray  # (threads, 2 + padding, 3) float64 [m]
    world_rotation: np.ndarray  # (threads, 3 + padding, 3, 3) float64: later world poses of a pair, final pose of one
    world_position: np.ndarray  # (threads, 3 + padding, 3) float64 [m]
    point: np.ndarray  # (threads, 3 + padding) float64 [m]
    toward: np.ndarray  # (threads, 3 + padding) float64: a direction
    ahead_toward: np.ndarray  # (threads, 3 + padding) float64: likewise, of a pair at a later moment
    ahead_ways: np.ndarray  # (threads, 2 + padding, WAY) float64 [m]: how the two move then, motion.put_way
    any_way: np.ndarray  # (2, WAY) float64 [m]: likewise, for unknown motion
    ahead_listed: np.ndarray  # (threads, MOST_AHEAD, 2) int32: its listed samples
    ahead_places: np.ndarray  # (threads, MOST_AHEAD, PLACE) float32 [m]: their places, see neighbour_lists.py
    ahead_ridges: np.ndarray  # (threads, MOST_AHEAD, 2) int32: its pairs of ridges, likewise
    stack: np.ndarray  # (threads, STACK) int32: a descent through a triangle hierarchy
    within: np.ndarray  # (threads, MOST_WITHIN) int64: triangles within a sphere's reach (sphere_contacts.py)
    touching: np.ndarray  # (threads, MOST_TOUCHING) int64: those at one point
    row: np.ndarray  # (threads, MOST_PLACES, 10) float64: contacts that are not chosen yet, traversal.query_pair
    row_ids: np.ndarray  # (threads, MOST_PLACES, 5) int64
    kept: np.ndarray  # (threads, nodes, 10) float64: contacts of candidate samples, sample_search.py
    kept_ids: np.ndarray  # (threads, nodes, 5) int64
    none_listed: np.ndarray  # (0, 2) int32, and (0, PLACE) float32: for searches without a list (neighbour_lists.py)
    no_places: np.ndarray


def scratch_for(
    pools: Pools, rows: np.ndarray, threads: int, before: Scratch | None, crossings: int = 0
) -> Scratch:
    """`before` if it has room for all pairs of `rows` (n,), else a new one. crossings: most of a pair's ridges."""
    nodes = 2 * _largest_tree(pools.fragment.tree_begin, pools.fragment.tree_end, rows) + 2 + crossings
    tetrahedra = len(pools.mesh.tetrahedra)
    if before is None or before.visited.shape[1] < tetrahedra or before.node_int.shape[1] < nodes:
        return make_scratch(threads, tetrahedra, nodes)
    return before


@kernel
def _largest_tree(tree_begin, tree_end, rows):
    entries = 0
    for row in rows:
        entries = max(entries, tree_end[row] - tree_begin[row])
    return entries


def make_scratch(threads: int, tetrahedra: int, nodes: int) -> Scratch:
    """Small arrays are padded by 128 bytes that are never written: threads that share a cache line wait for each
    other's writes, and two threads run 1.7 instead of 1.9 times as fast as one.
    """
    return Scratch(
        visited=np.zeros((threads, max(tetrahedra, 1)), dtype=np.int32),
        stamp=np.zeros(threads, dtype=np.int32),
        heap_key=np.zeros((threads, max(tetrahedra, 1))),
        heap_tet=np.zeros((threads, max(tetrahedra, 1)), dtype=np.int32),
        roots=np.zeros((threads, ROOTS)),
        node_int=np.zeros((threads, nodes, 4), dtype=np.int32),
        node_float=np.zeros((threads, nodes, 4)),
        queue=np.zeros((threads, 2, 2 * nodes), dtype=np.int32),
        spread=np.zeros((threads, 2, nodes)),
        ways=np.zeros((threads, 12, 5)),
        along=np.zeros((threads, nodes), dtype=np.float32),
        looked_at=np.zeros((threads, 4, nodes + LEAF), dtype=np.float32),
        leaves=np.zeros((threads, nodes), dtype=np.int32),
        candidates=np.zeros((threads, nodes, 4)),
        candidate_ids=np.zeros((threads, nodes, 2), dtype=np.int32),
        planes=np.zeros((threads, 16, 4), dtype=np.float32),
        rotation=np.zeros((threads, 4, 3, 3)),
        translation=np.zeros((threads, 8, 3)),
        world_rotation=np.zeros((threads, 4, 3, 3)),
        world_position=np.zeros((threads, 8, 3)),
        point=np.zeros((threads, 24)),
        toward=np.zeros((threads, 24)),
        ahead_toward=np.zeros((threads, 24)),
        ahead_ways=np.zeros((threads, 4, WAY)),
        any_way=np.tile(ANY_WAY, (2, 1)),
        ahead_listed=np.zeros((threads, MOST_AHEAD, 2), dtype=np.int32),
        ahead_places=np.zeros((threads, MOST_AHEAD, PLACE), dtype=np.float32),
        ahead_ridges=np.zeros((threads, MOST_AHEAD, 2), dtype=np.int32),
        stack=np.zeros((threads, STACK), dtype=np.int32),
        within=np.zeros((threads, MOST_WITHIN), dtype=np.int64),
        touching=np.zeros((threads, MOST_TOUCHING), dtype=np.int64),
        row=np.zeros((threads, MOST_PLACES, 10)),
        row_ids=np.zeros((threads, MOST_PLACES, 5), dtype=np.int64),
        kept=np.zeros((threads, nodes, 10)),
        kept_ids=np.zeros((threads, nodes, 5), dtype=np.int64),
        none_listed=np.zeros((0, 2), dtype=np.int32),
        no_places=np.zeros((0, PLACE), dtype=np.float32),
    )
