"""What the contacts of a fractured world have to be, by brute force: samples, who owns them, how deep they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from fractured_worlds import FracturedWorld
from oracles.brute_force import distances, owners, partition_of
from oracles.fragmented_body import ALL_KINDS, BARE_FACE, CRACK, ORIGINAL
from scipy.spatial.transform import Rotation

from fracture_collision.geometry.concave_shapes import l_block, torus
from fracture_collision.geometry.generators import TetGeometry, ball, bowl, brick, shell
from fracture_collision.geometry.stored_meshes import bunny
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world.contact_ids import contact_ids

# What the field measures against; steps are left out (docs/numerics.md).
MEASURED = (ORIGINAL, CRACK, BARE_FACE)

# Half the longest side, R, is 1 [m] for all.
SHAPES: dict[str, Callable[[], TetGeometry]] = {
    "ball": lambda: ball(1.0, 0.3),
    "brick": lambda: brick((2.0, 1.0, 0.8), 0.3),
    "shell": lambda: shell(1.0, 0.8, 0.5),
    "bowl": lambda: bowl(2.0, 0.2, 0.35, 0.6),
    "torus": lambda: torus(0.72, 0.28, 0.2),
    "l_block": lambda: l_block((2.0, 1.6, 0.6), (1.2, 0.9), 0.25),
    "bunny": lambda: bunny(2.0),
}


class Poses:
    """The states' poses, by fragment."""

    def __init__(self, states: FragmentStates) -> None:
        ids = np.asarray(states.fragment_ids).tolist()
        self.rotation = dict(zip(ids, Rotation.from_quat(states.orientations.reshape(-1, 4)), strict=True))
        self.position = dict(zip(ids, states.positions.reshape(-1, 3), strict=True))

    def to_body(self, fragment: int, points: np.ndarray) -> np.ndarray:
        return self.rotation[fragment].inv().apply(points - self.position[fragment])

    def to_world(self, fragment: int, points: np.ndarray) -> np.ndarray:
        return self.rotation[fragment].apply(points) + self.position[fragment]


def surface_samples(case: FracturedWorld, fragment: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) [m, body frame] and numbers (n,) of the samples that may become contacts."""
    tree = case.geometry.sphere_tree(case.row(fragment))
    leaves = (tree.size == 1) & (tree.on_surface == 1)
    return tree.center[leaves], tree.sample[leaves]


def sample_ids(own: int, other: int, samples: np.ndarray) -> np.ndarray:
    """contact_ids that samples of `own` have against `other`."""
    out = np.empty(len(samples), np.uint64)
    contact_ids(np.full(len(samples), own), np.full(len(samples), other), samples.astype(np.int64), out)
    return out


def pairs_of(answer: ContactConstraintArray) -> dict[tuple[int, int], tuple[slice, float]]:
    """(fragment_a, fragment_b) to the rows of its contacts and its missed_depth_bound [m]."""
    return {
        (int(a), int(b)): (
            slice(int(answer.pair_begin[i]), int(answer.pair_begin[i + 1])),
            float(answer.missed_depth_bound[i]),
        )
        for i, (a, b) in enumerate(zip(answer.fragment_a, answer.fragment_b, strict=True))
    }


class SampleDepths(NamedTuple):
    """Of all surface samples of one fragment against another; minus infinity where a sample is not inside it."""

    measured: np.ndarray  # (n,) [m] to the surface that the field measures against
    true: np.ndarray  # (n,) [m] to the nearest point that is not the other's: steps count too
    certain: np.ndarray  # (n,) bool: not on a face whose two tetrahedra disagree about the owner


class ContactTruth:
    """Brute force for one registry of a world; surfaces are made when first asked for."""

    def __init__(self, case: FracturedWorld) -> None:
        self.case = case
        self.fragment_ids = case.oracle.fragment_ids
        self.partition = partition_of(case.oracle)
        self.samples = {f: surface_samples(case, f) for f in self.fragment_ids}
        self._boxes: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def surface(self, fragment: int, kinds: tuple[str, ...] = MEASURED) -> np.ndarray:
        return self.case.oracle.surface_triangles(fragment, kinds)

    def box(self, fragment: int) -> tuple[np.ndarray, np.ndarray]:
        if fragment not in self._boxes:
            corners = self.surface(fragment, ALL_KINDS).reshape(-1, 3)
            self._boxes[fragment] = corners.min(axis=0), corners.max(axis=0)
        return self._boxes[fragment]

    def depths(self, own: int, other: int, poses: Poses) -> SampleDepths:
        points = poses.to_body(other, poses.to_world(own, self.samples[own][0]))
        return self.depths_of(other, points)

    def depths_of(self, other: int, points: np.ndarray) -> SampleDepths:
        """The same of any points (n, 3) [m] in the frame of `other`."""
        measured, true = np.full(len(points), -np.inf), np.full(len(points), -np.inf)
        certain = np.ones(len(points), dtype=bool)
        low, high = self.box(other)
        near = np.flatnonzero(np.all((points >= low) & (points <= high), axis=1))
        owner, certain[near] = owners(self.partition, points[near])
        inside = near[owner == other]
        measured[inside] = distances(points[inside], self.surface(other))
        true[inside] = distances(points[inside], self.surface(other, ALL_KINDS))
        return SampleDepths(measured, true, certain)
