"""Prints the figures of docs/accuracy.md: the service against slow oracles; takes about four minutes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numba import njit

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # the oracles live with the tests

from oracles.voronoi_cells import against_voronoi_cells  # noqa: E402
from worlds.fractured_worlds import SETTINGS, FracturedWorld, fractured_world  # noqa: E402
from worlds.rigid_shapes import RigidShape, cube, l_block, noisy_ball, torus, true_distance  # noqa: E402

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry  # noqa: E402
from fracture_collision.core.bodies.prepared import prepare_surface  # noqa: E402
from fracture_collision.core.field.elementary_queries import INSIDE, OUTSIDE, probe  # noqa: E402
from fracture_collision.core.memory.pools import OWNER, PARTED  # noqa: E402
from fracture_collision.core.mesh.point_location import owner_in_tetrahedron  # noqa: E402
from fracture_collision.core.mesh.surface_triangles import surface_triangles  # noqa: E402
from fracture_collision.core.search.scratch import make_scratch  # noqa: E402
from fracture_collision.geometry.generators import TetGeometry, ball, bowl, brick, plate, shell  # noqa: E402
from fracture_collision.geometry.tetrahedra import FACE_VERTICES, tetrahedron_volumes  # noqa: E402
from fracture_collision.records import FragmentStates  # noqa: E402
from fracture_collision.world import CollisionWorld  # noqa: E402

BODIES = {
    "ball": ball(1.0, 0.3),
    "brick": brick((2.0, 1.0, 0.8), 0.3),
    "shell": shell(1.0, 0.8, 0.4),
    "plate": plate(2.0, 0.2, 0.3, 0.2),
    "bowl": bowl(2.0, 0.2, 0.3, 0.6),
    "fine ball": ball(1.0, 0.15),
}
SEEDS, GENERATIONS = 8, 2
POINTS, POINTS_OF_FACES = 400, 20_000
ON_SURFACE = 1e-9  # of R
WRONG_WAY = np.cos(np.radians(30.0))
LEGEND = """
mass: pieces against the whole, relative; owners: points with another owner than the oracle's; depth: largest error
against all triangles of the border; one plane: share of the tetrahedra of several fragments that a single plane parts;
open: sum of the area vectors of a fragment's surface, against its area, at most; steps: of 20,000 points of faces that
cracks cross, those with one owner before the face and another behind it, and not on the surface of both; others:
largest relative change of mass of a fragment that had no part in a fracture; off 30: contacts more than 30 degrees off
the flat crack of their pair, places jittered by 1 % R
"""
# Bodies for the comparison with Voronoi cells: a coarse mesh, and one with about half the edge length.
CELL_BODIES = {
    "coarse ball": ball(1.0, 0.34),
    "ball": ball(1.0, 0.17),
    "coarse brick": brick((2.0, 1.2, 0.8), 0.4),
    "brick": brick((2.0, 1.2, 0.8), 0.2),
}
CELL_SEEDS, PATTERNS = (5, 12), 3
CELL_LEGEND = f"""
flat cracks against the Voronoi cells they were drawn by, {PATTERNS} patterns. wrong cell: share of the body's volume,
mean; cell off: a cell's volume less that of its fragments, in parts of the mean cell, at most; other: share of the
tetrahedra of several fragments whose edges or faces meet cells other than those of their own nodes, mean; fitting:
largest difference in one of the rest, in parts of the tetrahedron
"""


def main() -> None:
    print(f"{SEEDS} Voronoi seeds, {GENERATIONS} generations; lengths in units of R, half the body's longest side\n")
    columns = ("body", "cracks", "mass", "owners", "depth", "one plane", "open", "steps", "others", "off 30")
    print("".join(f"{c:>10}" for c in columns))
    for curved in (False, True):
        for name, body in BODIES.items():
            case = fractured_world(body, SEEDS, GENERATIONS, curved)
            radius = 0.5 * np.ptp(body.vertices, axis=0).max()
            owners, depth = _field(case, radius)
            row = (
                name, "curved" if curved else "flat", f"{_mass_error(case, body):.1e}", owners, f"{depth:.1e}",
                f"{_parted(case):.0%}", f"{_open_by(case):.1e}", _steps(case), f"{_change_of_others(case):.1e}",
                "" if curved else f"{_wrong_directions(case, radius):.1%}",
            )  # fmt: skip
            print("".join(f"{entry:>10}" for entry in row), flush=True)
    print(LEGEND)
    _print_cells()
    print(f"{'mesh':>12}{'triangles':>12}{'error':>12}{'wrong signs':>12}")
    for name, shape in (("cube", cube()), ("l_block", l_block()), ("torus", torus()), ("noisy ball", noisy_ball())):
        error, wrong = _triangle_field(shape)
        print(f"{name:>12}{len(shape.triangles):>12}{error:>12.1e}{wrong:>12d}")


def _print_cells() -> None:
    columns = ("body", "tetrahedra", "cells", "wrong cell", "cell off", "other", "fitting")
    print("".join(f"{c:>13}" for c in columns))
    for name, body in CELL_BODIES.items():
        low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
        for count in CELL_SEEDS:
            random = np.random.default_rng(2)
            checks = [against_voronoi_cells(body, random.uniform(low, high, (count, 3))) for _ in range(PATTERNS)]
            misplaced = np.mean([check.misplaced for check in checks])
            off = max(np.abs(check.off).max() for check in checks) * count
            other = np.mean([check.other / (check.other + check.fitting) for check in checks])
            fitting = max(check.worst_fitting for check in checks)
            row = name, len(body.tetrahedra), count, f"{misplaced:.2%}", f"{off:.1%}", f"{other:.0%}", f"{fitting:.0e}"
            print("".join(f"{entry:>13}" for entry in row), flush=True)
    print(CELL_LEGEND)


def _points_within(case: FracturedWorld) -> np.ndarray:
    random = np.random.default_rng(1)
    corners = case.oracle.vertices[case.oracle.tetrahedra[random.integers(0, len(case.oracle.tetrahedra), POINTS)]]
    return np.einsum("nij,ni->nj", corners, random.dirichlet(np.ones(4), POINTS))


def _field(case: FracturedWorld, radius: float) -> tuple[int, float]:
    points = _points_within(case)
    owners = case.oracle.owner(points)
    scratch = make_scratch(len(case.oracle.tetrahedra), 8)
    wrong, error = 0, 0.0
    for fragment in case.oracle.fragment_ids:
        own = owners == fragment
        answers = [probe(case.geometry.pools, case.row(fragment), tuple(p), 0.0, np.inf, scratch)[:2] for p in points]
        wrong += sum((status == INSIDE) != mine for (status, _), mine in zip(answers, own, strict=True))
        if not own.any():
            continue
        measured = -np.array([distance for (_, distance), mine in zip(answers, own, strict=True) if mine])
        error = max(error, np.abs(measured - case.oracle.depth(fragment, points[own])[0]).max())
    return wrong, error / radius


def _parted(case: FracturedWorld) -> float:
    pools, row = case.geometry.pools, case.row(case.oracle.fragment_ids[0])
    owners = pools.body.regions[np.array(case.geometry.tet_range(row)) + pools.fragment.tet_shift[row], OWNER]
    return float((owners == PARTED).sum() / (owners < 0).sum())


def _open_by(case: FracturedWorld) -> float:
    """Largest sum of the area vectors of a fragment's surface, relative to its area; zero if the surface is closed."""
    largest = 0.0
    for fragment in case.oracle.fragment_ids:
        row = case.row(fragment)
        corners, _ = surface_triangles(case.geometry.pools, row, case.geometry.tet_range(row))
        areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        largest = max(largest, np.linalg.norm(areas.sum(axis=0)) / np.linalg.norm(areas, axis=1).sum())
    return largest


def _steps(case: FracturedWorld) -> int:
    """Points of faces between fragments whose owner differs between the two adjacent tetrahedra."""
    pools, row = case.geometry.pools, case.row(case.oracle.fragment_ids[0])
    mesh, labels = pools.mesh, pools.body.node_fragment
    before, face = np.nonzero(mesh.neighbours >= 0)
    nodes = np.take_along_axis(mesh.tetrahedra[before], FACE_VERTICES[face].astype(np.int64), axis=1)
    owners = labels[nodes + pools.fragment.node_shift[row]]
    random = np.random.default_rng(5)
    chosen = random.choice(np.flatnonzero(np.any(owners != owners[:, :1], axis=1)), POINTS_OF_FACES)
    points = np.einsum("nij,ni->nj", mesh.nodes[nodes[chosen]], random.dirichlet(np.ones(3), POINTS_OF_FACES))
    before, behind = before[chosen], mesh.neighbours[before[chosen], face[chosen]]
    sides = np.column_stack((_owners(pools, row, before, points), _owners(pools, row, behind, points)))
    scratch, near = make_scratch(len(mesh.tetrahedra), 8), ON_SURFACE * pools.fragment.radius[row]
    steps = 0
    for i in np.flatnonzero(sides[:, 0] != sides[:, 1]).tolist():
        # on a crack that lies in the face, either owner is correct
        answers = (probe(pools, owner, tuple(points[i]), near, np.inf, scratch)[:2] for owner in sides[i].tolist())
        steps += not all(status != OUTSIDE and abs(distance) <= near for status, distance in answers)
    return steps


# Not cached: a cache in this folder would outlive changes to the kernel inlined here.
@njit(error_model="numpy")
def _owners(pools, fragment, tets, points):
    """Fragment rows (n,) that own the points (n, 3) [m] in tetrahedra `tets` (n,)."""
    owners = np.empty(len(points), np.int64)
    for i in range(len(points)):
        owners[i] = owner_in_tetrahedron(pools, fragment, tets[i], points[i, 0], points[i, 1], points[i, 2])
    return owners


def _mass_error(case: FracturedWorld, body: TetGeometry) -> float:
    registry = case.world.fragments()
    whole = CollisionWorld(SETTINGS)
    whole.add_body(case.messages[0][0])
    assert np.isclose(whole.fragments().masses[0], 2500.0 * tetrahedron_volumes(*body).sum())
    return abs(registry.masses.sum() / whole.fragments().masses[0] - 1.0)


def _change_of_others(case: FracturedWorld) -> float:
    world = CollisionWorld(SETTINGS)
    world.add_body(case.messages[0][0])
    masses: dict[int, float] = {}
    largest = 0.0
    for event in case.messages[1]:
        world.add_fracture(event)
        world.contacts(FragmentStates(1, event.sequence, np.zeros(0, int), np.zeros(0), np.zeros(0)))
        registry = world.fragments()
        now = dict(zip(registry.fragment_ids.tolist(), registry.masses.tolist(), strict=True))
        largest = max([largest, *(abs(now[f] / masses[f] - 1.0) for f in now if f in masses)])
        masses = now
    return largest


def _wrong_directions(case: FracturedWorld, radius: float) -> float:
    """Share of contacts whose normal is more than 30 degrees off the single plane between their two fragments."""
    planes: dict[tuple[int, int], set[tuple]] = {}
    for (a, b), plane in case.oracle.planes.items():
        pair = (int(case.oracle.labels[a]), int(case.oracle.labels[b]))
        oriented = plane if pair[0] < pair[1] else -plane
        planes.setdefault((min(pair), max(pair)), set()).add(tuple(np.round(oriented + 0.0, 12).tolist()))
    wrong = total = 0
    for seed in range(5):
        answer = case.world.contacts(case.states(0.01 * radius, seed))
        normals = answer.normals.reshape(-1, 3)
        for i, pair in enumerate(zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)):
            shared = planes.get(pair, set())
            if len(shared) != 1:
                continue
            own = normals[answer.pair_begin[i] : answer.pair_begin[i + 1]]
            total += len(own)
            wrong += int((own @ np.array(next(iter(shared)))[:3] < WRONG_WAY).sum())
    return wrong / total if total else float("nan")


def _triangle_field(shape: RigidShape) -> tuple[float, int]:
    geometry = CollisionGeometry()
    geometry.add_triangles(prepare_surface(*shape))
    random = np.random.default_rng(3)
    weights = random.dirichlet(np.ones(3), 1000)
    near = np.einsum("ij,ijk->ik", weights, shape.corners[random.integers(0, len(shape.corners), 1000)])
    points = near + random.normal(size=near.shape) * 10.0 ** random.uniform(-6, 0, (1000, 1))
    scratch = make_scratch(1, 8)
    measured = np.array([probe(geometry.pools, 0, tuple(p), np.inf, np.inf, scratch)[1] for p in points])
    expected = true_distance(shape, points)
    return float(np.abs(np.abs(measured) - np.abs(expected)).max()), int((measured * expected < 0.0).sum())


if __name__ == "__main__":
    main()
