"""Arguments of queries: the fragments of a step, a pair with its relative poses, and a buffer for its contacts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.rotations import relative_pose


class Pair(NamedTuple):
    """Two fragments, by their rows in the pools, and their relative poses."""

    a: int
    b: int
    rotation: np.ndarray  # (2, 3, 3) float64: [0] from a's body frame to b's, [1] back
    translation: np.ndarray  # (2, 3) float64 [m], likewise


class Step(NamedTuple):
    """The n fragments that take part in a step, their world poses, and the pairs to be searched."""

    rows: np.ndarray  # (n,) int64: their rows in the pools
    rotations: np.ndarray  # (n, 3, 3) float64
    positions: np.ndarray  # (n, 3) float64 [m]
    pairs: np.ndarray  # (p, 2) int64: indices into `rows`


@query_kernel
def put_pair(step, p, rotation, translation):
    """Pair number p of a Step.

    Its relative poses are computed into rotation (2, 3, 3) and translation (2, 3) [m].
    """
    i, j = step.pairs[p, 0], step.pairs[p, 1]
    rotations, positions = step.rotations, step.positions
    relative_pose(rotations[i], positions[i], rotations[j], positions[j], rotation[0], translation[0])
    relative_pose(rotations[j], positions[j], rotations[i], positions[i], rotation[1], translation[1])
    return Pair(step.rows[i], step.rows[j], rotation, translation)


class Sink(NamedTuple):
    """Buffer for the contacts of one pair.

    A query that finds more contacts than fit returns their number; it must be repeated with a larger buffer.

    contacts: sample point (3), witness on the other fragment (3), the other's outward unit normal (3), all in the
    other's body frame; gap [m]. ids: side (0: a's sample in b), sample (of a sphere: sphere_contacts.py), source and
    tetrahedron of the witness, tetrahedron of the sample (elementary_queries.Probe); columns ID_... of
    known_samples.py.
    """

    contacts: np.ndarray  # (n, 10) float64
    ids: np.ndarray  # (n, 5) int64


def make_sink(room: int) -> Sink:
    """A Sink of `room` rows, zero."""
    return Sink(np.zeros((room, 10)), np.zeros((room, 5), np.int64))
