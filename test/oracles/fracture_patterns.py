"""Fracture events for tests: flat Voronoi cracks, and curved ones whose planes bound no common cell."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracture_collision.core.mesh.connected_pieces import connected_pieces
from fracture_collision.records import FractureEvent
from oracles.fragmented_body import FragmentedBody

CrackPlane = Callable[[int, int, int, int], tuple[np.ndarray, float]]


def voronoi_event(
    body: FragmentedBody, fragment_id: int, seeds: np.ndarray, first_new_id: int, sequence: int = 1, body_id: int = 1
) -> FractureEvent:
    """Break a fragment into the Voronoi cells of `seeds` (k, 3) [m]; planes are the bisectors.

    Each connected piece of a cell becomes a fragment of its own, numbered from `first_new_id` in the order of the
    pieces' smallest nodes. All edges between two cells carry the same plane, to the bit.
    """
    seeds = np.asarray(seeds, dtype=np.float64)

    def bisector(_a: int, _b: int, i: int, j: int) -> tuple[np.ndarray, float]:
        low, high = seeds[min(i, j)], seeds[max(i, j)]
        normal = (high - low) / np.linalg.norm(high - low)
        sign = 1.0 if i < j else -1.0
        return sign * normal, sign * float(normal @ (0.5 * (low + high)))

    return event_of_labels(body, fragment_id, _nearest(body.vertices, seeds), bisector, first_new_id, sequence, body_id)


def curved_event(
    body: FragmentedBody,
    fragment_id: int,
    seeds: np.ndarray,
    first_new_id: int,
    sequence: int = 1,
    body_id: int = 1,
    amplitude: float = 0.15,
) -> FractureEvent:
    """As `voronoi_event`, but nearest in a smoothly warped space, so that cracks are curved and fragments concave.

    Each cut edge carries the tangent plane of the crack where the edge crosses it. `amplitude` is the warp's size in
    parts of the body's longest side.
    """
    length = np.ptp(body.vertices, axis=0).max()
    warp = warp_of(length, amplitude)
    warped_seeds = warp(np.asarray(seeds, dtype=np.float64))
    nearest = _nearest(warp(body.vertices), warped_seeds)

    def level(x: np.ndarray, i: np.ndarray | int, j: np.ndarray | int) -> np.ndarray:
        """Negative in cell i, positive in cell j."""
        w = warp(x)
        return np.sum((w - warped_seeds[i]) ** 2, axis=-1) - np.sum((w - warped_seeds[j]) ** 2, axis=-1)

    ends = body.edges[(body.labels[body.edges] == fragment_id).all(axis=1)]
    ends = ends[nearest[ends[:, 0]] != nearest[ends[:, 1]]]
    start, along = body.vertices[ends[:, 0]], body.vertices[ends[:, 1]] - body.vertices[ends[:, 0]]
    low, high = np.zeros((len(ends), 1)), np.ones((len(ends), 1))
    for _ in range(40):
        middle = 0.5 * (low + high)
        is_before = level(start + middle * along, *nearest[ends].T)[:, None] < 0.0
        low, high = np.where(is_before, middle, low), np.where(is_before, high, middle)
    places = start + np.clip(0.5 * (low + high), 0.02, 0.98) * along
    crossings = dict(zip(map(tuple, ends.tolist()), places, strict=True))

    def tangent(a: int, b: int, i: int, j: int) -> tuple[np.ndarray, float]:
        along, crossing = body.vertices[b] - body.vertices[a], crossings[a, b]
        step = 1e-5 * length * np.eye(3)
        gradient = level(crossing + step, i, j) - level(crossing - step, i, j)
        normal = gradient / np.linalg.norm(gradient)
        if normal @ along < 0.1 * np.linalg.norm(along):  # the crack grazes the edge, or crosses it more than once
            normal = along / np.linalg.norm(along)
        return normal, float(normal @ crossing)

    return event_of_labels(body, fragment_id, nearest, tangent, first_new_id, sequence, body_id)


def disagreeing_event(
    body: FragmentedBody,
    fragment_id: int,
    seeds: np.ndarray,
    first_new_id: int,
    sequence: int,
    tilt: float,
    random: np.random.Generator,
) -> FractureEvent:
    """As `voronoi_event`, but every cut edge has its own plane: `own_planes`."""
    nearest = _nearest(body.vertices, np.asarray(seeds, dtype=np.float64))
    return event_of_labels(
        body, fragment_id, nearest, own_planes(body.vertices, random, tilt), first_new_id, sequence, 1
    )


def own_planes(vertices: np.ndarray, random: np.random.Generator, tilt: float) -> CrackPlane:
    """Each cut edge has its own plane, tilted at random, at a random place along it; no two agree.

    `tilt`: the deviation of the normal from the edge's direction, as a ratio.
    """

    def plane(a: int, b: int, _i: int, _j: int) -> tuple[np.ndarray, float]:
        start, along = vertices[a], vertices[b] - vertices[a]
        normal = along / np.linalg.norm(along) + tilt * random.normal(size=3)
        normal /= np.linalg.norm(normal)
        if normal @ along < 0.1 * np.linalg.norm(along):
            normal = along / np.linalg.norm(along)
        return normal, float(normal @ (start + random.uniform(0.02, 0.98) * along))

    return plane


def warp_of(length: float, amplitude: float) -> Callable[[np.ndarray], np.ndarray]:
    """The map of points (..., 3) [m] in whose image the cells of `curved_event` are Voronoi.

    `length` [m]: the body's longest side.
    """

    def warp(x: np.ndarray) -> np.ndarray:
        phase = 2.0 * np.pi * x / length
        return x + amplitude * length * np.sin(np.roll(phase, 1, axis=-1) * 1.3 + np.roll(phase, 2, axis=-1))

    return warp


def _nearest(points: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    return np.argmin(np.linalg.norm(points[:, None] - seeds[None], axis=2), axis=1)


def event_of_labels(
    body: FragmentedBody,
    fragment_id: int,
    nearest_seed: np.ndarray,
    plane: CrackPlane,
    first_new_id: int,
    sequence: int,
    body_id: int,
) -> FractureEvent:
    nodes = np.flatnonzero(body.labels == fragment_id)
    inside = body.edges[np.all(body.labels[body.edges] == fragment_id, axis=1)]
    renumbered = np.full(len(body.labels), -1)
    renumbered[nodes] = np.arange(len(nodes))
    piece = connected_pieces(renumbered[inside], nearest_seed[nodes])
    if piece.max() == 0:
        raise ValueError(f"fragment {fragment_id}: all its nodes are nearest to one seed, nothing breaks")
    cut = inside[piece[renumbered[inside[:, 0]]] != piece[renumbered[inside[:, 1]]]]
    planes = [plane(a, b, int(nearest_seed[a]), int(nearest_seed[b])) for a, b in cut.tolist()]
    return FractureEvent(
        sequence=sequence,
        body_id=body_id,
        fragment_id=fragment_id,
        new_fragment_ids=(first_new_id + np.arange(piece.max() + 1)).astype(np.uint32),
        nodes=nodes.astype(np.uint32),
        node_fragments=piece.astype(np.uint32),
        cut_edges=cut.ravel().astype(np.uint32),
        cut_planes=np.array([(*normal, offset) for normal, offset in planes]).ravel(),
    )
