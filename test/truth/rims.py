"""Normals of contacts between freshly broken neighbours, against the direction of the pattern's crack between them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from oracles.fracture_patterns import curved_event, voronoi_event, warp_of
from oracles.fragmented_body import FragmentedBody
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.records import CollisionBody, ContactConstraintArray, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

AMPLITUDE = 0.15  # of a curved crack's warp, as a share of the body's longest side
# Contacts of a pair nearer than this share of R to each other are neighbours.
NEIGHBOUR = 0.1


class BrokenBody(NamedTuple):
    """One body, one fracture, and the cell of each fragment in the (warped) Voronoi pattern that made it."""

    body: CollisionBody
    event: FractureEvent
    seeds: np.ndarray  # (k, 3) [m] in the warped space
    warp_amplitude: float
    cell: dict[int, int]  # by fragment: row of seeds
    neighbours: set[tuple[int, int]]  # fragments with a cut edge between them, smaller id first
    longest: float  # [m] longest side, 2 R

    def direction(self, a: int, b: int, points: np.ndarray) -> np.ndarray:
        """Unit normal (n, 3) from a to b of the crack between them, at points (n, 3) [m] of the unbroken body."""
        warp = warp_of(self.longest, self.warp_amplitude)

        def level(x: np.ndarray) -> np.ndarray:
            w = warp(x)
            return ((w - self.seeds[self.cell[a]]) ** 2).sum(-1) - ((w - self.seeds[self.cell[b]]) ** 2).sum(-1)

        steps = 1e-5 * self.longest * np.eye(3)
        gradient = np.stack([level(points + h) - level(points - h) for h in steps], axis=-1)
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)


class RimMeasure(NamedTuple):
    """Contacts between neighbours; lengths in R, angles in degrees."""

    angles: np.ndarray  # (contacts,) between the normal and the crack's direction
    opposed: float  # share of pairs of neighbouring contacts with opposed normals
    apart: np.ndarray  # angles between the normals of neighbouring contacts
    apart_in_truth: np.ndarray  # and between the crack's directions at them

    @property
    def off(self) -> float:
        """Share of contacts whose normal is more than 30 degrees off."""
        return float(np.mean(self.angles > 30.0))


def broken_body(geometry: TetGeometry, pieces: int, curved: bool, seed: int = 3) -> BrokenBody:
    random = np.random.default_rng(seed)
    vertices = geometry.vertices
    seeds = vertices[random.choice(len(vertices), pieces, replace=False)] + random.normal(size=(pieces, 3)) * 0.03
    oracle = FragmentedBody(vertices, geometry.tetrahedra)
    longest = float(np.ptp(vertices, axis=0).max())
    amplitude = AMPLITUDE if curved else 0.0
    event = curved_event(oracle, 1, seeds, 2, amplitude=AMPLITUDE) if curved else voronoi_event(oracle, 1, seeds, 2)
    oracle.apply(event)
    warp = warp_of(longest, amplitude)
    nearest = cKDTree(warp(seeds)).query(warp(vertices))[1]
    cell = {f: int(np.bincount(nearest[oracle.labels == f]).argmax()) for f in oracle.fragment_ids}
    ends = oracle.labels[oracle.edges]
    ends = np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1)
    body = CollisionBody(1, 1, vertices=vertices.ravel(), tetrahedra=geometry.tetrahedra.ravel(), density=2500.0)
    return BrokenBody(body, event, warp(seeds), amplitude, cell, set(map(tuple, ends.tolist())), longest)


def world_of(broken: BrokenBody, settings: Settings, kind: type[CollisionWorld] = CollisionWorld) -> CollisionWorld:
    world = kind(settings)
    world.add_body(broken.body)
    world.add_fracture(broken.event)
    ids = np.array(sorted(broken.cell))
    world.contacts(FragmentStates(1, 1, ids, np.zeros(3 * len(ids)), np.tile((0.0, 0.0, 0.0, 1.0), len(ids))))
    return world


def jittered(broken: BrokenBody, world: CollisionWorld, distance: float, degrees: float, seed: int) -> FragmentStates:
    """Every fragment moved by up to `distance` (of R) and rotated by up to `degrees` about its centre of mass."""
    random = np.random.default_rng(seed)
    registry = world.fragments()
    n = len(registry.fragment_ids)
    ways, axes = random.normal(size=(2, n, 3))
    ways *= random.uniform(0.0, 0.5 * distance * broken.longest, (n, 1)) / np.linalg.norm(ways, axis=1)[:, None]
    axes *= np.radians(random.uniform(0.0, degrees, (n, 1))) / np.linalg.norm(axes, axis=1)[:, None]
    turns = Rotation.from_rotvec(axes)
    centers = registry.centers_of_mass.reshape(-1, 3)
    positions = ways + centers - turns.apply(centers)
    return FragmentStates(1, 1, registry.fragment_ids, positions.ravel(), turns.as_quat().ravel())


def measure(
    broken: BrokenBody, world: CollisionWorld, frames: list[FragmentStates], deeper: float,
    is_counted: Callable[[ContactConstraintArray], np.ndarray] | None = None,
) -> RimMeasure:  # fmt: skip
    """Measures the contacts between neighbours deeper than `deeper` (of R; minus infinity: all)."""
    opposed, pairs = 0, 0
    normals, truths = [], []
    apart, apart_in_truth = [], []
    for states in frames:
        answer = world.contacts(states)
        counted = np.full(len(answer.gaps), True) if is_counted is None else is_counted(answer)
        ids = states.fragment_ids.tolist()
        turn = dict(zip(ids, Rotation.from_quat(states.orientations.reshape(-1, 4)), strict=True))
        place = dict(zip(ids, states.positions.reshape(-1, 3), strict=True))
        points = 0.5 * (answer.points_a + answer.points_b).reshape(-1, 3)
        for k, pair in enumerate(zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)):
            rows = np.arange(int(answer.pair_begin[k]), int(answer.pair_begin[k + 1]))
            rows = rows[counted[rows] & (answer.gaps[rows] < -0.5 * deeper * broken.longest)]
            if pair not in broken.neighbours or not len(rows):
                continue
            ways = [
                turn[f].apply(broken.direction(*pair, turn[f].inv().apply(points[rows] - place[f]))) for f in pair
            ]
            truth = (ways[0] + ways[1]) / np.linalg.norm(ways[0] + ways[1], axis=1)[:, None]
            normal = answer.normals.reshape(-1, 3)[rows]
            normals.append(normal)
            truths.append(truth)
            close = cKDTree(points[rows]).query_pairs(NEIGHBOUR * 0.5 * broken.longest, output_type="ndarray")
            apart.append(_angles(normal, close))
            apart_in_truth.append(_angles(truth, close))
            opposed += int(np.count_nonzero(apart[-1] > 90.0))
            pairs += len(close)
    angles = _angle(np.concatenate(normals), np.concatenate(truths))
    return RimMeasure(angles, opposed / max(pairs, 1), np.concatenate(apart), np.concatenate(apart_in_truth))


def _angles(unit: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    return _angle(unit[pairs[:, 0]], unit[pairs[:, 1]])


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((first * second).sum(axis=1), -1.0, 1.0)))
