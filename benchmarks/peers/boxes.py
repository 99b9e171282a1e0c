"""A broad phase for methods without one: world-space boxes and their overlapping pairs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.peers.worlds import Frame, Surface

SLACK = 1e-6  # [m] touching boxes overlap


class LocalBoxes(NamedTuple):
    """One box per fragment, in the fragment's frame."""

    middle: np.ndarray  # (n, 3) [m]
    half: np.ndarray  # (n, 3) [m]


def local_boxes(surfaces: list[Surface]) -> LocalBoxes:
    low, high = (np.array([f(s.vertices, axis=0) for s in surfaces]) for f in (np.min, np.max))
    return LocalBoxes(0.5 * (low + high), 0.5 * (high - low))


def moved_boxes(boxes: LocalBoxes, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners (n, 3) [m] in the world."""
    middle = np.einsum("nij,nj->ni", frame.rotations, boxes.middle) + frame.positions
    half = np.einsum("nij,nj->ni", np.abs(frame.rotations), boxes.half) + SLACK
    return middle - half, middle + half


def overlapping(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All pairs (first < second) whose boxes overlap."""
    meet = np.all((low[:, None] <= high[None]) & (low[None] <= high[:, None]), axis=-1)
    return np.nonzero(np.triu(meet, 1))


def near_pairs(boxes: LocalBoxes, frame: Frame) -> list[tuple[int, int]]:
    first, second = overlapping(*moved_boxes(boxes, frame))
    return list(zip(first.tolist(), second.tolist(), strict=True))


class Vertices(NamedTuple):
    """All fragments' vertices in one array."""

    points: np.ndarray  # (v, 3) [m] each about its fragment's centre
    fragment: np.ndarray  # (v,)
    begin: np.ndarray  # (n + 1,)


def all_vertices(points: list[np.ndarray]) -> Vertices:
    """Takes the vertices of each fragment (k, 3) [m]."""
    counts = [len(p) for p in points]
    return Vertices(
        np.concatenate(points),
        np.repeat(np.arange(len(points)), counts),
        np.concatenate([[0], np.cumsum(counts)]),
    )


class Candidates(NamedTuple):
    """Vertices that lie in another fragment's box, in ascending order of that fragment."""

    row: np.ndarray  # (k,) among all vertices
    own: np.ndarray  # (k,) fragment of the vertex
    other: np.ndarray  # (k,) fragment of the box
    world: np.ndarray  # (k, 3) [m]
    local: np.ndarray  # (k, 3) [m] relative to the other's centre, in its axes


def candidates(vertices: Vertices, frame: Frame) -> Candidates:
    """Uses boxes of the moved vertices themselves, which are tighter than moved boxes."""
    moved = np.einsum("nij,nj->ni", frame.rotations[vertices.fragment], vertices.points)
    moved += frame.positions[vertices.fragment]
    low = np.minimum.reduceat(moved, vertices.begin[:-1]) - SLACK
    high = np.maximum.reduceat(moved, vertices.begin[:-1]) + SLACK
    first, second = overlapping(low, high)
    own_of, other_of = np.concatenate([first, second]), np.concatenate([second, first])
    order = np.lexsort((own_of, other_of))
    found, others = [np.zeros(0, int)], [np.zeros(0, int)]
    for u, v in zip(own_of[order].tolist(), other_of[order].tolist(), strict=True):
        begin, end = vertices.begin[u], vertices.begin[u + 1]
        inside = np.all((moved[begin:end] >= low[v]) & (moved[begin:end] <= high[v]), axis=1)
        found.append(begin + np.flatnonzero(inside))
        others.append(np.full(len(found[-1]), v))
    index, other = np.concatenate(found), np.concatenate(others)
    local = np.einsum("nji,nj->ni", frame.rotations[other], moved[index] - frame.positions[other])
    return Candidates(index, vertices.fragment[index], other, moved[index], local)
