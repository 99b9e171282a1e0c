"""Both fields at points inside fragments, against libigl's distance from independently built surfaces.

The surfaces come from the slow oracle, tetrahedron by tetrahedron. libigl's winding number checks that they close
around a point, and its closest points are the truth. Nothing is shared with fracture_collision.core except the
tested probes. Only `igl` is used: its package `igl.copyleft` has a different licence.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import igl
import numpy as np
from oracles.brute_force import owners, partition_of
from oracles.fragmented_body import uniform_points
from worlds.fractured_worlds import FracturedWorld

from fracture_collision.core.field.elementary_queries import INSIDE
from fracture_collision.core.glondu2014.paper_probe import paper_probe
from fracture_collision.core.search.scratch import make_scratch

FIELDS = ("averaged", "exact")
NEAR = 0.02  # of R: below this depth a point is near the surface
INWARD = 0.01  # of R: the length of a step inwards
NO_DIRECTION = 1e-9  # of R: nearer to the surface, the direction to the nearest point is rounding noise


class Truth(NamedTuple):
    """Points of fragments, and libigl's answers. Lengths in units of R."""

    points: np.ndarray  # (n, 3) [m]
    fragments: np.ndarray  # (n,) fragment id of each point's owner
    is_uniform: np.ndarray  # (n,) bool: one of the points uniform over the body's volume
    depth: np.ndarray  # (n,) from the whole border of the fragment
    outward: np.ndarray  # (n, 3) unit, to the nearest point of it; 0 nearer than NO_DIRECTION
    open_by: float  # the largest distance of a winding number from 1


class Said(NamedTuple):
    """A field's answers at the points of a Truth. Lengths in units of R."""

    depth: np.ndarray  # (n,)
    most: np.ndarray  # (n,) its upper bound of the depth
    outward: np.ndarray  # (n, 3) unit
    rise: np.ndarray  # (n,) growth of depth over a step INWARD against `outward`; nan if that leaves the fragment
    true_rise: np.ndarray  # (n,) the same over a step away from the nearest point of the border


def igl_closest(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) [m] of points (n, 3) from triangles (t, 3, 3), and the nearest points (n, 3)."""
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    squared, _, nearest = igl.point_mesh_squared_distance(points, triangles.reshape(-1, 3), faces)
    return np.sqrt(squared), nearest


def igl_winding(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) 1 where the triangles, counter-clockwise from outside, close around a point, 0 outside."""
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    return igl.winding_number(triangles.reshape(-1, 3), faces, points)


def make_truth(case: FracturedWorld, count: int, radius: float, seed: int) -> Truth:
    """Half of `count` points uniform over the body, half within NEAR of its surfaces; each with its owner.

    radius: R [m]. Points for which two containing tetrahedra disagree by rounding are left out.
    """
    random = np.random.default_rng(seed)
    oracle = case.oracle
    partition = partition_of(oracle)
    surfaces = {f: oracle.surface_triangles(f) for f in oracle.fragment_ids}
    everywhere = uniform_points(oracle.vertices, oracle.tetrahedra, count // 2, random)
    points = np.concatenate((everywhere, _near_points(surfaces, count - count // 2, radius, random)))
    owner, certain = owners(partition, points)
    kept = certain & (owner > 0)
    is_uniform = (np.arange(len(points)) < len(everywhere))[kept]
    points, owner = np.ascontiguousarray(points[kept]), owner[kept]
    depth, outward = np.empty(len(points)), np.zeros((len(points), 3))
    open_by = 0.0
    for fragment, triangles in surfaces.items():
        own = np.flatnonzero(owner == fragment)
        if not len(own):
            continue
        depth[own], nearest = igl_closest(points[own], triangles)
        far = own[depth[own] > NO_DIRECTION * radius]
        outward[far] = (nearest[depth[own] > NO_DIRECTION * radius] - points[far]) / depth[far, None]
        # on the surface itself the winding number jumps
        inside = own[depth[own] > 1e-6 * radius]
        open_by = max(open_by, np.abs(igl_winding(points[inside[:50]], triangles) - 1.0).max(initial=0.0))
    return Truth(points, owner, is_uniform, depth / radius, outward, open_by)


def ask(case: FracturedWorld, truth: Truth, field: str, radius: float) -> Said:
    """The answers of `field`; `averaged` requires a world that was broken with it."""
    depth, most, outward = _probe(case, truth.points, truth.fragments, field)
    assert np.isfinite(depth).all(), "a point is not inside the fragment that owns it"
    step = INWARD * radius
    rise, true_rise = (
        _probe(case, truth.points - step * direction, truth.fragments, field)[0] - depth
        for direction in (outward, truth.outward)
    )
    return Said(depth / radius, most / radius, outward, rise / radius, true_rise / radius)


def _probe(
    case: FracturedWorld, points: np.ndarray, fragments: np.ndarray, field: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth (n,) [m], most (n,) [m] and direction (n, 3) of each point in its fragment; nan if it is not inside."""
    pools, paper = case.geometry.pools, replace(case.geometry.paper.pools, is_averaged=field == "averaged")
    scratch = make_scratch(len(case.oracle.tetrahedra), 8)
    rows = {f: case.row(f) for f in case.oracle.fragment_ids}
    answers = np.full((len(points), 5), np.nan)
    for i, (point, fragment) in enumerate(zip(points.tolist(), fragments.tolist(), strict=True)):
        found = paper_probe(pools, paper, rows[fragment], tuple(point), 0.0, np.inf, scratch)
        if found.status == INSIDE:
            answers[i] = -found.distance, found.most_depth, found.nx, found.ny, found.nz
    return answers[:, 0], answers[:, 1], answers[:, 2:]


def _near_points(surfaces: dict[int, np.ndarray], count: int, radius: float, random: np.random.Generator) -> np.ndarray:
    triangles = np.concatenate(list(surfaces.values()))
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    chosen = triangles[random.choice(len(triangles), count, p=area / area.sum())]
    on_them = np.einsum("nij,ni->nj", chosen, random.dirichlet(np.ones(3), count))
    away = random.normal(size=(count, 3))
    return on_them + away * (
        NEAR * radius * random.uniform(0.0, 1.0, (count, 1)) / np.linalg.norm(away, axis=1)[:, None]
    )
