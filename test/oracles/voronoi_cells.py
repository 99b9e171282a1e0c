"""Deviation of the fragments of a flat fracture from their Voronoi cells, which are computed by clipping."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.tetrahedra import EDGE_VERTICES, FACE_VERTICES, tetrahedron_volumes
from oracles.convex_cells import area_vector, clip, moments, tetrahedron
from oracles.fracture_patterns import voronoi_event
from oracles.fragmented_body import FragmentedBody


class VoronoiCheck(NamedTuple):
    """A body's tetrahedra after one flat fracture, beside exact Voronoi cells. Volumes in parts of the body's."""

    cells: np.ndarray  # (k,) volume of each seed's cell
    off: np.ndarray  # (k,) volume of the fragments of each seed minus its cell's
    misplaced: float  # volume owned by a fragment of another cell
    fitting: int  # tetrahedra of several fragments whose edges and faces meet the cells of their own nodes alone
    other: int  # the rest of those
    worst_fitting: float  # largest difference in one of the fitting, in parts of the tetrahedron


def against_voronoi_cells(mesh: TetGeometry, seeds: np.ndarray) -> VoronoiCheck:
    body = FragmentedBody(*mesh)
    body.apply(voronoi_event(body, 1, seeds, 2))
    seed_of_node = np.argmin(np.linalg.norm(mesh.vertices[:, None] - seeds, axis=2), axis=1)
    volumes = tetrahedron_volumes(*mesh)
    cells, off, misplaced = np.zeros(len(seeds)), np.zeros(len(seeds)), 0.0
    np.add.at(cells, seed_of_node[mesh.tetrahedra[body.parts.row < 0, 0]], volumes[body.parts.row < 0])
    fitting, worst = 0, 0.0
    for row, t in enumerate(body.parts.tetrahedra.tolist()):
        nodes = mesh.tetrahedra[t]
        seed_of_label = dict(zip(body.labels[nodes].tolist(), seed_of_node[nodes].tolist(), strict=True))
        own = np.zeros(len(seeds))
        for label, share in zip(body.parts.labels[row].tolist(), body.parts.share[row].tolist(), strict=True):
            own[seed_of_label[label]] += share
        exact, on_face = voronoi_shares(mesh.vertices[nodes], seeds)
        cells += exact * volumes[t]
        off += (own - exact) * volumes[t]
        misplaced += 0.5 * np.abs(own - exact).sum() * volumes[t]
        # two labels of one cell: separate pieces of it
        fits = len(seed_of_label) == len(set(seed_of_label.values()))
        fits &= all(set(on_face[k]) == set(seed_of_node[nodes[FACE_VERTICES[k]]].tolist()) for k in range(4))
        for (a, b), point in zip(nodes[EDGE_VERTICES], body.parts.surface.edge_points[row], strict=True):
            distance = np.linalg.norm(point @ mesh.vertices[nodes] - seeds, axis=1)
            is_cut = body.labels[a] != body.labels[b]
            fits &= not is_cut or distance[seed_of_node[[a, b]]].max() <= distance.min() * (1.0 + 1e-12)
        if fits:
            fitting += 1
            worst = max(worst, np.abs(own - exact).max())
    whole = volumes.sum()
    other = len(body.parts.tetrahedra) - fitting
    return VoronoiCheck(cells / whole, off / whole, misplaced / whole, fitting, other, worst)


def voronoi_shares(corners: np.ndarray, seeds: np.ndarray) -> tuple[np.ndarray, list[list[int]]]:
    """The share (k,) of a tetrahedron that is nearest to each seed, by clipping; the seeds that each face meets."""
    shares, on_face = np.zeros(len(seeds)), [[] for _ in range(4)]
    whole = np.linalg.det(corners[1:] - corners[0]) / 6.0
    for k, seed in enumerate(seeds):
        cell = tetrahedron(corners)
        for other in np.flatnonzero(np.arange(len(seeds)) != k).tolist():
            cell = clip(cell, seed - seeds[other], 0.5 * (seed @ seed - seeds[other] @ seeds[other]), ("seed", other))
        shares[k] = moments(cell)[0] / whole
        for (kind, index), points in cell:
            full = corners[FACE_VERTICES[index]] if kind == "face" else points
            if kind == "face" and np.linalg.norm(area_vector(points)) > 1e-12 * np.linalg.norm(area_vector(full)):
                on_face[index].append(k)
    return shares, on_face
