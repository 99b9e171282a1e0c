"""Points where the cracks of a fractured body meet, from its parts by brute force: corners that must be samples."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from fracture_collision.geometry.tetrahedra import FACE_VERTICES
from oracles.fragmented_body import FragmentedBody


def corner_samples(oracle: FragmentedBody, fragment: int) -> dict[int, np.ndarray]:
    """Points (3,) [m] of the fragment by their numbers in the body: behind nodes and edge ends, five a tetrahedron.

    Of tetrahedra of three fragments and more the hub, unless one event parted three, and the points of faces of three.
    """
    found: dict[int, np.ndarray] = {}
    first, surface = len(oracle.vertices) + 2 * len(oracle.edges), oracle.parts.surface
    for row, t in enumerate(oracle.parts.tetrahedra.tolist()):
        nodes = oracle.tetrahedra[t]
        labels, corners = oracle.labels[nodes], oracle.vertices[nodes]
        groups = len(set(labels.tolist()))
        if groups < 3 or fragment not in labels:
            continue
        edges = map(tuple, map(sorted, combinations(nodes.tolist(), 2)))
        events = {oracle.events[edge] for edge in edges if edge in oracle.events}
        if groups > 3 or len(events) > 1:
            found[first + 5 * t] = surface.hubs[row] @ corners
        for face in range(4):
            of_face = labels[FACE_VERTICES[face]]
            is_elsewhere = 0 <= oracle.neighbours[t, face] < t
            if len(set(of_face.tolist())) == 3 and fragment in of_face and not is_elsewhere:
                found[first + 5 * t + 1 + face] = surface.face_points[row, face] @ corners
    return found
