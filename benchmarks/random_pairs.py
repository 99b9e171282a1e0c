"""Random pairs of everything in each other: what is missed, what is false, what the contacts do not part.

    python -m benchmarks.random_pairs [--pairs 10000] [--seed 1] [--only boxes]

Pairs whose boxes overlap. Boxes, closed triangle bodies (hooks, spikes, plates, tori, cans, needles) at any pose, so
that they pierce each other; fragments with flat and curved cracks moved by up to 3 % R from where they broke, or thrown
together. The truth is libigl's, at points of both surfaces no farther than 0.2 % R apart (test/truth/surface_truth.py).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import trimesh
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import Rotation

from benchmarks.peers.judging.least_translation import least_translation

sys.path.append(str(Path(__file__).resolve().parents[1] / "test"))  # the ground truth lives with the tests

from truth.contact_truth import ContactTruth, Poses, pairs_of, piled  # noqa: E402
from truth.surface_truth import Solid  # noqa: E402
from worlds.fractured_worlds import after_each_fracture, fractured_world, with_settings  # noqa: E402

from fracture_collision.geometry.generators import ball, brick, shell  # noqa: E402
from fracture_collision.records import ContactConstraintArray, FragmentStates  # noqa: E402
from fracture_collision.world import CollisionBody, CollisionWorld, Settings  # noqa: E402

SETTINGS = Settings(threads=1)
EPSILON = SETTINGS.penetration_tolerance  # [R]
FINEST = 2e-3  # [R] between points of a surface
# libigl's distances do not match ours to the last bit.
ROUNDING = 1e-6  # [R]
JITTERS = (0.003, 0.01, 0.03)  # [R]
SPREADS = (0.3, 0.6)  # [R], of piles
# Directions of contacts within so much [rad] are one.
ONE_WAY = np.deg2rad(11.0)


class Pair(NamedTuple):
    """Two bodies in each other, or near. Lengths in R of the smaller."""

    depth: float  # of the deepest point of either surface, if it is deeper than contacts up to epsilon
    bound: float  # missed_depth_bound, or epsilon for a pair that is not listed
    listed: float  # of the deepest contact; 0: none penetrates
    contacts: int
    is_listed: bool
    left: float  # depth that remains after the least translation that satisfies the contacts
    ways: int  # directions of the contacts that are deeper than epsilon
    name: str

    @property
    def faults(self) -> list[str]:
        is_in = self.depth > EPSILON + ROUNDING
        return [
            fault
            for fault, holds in (
                ("unlisted", is_in and not self.is_listed),
                ("missed", is_in and self.contacts == 0),
                ("beyond", self.depth > max(self.bound, self.listed) + ROUNDING),
                ("false", self.listed > EPSILON and self.depth < ROUNDING),
                ("not parted", self.left > EPSILON + ROUNDING),
            )
            if holds
        ]


FAULTS = ("unlisted", "missed", "beyond", "false", "not parted")


class Placed(NamedTuple):
    """Bodies at their poses, the answer, and the surfaces."""

    states: FragmentStates
    answer: ContactConstraintArray
    solids: dict[int, Solid]  # in the frame of each
    sizes: dict[int, float]  # [m] R of each
    names: dict[int, str]


def hook() -> trimesh.Trimesh:
    outline = np.array([(0, 0), (0.6, 0), (0.6, 0.15), (0.15, 0.15), (0.15, 0.6), (0, 0.6)], float) - 0.2
    n, half = len(outline), 0.1
    flat = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
    faces = [t[::-1] for t in flat] + [tuple(k + n for k in t) for t in flat]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, j + n), (i, j + n, i + n)]
    corners = np.vstack([np.column_stack([outline, np.full(n, z)]) for z in (-half, half)])
    return trimesh.Trimesh(corners, np.array(faces), process=False)


def triangle_bodies() -> dict[str, trimesh.Trimesh]:
    make = trimesh.creation
    return {
        "hook": hook(), "spike": make.cone(0.12, 0.9, sections=12), "plate": make.box((1.0, 0.8, 0.03)),
        "torus": make.torus(0.4, 0.08, major_sections=24, minor_sections=10),
        "can": make.annulus(0.25, 0.3, 0.5, sections=24), "needle": make.cylinder(0.01, 1.2, sections=8),
    }  # fmt: skip


def _of_meshes(one: trimesh.Trimesh, two: trimesh.Trimesh, names: tuple[str, str], pose: tuple) -> Placed:
    place, turns = pose
    world = CollisionWorld(SETTINGS)
    for k, mesh in ((1, one), (2, two)):
        corners, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
        world.add_body(CollisionBody(k, k, vertices=corners.ravel(), triangles=faces.ravel()))
    states = FragmentStates(1, 0, np.array([1, 2]), np.r_[0.0, 0.0, 0.0, place], turns.as_quat().ravel())
    meshes = {1: one, 2: two}
    return Placed(
        states, world.contacts(states), {k: Solid(mesh.triangles) for k, mesh in meshes.items()},
        {k: 0.5 * float(mesh.extents.max()) for k, mesh in meshes.items()}, dict(zip((1, 2), names, strict=True)),
    )  # fmt: skip


def bodies_of_triangles(random: np.random.Generator) -> Iterator[Placed]:
    shapes = triangle_bodies()
    while True:
        names = tuple(random.choice(list(shapes), 2).tolist())
        turns = Rotation.from_quat(random.normal(size=(2, 4)))
        yield _of_meshes(*(shapes[name] for name in names), names, (random.normal(0.0, 0.25, 3), turns))


def boxes(random: np.random.Generator) -> Iterator[Placed]:
    """Of any proportions; a third of them aligned, a third turned by a degree."""
    while True:
        one, two = (trimesh.creation.box(random.uniform(0.05, 1.0, 3)) for _ in range(2))
        most = (0.0, np.deg2rad(1.0), np.pi)[int(random.integers(3))]
        turns = Rotation.from_rotvec(random.uniform(-1.0, 1.0, (2, 3)) * most)
        place = random.uniform(-0.5, 0.5, 3) * (one.extents + two.extents)
        yield _of_meshes(one, two, ("box", "box"), (place, turns))


def _fragments(curved: bool, random: np.random.Generator) -> Iterator[Placed]:
    makers = ("ball", lambda: ball(1.0, 0.3)), ("brick", lambda: brick((2.0, 1.0, 0.8), 0.3)), (
        "shell", lambda: shell(1.0, 0.8, 0.5),
    )  # fmt: skip
    while True:
        for name, make in makers:
            seed = int(random.integers(1 << 30))
            case = fractured_world(make(), seeds=6, generations=2, curved=curved, seed=seed)
            world = with_settings(case, SETTINGS)
            for stage in after_each_fracture(case):
                truth = ContactTruth(stage)
                solids = {f: Solid(truth.surface(f)) for f in truth.fragment_ids}
                told = [stage.states(jitter, seed) for jitter in JITTERS]
                told += [piled(truth, seed + k, spread) for k, spread in enumerate(SPREADS)]
                for states in told:
                    ids = truth.fragment_ids
                    yield Placed(
                        states, world.contacts(states), solids, dict.fromkeys(ids, 1.0), dict.fromkeys(ids, name)
                    )


def flat_fragments(random: np.random.Generator) -> Iterator[Placed]:
    return _fragments(False, random)


def curved_fragments(random: np.random.Generator) -> Iterator[Placed]:
    return _fragments(True, random)


FAMILIES: dict[str, Callable[[np.random.Generator], Iterator[Placed]]] = {
    "boxes": boxes, "triangles": bodies_of_triangles, "flat fragments": flat_fragments,
    "curved fragments": curved_fragments,
}  # fmt: skip


def judged(placed: Placed) -> Iterator[Pair]:
    """The pairs whose boxes overlap."""
    poses, listed = Poses(placed.states), pairs_of(placed.answer)
    world = {f: poses.to_world(f, solid.triangles.reshape(-1, 3)) for f, solid in placed.solids.items()}
    boxes_of = {f: (points.min(axis=0), points.max(axis=0)) for f, points in world.items()}
    normals, gaps = placed.answer.normals.reshape(-1, 3), placed.answer.gaps
    for a, b in combinations(sorted(placed.solids), 2):
        if np.any((boxes_of[a][0] > boxes_of[b][1]) | (boxes_of[b][0] > boxes_of[a][1])):
            continue
        size = min(placed.sizes[a], placed.sizes[b])
        rows, bound = listed.get((a, b), (slice(0, 0), EPSILON * size))
        deepest = max(-gaps[rows].min(initial=0.0), 0.0)
        is_suspect = deepest > EPSILON * size
        shift = least_translation(normals[rows], -gaps[rows]) if rows.stop > rows.start else np.zeros(3)
        # whether it is deeper than said; or, where contacts are deep, whether they are in each other at all
        depth = _depth(placed.solids, poses, world, (a, b), (0.0 if is_suspect else deepest, size), np.zeros(3))
        left = 0.0
        if depth > EPSILON * size and rows.stop > rows.start:
            left = _depth(placed.solids, poses, world, (a, b), (EPSILON * size, size), shift * (1.0 + ROUNDING))
        yield Pair(
            depth / size, bound / size, deepest / size, rows.stop - rows.start, (a, b) in listed, left / size,
            _directions(normals[rows][gaps[rows] < -EPSILON * size]), f"{placed.names[a]} {placed.names[b]}",
        )  # fmt: skip


def _depth(solids: dict[int, Solid], poses: Poses, world: dict, pair: tuple[int, int], limits: tuple, shift) -> float:
    """Depth [m] of the deepest point of either, if it is deeper than the first limit, after b is moved by shift."""
    more_than, size = limits
    depth = 0.0
    for own, other in (pair, pair[::-1]):
        along = shift if own == pair[1] else -shift
        moved = poses.to_body(other, world[own] + along).reshape(-1, 3, 3)
        depth = max(depth, solids[other].deepest_of(moved, max(depth, more_than), FINEST * size).depth)
    return depth


def _directions(normals: np.ndarray) -> int:
    kept: list[np.ndarray] = []
    for n in normals:
        if not any(n @ m > np.cos(ONE_WAY) for m in kept):
            kept.append(n)
    return len(kept)


def campaign(family: str, pairs: int, seed: int) -> Iterator[Pair]:
    done = 0
    for placed in FAMILIES[family](np.random.default_rng(seed)):
        for pair in judged(placed):
            yield pair
            done += 1
            if done == pairs:
                return


@click.command(help=(__doc__ or "").split("\n\n")[0])
@click.option("--pairs", default=10_000, show_default=True, help="Of all families together.")
@click.option("--seed", default=1, show_default=True)
@click.option("--only", multiple=True, type=click.Choice(list(FAMILIES)), help="Of these families alone.")
@click.option("--list", "is_told", is_flag=True, help="Print each pair with a fault.")
def main(pairs: int, seed: int, only: tuple[str, ...], is_told: bool) -> None:
    console = Console(width=140)
    table = Table("family", "pairs", "deep", *FAULTS, "in one way: not parted", "most left, % R")
    families = only or tuple(FAMILIES)
    for family in families:
        share = -(-pairs // len(families))
        found = list(track(campaign(family, share, seed), family, total=share, console=Console(stderr=True)))
        deep = [pair for pair in found if pair.depth > EPSILON + ROUNDING]
        counts = [sum(fault in pair.faults for pair in found) for fault in FAULTS]
        single = [pair for pair in deep if pair.ways == 1]
        parted = sum("not parted" in pair.faults for pair in single)
        table.add_row(
            family, str(len(found)), str(len(deep)), *map(str, counts), f"{parted} of {len(single)}",
            f"{100.0 * max((pair.left for pair in found), default=0.0):.2f}",
        )  # fmt: skip
        for pair in found if is_told else ():
            if pair.faults:
                click.echo(f"{pair.faults} {pair}")
    console.print(table)


if __name__ == "__main__":
    main()
