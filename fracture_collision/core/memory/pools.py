"""The arrays every kernel reads: all meshes, bodies, fragments, polygons and samples, concatenated.

One flat array per quantity, independent of the number of bodies, so that a kernel takes everything in one structure and
equal geometries share one preprocess. Rows are only appended; a retired fragment's samples stay as garbage until the
pools are compacted (pool_compaction.py) or the world is rebuilt. Each field declares what has a row there, and what its
values are rows of (tables.py).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.memory.tables import AllMoves, Column, Moved

f8, f4, i8, i4, u8, u1 = np.float64, np.float32, np.int64, np.int32, np.uint64, np.uint8

# What has rows.
FRAGMENT, MESH, SURFACE = "fragment", "mesh", "surface"
NODE, TETRAHEDRON, EDGE = "node", "tetrahedron", "edge"  # of meshes
NODE_BEGIN, NODE_TETRAHEDRON, CELL, CELL_TETRAHEDRON = "node begin", "node tetrahedron", "cell", "cell tetrahedron"
BODY_NODE, BODY_TETRAHEDRON, BODY_EDGE = "body node", "body tetrahedron", "body edge"  # of broken bodies
POLYGON, CUT_PLANE = "polygon", "cut plane"
SAMPLE, SAMPLE_LEAF, WORD, SEED_PAIR, SEED = "sample", "sample leaf", "word", "seed pair", "seed"
TRIANGLE, PSEUDONORMAL, TREE_NODE = "triangle", "pseudonormal", "tree node"  # of surfaces

# Samples per leaf: one SIMD instruction in single precision. A leaf has six numbers for its box and three per sample.
LEAF = 8
LEAF_VALUES = 6 + 3 * LEAF
# Error bound of a projection of these numbers onto a unit vector, as a share of the sides of the box of all samples:
# the numbers are rounded to 2^-25 of its sides, and so are each of the five operations and the vector's components.
SAMPLE_ROUNDING = 1e-6

# Columns of BodyPool.regions.
OWNER = 0  # fragment row if one fragment owns the whole tetrahedron, else PARTED or FANNED
ROW = 1  # of a shared tetrahedron: the first row of its polygons
FRONT, BACK = 2, 3  # of a PARTED tetrahedron: fragment rows
PLANE = 4  # of a PARTED tetrahedron, four columns: the normal out of FRONT and the offset [m] from the grid's corner
LABELS = 4  # of a FANNED tetrahedron, four columns: fragment rows of its nodes
REGION = 8
# OWNER of shared tetrahedra (cut_tetrahedron.py): PARTED by one plane, common to all their rows between fragments; or
# FANNED about a hub, the first corner of these rows, which are sorted by face.
PARTED = -1
FANNED = -2
# Columns of BodyPool.sides: fragment rows, BACK_SIDE -1 outside the body; KIND is OLD_FACE + k for a piece of face k of
# a tetrahedron; for a triangle between two fragments it is the face it lies behind. VOID, of triangles about a hub: the
# part from the triangle to the node of its face in front has no volume (FRONT_VOID), or that to the node behind it
# (BACK_VOID).
FRONT_SIDE, BACK_SIDE, KIND, VOID = 0, 1, 2, 3
FRONT_VOID, BACK_VOID = 1, 2
OLD_FACE = 4
NEVER_BROKEN = np.iinfo(np.int32).min


def _move_regions(regions: np.ndarray, moves: AllMoves) -> None:
    is_parted, is_fanned = regions[:, OWNER] == PARTED, regions[:, OWNER] == FANNED
    fragments = moves[FRAGMENT]
    regions[:, ROW] = moves[POLYGON].of(regions[:, ROW])
    regions[:, OWNER] = fragments.of(regions[:, OWNER])
    regions[is_parted, FRONT : BACK + 1] = fragments.of(regions[is_parted, FRONT : BACK + 1])
    regions[is_fanned, LABELS:REGION] = fragments.of(regions[is_fanned, LABELS:REGION])


def _move_pairs(keys: np.ndarray, moves: AllMoves) -> None:
    keys[:] = moves[FRAGMENT].of(keys >> 32) << 32 | moves[FRAGMENT].of(keys & 0xFFFFFFFF)


class MeshPool(Struct):
    """Distinct tetrahedral meshes (tet_mesh.py), indices shifted to be absolute."""

    nodes: Annotated[np.ndarray, Column(NODE, f8, 3)]  # [m]
    tetrahedra: Annotated[np.ndarray, Column(TETRAHEDRON, i4, 4, NODE)]
    neighbours: Annotated[np.ndarray, Column(TETRAHEDRON, i4, 4, TETRAHEDRON)]  # -1: the old surface
    tetrahedron_edges: Annotated[np.ndarray, Column(TETRAHEDRON, i4, 6, EDGE)]
    edges: Annotated[np.ndarray, Column(EDGE, i4, 2, NODE)]
    edge_tets: Annotated[np.ndarray, Column(EDGE, i4, 0, TETRAHEDRON)]  # one tetrahedron incident to each edge
    boxes: Annotated[np.ndarray, Column(TETRAHEDRON, f4, 6)]  # [m], rounded outwards
    barycentric: Annotated[np.ndarray, Column(TETRAHEDRON, f8, 12)]
    walls: Annotated[np.ndarray, Column(TETRAHEDRON, f4, 16)]
    moments: Annotated[np.ndarray, Column(TETRAHEDRON, f8, 10)]
    on_surface: Annotated[np.ndarray, Column(NODE, u1)]
    node_normals: Annotated[np.ndarray, Column(NODE, f8, 3)]  # unit, outward, of the old surface; zero inside
    # mesh k's rows start at first node + k, one more than it has nodes
    node_tets_begin: Annotated[np.ndarray, Column(NODE_BEGIN, i4, 0, NODE_TETRAHEDRON)]
    node_tets: Annotated[np.ndarray, Column(NODE_TETRAHEDRON, i4, 0, TETRAHEDRON)]
    # first node, first edge, number of nodes, first tetrahedron, number of edges
    first: Annotated[np.ndarray, Column(MESH, i4, 5, (NODE, EDGE, None, TETRAHEDRON, None))]
    grid: Annotated[np.ndarray, Column(MESH, f8, 4)]  # origin [m], cell [m]
    # cells along x, y, z; first entry in cell_begin
    grid_dims: Annotated[np.ndarray, Column(MESH, i4, 4, (None, None, None, CELL))]
    cell_begin: Annotated[np.ndarray, Column(CELL, i4, 0, CELL_TETRAHEDRON)]  # cells + 1 per mesh
    cell_tets: Annotated[np.ndarray, Column(CELL_TETRAHEDRON, i4, 0, TETRAHEDRON)]
    # one bit per part of the cell that this tetrahedron may meet (occupancy.py)
    cell_parts: Annotated[np.ndarray, Column(CELL_TETRAHEDRON, u8)]


class BodyPool(Struct):
    """Per-body state that fracture changes; only broken bodies have rows here."""

    node_fragment: Annotated[np.ndarray, Column(BODY_NODE, i4, 0, FRAGMENT)]  # of each mesh node
    edge_plane: Annotated[np.ndarray, Column(BODY_EDGE, i4, 0, CUT_PLANE)]  # -1: not cut
    # first row of `planes` of the fracture that cut it: increases with each fracture; 0 if it is not cut
    edge_event: Annotated[np.ndarray, Column(BODY_EDGE, i4, 0, CUT_PLANE)]
    # where a cut edge is crossed, as a share of its length from its first node
    edge_share: Annotated[np.ndarray, Column(BODY_EDGE, f8)]
    # per tetrahedron, its owners: columns from OWNER on, half a cache line
    regions: Annotated[np.ndarray, Column(BODY_TETRAHEDRON, i4, REGION, Moved((FRAGMENT, POLYGON), _move_regions))]
    # the same memory, for PLANE, which is single precision
    region_planes: Annotated[np.ndarray, Column(BODY_TETRAHEDRON, f4, REGION, seen_in="regions")]
    cut_count: Annotated[np.ndarray, Column(BODY_TETRAHEDRON, i4)]  # number of its polygons
    # unit normal from the edge's first node to its second, offset [m]
    planes: Annotated[np.ndarray, Column(CUT_PLANE, f8, 4)]
    # [m] corners, right-handed about the outward normal of `front`
    triangles: Annotated[np.ndarray, Column(POLYGON, f8, 9)]
    faces: Annotated[np.ndarray, Column(POLYGON, f8, 4)]  # their planes: that unit normal and the offset [m]
    # FRONT_SIDE, BACK_SIDE, KIND, VOID
    sides: Annotated[np.ndarray, Column(POLYGON, i4, 4, (FRAGMENT, FRAGMENT, None, None))]


class FragmentPool(Struct):
    """One row per fragment, including bodies that never break."""

    kind: Annotated[np.ndarray, Column(FRAGMENT, i4)]  # kinds.py
    # row of MESH or, for TRIANGLES, of SURFACE; -1 without a mesh
    mesh: Annotated[np.ndarray, Column(FRAGMENT, i4)]
    # mesh node + shift = row of node_fragment; NEVER_BROKEN for a whole body
    node_shift: Annotated[np.ndarray, Column(FRAGMENT, i4)]
    tet_shift: Annotated[np.ndarray, Column(FRAGMENT, i4)]  # likewise for regions, cut_count
    edge_shift: Annotated[np.ndarray, Column(FRAGMENT, i4)]  # likewise for edge_plane
    box: Annotated[np.ndarray, Column(FRAGMENT, f8, 6)]  # [m], body frame
    # plane (n, offset), sphere (radius), box (half edges) [m]
    shape: Annotated[np.ndarray, Column(FRAGMENT, f8, 4)]
    # [m] R of the body, half the longest side of its box; infinite for a plane
    radius: Annotated[np.ndarray, Column(FRAGMENT, f8)]
    sample_begin: Annotated[np.ndarray, Column(FRAGMENT, i4, 0, SAMPLE)]  # first row of SamplePool.points
    sample_end: Annotated[np.ndarray, Column(FRAGMENT, i4, 0, SAMPLE)]
    # first cell x y z, cells x y z, first word of `occupancy`
    cells: Annotated[np.ndarray, Column(FRAGMENT, i4, 7, (None,) * 6 + (WORD,))]
    # first row of SeedPool.keys of its body, end row
    seeds: Annotated[np.ndarray, Column(FRAGMENT, i4, 2, SEED_PAIR)]
    leaf_begin: Annotated[np.ndarray, Column(FRAGMENT, i4, 0, SAMPLE_LEAF)]  # first leaf of SamplePool
    leaf_end: Annotated[np.ndarray, Column(FRAGMENT, i4, 0, SAMPLE_LEAF)]
    middle: Annotated[np.ndarray, Column(FRAGMENT, f8, 4)]  # [m], see sample_leaves.Leaves


class Measures(Struct):
    """Of each fragment, for others than queries."""

    moments: Annotated[np.ndarray, Column(FRAGMENT, f8, 10)]  # moments.py
    gaps: Annotated[np.ndarray, Column(FRAGMENT, f8)]  # [m] from a point of its surface to its nearest sample, at most


class TriangleMeshPool(Struct):
    """Distinct triangle meshes (triangle_field.py), indices shifted to be absolute."""

    corners: Annotated[np.ndarray, Column(TRIANGLE, f8, 9)]  # [m]
    features: Annotated[np.ndarray, Column(TRIANGLE, i4, 6, PSEUDONORMAL)]
    pseudonormals: Annotated[np.ndarray, Column(PSEUDONORMAL, f8, 3)]  # of edges, then of vertices, of each mesh
    node_box: Annotated[np.ndarray, Column(TREE_NODE, f8, 6)]
    node_skip: Annotated[np.ndarray, Column(TREE_NODE, i4, 0, TREE_NODE)]
    node_first: Annotated[np.ndarray, Column(TREE_NODE, i4, 0, TRIANGLE)]
    node_count: Annotated[np.ndarray, Column(TREE_NODE, i4)]
    node_range: Annotated[np.ndarray, Column(SURFACE, i4, 2, TREE_NODE)]  # first row of the nodes, end row
    triangle_range: Annotated[np.ndarray, Column(SURFACE, i4, 2, TRIANGLE)]  # likewise
    first_vertex: Annotated[np.ndarray, Column(SURFACE, i4, 0, PSEUDONORMAL)]  # that of its first vertex


class SamplePool(Struct):
    """Samples of the fragments' surfaces and their leaves (sample_leaves.py), contiguous per fragment."""

    points: Annotated[np.ndarray, Column(SAMPLE, f8, 3)]  # [m] body frame
    numbers: Annotated[np.ndarray, Column(SAMPLE, i4)]  # within the body, sample_numbers.py
    values: Annotated[np.ndarray, Column(SAMPLE_LEAF, f4, LEAF_VALUES, shape=(-1,))]  # [m]
    entries: Annotated[np.ndarray, Column(SAMPLE_LEAF, i4, LEAF, shape=(-1,))]


class SeedPool(Struct):
    """Crack seeds (crack_seeds.py).

    A body's rows are sorted by key, in the range given by FragmentPool.seeds. Its rows from before its last fracture
    stay as garbage, and so do the edges of broken fragments; other edges do not move.
    """

    # smaller row of the fragment pool << 32 | larger row
    keys: Annotated[np.ndarray, Column(SEED_PAIR, i8, 0, Moved((FRAGMENT,), _move_pairs))]
    ranges: Annotated[np.ndarray, Column(SEED_PAIR, i4, 2, SEED)]  # first row of `edges`, end row
    edges: Annotated[np.ndarray, Column(SEED, i4, 0, EDGE)]  # each farther from those before it than all that follow


# Columns of FragmentPool that a whole body has from its mesh.
SAMPLES_OF_WHOLE = ("sample_begin", "sample_end", "leaf_begin", "leaf_end", "middle")


class Whole(Struct):
    """Samples and cells of whole bodies, for those that are added later: columns as in FragmentPool."""

    sample_begin: Annotated[np.ndarray, Column(MESH, i4, 0, SAMPLE)]
    sample_end: Annotated[np.ndarray, Column(MESH, i4, 0, SAMPLE)]
    cells: Annotated[np.ndarray, Column(MESH, i4, 7, (None,) * 6 + (WORD,))]
    leaf_begin: Annotated[np.ndarray, Column(MESH, i4, 0, SAMPLE_LEAF)]
    leaf_end: Annotated[np.ndarray, Column(MESH, i4, 0, SAMPLE_LEAF)]
    middle: Annotated[np.ndarray, Column(MESH, f8, 4)]


class WholeSurface(Struct):
    """As Whole, of bodies of triangles."""

    sample_begin: Annotated[np.ndarray, Column(SURFACE, i4, 0, SAMPLE)]
    sample_end: Annotated[np.ndarray, Column(SURFACE, i4, 0, SAMPLE)]
    leaf_begin: Annotated[np.ndarray, Column(SURFACE, i4, 0, SAMPLE_LEAF)]
    leaf_end: Annotated[np.ndarray, Column(SURFACE, i4, 0, SAMPLE_LEAF)]
    middle: Annotated[np.ndarray, Column(SURFACE, f8, 4)]


class Pools(Struct):
    """All pools."""

    mesh: MeshPool
    body: BodyPool
    fragment: FragmentPool
    samples: SamplePool
    occupancy: Annotated[np.ndarray, Column(WORD, u8)]  # multi-level grids (occupancy.py)
    triangles: TriangleMeshPool
    seeds: SeedPool
