"""Times rays, distances, closest points and containment in a scene of many fragments, and trimesh beside them."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import click
import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table

from fracture_collision.fracture import voronoi
from fracture_collision.geometry.generators import ball
from fracture_collision.world import CollisionBody, CollisionWorld, FragmentStates, Settings

SPREAD = 2.0  # [m] fragments of a ball of 1 m are strewn over a cube of twice this side


def strewn(seeds: int, threads: int) -> tuple[CollisionWorld, FragmentStates]:
    """A ball broken along curved cracks, its fragments strewn at random."""
    mesh, random = ball(0.5, 0.1), np.random.default_rng(0)
    world = CollisionWorld(Settings(threads=threads))
    body = CollisionBody(1, 1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra, density=1000.0)
    world.add_body(body)
    event = voronoi(body, seeds, 1, curvature=0.2)
    world.add_fracture(event)
    ids = np.sort(event.new_fragment_ids)
    places = random.uniform(-SPREAD, SPREAD, (len(ids), 3))
    return world, FragmentStates(1, 1, ids, places, np.tile([0.0, 0.0, 0.0, 1.0], (len(ids), 1)))


def seconds_of(ask: Callable[[], object], runs: int) -> float:
    """The least of some runs, after one that loads kernels."""
    ask()
    times = []
    for _ in range(runs):
        began = perf_counter()
        ask()
        times.append(perf_counter() - began)
    return min(times)


@click.command(epilog="Example: python -m benchmarks.queries --fragments 200 --threads 1")
@click.option("--fragments", default=200, show_default=True, help="Seeds of the pattern that breaks the ball.")
@click.option("--threads", default=1, show_default=True, help="Of the world.")
@click.option("--runs", default=5, show_default=True, help="Of which the least counts.")
def main(fragments: int, threads: int, runs: int) -> None:
    """Time queries of a world, and trimesh's for the same surfaces (by embree, in single precision)."""
    world, states = strewn(fragments, threads)
    random, ids = np.random.default_rng(1), states.fragment_ids
    origins, directions = random.uniform(-1.5 * SPREAD, 1.5 * SPREAD, (20_000, 3)), random.normal(size=(20_000, 3))
    pairs = random.choice(ids, (1000, 2))
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    one, points = int(ids[0]), origins[:2000]
    meshes = [world.fragment_mesh(int(i)).to_trimesh() for i in ids]
    alone = meshes[0]
    for mesh, place in zip(meshes, states.positions, strict=True):
        mesh.apply_translation(place)
    every = trimesh.util.concatenate(meshes)
    asked: list[tuple[str, int, Callable[[], object], Callable[[], object] | None]] = [
        (
            "ray", len(origins), lambda: world.cast_rays(states, origins, directions),
            lambda: every.ray.intersects_first(origins, directions),
        ),
        ("distance of a pair", len(pairs), lambda: world.distance(states, pairs), None),
        ("closest point", len(points), lambda: world.closest_points(states, one, points), None),
        (
            "point contained", len(points), lambda: world.contains(states, one, points),
            lambda: alone.contains(points),
        ),
    ]  # fmt: skip
    table = Table(title=f"{len(ids)} fragments, {len(every.faces):,} triangles: us each")
    for name in ("query", "ours", "trimesh"):
        table.add_column(name, justify="left" if name == "query" else "right")
    for name, count, ours, theirs in asked:
        us = [f"{1e6 * seconds_of(ask, runs) / count:.2f}" if ask else "-" for ask in (ours, theirs)]
        table.add_row(name, *us)
    Console().print(table)


if __name__ == "__main__":
    main()
