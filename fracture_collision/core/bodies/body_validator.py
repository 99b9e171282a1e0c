"""Invariants of a fractured body's rows in the pools after every event: for tests and debugging."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.fracture.crack_seeds import MOST_SEEDS
from fracture_collision.core.memory.pools import (
    BACK,
    BACK_SIDE,
    FANNED,
    FRONT,
    FRONT_SIDE,
    LABELS,
    LEAF,
    OLD_FACE,
    OWNER,
    PARTED,
    PLANE,
    ROW,
    Pools,
)
from fracture_collision.core.mesh.occupancy import sphere_may_touch
from fracture_collision.core.mesh.surface_triangles import surface_triangles
from fracture_collision.core.samples.sample_leaves import leaves_of

# Rounding tolerance, as a share of lengths, areas and volumes of the body.
ROUNDING = 1e-9
# The plane of a thinner triangle (twice its area over its longest side squared) is arbitrary; its rim is not.
THIN = 1e-6
# Single-precision rounding tolerance.
SINGLE = 1e-6


def validate_body(geometry: CollisionGeometry, rows: Sequence[int]) -> None:
    """Raise AssertionError unless all stored data of one fractured body agree; `rows`: its living fragments.

    Labels, cuts and polygons are consistent; each fragment's surface is closed, oriented outward, encloses the
    fragment's volume and lies in its box and cells and in the hull of its samples; its leaves hold every
    sample once; the volumes add up to the body's.
    """
    geometry.validate()
    pools = geometry.pools
    tets = np.array(geometry.tet_range(rows[0]))
    _validate_labels(pools, rows, tets)
    _validate_seeds(pools, rows, tets)
    _validate_polygons(pools, rows, tets)
    _validate_regions(pools, rows, tets)
    radius = float(pools.fragment.radius[rows[0]])
    for row in rows:
        _validate_leaves(pools, row)
    volumes = [_validate_surface(geometry, row, radius) for row in rows]
    whole = pools.mesh.moments[tets, 0].sum()
    assert abs(sum(volumes) - whole) <= ROUNDING * whole, f"volumes add up to {sum(volumes)}, the body has {whole}"


def _validate_labels(pools: Pools, rows: Sequence[int], tets: np.ndarray) -> None:
    mesh, body, fragment = pools.mesh, pools.body, pools.fragment
    shift = int(fragment.node_shift[rows[0]])
    labels = body.node_fragment[mesh.tetrahedra[tets] + shift]
    assert set(np.unique(labels).tolist()) == set(rows), "the labels of the nodes are not the living fragments"
    stored = body.regions[tets + fragment.tet_shift[rows[0]], OWNER]
    alone = (labels == labels[:, :1]).all(axis=1)
    assert np.array_equal(stored[alone], labels[alone, 0]), "a tetrahedron's owner is not that of its nodes"
    is_shared = stored < 0
    has_it = (labels == stored[:, None]).any(axis=1)
    assert (is_shared | has_it).all() and not is_shared[alone].any(), "a tetrahedron's owner has no node of it"
    edges = np.unique(mesh.tetrahedron_edges[tets])
    ends = mesh.edges[edges]
    is_cut = body.node_fragment[ends[:, 0] + shift] != body.node_fragment[ends[:, 1] + shift]
    planes = body.edge_plane[edges + fragment.edge_shift[rows[0]]]
    assert np.array_equal(planes >= 0, is_cut), "an edge is cut if and only if its ends differ"
    shares = body.edge_share[edges + fragment.edge_shift[rows[0]]][is_cut]
    assert (shares >= 0.0).all() and (shares <= 1.0).all(), "a crossing has left its edge"


def _validate_leaves(pools: Pools, row: int) -> None:
    fragment, leaves = pools.fragment, leaves_of.py_func(pools, row)
    own = pools.samples.points[fragment.sample_begin[row] : fragment.sample_end[row]]
    samples = np.arange(len(own))
    is_sample, n = leaves.entries >= 0, len(leaves.entries) // LEAF
    assert np.array_equal(np.sort(leaves.entries[is_sample]), samples), "the leaves do not hold every sample once"
    assert n == -(-len(samples) // LEAF), "there are more leaves than samples fill"
    values = leaves.values.astype(np.float64)
    low, high = values[: 3 * n].reshape(3, n).T, values[3 * n : 6 * n].reshape(3, n).T
    points = values[6 * n :].reshape(3, -1).T
    exact = own[leaves.entries] - leaves.middle[:3]
    assert (np.abs(points - exact)[is_sample] <= 0.1 * leaves.middle[3]).all(), "a leaf has a sample elsewhere"
    inside = points.reshape(n, LEAF, 3)
    assert ((low[:, None] <= inside) & (inside <= high[:, None])).all(), "a leaf's box does not hold its samples"


def _validate_seeds(pools: Pools, rows: Sequence[int], tets: np.ndarray) -> None:
    mesh, fragment, seeds = pools.mesh, pools.fragment, pools.seeds
    blocks = {tuple(fragment.seeds[row].tolist()) for row in rows}
    assert len(blocks) == 1, "fragments of one body go by different seeds"
    begin, end = blocks.pop()
    edges = np.unique(mesh.tetrahedron_edges[tets])
    labels = pools.body.node_fragment[mesh.edges[edges] + fragment.node_shift[rows[0]]].astype(np.int64)
    keys = labels.min(axis=1) << 32 | labels.max(axis=1)
    expected = np.unique(keys[labels[:, 0] != labels[:, 1]])
    assert np.array_equal(seeds.keys[begin:end], expected), "seeds are not those of the pairs that share a crack"
    for k in range(begin, end):
        own = seeds.edges[slice(*seeds.ranges[k])]
        shared = edges[keys == seeds.keys[k]]
        assert len(own) == min(len(shared), MOST_SEEDS), "a pair has more seeds or fewer than it can have"
        assert len(np.unique(own)) == len(own) and np.isin(own, shared).all(), "a seed twice, or of another pair"


def _validate_regions(pools: Pools, rows: Sequence[int], tets: np.ndarray) -> None:
    """Compare the columns beside the owner of shared tetrahedra with their source."""
    mesh, body, fragment = pools.mesh, pools.body, pools.fragment
    own = tets + fragment.tet_shift[rows[0]]
    labels = body.node_fragment[mesh.tetrahedra[tets] + fragment.node_shift[rows[0]]]
    is_fanned, is_parted = body.regions[own, OWNER] == FANNED, body.regions[own, OWNER] == PARTED
    of_nodes = body.regions[own[is_fanned], LABELS : LABELS + 4]
    assert np.array_equal(of_nodes, labels[is_fanned]), "labels of a tetrahedron are not those of its nodes"
    regions, first = body.regions[own[is_parted]], body.regions[own[is_parted], ROW]
    sides = body.sides[first]
    assert np.array_equal(regions[:, FRONT], sides[:, FRONT_SIDE]), "a tetrahedron's front is not that of its polygons"
    assert np.array_equal(regions[:, BACK], sides[:, BACK_SIDE]), "a tetrahedron's back is not that of its polygons"
    grid = mesh.grid[fragment.mesh[rows[0]]]
    planes, faces = body.region_planes[own[is_parted], PLANE:].astype(float), body.faces[first]
    offsets = faces[:, 3] - faces[:, :3] @ grid[:3]
    room = SINGLE * (fragment.radius[rows[0]] + grid[3])
    assert np.allclose(planes[:, :3], faces[:, :3], rtol=0.0, atol=SINGLE, equal_nan=True), "a plane turned"
    assert np.allclose(planes[:, 3], offsets, rtol=0.0, atol=room, equal_nan=True), "a plane off that of its polygons"


def _validate_polygons(pools: Pools, rows: Sequence[int], tets: np.ndarray) -> None:
    body = pools.body
    shift = pools.fragment.tet_shift[rows[0]]
    living = np.array([*rows, -1])
    for t in tets.tolist():
        begin, count = int(body.regions[t + shift, ROW]), int(body.cut_count[t + shift])
        part = slice(begin, begin + count)
        fronts, backs, kinds, _ = body.sides[part].T
        assert (np.diff(kinds) >= 0).all(), f"tetrahedron {t}: kinds do not ascend"
        assert np.isin(fronts, living[:-1]).all() and np.isin(backs, living).all(), f"tetrahedron {t}: a retired owner"
        assert (fronts != backs).all(), f"tetrahedron {t}: a polygon between a fragment and itself"
        assert count == 0 or body.regions[t + shift, OWNER] < 0, f"tetrahedron {t}: polygons of one fragment alone"
        assert ((kinds < OLD_FACE) == (backs >= 0)).all(), f"tetrahedron {t}: a kind that its owners do not have"
        corners = body.triangles[part].reshape(-1, 3, 3)
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        is_wide = (np.linalg.norm(twice, axis=1) > THIN * sides**2) & ~np.isnan(body.faces[part, 3])
        heights = np.einsum("tcd,td->tc", corners, body.faces[part, :3]) - body.faces[part, 3:]
        off = np.abs(heights[is_wide]).max(initial=0.0)
        assert off <= ROUNDING * pools.fragment.radius[rows[0]], f"tetrahedron {t}: a triangle beside its plane"
        lengths = np.linalg.norm(body.faces[part, :3][is_wide], axis=1)
        assert np.allclose(lengths, 1.0, atol=ROUNDING), "a normal is not unit"


def _validate_surface(geometry: CollisionGeometry, row: int, radius: float) -> float:
    """Returns the volume [m3] that the fragment's surface encloses."""
    pools = geometry.pools
    corners, _ = surface_triangles(pools, row, geometry.tet_range(row))
    a, b, c = (corners[:, i] for i in range(3))
    areas = 0.5 * np.cross(b - a, c - a)
    total = np.linalg.norm(areas, axis=1).sum()
    assert np.linalg.norm(areas.sum(axis=0)) <= ROUNDING * total, f"fragment {row}: the surface is not closed"
    enclosed = float((areas * a).sum() / 3.0)
    volume = geometry.volume(row)
    assert abs(enclosed - volume) <= ROUNDING * radius**3, f"fragment {row}: encloses {enclosed}, has {volume}"
    points, box = corners.reshape(-1, 3), pools.fragment.box[row]
    inside = (points >= box[:3] - ROUNDING * radius) & (points <= box[3:] + ROUNDING * radius)
    assert inside.all(), f"fragment {row}: surface outside its box"
    fragment, directions = pools.fragment, np.random.default_rng(0).normal(size=(64, 3))
    samples = pools.samples.points[fragment.sample_begin[row] : fragment.sample_end[row]]
    reach, spanned = (points @ directions.T).max(axis=0), (samples @ directions.T).max(axis=0)
    assert (reach <= spanned + ROUNDING * radius).all(), f"fragment {row}: surface outside the hull of what spans it"
    for x, y, z in points.tolist():
        assert sphere_may_touch(pools, row, x, y, z, ROUNDING * radius), f"fragment {row}: surface outside its cells"
    return enclosed
