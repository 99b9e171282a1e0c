"""The required contacts of a fractured world, by brute force: samples, their owners and depths."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple

import numpy as np
from oracles.brute_force import distances, owners, partition_of
from scipy.spatial.transform import Rotation
from worlds.fractured_worlds import FracturedWorld, samples_of

from fracture_collision.geometry.generators import TetGeometry, ball, bowl, brick, l_block, shell, torus
from fracture_collision.geometry.stored_meshes import bunny
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld
from fracture_collision.world.contact_ids import contact_ids

# Samples nearer to a fragment's border than this [m] may count as inside or outside.
BORDER = 1e-9

# A witness this near to the other fragment's surface [m] counts as on it.
WITNESS = 1e-6

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


COARSE_SHAPES: dict[str, Callable[[], TetGeometry]] = {
    "ball": lambda: ball(1.0, 0.4),
    "brick": lambda: brick((2.0, 1.0, 0.8), 0.4),
    "shell": lambda: shell(1.0, 0.8, 0.6),
    "bowl": lambda: bowl(2.0, 0.2, 0.4, 0.6),
    "torus": lambda: torus(0.72, 0.28, 0.3),
    "l_block": lambda: l_block((2.0, 1.6, 0.6), (1.2, 0.9), 0.4),
}


class Poses:
    """The states' poses, by fragment."""

    def __init__(self, states: FragmentStates) -> None:
        ids = np.asarray(states.fragment_ids).tolist()
        turns = Rotation.from_quat(np.asarray(states.orientations).reshape(-1, 4)).as_matrix()
        self.rotation = dict(zip(ids, turns, strict=True))
        self.position = dict(zip(ids, np.asarray(states.positions).reshape(-1, 3), strict=True))

    def to_body(self, fragment: int, points: np.ndarray) -> np.ndarray:
        return (points - self.position[fragment]) @ self.rotation[fragment]

    def to_world(self, fragment: int, points: np.ndarray) -> np.ndarray:
        return points @ self.rotation[fragment].T + self.position[fragment]


def surface_samples(case: FracturedWorld, fragment: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) [m, body frame] and numbers (n,) of the samples that may become contacts."""
    return samples_of(case.geometry, case.row(fragment))


def sample_ids(own: int, other: int, samples: np.ndarray) -> np.ndarray:
    """contact_ids of the samples of `own` against `other`."""
    out = np.empty(len(samples), np.uint64)
    contact_ids(np.full(len(samples), own), np.full(len(samples), other), samples.astype(np.int64), out)
    return out


def pairs_of(answer: ContactConstraintArray) -> dict[tuple[int, int], tuple[slice, float]]:
    """(fragment_a, fragment_b) -> the rows of its contacts and its missed_depth_bound [m]."""
    return {
        (int(a), int(b)): (
            slice(int(answer.pair_begin[i]), int(answer.pair_begin[i + 1])),
            float(answer.missed_depth_bound[i]),
        )
        for i, (a, b) in enumerate(zip(answer.fragment_a, answer.fragment_b, strict=True))
    }


class SampleDepths(NamedTuple):
    """Depths of all surface samples of one fragment in another; minus infinity for samples outside."""

    depth: np.ndarray  # (n,) [m] to the nearest point outside the other
    certain: np.ndarray  # (n,) bool: False where two tetrahedra that contain the sample disagree by rounding


class ContactTruth:
    """Brute force for one registry of a world; surfaces are computed on first use."""

    def __init__(self, case: FracturedWorld) -> None:
        self.case = case
        self.fragment_ids = case.oracle.fragment_ids
        self.partition = partition_of(case.oracle)
        self.samples = {f: surface_samples(case, f) for f in self.fragment_ids}
        self._boxes: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def surface(self, fragment: int) -> np.ndarray:
        return self.case.oracle.surface_triangles(fragment)

    def box(self, fragment: int) -> tuple[np.ndarray, np.ndarray]:
        if fragment not in self._boxes:
            corners = self.surface(fragment).reshape(-1, 3)
            self._boxes[fragment] = corners.min(axis=0), corners.max(axis=0)
        return self._boxes[fragment]

    def depths(self, own: int, other: int, poses: Poses) -> SampleDepths:
        points = poses.to_body(other, poses.to_world(own, self.samples[own][0]))
        return self.depths_of(other, points)

    def depths_of(self, other: int, points: np.ndarray) -> SampleDepths:
        """The same for any points (n, 3) [m] in the frame of `other`."""
        depth, certain = np.full(len(points), -np.inf), np.ones(len(points), dtype=bool)
        low, high = self.box(other)
        near = np.flatnonzero(np.all((points >= low) & (points <= high), axis=1))
        owner, certain[near] = owners(self.partition, points[near])
        inside = near[owner == other]
        depth[inside] = distances(points[inside], self.surface(other))
        return SampleDepths(depth, certain)

    def world_boxes(self, poses: Poses) -> dict[int, np.ndarray]:
        """Lower and upper corner (2, 3) [m] in the world, of each fragment's box."""
        boxes = {}
        for fragment in self.fragment_ids:
            low, high = self.box(fragment)
            middle = poses.to_world(fragment, 0.5 * (low + high)[None])[0]
            reach = np.abs(poses.rotation[fragment]) @ (0.5 * (high - low))
            boxes[fragment] = np.array((middle - reach, middle + reach))
        return boxes


def piled(truth: ContactTruth, seed: int, spread: float) -> FragmentStates:
    """Every fragment's centre at random about the origin (standard deviation `spread` [m]), in any orientation."""
    random = np.random.default_rng(seed)
    ids = truth.fragment_ids
    turns = Rotation.from_quat(random.normal(size=(len(ids), 4)))
    middles = np.array([np.mean(truth.box(f), axis=0) for f in ids])
    positions = random.normal(scale=spread, size=(len(ids), 3)) - turns.apply(middles)
    return FragmentStates(1, truth.case.generations, np.array(ids), positions.ravel(), turns.as_quat().ravel())


def moved(case: FracturedWorld, seed: int, distance: float, degrees: float) -> FragmentStates:
    """All fragments in place, moved by up to `distance` [m] and turned by up to `degrees` about a random axis."""
    random = np.random.default_rng(seed)
    ids = np.array(case.oracle.fragment_ids)
    turns = random.normal(size=(len(ids), 3))
    turns *= np.radians(random.uniform(0, degrees, (len(ids), 1))) / np.linalg.norm(turns, axis=1)[:, None]
    shifts = random.normal(size=(len(ids), 3))
    shifts *= random.uniform(0, distance, (len(ids), 1)) / np.linalg.norm(shifts, axis=1)[:, None]
    return FragmentStates(1, case.generations, ids, shifts.ravel(), Rotation.from_rotvec(turns).as_quat().ravel())


FRAMES: dict[str, Callable[[ContactTruth, int], FragmentStates]] = {
    "touching": lambda truth, seed: truth.case.states(),
    "jittered": lambda truth, seed: moved(truth.case, seed, 0.01, 1.0),
    "deep": lambda truth, seed: moved(truth.case, seed, 0.2, 10.0),
    "piled": lambda truth, seed: piled(truth, seed, 0.25),
}


class PairCheck(NamedTuple):
    """One pair of fragments against the truth; lengths in metres. No violation is allowed."""

    contacts: int
    bound: float  # missed_depth_bound, or epsilon for an unlisted pair
    is_listed: bool  # the answer lists the pair
    deepest_unlisted: float  # depth of the deepest unlisted sample, 0 if none is inside
    misplaced: float  # largest distance of a listed sample from its true place
    off_surface: float  # largest distance of a witness from the other's surface
    apart: int  # penetrations reported for samples that are not inside
    excess: np.ndarray  # (inside,) reported depth minus distance to the nearest surface, for samples inside


def check_pair(
    truth: ContactTruth, poses: Poses, answer: ContactConstraintArray, pair: tuple[int, int],
    listed: dict[tuple[int, int], tuple[slice, float]], epsilon: float,
) -> PairCheck:  # fmt: skip
    """Compares a pair (smaller id first) of `answer` with brute force, in both directions."""
    rows, bound = listed.get(pair, (slice(0, 0), epsilon))
    ids, gaps = answer.contact_ids[rows], answer.gaps[rows]
    points = answer.points_a.reshape(-1, 3)[rows], answer.points_b.reshape(-1, 3)[rows]
    found, apart = 0, 0
    unlisted = misplaced = off_surface = 0.0
    excess = [np.zeros(0)]
    for side in range(2):
        own, other = pair[side], pair[1 - side]
        samples, numbers = truth.samples[own]
        depths = truth.depths(own, other, poses)
        keys = sample_ids(own, other, numbers)
        _, contact, sample = np.intersect1d(ids, keys, return_indices=True)
        found += len(contact)
        rest = depths.certain.copy()
        rest[sample] = False
        unlisted = max(unlisted, depths.depth[rest].max(initial=0.0))
        if not len(contact):
            continue
        there = poses.to_world(own, samples[sample])
        misplaced = max(misplaced, np.linalg.norm(points[side][contact] - there, axis=1).max())
        witness = poses.to_body(other, points[1 - side][contact])
        off_surface = max(off_surface, distances(witness, truth.surface(other)).max())
        depth, certain, gap = depths.depth[sample], depths.certain[sample], gaps[contact]
        inside = np.isfinite(depth)
        apart += int(np.count_nonzero(~inside & certain & (gap < -BORDER)))
        excess.append((-gap - depth)[inside & certain])
    assert found == len(ids), f"pair {pair}: {len(ids) - found} contacts are no sample of either fragment"
    return PairCheck(
        len(ids), bound, pair in listed, unlisted, misplaced, off_surface, apart, np.concatenate(excess)
    )  # fmt: skip


def check_all_pairs(
    truth: ContactTruth, states: FragmentStates, world: CollisionWorld | None = None
) -> list[PairCheck]:
    """Checks the answer of `world` (the truth's own, or one with the same messages) for every pair of fragments."""
    world = world or truth.case.world
    answer, poses, settings = world.contacts(states), Poses(states), world.settings
    listed = pairs_of(answer)
    assert list(listed) == sorted(listed)
    normals = answer.normals.reshape(-1, 3)
    along = (answer.points_b - answer.points_a).reshape(-1, 3)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    assert np.allclose(answer.gaps, (along * normals).sum(axis=1), atol=1e-12)
    assert len(set(answer.contact_ids.tolist())) == len(answer.contact_ids)
    assert (answer.gaps <= settings.detection_tolerance + BORDER).all()
    return [
        check_pair(truth, poses, answer, pair, listed, settings.penetration_tolerance)
        for pair in combinations(sorted(truth.fragment_ids), 2)
    ]


def assert_true(checks: list[PairCheck], epsilon: float) -> None:
    """For a search without a budget; R = 1 m. `epsilon` [m]: the penetration tolerance."""
    for check in checks:
        # without a budget the bound is epsilon plus rounding: nothing deeper may be missing
        assert check.bound <= epsilon + BORDER
        assert check.deepest_unlisted <= check.bound, check
        assert check.apart == 0, check
        assert check.misplaced <= 1e-12, check
        assert check.off_surface <= WITNESS, check
        assert np.abs(check.excess).max(initial=0.0) <= BORDER, check
