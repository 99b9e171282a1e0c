"""Working memory of one thread, for floods and searches. Leftover content never affects an answer."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.edges.ridge_contacts import MOST_CROSSINGS
from fracture_collision.core.edges.ridge_work import RidgeWork, make_ridge_work
from fracture_collision.core.edges.ridges import Ridges
from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.memory.pair import Sink, make_sink
from fracture_collision.core.memory.pools import LEAF
from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.mesh.triangle_field import STACK
from fracture_collision.core.search.neighbour_lists import MOST_AHEAD, PLACE
from fracture_collision.core.separation.approach import ANY_WAY, WAY

# Limits for spheres: triangles of the other's surface within a sphere's reach, places among them where it touches.
MOST_WITHIN = 8192
MOST_PLACES = 1024
# Behind each face of a tetrahedron, at most three planes separate fragments.
ROOTS = 12


class Scratch(Struct):
    """Working memory of one thread.

    A few rows of padding keep the small arrays of two threads in different cache lines.
    """

    visited: np.ndarray  # (tetrahedra,) int32: stamp of the last flood that reached it
    stamp: np.ndarray  # (1 + padding,) int32
    heap_key: np.ndarray  # (tetrahedra,) float64: squared box distance [m2]
    heap_tet: np.ndarray  # (tetrahedra,) int32
    roots: np.ndarray  # (ROOTS,) float64: where a ray may change its owner within a tetrahedron
    node_int: np.ndarray  # (nodes, 4) int32: columns of contact_choice.py or algorithm1.py
    node_float: np.ndarray  # (nodes, 4) float64 [m]: likewise, a point first
    queue: np.ndarray  # (2, 2 nodes) int32: rows of the two above
    spread: np.ndarray  # (2, nodes) float64: FAR [m2], MOST_DEPTH [m] of contact_choice.py
    ways: np.ndarray  # (8 + padding, 5) float64: directions out of a fragment, see deep_choice
    along: np.ndarray  # (nodes,) float32: extents of leaves of samples [m]
    looked_at: np.ndarray  # (4, nodes + LEAF) float32 [m]: places of samples, distance beyond planes
    leaves: np.ndarray  # (nodes,) int32: leaves of these samples
    candidates: np.ndarray  # (nodes, 4) float64 [m]: samples to be queried, see candidates.py
    candidate_ids: np.ndarray  # (nodes, 2) int32: likewise
    planes: np.ndarray  # (8 + padding, 4) float32: half-spaces
    rotation: np.ndarray  # (2 + padding, 3, 3) float64: a pair's relative poses
    translation: np.ndarray  # (2 + padding, 3) float64 [m]
    world_rotation: np.ndarray  # (3 + padding, 3, 3) float64: later world poses of a pair, final pose of one
    world_position: np.ndarray  # (3 + padding, 3) float64 [m]
    point: np.ndarray  # (3 + padding,) float64 [m]
    toward: np.ndarray  # (3 + padding,) float64: a direction
    ahead_toward: np.ndarray  # (3 + padding,) float64: likewise, of a pair at a later moment
    ahead_ways: np.ndarray  # (2 + padding, WAY) float64 [m]: how the two move then, motion.put_way
    any_way: np.ndarray  # (2, WAY) float64 [m]: likewise, for unknown motion
    ahead_samples: np.ndarray  # (MOST_AHEAD, 2) int32: its listed samples
    ahead_places: np.ndarray  # (MOST_AHEAD, PLACE) float32 [m]: their places, see neighbour_lists.py
    ahead_ridges: np.ndarray  # (MOST_AHEAD, 2) int32: its pairs of ridges, likewise
    stack: np.ndarray  # (STACK,) int32: a descent through a triangle hierarchy
    within: np.ndarray  # (MOST_WITHIN,) int64: triangles within a sphere's reach (sphere_contacts.py)
    boxes_within: np.ndarray  # (MOST_WITHIN, 7) float64 [m]: around these, see sphere_contacts.Near
    places: Sink  # MOST_PLACES rows: contacts of a sphere that are not chosen yet
    kept: Sink  # `nodes` rows: contacts of candidate samples, contact_choice.keep_answer
    ridge_work: RidgeWork
    none_listed: np.ndarray  # (0, 2) int32, and (0, PLACE) float32: for searches without a list (neighbour_lists.py)
    no_places: np.ndarray


def scratch_for(
    tetrahedra: int, ranges: tuple[np.ndarray, np.ndarray], rows: np.ndarray, threads: int,
    before: tuple[Scratch, ...], edges: Ridges,
) -> tuple[Scratch, ...]:  # fmt: skip
    """`before` if it has room for all pairs of `rows` (n,), else a new Scratch per thread.

    tetrahedra: in all meshes; ranges: where the samples, or tree entries, of all rows begin and end (F,); edges: Ridges
    of all rows, NO_RIDGES where their crossings are not searched.
    """
    crossings, ridges = (MOST_CROSSINGS, int(edges.count[rows].max(initial=0))) if len(edges.count) else (0, 0)
    nodes = 2 * _largest(*ranges, rows) + 2 + crossings
    if len(before) == threads:
        one = before[0]
        if len(one.visited) >= tetrahedra and len(one.node_int) >= nodes and len(one.ridge_work.worst) >= ridges:
            return before
    return tuple(make_scratch(tetrahedra, nodes, 2 * ridges) for _ in range(threads))


@kernel
def _largest(begin, end, rows):
    most = 0
    for row in rows:
        most = max(most, end[row] - begin[row])
    return most


def make_scratch(tetrahedra: int, nodes: int, ridges: int = 0) -> Scratch:
    """Working memory of one thread, for meshes, samples or trees, and ridges with up to these numbers of rows.

    Small arrays are padded by 128 bytes that are never written: threads that share a cache line wait for each other's
    writes, and two threads run 1.7 instead of 1.9 times as fast as one.
    """
    return Scratch(
        visited=np.zeros(max(tetrahedra, 1), dtype=np.int32),
        stamp=np.zeros(32, dtype=np.int32),
        heap_key=np.zeros(max(tetrahedra, 1)),
        heap_tet=np.zeros(max(tetrahedra, 1), dtype=np.int32),
        roots=np.zeros(ROOTS),
        node_int=np.zeros((nodes, 4), dtype=np.int32),
        node_float=np.zeros((nodes, 4)),
        queue=np.zeros((2, 2 * nodes), dtype=np.int32),
        spread=np.zeros((2, nodes)),
        ways=np.zeros((12, 5)),
        along=np.zeros(nodes, dtype=np.float32),
        looked_at=np.zeros((4, nodes + LEAF), dtype=np.float32),
        leaves=np.zeros(nodes, dtype=np.int32),
        candidates=np.zeros((nodes, 4)),
        candidate_ids=np.zeros((nodes, 2), dtype=np.int32),
        planes=np.zeros((16, 4), dtype=np.float32),
        rotation=np.zeros((4, 3, 3)),
        translation=np.zeros((8, 3)),
        world_rotation=np.zeros((4, 3, 3)),
        world_position=np.zeros((8, 3)),
        point=np.zeros(24),
        toward=np.zeros(24),
        ahead_toward=np.zeros(24),
        ahead_ways=np.zeros((4, WAY)),
        any_way=np.tile(ANY_WAY, (2, 1)),
        ahead_samples=np.zeros((MOST_AHEAD, 2), dtype=np.int32),
        ahead_places=np.zeros((MOST_AHEAD, PLACE), dtype=np.float32),
        ahead_ridges=np.zeros((MOST_AHEAD, 2), dtype=np.int32),
        stack=np.zeros(STACK, dtype=np.int32),
        within=np.zeros(MOST_WITHIN, dtype=np.int64),
        boxes_within=np.zeros((MOST_WITHIN, 7)),
        places=make_sink(MOST_PLACES),
        kept=make_sink(nodes),
        ridge_work=make_ridge_work(ridges),
        none_listed=np.zeros((0, 2), dtype=np.int32),
        no_places=np.zeros((0, PLACE), dtype=np.float32),
    )
